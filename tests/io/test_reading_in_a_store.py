"""Recordings read into files instead of memory: the same values, in flat memory."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from made_recordings import make
from made_results import assert_same
from mcap.writer import CompressionType, Writer
from mcap_messages import every
from private_memory import program_output

from smoother.io import open_recording, read_recording, write_recording
from smoother.io.mcap.container import Container
from smoother.io.recording.decode import SIDES, JointRows
from smoother.io.recording.streams import RecordingFile
from smoother.io.recording.write import as_file
from smoother.recording import JOINTS, JointState
from smoother.runtime import store as store_module

ZERO = 1_700_000_000 * 10**9


def in_small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every array on disk, every pass in many parts."""
    monkeypatch.setattr(store_module, "_SMALL_BYTES", 1)
    monkeypatch.setattr(store_module, "BATCH_ROWS", 13)


small_parts = pytest.fixture(in_small_parts)


def plain(_: Path) -> RecordingFile:
    return as_file(make())


def two_arms(_: Path) -> RecordingFile:
    return as_file([make(side="right"), make(rate=1.7, side="left")])


def dropped_samples(_: Path) -> RecordingFile:
    file = as_file(make(20))
    imu, arm, poses = file.imus[0], file.arms[0], file.poses[0]
    imu.acc[7], imu.gyro[300] = np.nan, np.inf
    imu.stamp_ns[100] = imu.stamp_ns[99]
    arm.stamp_ns[50] = arm.stamp_ns[48]
    arm.position[20, 1] = np.nan
    poses.stamp_ns[40:42] = poses.stamp_ns[39]
    poses.position[60, 1] = np.nan
    return file


def renumbered_body(_: Path) -> RecordingFile:
    file = as_file(make(20))
    (arm,), frames = file.arms, np.arange(len(file.arms[0].stamp_ns))
    file.arms = [replace(arm, body=body, state=arm.state.copy()) for body in (1, 4)]
    file.arms[0].state[frames >= 200] = file.arms[1].state[frames <= 260] = JointState.NOT_TRACKED
    return file


def several_imus(_: Path) -> RecordingFile:
    file = as_file(make(20))
    imu, arm = file.imus[0], file.arms[0]
    other = replace(imu, topic="/imu/b", frame_id="b", gyro=np.roll(imu.gyro, 300, axis=0))
    file.imus, file.arms = [replace(imu, topic="/imu/a", frame_id="a"), other], [replace(arm, side="")]
    return file


