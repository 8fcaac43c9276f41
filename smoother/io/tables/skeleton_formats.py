"""Plain tables of skeletons with a header, one row per frame: a row of `SKELETON_FORMATS` each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame, JointState
from .columns import time_among
from .joints import JointColumns, find_joint_columns, words_of
from .skeletons import Conventions, RawSkeleton, SkeletonTable, unit_by_arm
from .table import FileHead, Table, read_table
from .units import CAMERA_RATES, SECONDS, TIME, plain_unit

#: States (N,) from the cells of a confidence column, numbers or words made numbers.
StateReader = Callable[[FloatArray], NDArray[np.int8]]
#: What exporters write for states, as numbers.
_WORDS = {
    **dict.fromkeys(("nottracked", "not tracked", "not_tracked", "none", "false"), 0.0),
    **dict.fromkeys(("inferred", "low", "true"), 1.0),
    **dict.fromkeys(("tracked", "medium"), 2.0),
    "high": 3.0,
}


def header_of(head: FileHead) -> tuple[str, ...]:
    """Names of the columns of a file's beginning; none where it is not a table with a header."""
    layout = head.table
    return () if layout is None else layout.names


def read_wide(path: Path, states: StateReader | None, expected: str) -> tuple[RawSkeleton, JointColumns]:
    """Read a table with one row per frame and body."""
    sheet = read_table(path, expected)
    sheet.refuse_nameless()
    columns = find_joint_columns(sheet.names)
    raw = RawSkeleton(
        path,
        {joint: sheet.vectors(triple) for joint, triple in columns.axes.items()},
        rest=[(name, sheet.vectors(triple)) for name, triple in columns.rest],
        time_scale=columns.time_scale,
    )
    if columns.time is not None:
        raw.time, dates = sheet.times(columns.time)
        if dates:
            raw.time_scale = 1.0
        elif raw.time_scale is None:
            raw.time_scale = TIME.get(plain_unit(sheet.unit(columns.time)))
        if _counts_frames(raw.time) and raw.time_scale is None:
            raw.frame, raw.time = raw.time, None
    elif not _take_time(sheet, columns, raw) and columns.frame is not None:
        raw.frame = sheet.numbers(columns.frame)
    if columns.body is not None:
        raw.body = body_numbers(sheet, columns.body)
    if states is not None:
        values = {joint: state_numbers(sheet, column) for joint, column in columns.confidence.items()}
        raw.state = states_of(values, states)
    raw.notes += sheet.notes
    return raw, columns


def _take_time(sheet: Table, columns: JointColumns, raw: RawSkeleton) -> bool:
    """Whether a column of no known name is the time; it is the skeleton's then."""
    used = {columns.frame, columns.body, *columns.confidence.values()}
    used |= {at for triple in (*columns.axes.values(), *(each for _, each in columns.rest)) for at in triple}
    free: dict[str, FloatArray] = {}
    for at, name in enumerate(sheet.names):
        if at not in used:
            with suppress(RecordingError):  # of words, not of times
                free[name] = sheet.times(at)[0]
    name, unit = time_among(free, CAMERA_RATES, sheet.path, raw.notes)
    if not name:
        return False
    raw.time, raw.time_scale = free[name], SECONDS[unit]
    return True


def state_numbers(sheet: Table, column: int) -> FloatArray:
    """A column of confidences or states; words as `_WORDS` has them, also behind a prefix."""
    cells = sheet.texts(column)
    sample = next((cell for cell in cells if cell), "")
    if not any(character.isalpha() for character in sample) or sample.lower() == "nan":
        return sheet.numbers(column)
    code = {
        cell: _WORDS.get(cell.lower(), _WORDS.get(cell.lower().rpartition("_")[2], np.nan))
        for cell in set(cells)
    }
    return np.array([code[cell] for cell in cells])


def body_numbers(sheet: Table, column: int) -> FloatArray:
    """A column of the bodies' numbers; names are numbered in their order, no body (-1, 2^32 - 1) is nan."""
    cells = sheet.texts(column)
    if any(character.isalpha() for cell in cells[:50] for character in cell if cell.lower() != "nan"):
        order = {cell: float(number) for number, cell in enumerate(dict.fromkeys(cells)) if cell}
        return np.array([order.get(cell, np.nan) for cell in cells])
    numbers = sheet.numbers(column).copy()
    numbers[(numbers < 0) | (numbers == 2**32 - 1)] = np.nan
    return numbers


def azure_states(confidence: FloatArray) -> NDArray[np.int8]:
    """States of the Azure Kinect's confidences: 0 none, 1 low (occluded, guessed), 2 medium, 3 high."""
    state = np.zeros(len(confidence), np.int8)
    state[confidence == 1] = JointState.INFERRED
    state[confidence >= 2] = JointState.TRACKED
    return state


