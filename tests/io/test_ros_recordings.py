"""ROS 2 recordings as others make them."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import ros_bags as ros
from hypothesis import given, settings
from hypothesis import strategies as st
from made_recordings import swing
from mcap.writer import CompressionType, Writer
from mcap_messages import groups
from mcap_ros2._dynamic import serialize_dynamic

from smoother.errors import RecordingError
from smoother.io import open_recording, read_recording
from smoother.io.recording.choose import choose_truth
from smoother.io.wire import cdr
from smoother.io.wire.layout import Grouper
from smoother.recording import CameraFrame, JointState

ZERO = 1_700_000_000 * 10**9
RIGHT, LEFT = {"shoulder": 12, "elbow": 13, "wrist": 14, "hand": 15}, {"elbow": 6, "wrist": 7}


def azure(path: Path, *, textured: bool = True, log_delay: int = 5_000_000, **how: object) -> np.ndarray:
    """Right arm of body 3 swings with the IMU, all others otherwise; frames 100-129 are empty."""
    t = np.arange(0, 10, 0.01)
    fixed, moved, gyro = swing(t)
    along = (moved - fixed) / 0.25  # the sensor's x axis; its y axis is across
    across = np.stack([-along[:, 1], along[:, 0], along[:, 2]], axis=1)
    force = np.gradient(np.gradient(moved, 0.01, axis=0), 0.01, axis=0) - [0.0, 9.8, 0.0]
    acc = np.stack([(force * along).sum(axis=1), (force * across).sum(axis=1), force[:, 2]], axis=1)
    frames = np.arange(0.005, 10, 1 / 30)
    elbow, wrist, _ = swing(frames)
    other_elbow, other_wrist, _ = swing(frames, 1.7, 1.0)
    events = [(int(ns), "imu", i) for i, ns in enumerate(ZERO + np.rint(t * 1e9).astype(int))]
    events += [(int(ns), "body", i) for i, ns in enumerate(ZERO + np.rint(frames * 1e9).astype(int))]
    with ros.Bag(path, **how) as bag:
        for ns, kind, i in sorted(events):
            log = ns + log_delay
            if kind == "imu":
                bag.imu("/wrist/imu", ns, "wrist_link", acc[i], gyro[i], log)
                bag.imu("/k4a/imu", ns, "imu_link", np.array([0.1, 9.8, 0.2]), 0 * gyro[i], log)
                field = {
                    "header": ros.header(ns, "wrist_link"),
                    "magnetic_field": ros.xyz(np.arange(3.0) + i),
                }
                field["magnetic_field_covariance"] = [0.0] * 9
                bag.write("/wrist/mag", "sensor_msgs/msg/MagneticField", ros.FIELD, field, log)
                continue
            if i % 30 == 0:
                image = {"header": ros.header(ns, "rgb"), "height": 100, "width": 100, "encoding": "mono8"}
                image |= {"is_bigendian": 0, "step": 100, "data": bytes(10_000)}
                bag.write("/rgb/image_raw", "sensor_msgs/msg/Image", ros.IMAGE, image, log)
            markers = []
            if not 100 <= i < 130:
                for joint in range(32):
                    place = {13: elbow[i], 14: wrist[i], 6: other_elbow[i], 7: other_wrist[i]}
                    markers.append(ros.marker(ns, 300 + joint, place.get(joint, np.full(3, 1.0 + joint))))
                    if i > 50:
                        place = {13: other_elbow[i], 14: other_wrist[i]}
                        markers.append(ros.marker(ns, 400 + joint, place.get(joint, np.full(3, 2.0))))
            kind_name = "visualization_msgs/msg/MarkerArray"
            bag.write("/body_tracking_data", kind_name, ros.marker_array(textured), {"markers": markers}, log)
    return wrist


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    path = tmp_path_factory.mktemp("ros") / "azure.mcap"
    return path, azure(path)


@pytest.mark.slow
def test_azure_kinect_recording(bag: tuple[Path, np.ndarray]) -> None:
    path, wrist = bag
    recording = read_recording(path)
    assert (recording.imu.name, recording.side) == ("/wrist/imu", "right")
    assert recording.camera_frame is CameraFrame.OPTICAL
    assert recording.base_imu is not None and recording.base_imu.name == "/k4a/imu"
    assert any("body 3, right" in note for note in recording.notes)
    seen = recording.arm.tracked("wrist")
    assert not seen[100:130].any() and seen[:100].all() and seen[130:].all()
    np.testing.assert_allclose(recording.arm.joint("wrist")[seen], wrist[seen])
    # An empty array has no stamp: its log time, less the delay of the others, is in.
    np.testing.assert_allclose(np.diff(recording.arm.t_s), 1 / 30, atol=1e-6)
    assert recording.imu.mag is not None
    np.testing.assert_allclose(recording.imu.mag[7], [7.0, 8.0, 9.0])
    assert recording.origin_ns == ZERO


@pytest.mark.slow
def test_options_settle_what_is_meant(bag: tuple[Path, np.ndarray]) -> None:
    recording = read_recording(bag[0], imu="/k4a/imu", side="left", body=3)
    assert recording.imu.name == "/k4a/imu"
    assert recording.side == "left"
    with pytest.raises(RecordingError, match=r"--body 9.*body 3, left"):
        read_recording(bag[0], body=9)
    with pytest.raises(RecordingError, match=r"no IMU fits --imu chest; give one of /wrist/imu, /k4a/imu"):
        read_recording(bag[0], imu="chest")
    with pytest.raises(RecordingError, match=r"choose with --side and --body"):
        read_recording(bag[0], imu="k4a")


def test_a_preferred_side_decides(bag: tuple[Path, np.ndarray]) -> None:
    assert read_recording(bag[0], body=3, prefer_side="left").side == "left"


def test_markers_before_humble(tmp_path: Path) -> None:
    azure(tmp_path / "foxy.mcap", textured=False)
    assert read_recording(tmp_path / "foxy.mcap").side == "right"


@pytest.mark.slow
@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD, CompressionType.NONE])
def test_a_file_that_was_cut_off(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "cut.mcap"
    azure(path, compression=compression, chunk=1 << 18)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    recording = read_recording(path, side="right", body=3)
    assert any("ends in the middle" in note for note in recording.notes)
    assert 300 < len(recording.imu) < 700
    assert recording.imu.rate_hz == pytest.approx(100)


def test_stamps_of_zero_and_before_1970(tmp_path: Path) -> None:
    path = tmp_path / "zero.mcap"
    with ros.Bag(path) as bag:
        for i in range(5):
            bag.imu("/imu", 0, "x", np.ones(3), np.ones(3), 1000 + i)
            bag.imu("/early", -1_500_000_000 + i, "x", np.ones(3), np.ones(3), 1000 + i)
    streams = {stream.topic: stream.stamp_ns.tolist() for stream in open_recording(path).imus}
    assert streams["/imu"] == [1000, 1001, 1002, 1003, 1004]
    assert streams["/early"] == [-1_500_000_000 + i for i in range(5)]


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=400))
def test_garbage_is_counted_and_dropped(data: bytes) -> None:
    for walk in (partial(cdr.walk, kind="sensor_msgs/Imu"), cdr.marker_array):
        grouper = Grouper(walk)
        found = sum(len(index) for index, _, _ in groups(grouper, [data, data]))
        assert found + grouper.broken == 2


def test_deleting_markers_are_not_joints(tmp_path: Path) -> None:
    path = tmp_path / "delete.mcap"
    with ros.Bag(path) as bag:
        for i in range(50):
            ns = ZERO + i * 33_000_000
            bag.imu("/wrist", ns, "w", np.array([0, 0, 9.8]), np.zeros(3), ns)
            markers = [ros.marker(ns, 0, np.zeros(3), action=3)]
            if i < 25:
                markers += [ros.marker(ns, joint, np.full(3, 1.0 + 0.1 * joint)) for joint in RIGHT.values()]
            bag.write(
                "/markers", "visualization_msgs/msg/MarkerArray", ros.marker_array(), {"markers": markers}, ns
            )
    recording = read_recording(path)
    assert (recording.arm.state[:25, 1:4] == JointState.TRACKED).all()
    assert (recording.arm.state[25:] == JointState.NOT_TRACKED).all()


@pytest.mark.parametrize("cut", [False, True])
def test_a_file_without_chunks_and_a_truth_of_ros(tmp_path: Path, cut: bool) -> None:
    path = tmp_path / "plain.mcap"
    texts = {"sensor_msgs/msg/Imu": ros.IMU, "geometry_msgs/msg/PoseStamped": ros.POSE}
    bytes_of = {kind: serialize_dynamic(kind, text)[kind] for kind, text in texts.items()}
    with open(path, "wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        channels = []
        imu, posed = texts
        for topic, kind in (("/arm/imu", imu), ("/vicon/forearm", posed), ("/robot/goal", posed)):
            schema = writer.register_schema(kind, "ros2msg", texts[kind].encode())
            channels.append(writer.register_channel(topic, "cdr", schema))
        for i in range(200):
            ns = ZERO + i * 10**7
            writer.add_message(
                channels[0], ns, bytes_of[imu](ros.imu_message(ns, "a", np.ones(3), np.ones(3))), ns
            )
            turn = {"x": 0.1, "y": 0.2, "z": 0.3, "w": 0.9}
            pose = {"position": ros.xyz(np.arange(3.0) + i), "orientation": turn}
            for channel in channels[1:]:
                data = bytes_of[posed]({"header": ros.header(ns, "camera"), "pose": pose})
                writer.add_message(channel, ns, data, ns)
        writer.finish()
    if cut:
        path.write_bytes(path.read_bytes()[:60_000])
    found = open_recording(path)
    assert bool(found.notes) == cut
    count = len(found.imus[0].stamp_ns)
    assert 50 < count < 200 if cut else count == 200
    truth = next(poses for poses in found.poses if poses.topic == "/vicon/forearm")
    np.testing.assert_array_equal(truth.position[7], [7, 8, 9])
    np.testing.assert_array_equal(truth.quaternion[7], [0.9, 0.1, 0.2, 0.3])
    assert choose_truth(found, "")[0] is truth
