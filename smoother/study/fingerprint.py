"""What a result depends on, as hashes, and what rows say of the machine: nothing, unless asked for."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from ..config import Config
from ..io.recording.selection import Selection
from ..runtime.inputs import check_input

_BLOCK = 1 << 20


@dataclass(frozen=True)
class InputSelection:
    """What to take of a recording that has several of it, and what to carry over; see `smooth --help`."""

    imu: str | None = None
    skeleton: str | None = None
    side: str | None = None
    body: int | None = None
    passthrough_images: bool = False

    @property
    def selection(self) -> Selection:
        """What to take, as readers want it."""
        return Selection(imu=self.imu, skeleton=self.skeleton, side=self.side, body=self.body)


def file_hash(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes, in hexadecimal digits; refuses what is no file."""
    check_input(path)
    digest = hashlib.sha256()
    with open(path, "rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def config_hash(config: Config, choice: InputSelection) -> str:
    """SHA-256 of all settings that a result depends on; the number of processes is none of them."""
    settings: dict[str, Any] = config.model_dump(mode="json", exclude={"windows": {"processes"}})
    return text_hash(json.dumps([settings, asdict(choice)], sort_keys=True))


def text_hash(*texts: str) -> str:
    """SHA-256 of texts, told apart."""
    return hashlib.sha256("\0".join(texts).encode("utf-8", "surrogateescape")).hexdigest()


def row_id(name: str, input_hash: str, config: str, calibration: str, version: str) -> str:
    """What a result is known by: the same id, the same result."""
    return text_hash(name, input_hash, config, calibration, version)[:32]


_DAY_NS = 86_400 * 10**9
#: Stamps before 2000 are those of a clock that does not know the date.
EARLIEST_NS = 10_957 * _DAY_NS
#: Days of a person are shifted by up to so many.
MOST_DAYS = 3650.0


def place_of(word: str, source: str) -> str:
    """A recording's place as a hash with the study's word as its key: known again, but not read."""
    return text_hash("place", word, source)[:32]


def state_of(word: str, size_bytes: int, mtime_ns: int) -> str:
    """A file's size and time of change as a hash with the study's word as its key: equal, but not read.

    The time of change is that of the recording, mostly, which `relative_day` hides.
    """
    return text_hash("state", word, str(size_bytes), str(mtime_ns))[:32]


def hashed_name(word: str, name: str) -> str:
    """A recording's name as hashes with the study's word as their key, a hash a folder: layout stays.

    Parameters
    ----------
    word : str
        The study's.
    name : str
        In the study, with its ending: "p12/monday/reach.mcap".
    """
    stem, dot, ending = name.rpartition(".")
    parts = (stem if dot else name).split("/")
    return "/".join(text_hash("name", word, part)[:12] for part in parts) + dot + (ending if dot else "")


def person_of(name: str) -> str:
    """The first folder of a recording's name; "" where it lies in none."""
    return name.partition("/")[0] if "/" in name else ""


def relative_day(word: str, person: str, origin_ns: int) -> float | None:
    """When a recording was made, in days from a time that nobody but the study knows.

    The time is another one for each person, so that days of one person can be subtracted and nothing else.

    Parameters
    ----------
    word : str
        The study's, key of the person's secret time.
    person : str
        As `person_of` has it.
    origin_ns : int, ns
        Stamp that the recording's times count from.

    Returns
    -------
    day : float or None
        None where the recording's clock knows no date.
    """
    if origin_ns < EARLIEST_NS:
        return None
    shift = int(text_hash("day", word, person)[:13], 16) / 16**13 * MOST_DAYS
    return origin_ns / _DAY_NS - shift


def without_places(text: str, names: Mapping[str, str]) -> str:
    """A sentence without the folders and the name of this machine.

    Parameters
    ----------
    text : str
        May hold paths.
    names : mapping of str to str
        What to say for paths that the study knows; for the temporary, own and current folder there is a word.
    """
    import socket

    places = dict(names)
    for folder in (tempfile.gettempdir(), os.getcwd(), os.path.expanduser("~")):
        places.setdefault(folder, f"[{'temporary' if folder == tempfile.gettempdir() else 'own'} folder]")
    for path in sorted(places, key=len, reverse=True):  # the longest first: folders lie in folders
        if path and path.strip("/\\"):
            text = text.replace(path, places[path])
    host = socket.gethostname()
    return text.replace(host, "a machine") if len(host) > 3 else text