@pytest.mark.parametrize("made", [plain, two_arms, dropped_samples, renumbered_body, several_imus])
def test_columns_in_files_are_the_same(made: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "a.mcap"
    write_recording(made(tmp_path), path)  # type: ignore[operator]
    chosen = {two_arms: {"side": "right"}, several_imus: {"imu": "/imu/a"}}.get(made, {})
    expected = open_recording(path), read_recording(path, **chosen)
    in_small_parts(monkeypatch)
    assert_same(expected, (open_recording(path), read_recording(path, **chosen)), exact=True)


LONG = """
import sys
from pathlib import Path
import numpy as np
from smoother.io import read_recording
from private_memory import PrivatePeak

peak = PrivatePeak()
short, long, truth = sys.argv[1:]
read_recording(short)  # all that is imported on the way
begin = peak.mb()
recording = read_recording(long, truth=truth == "True")
print(peak.mb() - begin, len(recording.imu), len(recording.arm))
"""


@pytest.fixture(scope="module")
def long_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two hours at 80 Hz and 30 Hz, with truth: 86 MB of columns."""
    folder = tmp_path_factory.mktemp("long")
    file = as_file(make(20, origin_ns=ZERO))
    (arm,), (imu, base), (poses,) = file.arms, file.imus, file.poses

    def again(values: np.ndarray, count: int) -> np.ndarray:
        return np.resize(values, (count, *values.shape[1:]))

    samples, frames = 80 * 7200, 30 * 7200
    stamp, seen = ZERO + np.arange(samples) * 12_500_000, ZERO + np.arange(frames) * 33_333_333
    acc, gyro = again(imu.acc, samples), again(imu.gyro, samples)
    file.imus = [replace(imu, stamp_ns=stamp, acc=acc, gyro=gyro, mag=None)]
    file.arms = [
        replace(arm, stamp_ns=seen, position=again(arm.position, frames), state=again(arm.state, frames))
    ]
    place, turn = again(poses.position, samples), again(poses.quaternion, samples)
    joints = {name: again(values, samples) for name, values in poses.joints.items()}
    file.poses = [replace(poses, stamp_ns=stamp, position=place, quaternion=turn, score=None, joints=joints)]
    assert base.topic == "/imu/base"
    write_recording(file, folder / "long.mcap")
    write_recording(make(), folder / "short.mcap")
    return folder


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("truth", [True, False])
def test_memory_is_flat(long_recording: Path, truth: bool):
    paths = [str(long_recording / name) for name in ("short.mcap", "long.mcap")]
    done = program_output(LONG, *paths, str(truth))
    grown, samples, frames = done.split()
    assert (int(samples), int(frames)) == (80 * 7200, 30 * 7200)
    assert float(grown) < 45  # MB; measured 17, in memory 275 and 106


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
def test_images_cost_no_memory(tmp_path: Path, compression: CompressionType):
    """60 images of 1 MB among 6 s of samples, in chunks of 4 MB."""
    path, image = tmp_path / "images.mcap", np.random.default_rng(0).bytes(1 << 20)
    write_recording(make(6.0), tmp_path / "short.mcap")
    with open(path, "wb") as file:
        writer = Writer(file, chunk_size=4 << 20, compression=compression)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/CompressedImage", "ros2msg", b"")
        images = writer.register_channel("/rgb", "cdr", schema)
        ours: dict[str, int] = {}
        for count, message in enumerate(every(Container(tmp_path / "short.mcap"))):
            topic = message.topic
            if topic.name not in ours:
                schema = writer.register_schema(topic.schema, topic.schema_encoding, topic.schema_data)
                ours[topic.name] = writer.register_channel(topic.name, topic.encoding, schema)
            writer.add_message(ours[topic.name], message.log_ns, bytes(message.data), message.log_ns)
            if count % 40 == 0 and count < 2400:
                writer.add_message(images, message.log_ns, image, message.log_ns)
        writer.finish()
    grown, samples, _ = program_output(LONG, tmp_path / "short.mcap", path, False).split()
    assert int(samples) == 600
    assert float(grown) < 40  # MB; a chunk packed and unpacked, and the unpacker's own: measured 13 to 24


def joint_events() -> st.SearchStrategy[list[tuple[int, int, int, int, int]]]:
    """Message, body, side, joint and state of joints, in the order in which messages came."""
    event = st.tuples(
        st.integers(0, 9), st.integers(0, 2), st.integers(0, 2), st.integers(0, 4), st.integers(0, 2)
    )
    return st.lists(event, max_size=60).map(lambda events: sorted(events, key=lambda event: event[0]))


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(joint_events(), arrays.arrays(np.int64, 10, elements=st.integers(0, 12)), st.booleans())
@pytest.mark.usefixtures("small_parts")
def test_arms_are_what_a_loop_over_joints_makes(
    events: list[tuple[int, int, int, int, int]], stamps: np.ndarray, ordered: bool
):
    stamps = np.sort(stamps) if ordered else stamps
    rows = JointRows()
    position = np.random.default_rng(0).normal(size=(len(events), 3))
    for k, (message, body, side, joint, state) in enumerate(events):
        rows.add(np.array([message]), body, (side, joint), np.array([state]), position[k : k + 1].copy())
    found = rows.arms(stamps, "/s", "k", None)
    frames = list(dict.fromkeys(stamps.tolist()))
    expected = dict(slow_arms(events, position, stamps.tolist(), frames))
    assert [(arm.body, arm.side) for arm in found] == sorted(
        expected, key=lambda k: (k[0], SIDES.index(k[1]))
    )
    for arm in found:
        states, positions = expected[arm.body, arm.side]
        assert arm.stamp_ns.tolist() == frames
        np.testing.assert_array_equal(arm.state, states)
        np.testing.assert_array_equal(arm.position, positions)


def slow_arms(
    events: list[tuple[int, int, int, int, int]], position: np.ndarray, stamps: list[int], frames: list[int]
) -> Iterator[tuple[tuple[int, str], tuple[np.ndarray, np.ndarray]]]:
    for body, side in {(event[1], event[2]) for event in events}:
        states = np.zeros((len(frames), len(JOINTS)), np.int8)
        positions = np.full((len(frames), len(JOINTS), 3), np.nan)
        for event, place in zip(events, position, strict=True):
            if event[1:3] == (body, side):
                at = frames.index(stamps[event[0]]), event[3]
                states[at], positions[at] = event[4], place if event[4] else np.nan
        yield (body, SIDES[side]), (states, positions)
