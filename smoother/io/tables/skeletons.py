"""From a file's numbers to skeletons: states, unit, axes and times decided, and said, in one place."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...array_types import FloatArray, IntArray
from ...errors import RecordingError
from ...measurements.timestamps import begins_frames
from ...recording import CameraFrame, JointState
from ..recording.decode import states_of_scores
from ..recording.streams import SkeletonTable, States
from .joints import JointColumns, JointName, has_arm, joint_name, stated_time_unit
from .table import DeviceTable, shown
from .units import CAMERA_RATES, METRES, SECONDS, from_1970, time_unit


def without_origin(position: FloatArray) -> FloatArray:
    """Positions (..., 3) in which all of (0, 0, 0), as many programs write a lost marker, is nan."""
    return np.where((position == 0).all(axis=-1, keepdims=True), np.nan, position)


# ------------------------------------------------------------------------------------- what a format settles

#: What positions count in where a table contains u, v and the score instead of places.
PIXELS = "pixels"


@dataclass(frozen=True)
class Conventions:
    """What a format settles."""

    # "m" or "mm", what the format is written in as a rule; `PIXELS` throughout; "" where it has no rule
    unit: str = ""
    frame: CameraFrame | None = None  # Axes of the camera that the format has
    relative: bool = False  # Positions are about the hips
    up: tuple[int, int] | None = None  # Axis and sign of up in a room, where the body does not show it
    # What confidences are: "kinect" (0 to 3), "share" (0 to 1); "" = shares of one if none is larger
    states: str = ""


AZURE_AXES = Conventions("mm", CameraFrame.OPTICAL, states="kinect")
KINECT_AXES = Conventions("m", CameraFrame.KINECT)
#: Of BlazePose's landmarks, of which `RawSkeleton.landmarks` finds what they count in.
LANDMARKS = Conventions("m", CameraFrame.OPTICAL, relative=True, states="share")
RELATIVE_NOTE = (
    "World landmarks of MediaPipe are about the middle of the hips: motion is relative to the hips, the place"
    " in the room is not known, and a step or a bow of the trunk looks like a motion of the arm."
)
#: World landmarks have the middle of the hips within this of their origin, m.
_ABOUT_HIPS_M = 0.06
#: What exporters write for states, as numbers.
STATE_WORDS = {
    **dict.fromkeys(("nottracked", "not tracked", "not_tracked", "none", "false"), 0.0),
    **dict.fromkeys(("inferred", "low", "true"), 1.0),
    **dict.fromkeys(("tracked", "medium"), 2.0),
    "high": 3.0,
}


def kinect_states(confidence: FloatArray) -> States:
    """States of a Kinect's numbers: 0 none, 1 inferred (occluded, guessed), 2 (and 3 of an Azure) tracked."""
    state = np.zeros(len(confidence), np.int8)
    state[confidence == 1] = JointState.INFERRED
    state[confidence >= 2] = JointState.TRACKED
    return state


def share_states(confidence: FloatArray) -> States:
    """States of a visibility or score from 0 to 1: inferred up to one half, tracked above."""
    return np.where(confidence <= 0.5, JointState.INFERRED, JointState.TRACKED).astype(np.int8)


# ---------------------------------------------------------------------------------- what a body itself shows

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
                lengths += [float(np.median(length[length > 0]))] if (length > 0).any() else []
    return float(np.median(lengths)) if lengths else float("nan")


def unit_by_arm(position: Mapping[str, FloatArray]) -> tuple[str, float] | None:  # position dict of (F, 3)
    """Unit in which arms have an arm's length."""
    length = half_arm(position)
    units = (("m", 1.0), ("cm", 0.01), ("mm", 0.001))
    return next((each for each in units if ARM_M[0] <= length * each[1] <= ARM_M[1]), None)


