"""Drawn motions, verdicts by gap and by sample, and estimates as plain values: what a result holds."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import made_results
import numpy as np
import pytest
from scenes import answer, moving
from scipy.spatial.transform import Rotation

from smoother.errors import UnoccludeError
from smoother.measurements.visibility import Gap
from smoother.recovery.drawn_samples import _widened
from smoother.recovery.samples import widen_turns
from smoother.result import Draws, Estimates, Recovery, SelfCheck, UntrustedInterval
from smoother.result.verdict import from_plain, gap_verdicts, plain, trusted_at
from smoother.simulation import SimulatedArm

DRAWS = 300


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    """Two windows, with a gap in each."""
    return moving(2, duration_s=20.0, occlusion_lengths_s=(1.5,))


@pytest.fixture(scope="module")
def drawn(made: SimulatedArm) -> Recovery:
    return answer(made.recording, made.calibration, draws=DRAWS, seed=4)


def whitened(drawn: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Mean square of draws (k, n, d) in sigmas at each time (n,), a coordinate: 1 where they agree."""
    spread = np.einsum("kni,knj->nij", drawn, drawn, dtype=float) / len(drawn)
    return np.einsum("nii->n", np.linalg.solve(covariance, spread)) / drawn.shape[2]


def test_they_have_the_covariance_that_the_answer_states(drawn: Recovery) -> None:
    draws = drawn.draws
    assert draws is not None and len(draws) == DRAWS
    rows = np.searchsorted(drawn.t_s, draws.t_s)
    np.testing.assert_array_equal(drawn.t_s[rows], draws.t_s)
    pose = whitened(np.concatenate([draws.position, draws.rotation], axis=2), drawn.pose_covariance[rows])
    # six coordinates of 300 draws: a mean square is known to 3 %; between nodes covariances are interpolated
    assert abs(np.median(pose) - 1.0) < 0.06 and pose.min() > 0.75 and pose.max() < 1.25
    for joint in ("elbow", "wrist", "hand"):
        square = whitened(draws.joints[joint], drawn.joint_covariance[joint][rows])
        assert abs(np.median(square) - 1.0) < 0.1 and square.min() > 0.7 and square.max() < 1.3, joint
    # between the shoulder's knots the stated covariance is that of the knots, a straight line has less
    square = whitened(draws.joints["shoulder"], drawn.joint_covariance["shoulder"][rows])
    assert square.max() < 1.25 and square.min() > 0.4 and np.percentile(square, 95) > 0.9
    for values in (draws.position, draws.rotation, *draws.joints.values()):
        # the mean of 300 draws is off by 0.06 sigma; four times that anywhere
        assert (np.abs(values.mean(axis=0)) < 0.25 * values.std(axis=0)).all()
    inner = (drawn.t_s > 1.0) & (drawn.t_s < 19.0)
    faster = np.array([drawn.drawn(k).velocity - drawn.velocity for k in range(100)])[:, inner]
    ratio = faster.var(axis=0).sum(axis=1) / np.trace(drawn.velocity_covariance[inner], axis1=1, axis2=2)
    # the derivative of what is drawn 25 times per second; the interpolated covariances say no more
    assert 0.7 < np.median(ratio) < 1.3


def test_numbers_below_zero_are_refused(made: SimulatedArm) -> None:
    for wrong in ({"draws": -1}, {"draws": 2, "seed": -1}):
        with pytest.raises(UnoccludeError, match="0 or more; not -1"):
            answer(made.recording, made.calibration, **wrong)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_motions_and_the_answer_stays(
    made: SimulatedArm, drawn: Recovery
) -> None:
    few = answer(made.recording, made.calibration, draws=2, seed=4)
    # the same but for the rounding of products that are as wide as there are draws
    np.testing.assert_allclose(few.draws.position, drawn.draws.position[:2], atol=1e-6)
    np.testing.assert_allclose(few.draws.rotation, drawn.draws.rotation[:2], atol=1e-6)
    for name in ("position", "quaternion", "pose_covariance"):
        np.testing.assert_array_equal(getattr(few, name), getattr(drawn, name))


def test_wide_angles_are_widened_as_their_covariance_is() -> None:
    """Exactly: the rows of a square root stand for the draws."""
    root = np.random.default_rng(1).normal(size=(3, 6, 6)) * np.array([0.005, 0.1, 0.4])[:, None, None]
    covariance, draws = root @ root.transpose(0, 2, 1), root.transpose(0, 2, 1)  # draws (n, k, 6)
    both = np.concatenate(_widened(draws[:, :, :3], draws[:, :, 3:], covariance), axis=2)
    np.testing.assert_allclose(np.einsum("nki,nkj->nij", both, both), widen_turns(covariance), rtol=1e-9)
    assert widen_turns(covariance)[2, 3, 3] > 2.0 * covariance[2, 3, 3]
    np.testing.assert_array_equal(both[0], draws[0])  # small angles stay


