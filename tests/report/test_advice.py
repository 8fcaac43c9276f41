"""From figures to sentences: advice, the methods section of a paper."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import make_recording, make_recovery
from commands import done
from results import made

from calib.motion import ArmEstimates, ClockOffset, Evidence, forearm_frame, found_in
from smoother import __version__
from smoother.baselines.registry import BASELINES, ORIENTATIONS
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.error_radius import error_radius
from smoother.evaluation.advice import NOTHING, advice, towards_the_camera
from smoother.io import read_recovery, write_recovery
from smoother.measurements.visibility import Gap, Reason
from smoother.recording import JOINTS
from smoother.report.methods import CITATION, ORIENTATION_WORDS, REFERENCES, methods_section
from smoother.result import Estimates, Pairing, Recovery, SelfCheck, UntrustedInterval

FRAMES = dict.fromkeys(("shoulder", "elbow", "wrist", "hand", "upper_arm"), 500)
GOOD = Evidence(visible_s=25.0, frames=FRAMES, turning_rad_s=2.0, axial_rad=2.5)
STILL = replace(GOOD, turning_rad_s=0.01)
OFFSET = ClockOffset("rec", 0.02, 0.001, 0.0)
WIDE = np.array([0.2, 0.0, 0.0])


def arm(sigma_m: float = 0.003) -> ArmCalibration:
    places = {"elbow": [-0.035, -0.20, 0.0], "wrist": [-0.035, 0.05, 0.0], "hand": [-0.03, 0.13, 0.0]}
    levers = {joint: LeverArm(np.array(place), np.full(3, sigma_m)) for joint, place in places.items()}
    return ArmCalibration("right", levers, Length(0.3, 0.003))


def found(calibration: ArmCalibration | None = None, **changes: object) -> ArmEstimates:
    calibration = calibration or arm()
    whole = ArmEstimates(calibration, forearm_frame(calibration), (OFFSET,), GOOD, ())
    return replace(whole, **changes)  # type: ignore[arg-type]


def result() -> Recovery:
    """A forearm that lies across the view, seen all the time."""
    recovery = make_recovery(make_recording())
    return replace(recovery, joints=recovery.joints | {"wrist": recovery.joints["elbow"] + WIDE})


def said(recovery: Recovery | None = None, known: ArmEstimates | None = None) -> str:
    return "\n".join(advice(recovery or result(), known or found()))


def hidden(gap: Gap, sigma_m: float = 0.01) -> Recovery:
    recovery = result()
    covariance = recovery.pose_covariance.copy()
    inside = (recovery.t_s > gap.start_s) & (recovery.t_s < gap.end_s)
    covariance[inside, :3, :3] = sigma_m**2 * np.eye(3)
    return replace(recovery, gaps=(gap,), occluded=inside, pose_covariance=covariance)


def without_shoulder(from_s: float, to_s: float) -> Recovery:
    recovery = hidden(Gap(5.0, 7.0))
    away = (recovery.arm.t_s > from_s) & (recovery.arm.t_s < to_s)
    return replace(recovery, arm=recovery.arm.hide(away, ("shoulder",)))


def pointing() -> Recovery:
    recovery = result()
    return replace(recovery, joints=recovery.joints | {"wrist": 0.88 * recovery.joints["elbow"]})


def slow_camera() -> Recovery:
    recovery = result()
    return replace(recovery, arm=recovery.arm.select(slice(None, None, 3)), residuals=None)


def with_reason(reason: str, joint: str, frames: slice, of: Recovery | None = None) -> Recovery:
    recovery = of or result()
    kept = recovery.residuals
    assert kept is not None
    codes, used = kept.reason.copy(), kept.used.copy()
    codes[frames, JOINTS.index(joint)] = len(kept.reasons)
    used[frames, JOINTS.index(joint)] = False
    kept = replace(kept, reason=codes, reasons=(*kept.reasons, Reason.of_sentence(reason)), used=used)
    return replace(recovery, residuals=kept)


LOOSE = found(arm(0.012))
TURNED_LITTLE = replace(LOOSE, evidence=replace(GOOD, axial_rad=0.3))
ROUGH = found(arm(0.02))
MANY = slice(0, 200)
#: What is said of a recovery or of what a recording showed.
CASES: dict[str, Recovery | ArmEstimates | Callable[[], Recovery]] = {
    "palm up and palm down, three times in view": TURNED_LITTLE,
    "Begin with 20 s of lively motion in view (bend": found(evidence=replace(GOOD, visible_s=4.0)),
    "(bend and stretch the elbow and raise the arm)": found(evidence=replace(GOOD, turning_rad_s=0.05)),
    "(turn and move the sensor): this recording showed 0 s, turning 0": found(
        evidence=Evidence(0.0, {"strap": 9}, float("nan"), float("nan"))
    ),
    "sideways too: as seen from the sensor the place of elbow, wrist and hand is known": ROUGH,
    "hidden from 0.0 s on was seen from one side": lambda: hidden(Gap(0.0, 2.0, open_start=True), 0.08),
    "hidden from 18.0 s on was seen from one side": lambda: hidden(Gap(18.0, 20.0, open_end=True), 0.08),
    "every 3 s: in what was hidden from 5.0 s on the position is known to 8 cm": lambda: hidden(
        Gap(5.0, 9.0), 0.08
    ),
    "in view: the clocks of sensor and camera were matched to 16 ms only": found(
        offsets=(replace(OFFSET, sigma_s=0.016),)
    ),
    "moved against each other by 60 ms": found(offsets=(replace(OFFSET, drift_s=0.06),)),
    "Keep the shoulder in view while the forearm is hidden: it was seen in 10 %": lambda: without_shoulder(
        5.2, 7.0
    ),
    "Keep the shoulder in view: it and the upper arm's length": lambda: without_shoulder(-1.0, 99.0),
    "Stand a little sideways to the camera, or put it higher: the forearm pointed at it 100 %": pointing,
    "Stand a little sideways": lambda: with_reason("viewing ray: misjudged", "wrist", slice(0, 30)),
    "samples repeated the one before": lambda: with_reason("frozen: it stands", "elbow", MANY),
    "were not on the arm": lambda: with_reason("jump: far", "hand", MANY),
    "Move closer to the camera (1.5 to 3 m), with even light and without loose sleeves: the wrist jittered"
    " by 2.1 cm": found(camera_sigma_m={"elbow": 0.008, "wrist": 0.021}),
    "2.0 cm off, always in the same way": found(joint_bias_sigma_m=0.02),
    "30 frames per second: it gave 10": slow_camera,
    "80 samples per second or more: it gave 27": lambda: replace(result(), t_s=3.0 * result().t_s),
}


@pytest.mark.parametrize("sentence", CASES)
def test_each_fault_has_its_sentence(sentence: str):
    case = CASES[sentence]
    text = said(known=case) if isinstance(case, ArmEstimates) else said(case() if callable(case) else case)
    assert sentence in text


def test_what_is_good_or_would_not_help_asks_for_nothing():
    assert said() == NOTHING and advice(result(), None) == [NOTHING]
    assert said(hidden(Gap(5.0, 7.0), 0.08)) == NOTHING, "short gaps need nothing"
    assert "for a moment" not in said(hidden(Gap(5.0, 9.0), 0.02))
    assert "palm up" not in said(known=LOOSE), "it turned: turning more is no help"
    assert "palm up" not in said(known=replace(TURNED_LITTLE, given=(*FRAMES,)))
    assert "more than one axis" not in said(known=replace(ROUGH, joint_bias_sigma_m=0.014))
    contradicting = with_reason("residual: off", "elbow", MANY)
    assert "were not on the arm" in said(contradicting)
    assert "were not on the arm" not in said(contradicting, found(evidence=STILL)), "it hardly moved"


def test_how_far_the_forearm_points_at_the_camera():
    elbow = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 2.0], [np.nan, 0.0, 0.0]])
    along = np.array([[0.0, 0.0, -0.25], [0.25, 0.0, 0.0], [0.0, 0.0, 1.0]])
    angle = towards_the_camera(elbow, elbow + along)
    assert angle[0] == pytest.approx(0.0, abs=1e-6) and angle[1] > 85 and np.isnan(angle[2])


def test_what_a_recovery_shows_and_what_was_given():
    whole = found_in(result())
    assert whole is not None and whole.offsets[0].offset_s == 0.0 and not whole.all_given
    assert found_in(replace(result(), calibration=None)) is None
    given = {"given": ["elbow", "wrist", "hand", "upper_arm"]}
    told = found_in(replace(result(), estimates=Estimates.from_plain(given)))
    assert told is not None and told.all_given


def test_how_far_the_clock_wandered():
    recording = make_recording()
    recovery = make_recovery(recording, offset_s=0.01)
    t = recovery.arm.t_s
    there = found_in(replace(recovery, arm=replace(recovery.arm, t_s=t + 0.002 * t)), recording)
    assert there is not None
    assert there.offsets[0].drift_s == pytest.approx(0.002 * np.ptp(t), rel=1e-6)


CHECK = SelfCheck(8, 1, 1.7, 0.011, 0.010, 0.96, 1.4, 1.1)
#: What a section says, and the result of which it may say it; without it, it may not.
DONE = {
    "independent reference": {"self_check": CHECK},
    "multiplied by 1.30": {"sigma_factors": (1.0, 1.3)},
    "The magnetometer was used in 7 of 9": {"magnetometer_blocks": 9, "magnetometer_blocks_used": 7},
    "Given beforehand: elbow": {"given": ("elbow",)},
    "measured beforehand: +10.0 ms with 2.0 ms": {"clock_given_s": (0.01, 0.002)},
    "tested and proved (by chance: 0.0001)": {"pairing": Pairing(True, 1e-4, 120.0)},
    "tested and not proved": {"pairing": Pairing(False, 0.4, 3.0)},
    "1 gaps not trusted": {"trusted": True, "untrusted": (UntrustedInterval(9.0, 12.0, ("a push",)),)},
    "Gyroscope's bias": {"gyroscope_bias": (0.01, 0.0, 0.0)},
}


def section(recovery: Recovery, version: str = "9.9", simulation: str = "") -> str:
    return methods_section([recovery], version, simulation)[0]


@pytest.mark.parametrize("words", DONE)
def test_what_was_done_is_named_and_nothing_else(words: str) -> None:
    assert words in section(replace(made(), estimates=Estimates(**DONE[words])))
    assert words not in section(replace(made(), estimates=Estimates()))


def test_figures_are_the_results() -> None:
    one = made()
    text, t = section(one), one.t_s
    inside = np.zeros(len(t), bool)
    for gap in one.gaps:
        inside |= (t >= gap.start_s) & (t <= gap.end_s)
    worst_cm = 100 * np.nanmax(error_radius(np.asarray(one.pose_covariance)[inside, :3, :3]))
    occluded_s = sum(gap.end_s - gap.start_s for gap in one.gaps)
    for part in (
        f"recorded for {t[-1] - t[0]:.1f} s by a camera ({len(one.arm)} frames",
        f"({len(t)} samples of the forearm's, median rate {1 / np.median(np.diff(t)):.1f} Hz)",
        f"in {len(one.gaps)} gaps of {occluded_s:.1f} s in total",
        f"within {worst_cm:.1f} cm in 95 of 100 cases",
        f"estimated as {1e3 * one.clock_offset_s:+.1f} ± {1e3 * one.clock_offset_sigma_s:.1f} ms",
        "unocclude 9.9 [1]",
    ):
        assert part in text, part


def test_a_bare_result_and_a_simulation_claim_nothing() -> None:
    bare = replace(
        made(), calibration=None, gaps=(), clock_offset_s=float("nan"), residuals=None, estimates=Estimates()
    )
    assert "The forearm was never occluded." in section(bare)
    assert not [words for words in ("Place of", "clock offset", "Clock") if words in section(bare)]
    assert "Participants" in section(made()) and "Participants" not in section(made(), simulation="an arm")


@pytest.mark.parametrize("method", BASELINES)
def test_a_baseline_is_not_called_the_graph(method: str) -> None:
    estimates = Estimates(self_check=CHECK, further={"orientation": "madgwick"}, trusted=True)
    text = section(replace(made(), method=method, estimates=estimates))
    assert CITATION.sub("", BASELINES[method].words).split(" after")[0].strip() in text
    assert "Madgwick's" in text and "preintegration" not in text and "independent reference" not in text


def test_every_source_is_known_and_listed_once() -> None:
    texts = [*(entry.words for entry in BASELINES.values()), *ORIENTATION_WORDS.values()]
    assert {key for text in texts for key in CITATION.findall(text)} <= REFERENCES.keys()
    assert ORIENTATION_WORDS.keys() == set(ORIENTATIONS)
    hostile = section(replace(made(), name="a|b_c<d>[@gtsam].mcap"))
    table = [line for line in hostile.splitlines() if line.startswith("|")]
    assert len(table) > 4 and all(len(re.findall(r"(?<!\\)\|", line)) == 3 for line in table)
    listed = re.findall(r"^(\d+)\. ", hostile, re.MULTILINE)
    assert listed == [str(n + 1) for n in range(len(listed))]


def test_the_command_gives_each_arm_a_section(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recovery([made("left"), made("right")], tmp_path / "out.mcap")
    done("methods", tmp_path / "out.mcap", "-o", tmp_path / "m.md", "--json", tmp_path / "m.json")
    text = (tmp_path / "m.md").read_text(encoding="utf-8")
    assert text.count("## Methods: ") == 2 and text.count("### References") == 1 and __version__ in text
    assert json.loads((tmp_path / "m.json").read_text(encoding="utf-8"))["text"] == text
    assert len(read_recovery(tmp_path / "out.mcap")) == 2
    capsys.readouterr()
    done("methods", tmp_path / "out.mcap", "--side", "left")
    assert "right arm" not in capsys.readouterr().out
