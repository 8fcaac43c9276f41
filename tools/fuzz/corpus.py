"""The smallest files of every kind, made by code: where fuzzing begins."""

from __future__ import annotations

import json
import struct
import sys
import tempfile
from collections import Counter
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "helpers"))

from made_recordings import make, plain_texts
from made_results import recovery

from smoother.cli.config import to_toml
from smoother.config import Config
from smoother.io import write_recovery
from smoother.io.export.markers import C3dContent, write_c3d, write_trc
from smoother.io.recording.write import write_recording
from tools.fuzz.device_seeds import device_seeds
from tools.fuzz.media_seeds import media_seeds

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
SETTINGS = (
    to_toml(Config()),
    '[markers]\nwrist = ["RAD", "ULN"]\nelbow = ["EL"]\nplate = ["A", "B", "C"]\n'
    "[plate]\nR_A_P = [1, 0, 0, 0]\np_A_P = [0, 0, 0]\n",
    "[panel]\nmarkers = [[0.0, 0.0], [0.2, 0.0], [0.4, 0.0], [0.0, 0.2]]\n"
    "extent = [-0.1, -0.1, 0.5, 0.3]\nmarker_height = 0.0\n",
    "width = 640\nheight = 576\nfx = 504.0\nfy = 504.0\ncx = 320.0\ncy = 288.0\n"
    "distortion = [0, 0, 0, 0, 0]\n",
)
#: Words that readers look for, or that numbers break on.
WORDS = (
    b"nan", b"inf", b"-1", b"0", b"1e300", b"-1e-300", b"1e999", b"4294967295", b"9223372036854775808",
    b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0", b"\0\0\0\x80\0\0\0\0", b"\xef\xbb\xbf", b"\n",
    b"\t", b";", b",", b'"', b"\0", b"RF64", b"<!DOCTYPE", b"&a;", b"]]", b"[[", b"}}", b"{{",
    b"\\u0000", b"true",
)  # fmt: skip


def wrapped(data: bytes, most: int = 1 << 20, **way: object) -> bytes:
    """The same messages, the first of each topic, written by the mcap package."""
    reader, file = make_reader(BytesIO(data)), BytesIO()
    writer = Writer(file, **way)  # type: ignore[arg-type]
    writer.start()
    channels: dict[str, int] = {}
    count: Counter[str] = Counter()
    for schema, channel, message in reader.iter_messages():
        if schema is None or count[channel.topic] == most:
            continue
        count[channel.topic] += 1
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
        c3d, trc = (folder / "a.c3d").read_bytes(), (folder / "a.trc").read_bytes()
    plain = {"compression": CompressionType.NONE, "enable_crcs": False}
    containers = [
        wrapped(recording, 12, **plain, chunk_size=2000),
        wrapped(recording, 12, compression=CompressionType.LZ4, chunk_size=2000),
        wrapped(recording, 12, compression=CompressionType.ZSTD, chunk_size=2000),
        wrapped(recording, 12, **plain, use_chunking=False),
    ]
    messages = {kind: bytes(data) for kind, data in _payloads(recording).items()}
    texts = plain_texts()
    tables = [texts["recording"].partition("[truth]")[0], texts["skeleton"], texts["imu"]]
    short = "\0".join("\n".join(text.split("\n")[:20]) for text in tables).encode()
    point = {"x": 1.0, "y": 2.0, "z": 3.0}
    imu = {"timestamp": {"sec": 1, "nsec": 2}, "linear_acceleration": point, "angular_velocity": point}
    body = {"body": 1, "joints": [{"name": "wrist_right", "state": "TRACKED", "position": point}]}
    devices = device_seeds()
    return {
        "container": containers,
        "recording": [wrapped(recording, **plain), wrapped(recording, **plain, use_chunking=False)],
        "repair": containers,
        "result": [wrapped(answer, 5, **plain), wrapped(answer, 5, **plain, use_chunking=False)],
        "cdr": [b"\x29" + _cdr_imu(), b"\x01" + _CDR + struct.pack("<I", 0)],
        "protobuf": [bytes([len(data) // 8 + 1]) + data for data in messages.values()],
        "json": [b"\x20" + json.dumps(value).encode() for value in (imu, body)],
        "trc": [trc],
        "c3d": [c3d],
        "csv": [short],
        "calibration": [CALIBRATION.encode()],
        "settings": [text.encode() for text in SETTINGS],
        "study": [b"# a list\na.mcap\nb/c.mcap\tcal.toml\n"],
        **media_seeds(),
        "devices": [data for group in devices.values() for data in group],
        **{f"device-{key}": group for key, group in devices.items()},
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
    """Write the inputs, a folder a target, and the words beside them."""
    for target, inputs in seeds().items():
        (folder / target).mkdir(parents=True, exist_ok=True)
        for number, data in enumerate(inputs):
            (folder / target / f"seed_{number}").write_bytes(data)
    lines = ['"' + "".join(f"\\x{byte:02x}" for byte in word) + '"' for word in WORDS]
    (folder / "words.txt").write_text("\n".join(lines) + "\n", encoding="ascii")
