"""What is fuzzed: a function of bytes each. Only an error that is one sentence may leave it.

A target imports its reader itself: only that is instrumented, which takes a second instead of four.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

import numpy as np

from smoother.errors import UnoccludeError
from tools.fuzz import device_targets, message_targets
from tools.fuzz.files import file_of, place

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
    from smoother.io.mcap.repair_container import repair_container

    path, whole = file_of(data, "b.mcap"), place("whole.mcap")
    report = repair_container(path, whole, force=True)
    assert sum(1 for _ in Container(whole).messages()) == sum(report.messages.values())


def result(data: bytes) -> None:
    """What `smooth` wrote."""
    from smoother.io.result.read import read_recovery

    read_recovery(file_of(data, "result.mcap"))


def media(data: bytes) -> None:
    """MCAP: images, lenses, sound."""
    from smoother.io.media.audio import read_sound
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
    from smoother.io.media.audio import read_sound

    read_sound(file_of(data, "a.wav"))


def trc(data: bytes) -> None:
    """Markers in TRC."""
    from smoother.io.markers.trc import read_trc

    read_trc(file_of(data, "a.trc"))


def c3d(data: bytes) -> None:
    """Markers in C3D, as the header and the parameters say."""
    from smoother.io.markers.c3d import read_c3d

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
    from smoother.io.plain.datasets import import_utd_mhad

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
    "cdr": message_targets.cdr,
    "protobuf": message_targets.protobuf,
    "json": message_targets.json_messages,
    "trc": trc,
    "c3d": c3d,
    "csv": csv,
    "matlab": matlab,
    "picture": picture,
    "sound": sound,
    "calibration": calibration,
    "settings": settings,
    "study": study,
    "devices": device_targets.any_device,
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
        return partial(device_targets.one_device, name.removeprefix(_DEVICE))
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