def with_draws(count: int = 3, step_s: float = 0.04) -> Recovery:
    """A made-up answer with deviations that swing smoothly, at their own times."""
    recovery = made_results.recovery()
    t = np.arange(recovery.t_s[0], recovery.t_s[-1], step_s)
    phase = np.arange(count)[:, None, None] + np.arange(3) + 2 * np.pi * 0.5 * t[:, None]
    swing = 0.01 * np.sin(phase)
    joints = {joint: 2 * swing for joint in ("elbow", "wrist")}
    return replace(recovery, draws=Draws(t, 7, swing, 3 * swing, joints))


def swing(recovery: Recovery, k: int) -> np.ndarray:
    t = recovery.t_s
    return 0.01 * np.sin(k + np.arange(3) + 2 * np.pi * 0.5 * t[:, None])


def test_a_drawn_motion_is_the_answer_and_its_deviation_at_every_sample() -> None:
    recovery = with_draws()
    drawn, inner = recovery.drawn(1), slice(10, 380)
    moved = swing(recovery, 1)
    # a cubic spline through 50 points a period: its error is of the fourth order of the step
    np.testing.assert_allclose((drawn.position - recovery.position)[inner], moved[inner], atol=1e-6)
    np.testing.assert_allclose(
        (drawn.joints["wrist"] - recovery.joints["wrist"])[inner], 2 * moved[inner], atol=2e-6
    )
    np.testing.assert_array_equal(drawn.joints["shoulder"], recovery.joints["shoulder"])  # not drawn
    known = np.isfinite(recovery.quaternion).all(axis=1) & (np.arange(400) > 9) & (np.arange(400) < 380)
    turn = (
        Rotation.from_quat(drawn.quaternion[known], scalar_first=True)
        * Rotation.from_quat(recovery.quaternion[known], scalar_first=True).inv()
    )
    np.testing.assert_allclose(turn.as_rotvec(), 3 * moved[known], atol=3e-6)
    assert np.array_equal(np.isnan(drawn.quaternion), np.isnan(recovery.quaternion))
    assert drawn.draws is None and not drawn.pose_covariance.any()
    np.testing.assert_array_equal(drawn.t_s, recovery.t_s)
    assert drawn.gaps == recovery.gaps
    faster = drawn.velocity - recovery.velocity
    slope = np.gradient(moved, recovery.t_s, axis=0)
    rows = np.flatnonzero(np.isfinite(faster).all(axis=1))
    rows = rows[(rows > 30) & (rows < 370)]
    np.testing.assert_allclose(faster[rows], slope[rows], atol=2e-4)  # of 0.03 m/s; both are differences
    for number in (3, -1):
        with pytest.raises(UnoccludeError, match="3 were drawn"):
            recovery.drawn(number)
    with pytest.raises(UnoccludeError, match="--draws"):
        replace(recovery, draws=None).drawn(0)


def test_what_was_not_drawn_is_nan_and_ends_are_held() -> None:
    recovery = with_draws()
    draws, t, position = recovery.draws, recovery.t_s, recovery.draws.position.copy()
    position[:, (draws.t_s > 1.0) & (draws.t_s < 3.0)] = np.nan
    drawn = replace(recovery, draws=replace(draws, position=position)).drawn(0)
    assert np.isnan(drawn.position[(t > 1.6) & (t < 2.4)]).all()
    cut = {name: getattr(draws, name)[:, :95] for name in ("position", "rotation")}
    short = replace(draws, t_s=draws.t_s[:95], joints={}, **cut)
    late = recovery.rows(np.flatnonzero(t > short.t_s[-1]))
    held = replace(late, draws=short).drawn(0)
    expected = np.tile(short.position[0, -1], (len(late), 1))
    np.testing.assert_allclose(held.position - late.position, expected, atol=1e-9)
    np.testing.assert_allclose(held.velocity, late.velocity)


GAPS = (Gap(1.0, 2.0), Gap(5.0, 6.0), Gap(8.0, 9.0))
BODY = UntrustedInterval(5.5, 7.0, ("another body",))


@pytest.mark.parametrize(
    ("trusted", "intervals", "expected"),
    [
        (True, (BODY, UntrustedInterval(5.9, 6.0, ("another body", "late"))), [True, False, True]),
        (True, (UntrustedInterval(3.0, 5.0, ("x",)),), [True, True, True]),  # it ends where a gap begins
        (None, (BODY,), [True, False, True]),
        (False, (BODY,), [False, False, False]),
    ],
)
def test_what_an_untrusted_interval_reaches_into_is_not_trusted(
    trusted: bool | None, intervals: tuple[UntrustedInterval, ...], expected: list[bool]
) -> None:
    whole = ("mirrored",) if trusted is False else ()
    verdicts = gap_verdicts(GAPS, trusted, whole, intervals)
    assert [each.trusted for each in verdicts] == expected
    assert [(each.start_s, each.end_s) for each in verdicts] == [(gap.start_s, gap.end_s) for gap in GAPS]
    if len(intervals) == 2:
        assert verdicts[1].reasons == ("another body", "late")
    assert verdicts[0].reasons == whole
    t = np.arange(0.0, 10.0, 0.1)
    inside = np.any([(t >= each.start_s) & (t < each.end_s) for each in intervals], axis=0)
    np.testing.assert_array_equal(trusted_at(t, trusted, intervals), ~inside & (trusted is not False))


