"""Steps of camera, mounting and clock: found where they are, absent where nothing changed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother.config import Config
from smoother.recording import Recording
from smoother.recovery.change_signs import changed_for_good
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from smoother.window.solution import Step

ALONE = Config.model_validate({"windows": {"processes": 1}})
AT_S = 20.0


@cache
def made(preset: str, seed: int) -> SimulatedArm:
    simulation = ArmSimulation.preset(preset, protocol="random", duration_s=40.0, occlusion_lengths_s=())
    return simulate_arm(simulation, seed)


def hidden(recording: Recording) -> Recording:
    """The forearm is hidden while it happens."""
    frame_t = np.asarray(recording.arm.t_s)
    arm = recording.arm.hide(np.abs(frame_t - AT_S) < 1.0, ("elbow", "wrist", "hand"))
    return replace(recording, arm=arm, truth=None)


def with_camera(recording: Recording, turn: Rotation, move_m: tuple[float, float, float]) -> Recording:
    late = np.asarray(recording.arm.t_s) > AT_S
    position = np.array(recording.arm.position)
    position[late] = position[late] @ turn.as_matrix().T + move_m
    return replace(recording, arm=replace(recording.arm, position=position))


def with_strap(recording: Recording, turn: Rotation) -> Recording:
    imu = recording.imu
    late = (np.asarray(imu.t_s) > AT_S)[:, None]
    acc, gyro = (np.where(late, turn.apply(values), values) for values in (imu.acc, imu.gyro))
    return replace(recording, imu=replace(imu, acc=acc, gyro=gyro))


def about(axis: str, degrees: float) -> Rotation:
    return Rotation.from_euler(axis, degrees, degrees=True)


NOTHING = Rotation.identity()
#: What happens at 20 s, and what the verdict says then.
STEPS = {
    "pitch": (
        lambda r: with_camera(r, about("x", 12.0), (0.0, 0.0, 0.0)),
        "the camera was moved, or the strap slipped",
    ),
    "yaw": (
        lambda r: with_camera(r, about("y", 15.0), (0.0, 0.0, 0.0)),
        "the camera was moved, or the strap slipped",
    ),
    "push": (
        lambda r: with_camera(r, NOTHING, (0.25, 0.0, 0.0)),
        "the camera was moved, or the strap slipped",
    ),
    "strap": (lambda r: with_strap(r, about("x", 15.0)), "the camera was moved, or the strap slipped"),
}


def judged(recording: Recording) -> Recovery:
    return smooth(hidden(recording), config=ALONE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("preset", "seed", "kind"),
    [("realistic", 31, kind) for kind in STEPS] + [("azure", 32, kind) for kind in ("pitch", "yaw", "strap")],
)
def test_a_step_in_a_gap_distrusts_the_recording(kind: str, preset: str, seed: int) -> None:
    change, words = STEPS[kind]
    estimates = judged(change(made(preset, seed).recording)).estimates
    assert estimates.trusted is False
    reasons = [each for each in estimates.reasons if "in one frame" in each]
    assert any(f"at about {AT_S:.0f} s" in each for each in reasons) and any(
        words in each for each in reasons
    )


@pytest.mark.slow
@pytest.mark.parametrize(("preset", "seed"), [("realistic", 31), ("azure", 32), ("white", 33)])
def test_nothing_changed(preset: str, seed: int) -> None:
    estimates = judged(made(preset, seed).recording).estimates
    assert estimates.trusted and not estimates.cautions


def test_what_chance_gives_is_no_step() -> None:
    """The bound grows with the number of moments that were tried; what another body's block leaves counts."""
    step = Step("camera", 10.0, np.zeros(6), 25.0)
    usual = [Step("camera", 1.0 * k, np.zeros(6), 5.0) for k in range(2000)]
    assert list(changed_for_good([step], [step]))
    assert not list(changed_for_good([step, *usual], [step, *usual]))
    (doubt,) = changed_for_good([step], usual)
    assert (doubt.start_s, doubt.end_s) == pytest.approx((9.9, 10.1))


def test_a_tracked_point_has_no_mounting_to_step() -> None:
    """Its columns are zero, and chance gives that always."""
    assert not list(changed_for_good([Step("mounting", 10.0, np.zeros(6), 0.0)], []))
