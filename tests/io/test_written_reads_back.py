"""What is written reads back equal: recordings, containers, calibrations, markers, of any values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from calib.file import CalibrationFile, read_calibration, write_calibration
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.io.export.markers import write_trc
from smoother.io.markers import read_trc
from smoother.io.mcap.merge import repair_container
from smoother.io.recording.read import open_recording
from smoother.io.recording.streams import ArmFrames, ImuSamples, RecordingFile
from smoother.io.recording.write import write_recording

quick = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
START = 1_700_000_000 * 10**9
numbers = st.floats(-1e3, 1e3, allow_subnormal=True)
places = st.floats(-10, 10).map(lambda value: round(value, 6))


@st.composite
def files(draw: st.DrawFn) -> RecordingFile:
    """Streams of any values and rising stamps less than twelve hours apart."""
    count, frames = draw(st.integers(1, 12)), draw(st.integers(1, 8))

    def stamps(size: int) -> np.ndarray:
        steps = draw(st.lists(st.integers(1, 10**13), min_size=size, max_size=size))
        return START + np.cumsum(np.array(steps, np.int64))

    acc, gyro = (draw(arrays.arrays(np.float64, (count, 3), elements=numbers)) for _ in range(2))
    state = draw(arrays.arrays(np.int8, (frames, 5), elements=st.integers(0, 2)))
    state[:, 1] = 2  # an arm that is never there is not written
    position = draw(arrays.arrays(np.float64, (frames, 5, 3), elements=numbers))
    position[state == 0] = np.nan
    return RecordingFile(
        Path("drawn"),
        imus=[ImuSamples("/imu/forearm_right", "forearm_right", stamps(count), acc, gyro)],
        arms=[
            ArmFrames(
                "/skeleton", "camera", draw(st.integers(0, 9)), "right", stamps(frames), position, state
            )
        ],
    )


@quick
@given(files())
def test_recordings(tmp_path: Path, file: RecordingFile):
    write_recording(file, tmp_path / "a.mcap", force=True)
    repair_container(tmp_path / "a.mcap", tmp_path / "b.mcap", force=True)
    for path in (tmp_path / "a.mcap", tmp_path / "b.mcap"):
        back = open_recording(path)
        (imu,), (arm,) = back.imus, back.arms
        assert not back.notes
        for name in ("stamp_ns", "acc", "gyro"):
            np.testing.assert_array_equal(getattr(imu, name), getattr(file.imus[0], name))
        for name in ("stamp_ns", "position", "state", "body", "side"):
            np.testing.assert_array_equal(getattr(arm, name), getattr(file.arms[0], name))


vectors = st.lists(st.floats(-1.9, 1.9), min_size=3, max_size=3).map(np.array)
sigmas = st.lists(st.floats(1e-9, 1.9), min_size=3, max_size=3).map(np.array)


@quick
@given(
    st.dictionaries(st.sampled_from(["elbow", "wrist", "hand"]), st.builds(LeverArm, vectors, sigmas)),
    st.none() | st.builds(Length, st.floats(1e-3, 1.9), st.floats(1e-6, 1.9)),
    st.none() | vectors,
)
def test_calibrations(
    tmp_path: Path, levers: dict[str, LeverArm], upper_arm: Length | None, bias: np.ndarray | None
):
    path = tmp_path / "cal.toml"
    path.unlink(missing_ok=True)
    arm = ArmCalibration(side="right", lever_arms=levers, upper_arm=upper_arm, accelerometer_bias=bias)
    write_calibration(path, CalibrationFile({"right": arm}))
    back = read_calibration(path).arm("right")
    assert set(back.lever_arms) == set(levers) and back.upper_arm == upper_arm
    for joint, lever in levers.items():
        np.testing.assert_array_equal(back.lever_arms[joint].position_m, lever.position_m)
        np.testing.assert_array_equal(back.lever_arms[joint].sigma_m, lever.sigma_m)
    assert (back.accelerometer_bias is None) == (bias is None)
    if bias is not None:
        np.testing.assert_array_equal(back.accelerometer_bias, bias)


@quick
@given(
    arrays.arrays(np.float64, st.tuples(st.integers(2, 6), st.integers(1, 4), st.just(3)), elements=places)
)
def test_markers(tmp_path: Path, position: np.ndarray):
    position[abs(position).max(axis=2) < 1e-6] = 0.5  # the origin stands for a hidden marker
    names = [f"M{i}" for i in range(position.shape[1])]
    write_trc(tmp_path / "a.trc", names, np.arange(len(position)) * 0.01, position, 100.0, True)
    back = read_trc(tmp_path / "a.trc")
    assert list(back.names) == names
    np.testing.assert_allclose(back.position, position, atol=1e-6)  # six decimals of a mm or so
