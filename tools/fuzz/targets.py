"""What is fuzzed: a function of bytes each. Only an error that is one sentence may leave it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from calib.file import read_calibration
from smoother.errors import UnoccludeError
from smoother.io.devices.file_reader import FileReader
from smoother.io.markers.c3d import read_c3d
from smoother.io.markers.trc import read_trc
from smoother.io.mcap.container import Container
from smoother.io.mcap.messages import Topic, TopicMessages
from smoother.io.mcap.repair_container import repair_container
from smoother.io.plain.folder import open_csv
from smoother.io.recording.decode import plain_decoder
from smoother.io.recording.json_messages import json_decoder
from smoother.io.recording.read import open_recording, select_recording
from smoother.io.recording.skeletons import skeleton_decoder
from smoother.io.result.read import read_recovery

#: Inputs longer than this teach nothing more, bytes.
LONGEST = 1 << 16
#: Files of one process; in memory where the system has such a folder.
_SHM = Path("/dev/shm")
FOLDER = Path(tempfile.mkdtemp(prefix="unocclude_fuzz_", dir=_SHM if _SHM.is_dir() else None))


def _file(data: bytes, name: str) -> Path:
    path = FOLDER / f"{os.getpid()}_{name}"
    path.write_bytes(data)
    return path


def container(data: bytes) -> None:
    """MCAP: messages, streams, the recording chosen of them, and the repaired file."""
    path = _file(data, "a.mcap")
    for _ in Container(path).messages():
        pass
    select_recording(open_recording(path))


def repair(data: bytes) -> None:
    """MCAP, written anew; what was repaired reads back."""
    path, whole = _file(data, "b.mcap"), FOLDER / f"{os.getpid()}_whole.mcap"
    report = repair_container(path, whole, force=True)
    assert sum(1 for _ in Container(whole).messages()) == sum(report.messages.values())


def _fed(data: bytes, encoding: str, schemas: tuple[str, ...]) -> None:
    """Messages of each schema, cut from the input by its first bytes."""
    size = max(data[0], 1) * 8 if data else 1
    start = np.arange(1, max(len(data), 2), size)
    stop = np.minimum(start + size, len(data))
    for schema in schemas:
        topic = Topic("/imu/forearm", schema, "", b"", encoding)
        decoder = plain_decoder(topic) or skeleton_decoder(topic) or json_decoder(topic)
        assert decoder is not None, schema
        decoder.feed(TopicMessages(np.arange(len(start)), data, start, np.maximum(stop, start)))
        if hasattr(decoder, "arms"):
            decoder.arms()
        else:
            decoder.stream()


def cdr(data: bytes) -> None:
    """ROS 2 messages."""
    kinds = ("Imu", "MagneticField")
    schemas = [f"sensor_msgs/msg/{kind}" for kind in kinds]
    _fed(data, "cdr", (*schemas, "geometry_msgs/msg/PoseStamped", "visualization_msgs/msg/MarkerArray"))


def protobuf(data: bytes) -> None:
    """Our messages and Foxglove's."""
    _fed(data, "protobuf", ("unocclude.Imu", "unocclude.Skeleton", "foxglove.PoseInFrame"))


def json_messages(data: bytes) -> None:
    """Messages in JSON."""
    _fed(data, "json", ("unocclude.Imu", "unocclude.Skeleton", "foxglove.PoseInFrame"))


def trc(data: bytes) -> None:
    """Markers in TRC."""
    read_trc(_file(data, "a.trc"))


def c3d(data: bytes) -> None:
    """Markers in C3D, as the header and the parameters say."""
    read_c3d(_file(data, "a.c3d"))


def csv(data: bytes) -> None:
    """A folder of plain files; the input is the three of them, parted by NUL."""
    folder = FOLDER / f"{os.getpid()}_folder"
    folder.mkdir(exist_ok=True)
    names = ("recording.toml", "skeleton.csv", "imu.csv")
    for name, text in zip(names, [*data.split(b"\0", 2), b"", b""], strict=False):
        (folder / name).write_bytes(text)
    open_csv(folder)


def devices(data: bytes) -> None:
    """A file of any device, recognised by its content."""
    path = _file(data, "export.csv")
    reader = FileReader()
    reader.read(path, reader.format_of(path, ""))


def calibration(data: bytes) -> None:
    """A calibration file."""
    file = read_calibration(_file(data, "a.toml"))
    file.arm("right")


def result(data: bytes) -> None:
    """What `smooth` wrote."""
    read_recovery(_file(data, "result.mcap"))


TARGETS: dict[str, Callable[[bytes], None]] = {
    "container": container,
    "repair": repair,
    "cdr": cdr,
    "protobuf": protobuf,
    "json": json_messages,
    "trc": trc,
    "c3d": c3d,
    "csv": csv,
    "devices": devices,
    "calibration": calibration,
    "result": result,
}


def once(name: str, data: bytes) -> None:
    """Run a target; a sentence for the user is an answer, anything else is raised."""
    if len(data) > LONGEST:
        return
    try:
        with np.errstate(all="ignore"):
            TARGETS[name](data)
    except UnoccludeError as error:
        sentence = str(error)
        assert len(sentence) < 4000, f"a sentence of {len(sentence)} letters"