def kinect_states(confidence: FloatArray) -> NDArray[np.int8]:
    """States of the Kinect v2's: 0 not tracked, 1 inferred, 2 tracked."""
    return azure_states(confidence)


def states_of(
    confidence: dict[str, FloatArray],  # dict of (N,)
    states: StateReader,
) -> dict[str, NDArray[np.int8]]:
    """States of all joints; where no value of a Kinect v2's is above 1, they are shares of one."""
    largest = max((float(np.nanmax(c)) for c in confidence.values() if np.isfinite(c).any()), default=0.0)
    if states is not azure_states and largest <= 1.0:
        states = share_states
    return {joint: states(values) for joint, values in confidence.items()}


def share_states(confidence: FloatArray) -> NDArray[np.int8]:
    """States of a visibility or score from 0 to 1: inferred up to one half, tracked above."""
    state = np.full(len(confidence), JointState.TRACKED, np.int8)
    state[confidence <= 0.5] = JointState.INFERRED
    return state


def inferred_throughout(raw: RawSkeleton) -> None:
    """Joints with positions that are never tracked are treated as inferred, with a note."""
    joints = []
    for joint, state in raw.state.items():
        there = np.isfinite(raw.position[joint]).all(axis=1) & (raw.position[joint] != 0).any(axis=1)
        if there.any() and not state.any():
            state[there] = JointState.INFERRED
            joints.append(joint)
    if joints:
        raw.notes.append(
            f"{', '.join(joints)}: confidence 0 in every frame, though with positions; they are treated as"
            " inferred, so they are kept and not measured by."
        )


def _counts_frames(time: FloatArray) -> bool:
    """Whether a column of times is a count of frames: whole numbers, the next one at nearly every row."""
    step = np.diff(time[np.isfinite(time)])
    return bool(len(step) > 2 and (step == 1).mean() > 0.5 and np.isin(step, np.arange(100)).all())


#: World landmarks have the middle of the hips within this of their origin, m.
_ABOUT_HIPS_M = 0.06
RELATIVE_NOTE = (
    "World landmarks of MediaPipe are about the middle of the hips: motion is relative to the hips, the place"
    " in the room is not known, and a step or a bow of the trunk looks like a motion of the arm."
)


def landmarks_in_metres(raw: RawSkeleton, world: bool, normalised: bool = False) -> list[SkeletonTable]:
    """Skeletons of BlazePose's landmarks: about the hips in metres, or a room's (FreeMoCap)."""
    fits = unit_by_arm(raw.position)
    is_about_hips = about_hips(raw)
    if not world and fits is not None and fits[0] in ("mm", "cm") and not normalised:
        return raw.skeletons(Conventions())
    if normalised or (not is_about_hips and (_in_image(raw) or (fits is None and not world))):
        raise RecordingError(
            f"{raw.path} contains landmarks as parts of the image's width and height (pose_landmarks), which"
            " are not metres; export pose_world_landmarks of the same video."
        )
    if is_about_hips or world or _middle_of_hips(raw) is None:
        raw.notes.append(RELATIVE_NOTE)
        return raw.skeletons(Conventions("m", CameraFrame.OPTICAL, relative=True))
    return raw.skeletons(Conventions())


def about_hips(raw: RawSkeleton) -> bool:
    """Whether the middle of the hips is the origin."""
    middle = _middle_of_hips(raw)
    return middle is not None and bool(np.abs(middle).max() < _ABOUT_HIPS_M)


def _middle_of_hips(raw: RawSkeleton) -> FloatArray | None:
    """Median middle of the hips (3,), None where the file has none."""
    hips = {name.side: rows for name, rows in raw.rest if name.part == "hip" and name.side}
    if len(hips) < 2:
        return None
    middle = 0.5 * (hips["left"] + hips["right"])
    middle = middle[np.isfinite(middle).all(axis=1)]
    return np.median(middle, axis=0) if len(middle) else None


def _in_image(raw: RawSkeleton) -> bool:
    """Whether shoulders and elbows are between 0 and 1 in x and y, y down, as in an image."""
    hips = [rows[:, 1] for name, rows in raw.rest if name.part == "hip"]
    shoulders = [rows[:, 1] for joint, rows in raw.position.items() if joint.startswith("shoulder")]
    if hips and shoulders and np.nanmedian(np.concatenate(shoulders)) > np.nanmedian(np.concatenate(hips)):
        return False
    rows = [rows[:, :2] for joint, rows in raw.position.items() if joint.startswith(("shoulder", "elbow"))]
    if not rows:
        return False
    points = np.concatenate(rows)
    points = points[np.isfinite(points).all(axis=1) & (points != 0).any(axis=1)]
    inside = ((points > -0.05) & (points < 1.05)).all(axis=1)
    return bool(len(points) and inside.mean() > 0.9)


