"""Advice, rejected samples and coverage: from figures to sentences and curves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery, turn

from calib.motion import (
    ArmEstimates,
    ClockOffset,
    Evidence,
    ForearmFrame,
    JointError,
    forearm_frame,
    found_in,
    gather_from,
)
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.evaluation.advice import NOTHING, advice, rejected, towards_the_camera
from smoother.evaluation.coverage import LEVELS, camera_residuals, stated_and_actual
from smoother.measurements.visibility import Gap, Reason
from smoother.recording import JOINTS
from smoother.result import Estimates, Recovery

FRAMES = dict.fromkeys(("shoulder", "elbow", "wrist", "hand", "upper_arm"), 500)
GOOD = Evidence(visible_s=25.0, frames=FRAMES, turning_rad_s=2.0, axial_rad=2.5)
OFFSET = ClockOffset("rec", 0.02, 0.001, 0.0)
WIDE = np.array([0.2, 0.0, 0.0])


def arm(sigma_m: float = 0.003) -> ArmCalibration:
    places = {"elbow": [-0.035, -0.20, 0.0], "wrist": [-0.035, 0.05, 0.0], "hand": [-0.03, 0.13, 0.0]}
    levers = {joint: LeverArm(np.array(place), np.full(3, sigma_m)) for joint, place in places.items()}
    return ArmCalibration("right", levers, Length(0.3, 0.003))


def found(**changes: object) -> ArmEstimates:
    calibration = changes.get("calibration", arm())
    assert isinstance(calibration, ArmCalibration)
    whole = ArmEstimates(calibration, forearm_frame(calibration), (OFFSET,), GOOD, ())
    return replace(whole, **changes)  # type: ignore[arg-type]


def result() -> Recovery:
    """A forearm that lies across the view, seen all the time."""
    recovery = make_recovery(make_recording())
    return replace(recovery, joints=recovery.joints | {"wrist": recovery.joints["elbow"] + WIDE})


def said(recovery: Recovery | None = None, known: ArmEstimates | None = None) -> str:
    return "\n".join(advice(recovery or result(), known or found()))


def hidden(recovery: Recovery, gap: Gap, sigma_m: float) -> Recovery:
    covariance = recovery.pose_covariance.copy()
    inside = (recovery.t_s > gap.start_s) & (recovery.t_s < gap.end_s)
    covariance[inside, :3, :3] = sigma_m**2 * np.eye(3)
    return replace(recovery, gaps=(gap,), occluded=inside, pose_covariance=covariance)


def with_reason(recovery: Recovery, reason: str, joint: str, frames: slice) -> Recovery:
    kept = recovery.residuals
    assert kept is not None
    codes, used = kept.reason.copy(), kept.used.copy()
    codes[frames, JOINTS.index(joint)] = len(kept.reasons)
    used[frames, JOINTS.index(joint)] = False
    kept = replace(kept, reason=codes, reasons=(*kept.reasons, Reason.of_sentence(reason)), used=used)
    return replace(recovery, residuals=kept)


def test_a_good_recording_asks_for_nothing():
    assert said() == NOTHING
    assert advice(result(), None) == [NOTHING]


def test_roll():
    loose = found(calibration=arm(0.012))
    turned_little = replace(loose, evidence=replace(GOOD, axial_rad=0.3))
    assert "palm up and palm down, three times in view" in said(known=turned_little)
    assert "palm up" not in said(known=loose)  # it turned: turning more is no help
    assert "palm up" not in said(known=replace(turned_little, given=("elbow", "wrist", "hand", "upper_arm")))


@pytest.mark.parametrize(("part", "value"), [("visible_s", 4.0), ("turning_rad_s", 0.05)])
def test_little_motion(part, value):
    text = said(known=found(evidence=replace(GOOD, **{part: value})))
    assert text.startswith("Begin with 20 s of lively motion in view (bend")
    nothing = Evidence(0.0, {"strap": 9}, float("nan"), float("nan"))
    assert "(turn and move the sensor): this recording showed 0 s, turning 0" in said(
        known=found(evidence=nothing)
    )


def test_lever_arms_beyond_the_cameras_own_error():
    rough = found(calibration=arm(0.02))
    assert "about more than one axis in view, sideways too: where the elbow, wrist and hand lie" in said(
        known=rough
    )
    assert "more than one axis" not in said(known=replace(rough, joint_bias_sigma_m=0.014))


@pytest.mark.parametrize(
    ("gap", "sentence"),
    [
        (Gap(0.0, 2.0, open_start=True), "1.5 s before the first movement out of view: the gap at 0.0 s was"),
        (Gap(18.0, 20.0, open_end=True), "1.5 s after the last one: the gap at 18.0 s was seen from one"),
        (
            Gap(5.0, 9.0),
            "into view for a moment every 3 s: in the gap at 5.0 s the position is known to 8 cm",
        ),
    ],
)
def test_gaps(gap, sentence):
    assert sentence in said(hidden(result(), gap, 0.08))
    assert "for a moment" not in said(hidden(result(), gap, 0.02))


def test_short_gaps_need_nothing():
    assert said(hidden(result(), Gap(5.0, 7.0), 0.08)) == NOTHING


def test_clock():
    slow = found(offsets=(replace(OFFSET, sigma_s=0.016),))
    assert "Move briskly at the start, in view" in said(known=slow) and "to 16 ms only" in said(known=slow)
    wandered = found(offsets=(replace(OFFSET, drift_s=0.06),))
    assert "moved against each other by 60 ms" in said(known=wandered)


def test_shoulder():
    recovery = hidden(result(), Gap(5.0, 7.0), 0.01)
    away = (recovery.arm.t_s > 5.2) & (recovery.arm.t_s < 7.0)
    lost = replace(recovery, arm=recovery.arm.hide(away, ("shoulder",)))
    assert "Keep the shoulder in view while the forearm is hidden: it was seen in 10 %" in said(lost)
    never = replace(recovery, arm=recovery.arm.hide(np.ones(len(recovery.arm), bool), ("shoulder",)))
    assert "Keep the shoulder in view: it and the upper arm's length" in said(never)


def test_towards_the_camera():
    elbow = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 2.0], [np.nan, 0.0, 0.0]])
    along = np.array([[0.0, 0.0, -0.25], [0.25, 0.0, 0.0], [0.0, 0.0, 1.0]])
    angle = towards_the_camera(elbow, elbow + along)
    assert angle[0] == pytest.approx(0.0, abs=1e-6) and angle[1] > 85 and np.isnan(angle[2])
    recovery = result()
    elbow = recovery.joints["elbow"]
    pointing = replace(recovery, joints=recovery.joints | {"wrist": 0.88 * elbow})
    assert "Stand a little sideways to the camera, or put it higher: the forearm pointed at it 100 %" in said(
        pointing
    )
    some = with_reason(recovery, "viewing ray: misjudged", "wrist", slice(0, 30))
    assert "Stand a little sideways" in said(some)


def test_camera():
    assert "samples repeated the one before" in said(
        with_reason(result(), "frozen: it stands", "elbow", slice(0, 200))
    )
    assert "were not on the arm" in said(with_reason(result(), "jump: far", "hand", slice(0, 200)))
    loud = found(camera={"elbow": JointError(0.008), "wrist": JointError(0.021)})
    assert "Move closer to the camera" in said(known=loud) and "the wrist jittered by 2.1 cm" in said(
        known=loud
    )
    assert "2.0 cm off, always in the same way" in said(known=found(joint_bias_sigma_m=0.02))


def test_what_contradicts_hardly_any_motion_is_not_held_against_the_camera():
    recovery = with_reason(result(), "residual: off", "elbow", slice(0, 200))
    assert "were not on the arm" in said(recovery)
    assert "were not on the arm" not in said(recovery, found(evidence=replace(GOOD, turning_rad_s=0.01)))


def test_rates():
    recovery = result()
    slow = replace(recovery, arm=recovery.arm.select(slice(None, None, 3)), residuals=None)
    assert "30 frames per second: it gave 10" in said(slow)
    few = replace(recovery, t_s=3.0 * recovery.t_s)
    assert "80 samples per second or more: it gave 27" in said(few)


def test_rejected_by_reason_and_joint():
    recovery = with_reason(result(), "jump: far off", "wrist", slice(10, 13))
    recovery = with_reason(recovery, "frozen: still", "elbow", slice(20, 60))
    rows = rejected(recovery)
    assert [(row.reason, row.why, row.joint, row.count) for row in rows] == [
        ("frozen", "still", "elbow", 40),
        ("jump", "far off", "wrist", 3),
    ]
    t = recovery.residuals.t_s
    assert rows[1].share == pytest.approx(3 / len(t))
    assert (rows[1].first_s, rows[1].last_s) == (t[10], t[12])
    assert rejected(result()) == rejected(replace(recovery, residuals=None)) == []


def test_coverage_of_honest_and_bold_errors():
    rng = np.random.default_rng(1)
    covariance = np.tile(np.diag([1e-4, 4e-4, 9e-4]), (20000, 1, 1))
    error = rng.normal(size=(20000, 3)) * [0.01, 0.02, 0.03]
    honest = stated_and_actual(error, covariance)
    np.testing.assert_allclose(honest.coverage(), LEVELS, atol=0.02)
    stated, actual = honest.binned()
    np.testing.assert_allclose(stated, actual, rtol=0.05)
    bold = stated_and_actual(2 * error, covariance)
    assert (bold.coverage() < LEVELS).all() and bold.inside(0.95) < 0.6
    error[:5] = np.nan
    assert len(stated_and_actual(error, covariance).squared) == 19995
    nothing = stated_and_actual(error[:5], covariance[:5])
    assert np.isnan(nothing.coverage()).all() and len(nothing.binned()[0]) == 0


def test_camera_residuals_hold_the_noise_and_no_constant_error():
    recovery = result()  # its residuals are white, 8 mm
    off = {"wrist": [0.02, 0.0, 0.0]}
    kept = recovery.residuals
    assert kept is not None
    residual = kept.residual.copy()
    residual[:, JOINTS.index("wrist")] += off["wrist"]
    figures = {"camera_sigma_m": {"elbow": 0.008, "wrist": 0.008}, "joint_bias_m": off}
    recovery = replace(
        recovery, residuals=replace(kept, residual=residual), estimates=Estimates.from_plain(figures)
    )
    both = camera_residuals(recovery)
    assert set(both) == {"elbow", "wrist"}
    for each in both.values():
        assert each.inside(0.95) == pytest.approx(0.95, abs=0.03)
    assert camera_residuals(result()) == {}


def test_what_a_recovery_shows():
    recovery = result()
    evidence = gather_from(recovery)
    assert evidence.visible_s == pytest.approx(20.0, abs=0.1)
    step = turn(recovery.t_s)[:-1].inv() * turn(recovery.t_s)[1:]
    rates = step.magnitude() / np.diff(recovery.t_s)
    assert evidence.turning_rad_s == pytest.approx(np.sqrt(np.mean(rates**2)), rel=1e-3)
    assert evidence.frames["wrist"] == evidence.frames["upper_arm"] == len(recovery.arm)
    whole = found_in(recovery)
    assert whole is not None and whole.offsets[0].offset_s == 0.0 and not whole.all_given
    assert isinstance(whole.frame, ForearmFrame)
    assert found_in(replace(recovery, calibration=None)) is None
    given = {"given": ["elbow", "wrist", "hand", "upper_arm"]}
    told = found_in(replace(recovery, estimates=Estimates.from_plain(given)))
    assert told is not None and told.all_given


def test_how_far_the_clock_wandered():
    recording = make_recording()
    recovery = make_recovery(recording, offset_s=0.01)
    t = recovery.arm.t_s
    bent = replace(recovery, arm=replace(recovery.arm, t_s=t + 0.002 * t))
    found_there = found_in(bent, recording)
    assert found_there is not None
    assert found_there.offsets[0].drift_s == pytest.approx(0.002 * np.ptp(t), rel=1e-6)
