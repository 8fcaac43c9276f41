"""What an importer of device files is: it recognises a file by what is in it, and reads it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...recording import CameraFrame


@dataclass
class ImuTable:
    """One inertial sensor as a file has it, in SI units, times not yet repaired.

    Attributes
    ----------
    name : str
        What the file calls the sensor ("" where it does not say).
    t_s : ndarray, shape (N,), s, optional
        Stamps as written, on the device's clock; None where the file has none (an even `rate_hz` counts).
    acc, gyro : ndarray, shape (N, 3), m/s^2 and rad/s, optional
        None where the file holds only the other of the two.
    mag : ndarray, shape (N, 3), optional
        In the sensor's own unit.
    rate_hz : float, Hz, optional
        Rate that the file states, or that its counter counts.
    counter : ndarray of int, shape (N,), optional
        Packet counter, where there is one (a jump is lost samples; `counter_wraps` is where it starts anew).
    counter_wraps : int
        0 = it does not wrap.
    units : str
        As written in the file, for the line that is said of it ("m/s^2, deg/s").
    notes : list of str
        What was decided or dropped in reading, a sentence each.
    gyro_unit_assumed : bool
        The file does not state the gyroscope's unit, and its size alone decided: an accelerometer may
        settle it.
    """

    name: str
    t_s: FloatArray | None
    acc: FloatArray | None
    gyro: FloatArray | None
    mag: FloatArray | None = None
    rate_hz: float | None = None
    counter: NDArray[np.int64] | None = None
    counter_wraps: int = 0
    units: str = ""
    notes: list[str] = field(default_factory=list)
    gyro_unit_assumed: bool = False


@dataclass
class SkeletonTable:
    """One body's joints as a file has them, in metres, times not yet repaired.

    Attributes
    ----------
    body : int
        The file's number of the body.
    t_s : ndarray, shape (F,), s, optional
        Frame times as written, on the camera's clock; None where the file has none (`rate_hz` counts).
    position : dict of str to ndarray, shape (F, 3), m
        By joint and side (`wrist_left`, `shoulder_right`, ..); nan where there is none.
    state : dict of str to ndarray of int8, shape (F,)
        `JointState` values of the same joints.
    frame : CameraFrame, optional
        Where the format settles the axes.
    gravity_hint : ndarray, shape (3,), optional
        Direction of down in the axes of the positions, where they are a room's (y up, say) and no camera's.
    rate_hz : float, Hz, optional
        Rate that the file or its format states.
    relative : bool
        Positions are relative to the body (about the hips): the place in the room is not known.
    units : str
        As written in the file ("mm").
    notes : list of str
        What was decided or dropped in reading, a sentence each.
    """

    body: int
    t_s: FloatArray | None
    position: dict[str, FloatArray]
    state: dict[str, NDArray[np.int8]]
    frame: CameraFrame | None = None
    gravity_hint: FloatArray | None = None
    rate_hz: float | None = None
    relative: bool = False
    units: str = ""
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class FileHead:
    """What an importer sees of a file to recognise it.

    Attributes
    ----------
    path : Path
        The file; its name is for messages only and recognises nothing.
    raw : bytes
        Its first 64 kB.
    text : str
        The same decoded (UTF-8, UTF-16, a byte-order mark taken off), "" where it is no text.
    lines : tuple of str
        The text's whole lines.
    """

    path: Path
    raw: bytes
    text: str
    lines: tuple[str, ...]


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
        """What it holds: "imu", "skeleton" or "recording" (both)."""

    @property
    def recognised_by(self) -> str:
        """What in a file gives it away, for `unocclude import formats`."""

    def recognises(self, head: FileHead) -> bool:
        """Whether the file is of this layout; never raises."""

    def read(self, path: Path) -> list[ImuTable] | list[SkeletonTable] | list[ImuTable | SkeletonTable]:
        """Read the whole file.

        Parameters
        ----------
        path : Path
            The file.

        Returns
        -------
        list of ImuTable, of SkeletonTable, or of both
            One for each sensor or skeleton, in the file's order.

        Raises
        ------
        RecordingError
            In one sentence: the file, what was expected, and what to export instead.
        """