def _up_axis(points: list[tuple[JointName, FloatArray]]) -> tuple[int, int] | None:  # points (F, 3) )
    """Axis along which the body stands or sits upright most of the time."""
    upper = [rows for name, rows in points if name.part in ("top", "shoulder")]
    lower = [rows for name, rows in points if name.part == "hip"]
    lower = lower or [rows for name, rows in points if name.part == "foot"]
    if not upper or not lower:
        return None
    middles = [np.ma.masked_invalid(np.stack(each)).mean(axis=0).filled(np.nan) for each in (upper, lower)]
    trunk = middles[0] - middles[1]
    trunk = trunk[np.isfinite(trunk).all(axis=1)]
    direction = np.median(trunk, axis=0) if len(trunk) else np.zeros(3)
    length, axis = float(np.linalg.norm(direction)), int(np.abs(direction).argmax())
    if not length > 0 or abs(direction[axis]) < UPRIGHT * length:
        return None
    return axis, 1 if direction[axis] > 0 else -1


#: A camera's conventions by the axis and sign of up.
_CAMERAS = {(1, 1): CameraFrame.KINECT, (1, -1): CameraFrame.OPTICAL}


# -------------------------------------------------------------------------------------------- rows to frames

#: Body numbers above this do not fit a recording: they are counted from 0 instead.
_LARGEST_BODY = 2**31 - 1
#: Rate of a file without times, Hz: that of the cameras' usual mode.
USUAL_RATE_HZ = 30.0


def gathered(
    key: FloatArray, body: FloatArray, names: Sequence[str], points: FloatArray
) -> tuple[IntArray, dict[str, FloatArray]]:
    """Rows of joints as rows of frames and bodies: the first row of each, and points (F, k) by joint."""
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
    by_joint = {name: np.full((len(first), points.shape[1]), np.nan) for name in written.tolist()}
    for code, rows in enumerate(by_joint.values()):
        mine = np.flatnonzero(joint_of == code)
        rows[row[mine]] = points[mine]
    return first[order], by_joint


def _frames_of_rows(time: FloatArray, body: FloatArray | None) -> tuple[IntArray, FloatArray]:
    """Number of the frame that each row is of, and the frames' times."""
    count = len(time)
    if body is None or (len(bodies := np.unique(body)) < 2 and np.isfinite(bodies).all()):
        return np.arange(count), time
    bodies = bodies[np.isfinite(bodies)]
    behind = np.isfinite(time).all() and (np.diff(time) < 0).any()  # one body behind the other
    if behind and all((np.diff(time[body == one]) >= 0).all() for one in bodies):
        times, frame = np.unique(time, return_inverse=True)
        return frame, times
    is_new = np.append(True, time[1:] != time[:-1])[:count]
    return np.cumsum(is_new) - 1, time[is_new]