@pytest.mark.parametrize(
    ("check", "words"),
    [
        (SelfCheck(8, 0, 1.7, 0.011, 0.010, error_95_m=0.021, stated_95_m=0.028), "within 2.1 cm in 95"),
        (SelfCheck(8, 0, 1.7, 0.011, 0.010), "1.1 cm rms"),  # of a file that states the rms only
        (SelfCheck(2, 2, 1.7), "could not be recovered"),
        (SelfCheck(0, note="the camera never saw the arm long enough"), "never saw the arm long enough."),
    ],
)
def test_the_self_check_speaks_plainly(check: SelfCheck, words: str) -> None:
    assert words in check.sentence
    stated = plain(check)
    assert stated["rms_m"] is None if math.isnan(check.rms_m) else stated["rms_m"] == check.rms_m
    back = from_plain(SelfCheck, stated)
    assert back is not None and plain(back) == stated
    for other in (
        {},
        {"stretches": "8"},
        {"stretches": 8, "rms_m": [1]},
        {"stretches": 8, "note": 3},
        7,
        None,
    ):
        assert from_plain(SelfCheck, other) is None  # values of another kind are none


#: One of each; `orientation` is known to another version only.
PLAIN = {
    "camera_sigma_m": {"wrist": 0.008, "elbow": 0.01}, "camera_effective_sigma_m": {"wrist": 0.02},
    "joint_bias_m": {"wrist": [0.001, 0.0, -0.002]}, "joint_bias_sigma_m": 0.004,
    "accelerometer_bias": [0.01, 0.02, 0.03], "gyroscope_bias": [0.001, 0.002, 0.003],
    "magnetometer_blocks": 12, "magnetometer_blocks_used": 11, "magnetometer_sigma_deg": 2.0,
    "magnetic_field_direction": [0.0, 1.0, 0.0], "given": ["wrist", "upper_arm"], "max_sigma_m": 0.02,
    "sigma_factors": [1.2, 1.5], "trusted": False, "reasons": ["the upper arm is 53 cm"],
    "cautions": ["the gyroscope was clipped"], "cause": "the skeleton seems mirrored (x)",
    "remedies": ["--mirror x"],
    "untrusted": [{"start_s": 1.0, "end_s": 2.5, "reasons": ["another body"]}],
    "findings": [
        {"code": "gap-unconfirmed", "severity": "times", "start_s": 1.0, "end_s": 2.5,
         "sentence": "another body", "remedy": ""},
        {"code": "cause", "severity": "recording", "start_s": None, "end_s": None,
         "sentence": "the skeleton seems mirrored (x)", "remedy": "--mirror x"},
    ],
    "self_check": {
        "stretches": 6, "unanswered": 0, "length_s": 1.5, "rms_m": 0.02, "stated_sigma_m": 0.021,
        "inside_95": 0.96, "worst_nees": 1.2, "sigma_factor": 1.0, "note": "", "failed": 0,
        "error_95_m": 0.031, "stated_95_m": 0.034,
    },
    "pairing": {
        "proved": True, "chance": 1e-6, "evidence": 80.0, "offset_s": 0.02, "reason": "", "caution": "",
    },
    "clock_given_s": [0.12, 0.001],
    "cameras": [{
        "name": "side", "R_K_C": [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
        "p_K_C_m": [1.5, 0.0, 1.4], "sigma_m": 0.004, "sigma_deg": 0.2, "offset_s": 0.02,
        "offset_sigma_s": 0.001, "skew": 1e-5, "misfit_m": 0.01, "together_s": 20.0,
        "joint_sigma_m": {"wrist": 0.005}, "reason": "", "seen_s": [[0.0, 12.5]],
    }],
    "orientation": "vqf",
}  # fmt: skip


def test_every_estimate_comes_back() -> None:
    estimates = Estimates.from_plain(PLAIN)
    assert estimates.plain() == PLAIN
    assert set(PLAIN) - {"orientation"} == {each.name for each in fields(Estimates)} - {"further"}
    assert estimates.further == {"orientation": "vqf"}
    assert estimates.joint_bias_m == {"wrist": (0.001, 0.0, -0.002)}
    assert Estimates().plain() == {}  # what is not stated is left out, that nothing was found is stated
    nothing = {"joint_bias_m": {}, "joint_bias_sigma_m": 0.0}
    assert Estimates(**nothing).plain() == nothing


@pytest.mark.parametrize("name", [name for name in PLAIN if name not in ("orientation", "cause")])
@pytest.mark.parametrize("value", [None, "text", {"knee": 1.0}, {"wrist": "far"}, [[1.0]], [None]])
def test_a_value_of_another_kind_is_kept_beside(name: str, value: object) -> None:
    estimates = Estimates.from_plain({name: value})
    assert estimates == Estimates(further={name: value})
    assert estimates.plain() == {name: value}
