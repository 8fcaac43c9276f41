"""The smallest files of every kind, made by code: where fuzzing begins."""

from __future__ import annotations

import json
import struct
import sys
import tempfile
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "helpers"))

import device_files
from made_recordings import make, plain_texts
from made_results import recovery

from smoother.io import write_recovery
from smoother.io.export.c3d import C3dContent, write_c3d
from smoother.io.export.trc import write_trc
from smoother.io.recording.write import write_recording

#: Plain CDR, little endian.
_CDR = b"\0\1\0\0"
CALIBRATION = """format = "unocclude calibration"
version = 1
[arm.right]
upper_arm_m = 0.301
upper_arm_sigma_m = 0.004
R_F_A = [1.0, 0.0, 0.0, 0.0]
[arm.right.lever_arm.elbow]
position_m = [0.03, -0.21, 0.0]
sigma_m = [0.005, 0.005, 0.005]
"""


def _wrapped(data: bytes, **way: object) -> bytes:
    """The same messages, written by the mcap package."""
    reader, file = make_reader(BytesIO(data)), BytesIO()
    writer = Writer(file, **way)  # type: ignore[arg-type]
    writer.start()
    channels: dict[str, int] = {}
    for schema, channel, message in reader.iter_messages():
        if channel.topic not in channels:
            number = writer.register_schema(schema.name, schema.encoding, b"")
            channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, number)
        writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
    for record in reader.iter_metadata():
        writer.add_metadata(record.name, record.metadata)
    writer.finish()
    return file.getvalue()


def seeds() -> dict[str, list[bytes]]:
    """Inputs by target."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_recording(make(0.5), folder / "a.mcap")
        recording = (folder / "a.mcap").read_bytes()
        write_recovery([recovery(60)], folder / "b.mcap")
        answer = (folder / "b.mcap").read_bytes()
        position = np.random.default_rng(0).normal(size=(3, 2, 3))
        write_c3d(folder / "a.c3d", C3dContent(("A", "B"), position, 100.0), True)
        write_trc(folder / "a.trc", ("A", "B"), np.arange(3) * 0.01, position, 100.0, True)
        devices = []
        for write in device_files.EXAMPLES.values():
            try:
                write(folder / "device")
                devices.append((folder / "device").read_bytes())
            except (ImportError, OSError):
                continue
        c3d, trc = (folder / "a.c3d").read_bytes(), (folder / "a.trc").read_bytes()
    containers = [
        recording,
        _wrapped(recording, compression=CompressionType.NONE, chunk_size=2000, enable_crcs=False),
        _wrapped(recording, compression=CompressionType.LZ4, chunk_size=2000),
        _wrapped(recording, use_chunking=False),
    ]
    messages = {kind: bytes(data) for kind, data in _payloads(recording).items()}
    texts = plain_texts()
    plain = [texts[name] for name in ("recording", "skeleton", "imu_forearm_right") if name in texts]
    short = "\0".join("\n".join(text.split("\n")[:20]) for text in plain).encode()
    point = {"x": 1.0, "y": 2.0, "z": 3.0}
    imu = {"timestamp": {"sec": 1, "nsec": 2}, "linear_acceleration": point, "angular_velocity": point}
    body = {"body": 1, "joints": [{"name": "wrist_right", "state": "TRACKED", "position": point}]}
    return {
        "container": containers,
        "repair": containers,
        "cdr": [b"\x29" + _cdr_imu(), b"\x01" + _CDR + struct.pack("<I", 0)],
        "protobuf": [bytes([len(data) // 8 + 1]) + data for data in messages.values()],
        "json": [b"\x20" + json.dumps(value).encode() for value in (imu, body)],
        "trc": [trc],
        "c3d": [c3d],
        "csv": [short],
        "devices": devices,
        "calibration": [CALIBRATION.encode()],
        "result": [answer, _wrapped(answer, compression=CompressionType.NONE, enable_crcs=False)],
    }


def _cdr_imu() -> bytes:
    """sensor_msgs/msg/Imu: header, then 37 doubles; eight bytes are counted from behind the first four."""
    head = struct.pack("<iII4s", 1_700_000_000, 5, 4, b"imu\0")
    return _CDR + head + struct.pack("<37d", *np.arange(37.0))


def _payloads(data: bytes) -> dict[str, bytes]:
    """A message of each schema."""
    return {
        schema.name: message.data
        for schema, _, message in make_reader(BytesIO(data)).iter_messages()
        if schema
    }


def write_seeds(folder: Path) -> None:
    """Write the inputs, a folder a target."""
    for target, inputs in seeds().items():
        (folder / target).mkdir(parents=True, exist_ok=True)
        for number, data in enumerate(inputs):
            (folder / target / f"seed_{number}").write_bytes(data)
