"""From a file's numbers to skeletons: unit, axes, states and times decided, and said, in one place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray, IntArray
from ...errors import RecordingError
from ...measurements.timestamps import begins_frames
from ...recording import CameraFrame, JointState
from .joints import JointName, joint_name
from .table import shown
from .units import CAMERA_RATES, METRES, SECONDS, from_1970, time_unit


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

    def __len__(self) -> int:
        return next(map(len, self.position.values()), 0)

    def select(self, keep: BoolArray | IntArray) -> SkeletonTable:
        """Some of the frames, or all in another order."""
        return replace(
            self,
            t_s=None if self.t_s is None else self.t_s[keep],
            position={joint: values[keep] for joint, values in self.position.items()},
            state={joint: values[keep] for joint, values in self.state.items()},
        )


def without_origin(position: FloatArray) -> FloatArray:
    """Positions (..., 3) in which all of (0, 0, 0), as many programs write a lost marker, is nan."""
    return np.where((position == 0).all(axis=-1, keepdims=True), np.nan, position)


#: What positions count in where a table contains u, v and the score instead of places.
PIXELS = "pixels"
#: Half an arm of a child to a tall adult, shoulder to elbow or elbow to wrist, m.
ARM_M = (0.09, 0.6)
#: What is larger is not a position in any unit, but a cell that was damaged.
LARGEST = 1e7
#: An axis is up where the trunk lies so much along it (cosine).
UPRIGHT = 0.75


def half_arm(position: Mapping[str, FloatArray]) -> float:
    """Median length of upper arms and forearms in the unit of the positions; nan where there are none."""
    lengths = []
    for side in ("left", "right"):
        for one, other in (("shoulder", "elbow"), ("elbow", "wrist")):
            a, b = position.get(f"{one}_{side}"), position.get(f"{other}_{side}")
            if a is not None and b is not None:
                near = (np.abs(a) < LARGEST).all(axis=1) & (np.abs(b) < LARGEST).all(axis=1)
                length = np.linalg.norm(a[near] - b[near], axis=1)
                length = length[np.isfinite(length) & (length > 0)]
                if len(length):
                    lengths.append(float(np.median(length)))
    return float(np.median(lengths)) if lengths else float("nan")


def unit_by_arm(position: Mapping[str, FloatArray]) -> tuple[str, float] | None:  # position dict of (F, 3)
    """Unit in which arms have an arm's length."""
    length = half_arm(position)
    for unit, metres in (("m", 1.0), ("cm", 0.01), ("mm", 0.001)):
        if ARM_M[0] <= length * metres <= ARM_M[1]:
            return unit, metres
    return None


def up_axis(points: list[tuple[JointName, FloatArray]]) -> tuple[int, int] | None:  # points (F, 3) )
    """Axis along which the body stands or sits upright most of the time."""
    upper = [rows for name, rows in points if name.part in ("top", "shoulder")]
    lower = [rows for name, rows in points if name.part == "hip"]
    lower = lower or [rows for name, rows in points if name.part == "foot"]
    if not upper or not lower:
        return None
    trunk = _middle(upper) - _middle(lower)
    trunk = trunk[np.isfinite(trunk).all(axis=1)]
    if not len(trunk):
        return None
    direction = np.median(trunk, axis=0)
    length = float(np.linalg.norm(direction))
    axis = int(np.abs(direction).argmax())
    if not length > 0 or abs(direction[axis]) < UPRIGHT * length:
        return None
    return axis, 1 if direction[axis] > 0 else -1


def _frame_of(axis: int, sign: int, camera: bool) -> CameraFrame | None:
    """The convention of axes of which one is up; a room's y up has none (`camera`: axes of a camera)."""
    if (axis, sign) == (2, 1):
        return CameraFrame.ZUP
    if camera and axis == 1:
        return CameraFrame.KINECT if sign > 0 else CameraFrame.OPTICAL
    return None


