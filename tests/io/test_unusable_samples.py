"""Values and stamps that no sensor measured: dropped with a note, or one sentence; never an answer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_recordings import make

from calib.file import read_calibration
from smoother.errors import CalibrationError, RecordingError
from smoother.io import read_recording
from smoother.io.recording.clean import clean_arm, clean_imu, unusable_samples
from smoother.io.recording.streams import ArmFrames, ImuSamples
from smoother.io.recording.write import write_recording
from smoother.measurements.timestamps import largest_group
from smoother.recording import JointState, Recording

T = 10**18 + np.arange(0, 8 * 10**9, 10**7)


def motion() -> tuple[np.ndarray, np.ndarray]:
    """A noisy sensor that turns, 800 samples at 100 Hz."""
    rng = np.random.default_rng(2)
    t = np.arange(800) * 0.01
    gyro = np.stack([2 * np.sin(2 * t), np.cos(t), 0.1 * t], axis=1) + rng.normal(0, 0.01, (800, 3))
    acc = np.array([0.0, 9.81, 0.0]) + rng.normal(0, 0.05, (800, 3))
    gyro[400:600] = rng.normal(0.01, 0.01, (200, 3))
    return acc, gyro


def causes(acc: np.ndarray, gyro: np.ndarray, stamp: np.ndarray = T) -> dict[str, list[int]]:
    return {name: np.flatnonzero(mask).tolist() for name, mask in unusable_samples(stamp, acc, gyro).items()}


def test_what_no_sensor_measures():
    acc, gyro = motion()
    acc[100:103], gyro[100:103] = 0, 0
    acc[200, 1], gyro[210, 2] = 1e300, -40
    gyro[50, 0] += 9
    found = causes(acc, gyro)
    assert found["all zero"] == [100, 101, 102]
    assert found["beyond any sensor's range"] == [200, 210]
    assert found["lone spikes"] == [50]
    # at a low rate a peak may last one sample
    assert "lone spikes" not in causes(acc, gyro, 10**18 + 4 * (T - 10**18))


def test_frozen_in_motion_and_at_rest():
    acc, gyro = motion()
    acc[20:80], gyro[20:80] = acc[20], gyro[20]  # turning at 1 rad/s and more
    assert causes(acc, gyro)["frozen"] == list(range(21, 80))
    acc, gyro = motion()
    acc[420:580], gyro[420:580] = acc[420], gyro[420]
    assert causes(acc, gyro)["frozen"] == list(range(421, 580))
    # a simulation without noise stands still to the last bit, and is right
    t = np.arange(800) * 0.01
    still = np.zeros((800, 3))
    still[:300, 0] = np.sin(t[:300]) ** 2 * np.sin(np.pi * t[:300] / 3) ** 2
    assert causes(np.tile([0.0, 9.81, 0.0], (800, 1)), still) == {}


def test_the_end_of_a_range():
    acc, gyro = motion()
    fast = 8 * gyro
    clipped = np.clip(fast, -8.7, 8.7)
    found = causes(acc, clipped)["at the end of the range"]
    assert found and (np.abs(fast[found]).max(axis=1) > 8.69).all()
    assert causes(acc, fast) == {}


@pytest.mark.parametrize("row", [0, 400, -1])
@pytest.mark.parametrize("away", [10 * 86_400 * 10**9, -10 * 86_400 * 10**9, 365 * 86_400 * 10**9, -(10**18)])
def test_one_stamp_far_from_all_others(row: int, away: int):
    stamp = T.copy()
    stamp[row] += away
    mask = largest_group(stamp)
    assert mask is not None and (~mask).sum() == 1 and not mask[row]
    assert largest_group(T) is None


@pytest.mark.parametrize("by_s", [0.1, 0.3, 2.0, 60.0])
@pytest.mark.parametrize("stream", ["imu", "arm"])
def test_a_clock_that_was_set_back_is_refused(stream: str, by_s: float):
    """A few samples would be dropped, and all behind them stay at the wrong time."""
    imu = ImuSamples("/imu", "imu", T - round(by_s * 1e9) * (T[400] <= T), *motion(), None)
    position = np.tile(np.arange(15.0).reshape(5, 3) / 10, (267, 1, 1))  # nothing moves
    state = np.full((267, 5), JointState.TRACKED, np.int8)
    frames = T[::3]
    arm = ArmFrames(
        "/skeleton", "camera", 0, "right", frames - round(by_s * 1e9) * (frames >= T[400]), position, state
    )
    with pytest.raises(RecordingError, match=r"clock of /\w+.* was set back by .* at (3\.99|4\.0) s of it"):
        if stream == "imu":
            clean_imu(imu, "a.mcap")
        else:
            clean_arm(arm, "a.mcap")


def test_joints_that_no_camera_sees(tmp_path: Path):
    made = make()
    position = made.arm.position.copy()
    position[5, 1], position[6, 2] = 30.0, 1e300
    write_recording(replace(made, arm=replace(made.arm, position=position)), tmp_path / "a.mcap")
    found = read_recording(tmp_path / "a.mcap")
    assert not found.arm.tracked("elbow")[5] and not found.arm.tracked("wrist")[6]
    assert any("2 joint positions are farther than 20 m" in note for note in found.notes)
    position[:100, 1] = 40.0
    write_recording(replace(made, arm=replace(made.arm, position=position)), tmp_path / "b.mcap")
    with pytest.raises(RecordingError, match="check the unit"):
        read_recording(tmp_path / "b.mcap")


@pytest.mark.parametrize("hint", [[0, 0, 0], [0, 1e300, 0], [1e-300, 0, 0]])
def test_gravity_is_a_direction(hint: list[float]):
    made = make()
    with pytest.raises(RecordingError):
        Recording.from_arrays(
            made.imu.t_s,
            made.imu.acc,
            made.imu.gyro,
            made.arm.t_s,
            {"wrist": made.arm.joint("wrist")},
            gravity_hint=np.array(hint, float),
        )


LEVER = "[arm.right.lever_arm.hand]\nposition_m = [{}, 0.0, 0.0]\nsigma_m = [0.01, 0.01, 0.01]\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (LEVER.format("80.0"), "looks like mm"),
        (LEVER.format("1e300"), "looks like mm"),
        ("[arm.right]\nupper_arm_m = 301.0\nupper_arm_sigma_m = 4.0\n", "check its unit"),
        ("[arm.right]\naccelerometer_bias = [1e10, 0.0, 0.0]\n", "check its unit"),
        ("[arm.right]\ngyroscope_bias = [100.0, 0.0, 0.0]\n", "check its unit"),
        ("a = " + "[" * 5000 + "]" * 5000, "not TOML"),
        ("a = " + "1" * 5000, "not TOML"),
    ],
)
def test_a_calibration_that_cannot_be(tmp_path: Path, text: str, said: str):
    path = tmp_path / "c.toml"
    path.write_text(text)
    with pytest.raises(CalibrationError, match=said) as caught:
        read_calibration(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 500
