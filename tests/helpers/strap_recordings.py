"""A simulated arm's recording with rendered colour and depth images, as Foxglove messages."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.reader import make_reader
from mcap.writer import Writer

from calib.intrinsics import Intrinsics, PlacedCamera
from smoother.io import write_recording
from smoother.io.wire.schemas import schema_data
from smoother.simulation.arm import SimulatedArm
from smoother.simulation.strap import Arm, StrapImageNoise, render

BASELINE_M = 0.05
KINECT = np.diag([-1.0, -1.0, 1.0])
COLOUR = PlacedCamera(
    Intrinsics(480, 270, 400.0, 400.0, 240.0, 135.0), KINECT, np.array([BASELINE_M, 0.0, 0.0])
)
DEPTH = PlacedCamera(Intrinsics(320, 288, 260.0, 260.0, 160.0, 144.0), KINECT)


def with_images(simulated: SimulatedArm, path: Path, every: int = 3, seed: int = 0) -> None:
    """Write the recording, and images of its arm at every so many frames (the strap at the IMU's place)."""
    plain = path.with_suffix(".plain.mcap")
    recording = simulated.recording
    write_recording(recording, plain)
    rng, truth, measures = np.random.default_rng(seed), recording.truth, simulated.parameters
    assert truth is not None
    radius = float(np.linalg.norm(_off_axis(simulated)))
    messages = []
    for t in recording.arm.t_s[::every]:
        k = int(np.argmin(np.abs(truth.t_s - t)))
        elbow, wrist = truth.joints["elbow"][k], truth.joints["wrist"][k]
        arm = Arm(elbow, wrist, radius, measures["forearm_m"] - measures["strap_to_wrist_m"])
        noise = StrapImageNoise(rng=rng)
        grey, _ = render(arm, COLOUR, noise)
        _, z = render(arm, DEPTH, noise)
        stamp = int(np.rint(t * 1e9))
        messages += [(stamp, _jpeg(grey, stamp)), (stamp + 2_000_000, _depth(z, stamp + 2_000_000))]
    with open(path, "wb") as stream, open(plain, "rb") as source:
        writer = Writer(stream)
        writer.start()
        channels: dict[str, int] = {}

        def add(topic: str, schema: str, data: bytes, stamp: int, schema_bytes: bytes | None = None) -> None:
            if topic not in channels:
                number = writer.register_schema(schema, "protobuf", schema_bytes or schema_data(schema))
                channels[topic] = writer.register_channel(topic, "protobuf", number)
            writer.add_message(channels[topic], stamp, data, stamp)

        for lens, frame in ((COLOUR.lens, "colour"), (DEPTH.lens, "depth")):
            own = CameraCalibration(
                frame_id=frame, width=lens.width, height=lens.height, distortion_model="plumb_bob"
            )
            own.K.extend([lens.fx, 0, lens.cx, 0, lens.fy, lens.cy, 0, 0, 1])
            add(f"/{frame}/calibration", "foxglove.CameraCalibration", own.SerializeToString(), 0)
        tree = FrameTransforms()
        each = tree.transforms.add(parent_frame_id="depth", child_frame_id="colour")
        each.translation.x, each.rotation.w = -BASELINE_M, 1.0
        add("/tf", "foxglove.FrameTransforms", tree.SerializeToString(), 0)
        for stamp, message in messages:
            kind = "foxglove.CompressedImage" if isinstance(message, CompressedImage) else "foxglove.RawImage"
            topic = "/colour/image" if isinstance(message, CompressedImage) else "/depth/image"
            add(topic, kind, message.SerializeToString(), stamp)
        reader = make_reader(source)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            add(channel.topic, schema.name, message.data, message.log_time, schema.data)
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        writer.finish()
    plain.unlink()


def _off_axis(simulated: SimulatedArm) -> np.ndarray:
    """From the forearm's core to the IMU, in {A}."""
    elbow, wrist = (simulated.calibration.lever_arms[joint].position_m for joint in ("elbow", "wrist"))
    y = (wrist - elbow) / np.linalg.norm(wrist - elbow)
    return -(elbow - (elbow @ y) * y)


def radius_of(simulated: SimulatedArm) -> float:
    """Core of the forearm to the IMU, m."""
    return float(np.linalg.norm(_off_axis(simulated)))


def _jpeg(grey: np.ndarray, stamp: int) -> CompressedImage:
    good, data = cv2.imencode(".jpg", cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), [cv2.IMWRITE_JPEG_QUALITY, 90])
    assert good
    message = CompressedImage(frame_id="colour", data=data.tobytes(), format="jpeg")
    message.timestamp.FromNanoseconds(stamp)
    return message


def _depth(z: np.ndarray, stamp: int) -> RawImage:
    millimetres = np.nan_to_num(np.rint(1000 * z)).astype("<u2")
    height, width = z.shape
    message = RawImage(
        frame_id="depth",
        width=width,
        height=height,
        encoding="16UC1",
        step=2 * width,
        data=millimetres.tobytes(),
    )
    message.timestamp.FromNanoseconds(stamp)
    return message