def _middle(points: list[FloatArray]) -> FloatArray:
    """Mean (F, 3) of points, each where it is there."""
    return np.ma.masked_invalid(np.stack(points)).mean(axis=0).filled(np.nan)


#: Body numbers above this do not fit a recording: they are counted from 0 instead.
_LARGEST_BODY = 2**31 - 1


def gathered(
    key: FloatArray, body: FloatArray, names: Sequence[str], xyz: FloatArray, state: NDArray | None
) -> tuple[IntArray, dict[str, FloatArray], dict[str, NDArray[np.int8]]]:
    """Rows of joints as rows of frames and bodies: the first row of each; positions, states by joint."""
    written, joint_of = np.unique(names, return_inverse=True)
    number_of_body = np.unique(body, return_inverse=True)[1]
    starts = joint_of + len(joint_of) * number_of_body
    if (np.diff(key[np.isfinite(key)]) >= 0).all() or begins_frames(key, starts):
        frame = np.cumsum(np.append(True, key[1:] != key[:-1])[: len(key)])
    else:
        frame = np.unique(key, return_inverse=True)[1]
    pairs = np.stack([frame, number_of_body])
    _, first, row = np.unique(pairs, axis=1, return_index=True, return_inverse=True)
    order = np.argsort(first)  # frames in the order of the file
    row = np.argsort(order)[np.reshape(row, -1)]
    position = {name: np.full((len(first), 3), np.nan) for name in written.tolist()}
    states = {name: np.zeros(len(first), np.int8) for name in position}
    for code, name in enumerate(position):
        mine = np.flatnonzero(joint_of == code)
        position[name][row[mine]] = xyz[mine]
        states[name][row[mine]] = JointState.TRACKED if state is None else state[mine]
    return first[order], position, states


def _frames_of_rows(time: FloatArray, body: FloatArray | None) -> tuple[IntArray, FloatArray]:
    """Number of the frame that each row is of, and the frames' times."""
    count = len(time)
    if body is None or (len(bodies := np.unique(body)) < 2 and np.isfinite(bodies).all()):
        return np.arange(count), time
    known, bodies = np.isfinite(time), bodies[np.isfinite(bodies)]
    behind = known.all() and (np.diff(time) < 0).any()  # one body behind the other
    if behind and all((np.diff(time[body == one]) >= 0).all() for one in bodies):
        times, frame = np.unique(time, return_inverse=True)
        return frame, times
    is_new = np.append(True, time[1:] != time[:-1])[:count]
    return np.cumsum(is_new) - 1, time[is_new]


#: Rate of a file without times, Hz: that of the cameras' usual mode.
USUAL_RATE_HZ = 30.0


@dataclass(frozen=True)
class Conventions:
    """What a format settles."""

    # "m" or "mm", what the format is written in as a rule; `PIXELS` throughout; "" where it has no rule
    unit: str = ""
    frame: CameraFrame | None = None  # Axes of the camera that the format has
    relative: bool = False  # Positions are about the hips
    up: tuple[int, int] | None = None  # Axis and sign of up in a room, where the body does not show it