@dataclass
class RawSkeleton:
    """Numbers of a file as written, one row per frame and body."""

    path: Path  # The file
    # dict of (N, 4): x, y, z in the file's unit and the confidence (nan = none), by joint and side
    points: dict[str, FloatArray] = field(default_factory=dict)
    rest: list[tuple[JointName, FloatArray]] = field(default_factory=list)  # (N, 3) ): hips, feet and head
    time: FloatArray | None = None  # (N,): as written
    time_unit: str = ""  # Of `time`, where the file states it; "s" of dates
    frame: FloatArray | None = None  # (N,): numbers of the frames
    body: FloatArray | None = None  # (N,): numbers of the bodies, nan where a frame has none
    rate_hz: float | None = None  # As the file states it
    notes: list[str] = field(default_factory=list)  # What was decided in reading

    @property
    def position(self) -> dict[str, FloatArray]:
        """Positions (N, 3) by joint and side."""
        return {joint: points[:, :3] for joint, points in self.points.items()}

    def add(self, name: str, points: FloatArray) -> None:
        """Put in the points (N, 3 or 4) of a joint or marker by its name, if it is one that counts."""
        meaning = joint_name(name)
        if meaning is None or (meaning.joint and meaning.kind == "skin"):
            return
        if not meaning.joint:
            self.rest.append((meaning, points[:, :3]))
            return
        self.points[meaning.joint] = np.full((len(points), 4), np.nan)
        self.points[meaning.joint][:, : points.shape[1]] = points

    def add_columns(
        self,
        columns: JointColumns,
        place: Callable[[int], FloatArray],
        confidence: Callable[[int], FloatArray],
    ) -> None:
        """Put in the joints that were found in a table, of which both give a column's numbers."""
        for joint, triple in columns.axes.items():
            cells = [place(at) for at in triple]
            said = columns.confidence.get(joint)
            cells.append(np.full(len(cells[0]), np.nan) if said is None else confidence(said))
            self.points[joint] = np.stack(cells, axis=1)
        self.rest += [(name, np.stack([place(at) for at in three], axis=1)) for name, three in columns.rest]

    def set_times(self, table: DeviceTable, column: int) -> None:
        """Take the times of a table's column."""
        self.time, dates = table.times(column)
        self.time_unit = "s" if dates else stated_time_unit(table, column)

    def skeletons(self, conventions: Conventions) -> list[SkeletonTable]:
        """One skeleton a body."""
        is_flat = conventions.unit == PIXELS
        if not is_flat:
            self._drop_empty()
        if self.body is not None:  # a column that counts rows (an `id`) names no bodies
            numbers, counts = np.unique(self.body[np.isfinite(self.body)], return_counts=True)
            if len(numbers) > 10 and np.median(counts) < 3:
                self.body = None
                self.notes.append("The body column counts rows; assumed one body.")
        require_arm(self.points, self.path, "joints")
        unit, metres = (PIXELS, 1.0) if is_flat else self._unit(conventions)
        frame, down = (conventions.frame, None) if is_flat else self._axes(conventions)
        time, seconds, rate = self._times()
        states = self._states("scores" if is_flat else conventions.states)
        position = {joint: rows * metres for joint, rows in self.position.items()}
        pattern = SkeletonTable(0, None, position, states, frame, down, rate, conventions.relative, unit)
        return self.bodies(pattern, time, seconds)

    def landmarks(self, world: bool, normalised: bool = False) -> list[SkeletonTable]:
        """Skeletons of BlazePose's landmarks: about the hips in metres, or a room's (FreeMoCap)."""
        fits, is_about_hips = unit_by_arm(self.position), self.is_about_hips()
        in_room = Conventions(states="share")
        if not world and fits is not None and fits[0] in ("mm", "cm") and not normalised:
            return self.skeletons(in_room)
        if normalised or (not is_about_hips and (self._in_image() or (fits is None and not world))):
            raise RecordingError(
                f"{self.path} contains landmarks as parts of the image's width and height (pose_landmarks),"
                " which are not metres; export pose_world_landmarks of the same video."
            )
        if not (is_about_hips or world or self._middle_of_hips() is None):
            return self.skeletons(in_room)
        self.notes.append(RELATIVE_NOTE)
        return self.skeletons(LANDMARKS)

    def bodies(self, pattern: SkeletonTable, time: FloatArray, seconds: float | None) -> list[SkeletonTable]:
        """One skeleton a body of a table of all rows, on the times (N,) of all frames of the file."""
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
                position={joint: np.full((len(times), 3), np.nan) for joint in pattern.position},
                state={joint: np.zeros(len(times), np.int8) for joint in pattern.position},
                notes=[*self.notes, *([] if fits else [f"Body {number:.0f} is called {count}."])],
            )
            for joint, position in pattern.position.items():
                own.position[joint][frame[rows]] = position[rows]
                own.state[joint][frame[rows]] = pattern.state[joint][rows]
            tables.append(own)
        if not tables:
            raise RecordingError(
                f"{self.path} has no frame with a body; record again with the person in view."
            )
        return tables

    def is_about_hips(self) -> bool:
        """Whether the middle of the hips is the origin."""
        middle = self._middle_of_hips()
        return middle is not None and bool(np.abs(middle).max() < _ABOUT_HIPS_M)

    def _middle_of_hips(self) -> FloatArray | None:
        """Median middle of the hips (3,), None where the file has none."""
        hips = {name.side: rows for name, rows in self.rest if name.part == "hip" and name.side}
        if len(hips) < 2:
            return None
        middle = 0.5 * (hips["left"] + hips["right"])
        middle = middle[np.isfinite(middle).all(axis=1)]
        return np.median(middle, axis=0) if len(middle) else None

    def _in_image(self) -> bool:
        """Whether shoulders and elbows are between 0 and 1 in x and y, y down, as in an image."""
        hips = [rows[:, 1] for name, rows in self.rest if name.part == "hip"]
        upper = {joint: rows for joint, rows in self.position.items() if not joint.startswith(("w", "h"))}
        shoulders = [rows[:, 1] for joint, rows in upper.items() if joint.startswith("shoulder")]
        is_up = hips and shoulders and np.nanmedian(shoulders) > np.nanmedian(hips)
        if is_up or not upper:
            return False
        points = np.concatenate([rows[:, :2] for rows in upper.values()])
        points = points[np.isfinite(points).all(axis=1) & (points != 0).any(axis=1)]
        inside = ((points > -0.05) & (points < 1.05)).all(axis=1)
        return bool(len(points) and inside.mean() > 0.9)

    def _states(self, kind: str) -> dict[str, States]:
        """States of all joints by their confidences; those without a position are not tracked."""
        said = {joint: points[:, 3] for joint, points in self.points.items()}
        largest = max((np.nanmax(each) for each in said.values() if np.isfinite(each).any()), default=0.0)
        if largest > 3.0:  # per cent (ZED)
            said, largest = {joint: each / 100 for joint, each in said.items()}, largest / 100
        kind = kind or ("kinect" if largest > 1.0 else "share")
        read = {"kinect": kinect_states, "share": share_states, "scores": states_of_scores}[kind]
        states, never = {}, []
        for joint, points in self.position.items():
            there, confidence = np.isfinite(points).all(axis=1), said[joint]
            is_said = np.isfinite(confidence).any()
            state = read(confidence) if is_said else np.full(len(points), JointState.TRACKED, np.int8)
            if there.any() and not state.any():
                state[there] = JointState.INFERRED
                never.append(joint)
            states[joint] = np.where(there, state, np.int8(JointState.NOT_TRACKED)).astype(np.int8)
        if never:
            self.notes.append(
                f"{', '.join(never)}: confidence 0 in every frame, though with positions; they are treated as"
                " inferred, so they are kept and not measured by."
            )
        return states

    def _drop_empty(self) -> None:
        """Lost joints, written as (0, 0, 0), have no position; joints that never have one are left out."""

        def seen(rows: FloatArray) -> FloatArray:
            near = (np.abs(rows[:, :3]) < LARGEST).all(axis=1) & (rows[:, :3] != 0).any(axis=1)
            return np.where(near[:, None], rows, np.nan)

        self.rest = [(name, seen(rows)) for name, rows in self.rest]
        there = {joint: np.isfinite(seen(rows)[:, :3]).any() for joint, rows in self.points.items()}
        if there and not any(there.values()):
            raise RecordingError(
                f"{self.path} names joints and has no position of any; record again with the person in view."
            )
        for joint, rows in [(joint, self.points.pop(joint)) for joint in list(there)]:
            if there[joint]:
                self.points[joint] = np.column_stack([seen(rows)[:, :3], rows[:, 3]])

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
        shoulders = [f"shoulder_{side}" for side in ("left", "right") if f"shoulder_{side}" in self.points]
        upper = [(JointName("shoulder", ""), self.position[joint]) for joint in shoulders]
        upright = _up_axis([*self.rest, *upper])
        own, up, why = (
            conventions.frame,
            upright or conventions.up,
            " (the body is then upright in most frames)",
        )
        if own is not None:
            if own not in _CAMERAS.values() or upright not in _CAMERAS or _CAMERAS[upright] is own:
                return own, None
            why = f", not the usual ones{why}"
        elif upright is None:
            why = ", as usual in this format"
        if up is None:
            self.notes.append("It is not known which axis is up: neither the file nor the body shows it.")
            return None, None
        axis, sign = up
        self.notes.append(f"Assumed axes: {'xyz'[axis]} {'up' if sign > 0 else 'down'}{why}.")
        if own is not None:
            return _CAMERAS[up], None
        return CameraFrame.ZUP if up == (2, 1) else None, -sign * np.eye(3)[axis]

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
        if self.frame is not None and np.isfinite(self.frame).all():
            return self.frame, 1.0 / rate, rate
        return np.arange(len(next(iter(self.points.values()))), dtype=float), None, rate


def require_arm(joints: Iterable[str], path: Path, what: str, names: Iterable[str] = ()) -> None:
    """Refuse a skeleton of which no side has an elbow and a wrist (or a hand)."""
    joints = list(joints)
    if not has_arm(joints):
        raise RecordingError(
            f"{path}: no arm with an elbow and a wrist is among its {what}"
            f" ({shown(', '.join(names or joints), 120)}); export shoulder, elbow and wrist of the arm under"
            " such names as RShoulder, RElbow and RWrist."
        )
