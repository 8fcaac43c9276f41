"""What the program says of a recording costs trust: the gaps that a sign contradicts, or the whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scenes import ALONE
from scipy.spatial.transform import Rotation

from smoother import Recording
from smoother.linalg import runs
from smoother.recording import JOINTS
from smoother.recovery.cause import on_upper_arm
from smoother.result import Estimates
from smoother.result.verdict import EVER, finding
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth
from tools.reliability import setup_errors
from tools.reliability.setup_errors import Setup

#: A fault put into a recording at a gap (start and end, s on the camera's clock).
Fault = Callable[[Recording, float, float], Recording]


def simulated(seed: int, **settings: object) -> Setup:
    config = ArmSimulation.preset("realistic", protocol="random", duration_s=30.0, **settings)
    arm = simulate_arm(config, seed)
    return Setup(arm, config, np.random.default_rng(seed), replace(arm.recording, truth=None))


def gap_near_the_middle(recording: Recording) -> tuple[float, float]:
    arm = recording.arm
    gaps = [
        (float(arm.t_s[run.start]), float(arm.t_s[run.stop - 1]))
        for run in runs(~arm.forearm_tracked)
        if arm.t_s[run.stop - 1] - arm.t_s[run.start] > 0.8
    ]
    return min(gaps, key=lambda gap: abs(sum(gap) - 30.0))


def tilted_deg(degrees: float) -> Fault:
    """The camera tilts while the arm is hidden."""

    def tilted(recording: Recording, start_s: float, end_s: float) -> Recording:
        arm, turn = recording.arm, Rotation.from_euler("x", degrees, degrees=True).as_matrix()
        late = (arm.t_s > 0.5 * (start_s + end_s))[:, None, None]
        return replace(
            recording, arm=replace(arm, position=np.where(late, arm.position @ turn.T, arm.position))
        )

    return tilted


def first_of_two_moved(recording: Recording, start_s: float, end_s: float) -> Recording:
    arm = recording.arm
    late = (arm.t_s > 0.5 * (start_s + end_s))[:, None, None]
    return replace(recording, arm=replace(arm, position=arm.position + np.where(late, [0.25, 0.0, 0.1], 0.0)))


def nearer_on_both_sides(recording: Recording, start_s: float, end_s: float) -> Recording:
    """Seen 25 cm nearer for 1.2 s before and after the gap."""
    arm, position = recording.arm, recording.arm.position.copy()
    forearm = [JOINTS.index(joint) for joint in ("elbow", "wrist", "hand")]
    near = np.flatnonzero((arm.t_s > start_s - 1.2) & (arm.t_s < end_s + 1.2))
    position[np.ix_(near, forearm, [2])] -= 0.25
    return replace(recording, arm=replace(arm, position=position))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "seed", "settings", "words", "whole"),
    [
        (tilted_deg(12.0), 3, {}, "the camera was moved", True),
        (tilted_deg(-6.0), 5, {}, "the camera was moved", True),
        (first_of_two_moved, 3, {"cameras": (60.0,)}, "the camera was moved", True),
        (nearer_on_both_sides, 3, {}, "nothing on either side confirms", False),
    ],
    ids=["tilted", "tilted a little", "first camera moved", "blocks on both sides"],
)
def test_a_sign_distrusts_the_gaps_it_touches(
    fault: Fault, seed: int, settings: dict[str, object], words: str, whole: bool
) -> None:
    recording = simulated(seed, **settings).recording
    gap = gap_near_the_middle(recording)
    recovery = smooth(fault(recording, *gap), config=ALONE)
    (verdict,) = [
        each for each in recovery.gap_verdicts if each.start_s - 0.2 < sum(gap) / 2 < each.end_s + 0.2
    ]
    assert any(words in reason for reason in verdict.reasons), (verdict, recovery.estimates)
    assert (recovery.estimates.trusted is False) == whole
    assert whole or any(each.trusted for each in recovery.gap_verdicts)
    found = recovery.estimates
    said = {each.sentence: each.severity for each in found.findings}
    assert {said[reason] for reason in found.reasons} <= {"recording", "times"}
    assert all(said[why] == "times" for each in found.untrusted for why in each.reasons)
    of_gaps = [caution for caution in found.cautions if not caution.endswith("not to be trusted")]
    assert {said[caution] for caution in of_gaps} <= {"caution"}


@pytest.mark.parametrize(
    ("times", "trusted", "cautions", "untrusted"),
    [(None, True, 1, 0), ((2.0, 3.0), True, 0, 1), (EVER, False, 0, 0)],
)
def test_what_a_sign_contradicts(
    times: tuple[float, float] | None, trusted: bool, cautions: int, untrusted: int
) -> None:
    found = Estimates(trusted=True).with_findings([finding("so", "it is so", times)] * 2)
    assert (found.trusted, len(found.cautions), len(found.untrusted)) == (trusted, cautions, untrusted)
    assert found.reasons == (() if trusted else ("it is so",))
    (one,) = found.findings
    assert (one.code, one.sentence, one.start_s is None) == ("so", "it is so", untrusted == 0)


@pytest.mark.slow
@pytest.mark.parametrize("flexion_rad", [(0.5, 2.0), (0.5, 0.9)], ids=["lively elbow", "stiff elbow"])
def test_an_imu_on_the_upper_arm_is_found_though_it_fits_the_forearm(
    flexion_rad: tuple[float, float],
) -> None:
    setup = simulated(7, flexion_rad=flexion_rad)
    assert on_upper_arm(setup.recording) is None
    wrong = replace(setup_errors.sensor_on_the_upper_arm(setup).recording, truth=None)
    estimates = smooth(wrong, config=ALONE).estimates
    assert estimates.trusted is False
    assert estimates.cause is not None and "on the upper arm" in estimates.cause