@dataclass
class RawSkeleton:
    """Numbers of a file as written, one row per frame and body."""

    path: Path  # The file
    # dict of (N, 3): by joint and side, in the file's unit
    position: dict[str, FloatArray] = field(default_factory=dict)
    # int (N,): `JointState` values where the file has them
    state: dict[str, NDArray[np.int8]] = field(default_factory=dict)
    time: FloatArray | None = None  # (N,): as written
    time_unit: str = ""  # Of `time`, where the file states it; "s" of dates
    frame: FloatArray | None = None  # (N,): numbers of the frames
    body: FloatArray | None = None  # (N,): numbers of the bodies, nan where a frame has none
    rest: list[tuple[JointName, FloatArray]] = field(default_factory=list)  # (N, 3) ): hips, feet and head
    rate_hz: float | None = None  # As the file states it
    notes: list[str] = field(default_factory=list)  # What was decided in reading

    def add(self, name: str, rows: FloatArray, state: NDArray[np.int8] | None = None) -> None:
        """Put in the positions (N, 3) of a joint or marker by its name, if it is one that counts."""
        meaning = joint_name(name)
        if meaning is None or (meaning.joint and meaning.kind == "skin"):
            return
        if not meaning.joint:
            self.rest.append((meaning, rows))
            return
        self.position[meaning.joint] = rows
        if state is not None:
            self.state[meaning.joint] = state

    def skeletons(self, conventions: Conventions) -> list[SkeletonTable]:
        """One skeleton a body."""
        if conventions.unit != PIXELS:
            self._drop_empty()
        if self.body is not None:  # a column that counts rows (an `id`) names no bodies
            numbers, counts = np.unique(self.body[np.isfinite(self.body)], return_counts=True)
            if len(numbers) > 10 and np.median(counts) < 3:
                self.body = None
                self.notes.append("The body column counts rows; assumed one body.")
        require_arm(self.position, self.path, "joints", list(self.position))
        if conventions.unit == PIXELS:
            unit, metres, frame, down = PIXELS, 1.0, conventions.frame, None
        else:
            unit, metres = self._unit(conventions)
            frame, down = self._axes(conventions)
        time, seconds, rate = self._times()
        for joint, rows in self.position.items():
            self.position[joint] = rows * metres
            state = self.state.get(joint, np.full(len(rows), JointState.TRACKED, np.int8))
            there = np.isfinite(rows).all(axis=1)
            self.state[joint] = np.where(there, state, np.int8(JointState.NOT_TRACKED)).astype(np.int8)
        pattern = SkeletonTable(0, None, {}, {}, frame, down, rate, conventions.relative, unit)
        return self.bodies(pattern, time, seconds)

    def bodies(self, pattern: SkeletonTable, time: FloatArray, seconds: float | None) -> list[SkeletonTable]:
        """One skeleton a body of positions in metres, on the times (N,) of all frames of the file."""
        frame, times = _frames_of_rows(time, self.body)
        bodies = np.zeros(len(frame)) if self.body is None else self.body
        numbers = np.unique(bodies[np.isfinite(bodies)])
        tables = []
        for count, number in enumerate(numbers.tolist()):
            rows = np.flatnonzero(bodies == number)
            fits = 0 <= number <= _LARGEST_BODY and number == int(number)
            own = replace(
                pattern,
                body=int(number) if fits else count,
                t_s=None if seconds is None else times * seconds,
                position={joint: np.full((len(times), 3), np.nan) for joint in self.position},
                state={joint: np.zeros(len(times), np.int8) for joint in self.position},
                notes=[*self.notes, *([] if fits else [f"Body {number:.0f} is called {count}."])],
            )
            for joint in self.position:
                own.position[joint][frame[rows]] = self.position[joint][rows]
                own.state[joint][frame[rows]] = self.state[joint][rows]
            tables.append(own)
        if not tables:
            raise RecordingError(
                f"{self.path} has no frame with a body; record again with the person in view."
            )
        return tables

    def _drop_empty(self) -> None:
        """Lost joints, written as (0, 0, 0), have no position; joints that never have one are left out."""

        def seen(rows: FloatArray) -> FloatArray:
            near = (np.abs(rows) < LARGEST).all(axis=1, keepdims=True)
            return np.where(near, without_origin(rows), np.nan)

        self.rest = [(name, seen(rows)) for name, rows in self.rest]
        filled = {joint: seen(rows) for joint, rows in self.position.items()}
        self.position = {joint: rows for joint, rows in filled.items() if np.isfinite(rows).any()}
        if filled and not self.position:
            raise RecordingError(
                f"{self.path} names joints and has no position of any; record again with the person in view."
            )

    def _unit(self, conventions: Conventions) -> tuple[str, float]:
        """Name of the unit and metres in it."""
        fits, length = unit_by_arm(self.position), half_arm(self.position)
        if fits is None and conventions.unit and not np.isfinite(length):
            return conventions.unit, METRES[conventions.unit]
        if fits is None:
            raise RecordingError(
                f"{self.path}: half an arm is {length:.3g} long, which is a length in neither m, cm nor mm;"
                " export positions in metres, not pixels or parts of the image."
            )
        unit, metres = fits
        if unit != conventions.unit:
            usual = f", not the usual {conventions.unit}" if conventions.unit else ""
            said = f"{unit}{usual} (half an arm is then {length * metres:.2f} m long)"
            self.notes.append(f"Assumed unit of positions: {said}.")
        return unit, metres

    def _axes(self, conventions: Conventions) -> tuple[CameraFrame | None, FloatArray | None]:
        """Convention of the axes, and the direction of down where they are a room's."""
        shoulders = [
            (JointName("shoulder", side), self.position[f"shoulder_{side}"])
            for side in ("left", "right")
            if f"shoulder_{side}" in self.position
        ]
        upright = up_axis([*self.rest, *shoulders])
        if (own := conventions.frame) is not None:
            other = {CameraFrame.KINECT: (1, -1), CameraFrame.OPTICAL: (1, 1)}.get(own)
            if upright is None or upright != other:
                return own, None
            self._note_axes(upright, ", not the usual ones (the body is then upright in most frames)")
            return _frame_of(*upright, camera=True), None
        axis, sign = upright or conventions.up or (-1, 0)
        if not sign:
            self.notes.append("It is not known which axis is up: neither the file nor the body shows it.")
            return None, None
        down = -sign * np.eye(3)[axis]
        if upright is None:
            self._note_axes((axis, sign), ", as usual in this format")
            return None, down
        self._note_axes(upright, " (the body is then upright in most frames)")
        return _frame_of(*upright, camera=False), down

    def _note_axes(self, up: tuple[int, int], why: str) -> None:
        self.notes.append(f"Assumed axes: {'xyz'[up[0]]} {'up' if up[1] > 0 else 'down'}{why}.")

    def _times(self) -> tuple[FloatArray, float | None, float | None]:
        """What distinguishes frames, its unit in seconds (None: no times), the rate without times."""
        if self.time is not None and np.isfinite(self.time).any():
            self.time = np.where(np.isfinite(self.time), self.time, np.nan)
            fits = time_unit(self.time_unit, self.time, CAMERA_RATES) or self.time_unit
            if not fits:
                raise RecordingError(
                    f"{self.path}: its times give no certain frame rate in s, ms, us, ns or ticks of 100 ns;"
                    " export times of the frames with their unit (time_ms)."
                )
            if fits != self.time_unit:
                self.notes.append(f"Assumed unit of times: {fits} (gives a camera's frame rate).")
            return from_1970(self.time, fits), SECONDS[fits], None
        rate = self.rate_hz or USUAL_RATE_HZ
        if self.rate_hz is None:
            self.notes.append(
                f"The file has no times: assumed {rate:g} frames per second, evenly; export times if you can."
            )
        count = len(next(iter(self.position.values())))
        if self.frame is not None and np.isfinite(self.frame).all():
            return self.frame, 1.0 / rate, rate
        return np.arange(count, dtype=float), None, rate


def require_arm(position: dict[str, FloatArray], path: Path, what: str, names: list[str]) -> None:
    """Refuse a skeleton of which no side has an elbow and a wrist (or a hand)."""
    for side in ("left", "right"):
        if f"elbow_{side}" in position and ({f"wrist_{side}", f"hand_{side}"} & position.keys()):
            return
    listed = shown(", ".join(names), 120)
    raise RecordingError(
        f"{path}: no arm with an elbow and a wrist is among its {what} ({listed}); export shoulder, elbow and"
        " wrist of the arm under such names as RShoulder, RElbow and RWrist."
    )
