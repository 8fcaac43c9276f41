"""The smallest files of every kind, made by code: where fuzzing begins."""

from __future__ import annotations

import json
import struct
import sys
import tempfile
from collections import Counter
from io import BytesIO
from pathlib import Path

import device_files
import numpy as np
import skeleton_files
from library_files import write_bag, write_opal
from made_recordings import make, plain_texts
from made_results import recovery
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from calib.intrinsics import Intrinsics
from smoother.cli.config import to_toml
from smoother.config import Config
from smoother.io import write_recovery
from smoother.io.devices.registry import formats
from smoother.io.export.markers import C3dContent, write_c3d, write_trc
from smoother.io.media.images import (
    CAMERA_CALIBRATION,
    COMPRESSED_IMAGE,
    RAW_IMAGE,
    jpeg_image,
    lens_message,
    raw_image,
)
from smoother.io.recording.write import write_recording
from smoother.io.tables.joint_columns import BLAZEPOSE
from smoother.io.wire.schemas import message_class

_NS = 1_700_000_000 * 10**9


def media_seeds() -> dict[str, list[bytes]]:
    """Inputs by target."""
    import cv2
    from scipy.io import savemat, wavfile

    grey = np.arange(64, dtype=np.uint16).reshape(8, 8)
    pictures = [cv2.imencode(".png", image)[1].tobytes() for image in (grey, grey.astype(np.uint8))]
    pictures.append(cv2.imencode(".jpg", grey.astype(np.uint8))[1].tobytes())
    sounds = []
    for kind in (np.int16, np.uint8, np.float32, np.int32):
        file = BytesIO()
        wavfile.write(file, 8000, np.arange(16).reshape(8, 2).astype(kind))
        sounds.append(file.getvalue())
    trial = BytesIO()
    savemat(trial, {"d_iner": np.ones((6, 6)), "d_skel": np.ones((20, 3, 4))}, do_compression=False)
    return {"picture": pictures, "sound": sounds, "matlab": [trial.getvalue()], "media": [_media(grey)]}


def _media(grey: np.ndarray) -> bytes:
    """A container of an image each kind, a lens and two blocks of sound."""
    audio = message_class("foxglove.RawAudio")(
        data=struct.pack("<8h", *range(8)), format="pcm-s16", sample_rate=8000, number_of_channels=1
    )
    audio.timestamp.FromNanoseconds(_NS)
    lens = Intrinsics(8, 8, 8.0, 8.0, 4.0, 4.0, (0.0,) * 5)
    messages = [
        (RAW_IMAGE, raw_image("depth", "16UC1", grey, _NS)),
        (COMPRESSED_IMAGE, jpeg_image("colour", grey.astype(np.uint8), _NS)),
        (CAMERA_CALIBRATION, lens_message("depth", lens, _NS)),
        ("foxglove.RawAudio", audio.SerializeToString()),
    ]
    file = BytesIO()
    writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
    writer.start()
    for name, data in messages:
        schema = writer.register_schema(name, "protobuf", b"")
        channel = writer.register_channel(f"/{name}", "protobuf", schema)
        for _ in range(2):
            writer.add_message(channel, _NS, data, _NS)
    writer.finish()
    return file.getvalue()


sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "helpers"))


#: Text is cut to this many lines: that is enough to be recognised, and read in a tenth of the time.
_LINES = 24


def device_seeds() -> dict[str, list[bytes]]:
    """Files by importer; an importer whose library is absent has none."""
    makers = {
        **device_files.EXAMPLES,
        "rosbag1": lambda path: write_bag(path, samples=4, frames=2),
        "apdm-hdf5": lambda path: write_opal(path, count=12),
        "pose-json": _landmarks,
    }
    seeds: dict[str, list[bytes]] = {}
    with tempfile.TemporaryDirectory() as name:
        for importer in formats():
            path = Path(name) / importer.key
            try:
                makers[importer.key](path)
            except ImportError:
                seeds[importer.key] = [b"\0"]
                continue
            data = path.read_bytes()
            lines = data.split(b"\n")
            is_table = len(lines) > _LINES and b"\0" not in data
            seeds[importer.key] = [b"\n".join(lines[:_LINES]) + b"\n" if is_table else data]
    return seeds


def _landmarks(path: Path) -> None:
    """Landmarks of MediaPipe as a program of one's own writes them."""
    rows = [
        [{"x": x, "y": y, "z": z, "visibility": 0.9} for x, y, z in frame]
        for frame in skeleton_files.landmarks(4).tolist()
    ]
    assert len(rows[0]) == len(BLAZEPOSE)
    frames = [{"timestamp_ms": 40 * at, "world_landmarks": row} for at, row in enumerate(rows)]
    path.write_text(json.dumps({"frames": frames}), encoding="utf-8")


sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "helpers"))


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
    devices = device_seeds()
    return {
        "container": containers,
        "recording": [wrapped(recording, **plain), wrapped(recording, **plain, use_chunking=False)],
        "repair": containers,
        "result": [wrapped(answer, 5, **plain), wrapped(answer, 5, **plain, use_chunking=False)],
        "cdr": [b"\x29" + _cdr_imu(), b"\x01" + _CDR + struct.pack("<I", 0)],
        "protobuf": [bytes([len(data) // 8 + 1]) + data for data in messages.values()],
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