@dataclass(frozen=True)
class SkeletonFormat:
    """An importer of a table with a header, one row per frame and body; see `Format`."""

    key: str  # As in `Format`
    title: str  # As in `Format`
    recognised_by: str  # As in `Format`
    expected: str  # What a file should be, for messages
    # Whether a table that names an elbow and a wrist of one side is of this format, by its columns' names and
    # what they are
    fits: Callable[[Sequence[str], JointColumns], bool]
    states: StateReader  # Makes states of the numbers of a joint's confidence
    # What the format settles; or makes the skeletons in a way of its own
    conventions: Conventions | Callable[[RawSkeleton, JointColumns], list[SkeletonTable]]
    guesses: bool = False  # Joints that are never tracked are treated as inferred
    kind: str = "skeleton"  # As in `Format`

    def recognises(self, head: FileHead) -> bool:
        """Whether the header names an elbow and a wrist of one side, as this format does."""
        names = header_of(head)
        columns = find_joint_columns(names)
        return columns.has_arm() and self.fits(names, columns)

    def read(self, path: Path) -> list[SkeletonTable]:
        """Read all bodies."""
        raw, columns = read_wide(path, self.states, self.expected)
        if self.guesses:
            inferred_throughout(raw)
        if callable(self.conventions):
            return self.conventions(raw, columns)
        return raw.skeletons(self.conventions)


def _words(names: Sequence[str]) -> set[str]:
    return {word for name in names for word in words_of(name)}


def _is_azure(names: Sequence[str], _: JointColumns) -> bool:
    """Whether the header names joints that only this SDK has."""
    return bool(_words(names) & {"navel", "naval", "clavicle", "k4abt"}) or "WRIST_RIGHT (c)" in names


def _is_kinect_v2(names: Sequence[str], _: JointColumns) -> bool:
    """Whether the header names joints that only this SDK has."""
    pairs = {pair for name in names for pair in pairwise(words_of(name))}
    return bool(pairs & {("spine", "base"), ("spine", "shoulder"), ("spine", "mid"), ("hand", "tip")})


def _is_mediapipe(names: Sequence[str], columns: JointColumns) -> bool:
    """Whether the header numbers landmarks, or names some that only BlazePose has."""
    return columns.numbered or columns.world or bool(_words(names) & {"pinky", "mouth", "visibility"})


#: Where two recognise a table, the upper one has it.
SKELETON_FORMATS = (
    # Positions in mm in the depth camera's axes, times in us. Confidence 2 and 3 is tracked, 1 (occluded,
    # guessed) inferred, 0 (out of range) not tracked. Orbbec's wrapper of this SDK writes the same joints.
    SkeletonFormat(
        key="azure-kinect",
        title="Azure Kinect or Orbbec body tracking, table",
        recognised_by=(
            "columns x, y, z of joints by the SDK's names (SPINE_NAVEL, CLAVICLE_LEFT, WRIST_RIGHT ..)"
        ),
        expected="a table of an Azure Kinect's joints",
        fits=_is_azure,
        states=azure_states,
        conventions=Conventions("mm", CameraFrame.OPTICAL),
        guesses=True,
    ),
    # Positions in m, x left, y up, z forward; tracking states 0, 1, 2 or in words where there are any.
    SkeletonFormat(
        key="kinect-v2",
        title="Kinect v2 joints, table",
        recognised_by=(
            "columns x, y, z of joints by the SDK's names (SpineBase, SpineShoulder, WristRight ..)"
        ),
        expected="a table of a Kinect's joints",
        fits=_is_kinect_v2,
        states=kinect_states,
        conventions=Conventions("m", CameraFrame.KINECT),
    ),
    # BlazePose's 33 landmarks by number or name; world landmarks are metres about the hips.
    SkeletonFormat(
        key="mediapipe",
        title="MediaPipe world landmarks, table",
        recognised_by=(
            "columns x, y, z of 33 numbered landmarks, or of landmarks such as right_pinky, mouth_left"
        ),
        expected="a table of MediaPipe's landmarks",
        fits=_is_mediapipe,
        states=share_states,
        conventions=lambda raw, columns: landmarks_in_metres(raw, columns.world, columns.normalised),
    ),
    # The unit is found by the arms' lengths, up by how the body stands.
    SkeletonFormat(
        key="joint-table",
        title="table of joints by name (FreeMoCap, Pose2Sim and others)",
        recognised_by=(
            "columns x, y, z of an elbow and a wrist of one side, such as right_wrist_x or RWrist_X"
        ),
        expected="a table of joints",
        fits=lambda names, columns: True,
        states=kinect_states,
        conventions=Conventions(),
    ),
)
