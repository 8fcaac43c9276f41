"""What an importer of device files is: it recognises a file by what is in it, and reads it.

The beginning of a file, as importers see it, and how it is shown in a message.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray, IntArray
from ...errors import RecordingError
from ...recording import CameraFrame
from ...runtime.inputs import check_input, marked_encoding
from .table_layout import is_workbook, workbook_text


@dataclass
class ImuTable:
    """One inertial sensor as a file has it, in SI units, times not yet repaired."""

    name: str  # What the file calls the sensor ("" where it does not say)
    t_s: FloatArray | None  # (N,) s: stamps as written, on the device's clock
    acc: FloatArray | None  # (N, 3) m/s^2 and rad/s: none where the file contains only the other of the two
    gyro: FloatArray | None  # (N, 3) m/s^2 and rad/s: none where the file contains only the other of the two
    mag: FloatArray | None = None  # (N, 3): in the sensor's own unit
    rate_hz: float | None = None  # Rate that the file states, or that its counter counts
    # int (N,): Packet counter, where there is one
    counter: NDArray[np.int64] | None = None
    counter_wraps: int = 0  # 0 = it does not wrap
    units: str = ""  # As written in the file, for the line that is said of it ("m/s^2, deg/s")
    notes: list[str] = field(default_factory=list)  # What was decided or dropped in reading, a sentence each
    # The file does not state the gyroscope's unit, and its size alone decided: an accelerometer may settle it
    gyro_unit_assumed: bool = False
    made_of: tuple[str, ...] = ()  # Streams of the file that contain a half each


@dataclass
class ImagePoints:
    """One body's joints in the pictures of a camera."""

    width: int  # Of the pictures, pixels
    height: int  # Of the pictures, pixels
    joints: dict[str, FloatArray]  # dict of (F, 3)

    def select(self, keep: BoolArray | IntArray) -> ImagePoints:
        """Some of the frames."""
        return ImagePoints(self.width, self.height, {name: rows[keep] for name, rows in self.joints.items()})


@dataclass
class SkeletonTable:
    """One body's joints as a file has them, in metres, times not yet repaired."""

    body: int  # The file's number of the body
    t_s: FloatArray | None  # (F,) s: frame times as written, on the camera's clock
    # dict of (F, 3) m: By joint and side (`wrist_left`, `shoulder_right`, ..); nan where there is none
    position: dict[str, FloatArray]
    state: dict[str, NDArray[np.int8]]  # int (F,): `JointState` values of the same joints
    frame: CameraFrame | None = None  # Where the format settles the axes
    gravity_hint: FloatArray | None = None  # (3,)
    rate_hz: float | None = None  # Rate that the file or its format states
    relative: bool = False  # Positions are relative to the body (about the hips)
    units: str = ""  # As written in the file ("mm")
    notes: list[str] = field(default_factory=list)  # What was decided or dropped in reading, a sentence each
    image: ImagePoints | None = None  # The same joints in the pictures, where the file has them


@dataclass(frozen=True)
class FileHead:
    """What an importer sees of a file to recognise it."""

    path: Path  # The file; its name is for messages only and recognises nothing
    raw: bytes  # Its first 64 kB
    text: str  # The same decoded (UTF-8, UTF-16, a byte-order mark taken off), or a workbook's first rows
    lines: tuple[str, ...]  # The text's whole lines
    trouble: str = ""  # Why a workbook cannot be read; "" where it can


#: What a file holds: sensors, skeletons, or both.
Tables = list[ImuTable] | list[SkeletonTable] | list[ImuTable | SkeletonTable]


class DeviceFormat(Protocol):
    """An importer of one layout of files."""

    @property
    def key(self) -> str:
        """Its name on the command line (`xsens-dot`)."""

    @property
    def title(self) -> str:
        """Its name in sentences ("Xsens DOT export")."""

    @property
    def kind(self) -> str:
        """What it contains: "imu", "skeleton" or "recording" (both)."""

    @property
    def recognised_by(self) -> str:
        """What in a file gives it away, for `unocclude import formats`."""

    def recognises(self, head: FileHead, /) -> bool:
        """Whether the file is of this layout; never raises."""

    def read(self, path: Path, /) -> Tables:
        """Read the whole file."""


@dataclass(frozen=True)
class FileFormat:
    """The row of a layout that is no plain table: a `DeviceFormat` whose `read` is a function of its own."""

    key: str
    title: str
    kind: str
    recognised_by: str
    recognises: Callable[[FileHead], bool]
    read: Callable[[Path], Tables]


