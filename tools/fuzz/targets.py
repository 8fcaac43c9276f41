"""What is fuzzed: a function of bytes each. Only an error that is one sentence may leave it.

A target imports its reader itself: only that is instrumented, which takes a second instead of four.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np

from smoother.errors import UnoccludeError

_SHM = Path("/dev/shm")


@cache
def _folder(process: int) -> tempfile.TemporaryDirectory[str]:
    """A folder of this process, deleted when it ends."""
    return tempfile.TemporaryDirectory(prefix="unocclude_fuzz_", dir=_SHM if _SHM.is_dir() else None)


def place(name: str) -> Path:
    """A file's place."""
    return Path(_folder(os.getpid()).name) / name


def file_of(data: bytes, name: str) -> Path:
    """The bytes as a file."""
    path = place(name)
    path.write_bytes(data)
    return path


def any_device(data: bytes) -> None:
    """A file of any device, recognised by its content."""
    from smoother.io.devices.files import import_files
    from smoother.io.devices.folder import sort_files
    from smoother.io.devices.registry import FileReader

    path, reader = file_of(data, "export.csv"), FileReader()
    skeletons, imus, _ = sort_files([path], reader)
    import_files(skeletons, imus, reader=reader)


def one_device(key: str, data: bytes) -> None:
    """A file that the user says is of this device."""
    from smoother.io.devices.files import ImuFiles, import_files
    from smoother.io.devices.registry import FileReader, format_named
    from smoother.io.tables.protocol import ImuTable, SkeletonTable

    path, reader = file_of(data, "export.dat"), FileReader(key, key)
    tables = reader.read(path, format_named(key))
    skeletons = [path] if any(isinstance(table, SkeletonTable) for table in tables) else []
    imus = [ImuFiles((path,))] if any(isinstance(table, ImuTable) for table in tables) else []
    import_files(skeletons, imus, reader=reader)


def _fed(data: bytes, encoding: str, schemas: tuple[str, ...]) -> None:
    """Messages of each schema, cut from the input by its first byte."""
    from smoother.io.mcap.messages import Topic, TopicMessages
    from smoother.io.recording.decode import plain_decoder, skeleton_decoder

    size = max(data[0], 1) * 8 if data else 1
    start = np.arange(1, max(len(data), 2), size)
    stop = np.minimum(start + size, len(data))
    for schema in schemas:
        topic = Topic("/imu/forearm", schema, "", b"", encoding)
        decoder = plain_decoder(topic) or skeleton_decoder(topic)
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


#: Inputs longer than this teach nothing more, bytes.
LONGEST = 1 << 16


def container(data: bytes) -> None:
    """MCAP: all messages, front to back."""
    from smoother.io.mcap.container import Container

    for _ in Container(file_of(data, "a.mcap")).messages():
        pass


def recording(data: bytes) -> None:
    """MCAP: streams, and the recording chosen of them."""
    from smoother.io.recording.read import open_recording, select_recording

    select_recording(open_recording(file_of(data, "a.mcap")))


def repair(data: bytes) -> None:
    """MCAP, written anew; what was repaired reads back."""
    from smoother.io.mcap.container import Container
    from smoother.io.mcap.merge import repair_container

    path, whole = file_of(data, "b.mcap"), place("whole.mcap")
    report = repair_container(path, whole, force=True)
    assert sum(1 for _ in Container(whole).messages()) == sum(report.messages.values())


def result(data: bytes) -> None:
    """What `smooth` wrote."""
    from smoother.io.result.read import read_recovery

    read_recovery(file_of(data, "result.mcap"))


def media(data: bytes) -> None:
    """MCAP: images, lenses, sound."""
    from smoother.io.media.clock_files import read_sound
    from smoother.io.media.images import ImageMessage, read_images

    path = file_of(data, "c.mcap")
    for message in read_images(path):
        if isinstance(message, ImageMessage):
            try:
                message.pixels()
            except UnoccludeError:
                continue
    read_sound(path)


def picture(data: bytes) -> None:
    """A PNG file, as depth and as infrared."""
    from calib.panel.images import read_view

    path = file_of(data, "a.png")
    read_view(path, path)


def sound(data: bytes) -> None:
    """A WAV file."""
    from smoother.io.media.clock_files import read_sound

    read_sound(file_of(data, "a.wav"))


def trc(data: bytes) -> None:
    """Markers in TRC."""
    from smoother.io.markers import read_trc

    read_trc(file_of(data, "a.trc"))


def c3d(data: bytes) -> None:
    """Markers in C3D, as the header and the parameters say."""
    from smoother.io.markers import read_c3d

    read_c3d(file_of(data, "a.c3d"))


def csv(data: bytes) -> None:
    """A folder of plain files; the input is the three of them, parted by NUL."""
    from smoother.io.plain.folder import open_csv

    folder = place("folder")
    folder.mkdir(exist_ok=True)
    names = ("recording.toml", "skeleton.csv", "imu.csv")
    for name, text in zip(names, [*data.split(b"\0", 2), b"", b""], strict=False):
        (folder / name).write_bytes(text)
    open_csv(folder)


def matlab(data: bytes) -> None:
    """A trial of a published data set."""
    from smoother.io.plain.folder import import_utd_mhad

    path = file_of(data, "a.mat")
    import_utd_mhad(path, path)


def calibration(data: bytes) -> None:
    """A calibration file."""
    from calib.file import read_calibration

    read_calibration(file_of(data, "a.toml")).arm("right")


def settings(data: bytes) -> None:
    """A file of settings, of markers, of a panel, of a lens: each reader has it."""
    from calib.panel.definition import read_intrinsics, read_panel
    from smoother.cli.config import read_config
    from smoother.evaluation.mocap.markers import read_marker_map

    path = file_of(data, "b.toml")
    for read in (read_config, read_marker_map, read_panel, read_intrinsics):
        try:
            read(path)
        except UnoccludeError as error:
            short(error)


def study(data: bytes) -> None:
    """A list of a study's recordings."""
    from smoother.study.inputs import find_entries

    find_entries(str(file_of(data, "list.txt")), place("study"))


_READERS: dict[str, Callable[[bytes], None]] = {
    "container": container,
    "recording": recording,
    "repair": repair,
    "result": result,
    "media": media,
    "cdr": cdr,
    "protobuf": protobuf,
    "trc": trc,
    "c3d": c3d,
    "csv": csv,
    "matlab": matlab,
    "picture": picture,
    "sound": sound,
    "calibration": calibration,
    "settings": settings,
    "study": study,
    "devices": any_device,
}
_DEVICE = "device-"


@cache
def names() -> tuple[str, ...]:
    """All targets: the readers, and one for each importer of device files."""
    from smoother.io.devices.registry import formats

    return *_READERS, *(f"{_DEVICE}{importer.key}" for importer in formats())


def target(name: str) -> Callable[[bytes], None]:
    """A target by its name."""
    if name.startswith(_DEVICE):
        return partial(one_device, name.removeprefix(_DEVICE))
    return _READERS[name]


def short(error: UnoccludeError) -> None:
    """A sentence for the user is an answer, if it is one that can be read."""
    sentence = str(error)
    assert len(sentence) < 4000, f"a sentence of {len(sentence)} letters"


def once(name: str, data: bytes) -> None:
    """Run a target; a sentence for the user is an answer, anything else is raised."""
    if len(data) > LONGEST:
        return
    try:
        with np.errstate(all="ignore"):
            target(name)(data)
    except UnoccludeError as error:
        short(error)