def begins(*marks: bytes) -> Callable[[FileHead], bool]:
    """Recognises files by their first bytes: one of these."""
    return lambda head: head.raw.startswith(marks)


#: So much of a file is read to recognise it, bytes.
HEAD_BYTES = 65_536
#: This many rows of a workbook.
HEAD_ROWS = 500
#: So much of a file is shown in a message at most, characters.
SHOWN_CHARACTERS = 200
#: Among the first characters, more of these than one in this many are not text.
_CONTROL_SHARE = 0.02
#: Dashes that are used as a minus: before a number or the digits of an exponent, not between two numbers.
_DASH = re.compile(r"(?:(?<!\w)|(?<=\d[eE]))[\u2012\u2013](?=[.,]?\d)")


def read_head(path: Path) -> FileHead:
    """Read a file's beginning."""
    check_input(path, RecordingError)
    try:
        with path.open("rb") as stream:
            raw = stream.read(HEAD_BYTES)
    except FileNotFoundError:
        raise RecordingError(f"{path} does not exist; check the name.") from None
    except IsADirectoryError:
        raise RecordingError(f"{path} is a folder; name the file in it.") from None
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error
    if not raw:
        raise RecordingError(f"{path} is empty; export or copy it again.")
    if is_workbook(raw):
        text, trouble = "", ""
        try:
            text = workbook_text(path, HEAD_ROWS)
        except RecordingError as error:  # other files of its folder can be of use
            trouble = str(error)
        return FileHead(path, raw, text, tuple(text.splitlines()), trouble)
    text = decode(raw)
    whole = text if len(raw) < HEAD_BYTES else text[: text.rfind("\n") + 1] or text
    return FileHead(path, raw, text, tuple(whole.splitlines()))


def decode(raw: bytes) -> str:
    """A file's bytes as text without byte-order mark, with plain minus signs; "" where they are not text."""
    encoding = marked_encoding(raw)
    if encoding is None and len(raw) >= 4:  # UTF-16 without a mark: every other byte of plain text is zero
        even, odd = raw[0:400:2].count(0), raw[1:400:2].count(0)
        half = len(raw[:400]) // 2
        if odd > 0.8 * half and not even:
            encoding = "utf-16-le"
        elif even > 0.8 * half and not odd:
            encoding = "utf-16-be"
    if encoding is None:
        if b"\0" in raw:
            return ""
        encoding = "utf-8"
    try:
        # The last character may be cut in two by the end of the head.
        text = codecs.getincrementaldecoder(encoding)().decode(raw)
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    start = text[:4000]
    control = sum(1 for character in start if ord(character) < 32 and character not in "\t\r\n\f")
    return "" if control > _CONTROL_SHARE * len(start) else plain_minus(text)


def plain_minus(text: str) -> str:
    """Text in which typographic minus signs, and dashes before a number, are the plain minus."""
    text = text.replace("\u2212", "-")
    return _DASH.sub("-", text) if "\u2012" in text or "\u2013" in text else text


def no_table(raw: bytes, text: str) -> str:
    """What is plainly no table to read, and what to do: goes behind the file's name; "" for others."""
    if raw.startswith(b"\xd0\xcf\x11\xe0"):
        return "is an Excel workbook of the old kind; save it as .xlsx or CSV."
    if raw.startswith(b"PK\x03\x04") and not is_workbook(raw):
        return "is an archive (zip, or a spreadsheet); unpack it, or save it as CSV."
    lines = [line for line in text.splitlines() if line.strip()]
    names = r"[^\d;,\t][^;,\t]*([;,\t]\s*[^\d\s;,\t+.-][^;,\t]*)+"
    is_header = len(lines) == 1 and re.fullmatch(names, lines[0])
    return "has a header and has no rows; export it again." if is_header else ""


def amount(count: int, one: str, many: str) -> str:
    """A count with the words behind it: of one, or of many."""
    return f"{count} {one if count == 1 else many}"


def shown(text: str, characters: int = SHOWN_CHARACTERS) -> str:
    """Text as a message can show it: no control characters, no more than this many characters."""
    plain = " ".join("".join(c if c.isprintable() else " " for c in text[: 8 * characters]).split())
    return plain if len(plain) <= characters else plain[: characters - 2] + ".."


def first_rows(head: FileHead, characters: int = SHOWN_CHARACTERS) -> str:
    """The first rows of a file for a message, or its first bytes where it is not text."""
    if not head.text:
        return f"bytes {head.raw[:16].hex(' ')} .."
    return shown(" | ".join(line for line in head.lines[:4] if line.strip()), characters)
