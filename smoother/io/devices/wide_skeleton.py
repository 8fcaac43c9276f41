"""Tables with one row a frame and body, read by the names of their columns."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...recording import JointState
from .joint_columns import JointColumns, find_joint_columns
from .protocol import FileHead
from .raw_skeleton import RawSkeleton
from .sheet import Sheet, read_sheet
from .table_layout import layout_of

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
    """Names of the columns of a file's beginning; none where it is no table with a header."""
    layout = layout_of(head.lines) if head.text else None
    return () if layout is None else layout.names


def read_wide(path: Path, states: StateReader | None, expected: str) -> tuple[RawSkeleton, JointColumns]:
    """Read a table with one row a frame and body.

    Parameters
    ----------
    path : Path
        The file.
    states : callable, optional
        Makes states of the numbers of a joint's confidence; None = confidences are passed over.
    expected : str
        What the file should be, for messages.

    Returns
    -------
    RawSkeleton, JointColumns
        The numbers as written, and the columns that they are from.

    Raises
    ------
    RecordingError
        The file is no table.
    """
    sheet = read_sheet(path, expected)
    sheet.refuse_nameless()
    columns = find_joint_columns(sheet.layout.names)
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
            raw.time_scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}.get(sheet.unit(columns.time))
        if _counts_frames(raw.time) and raw.time_scale is None:
            raw.frame, raw.time = raw.time, None
    elif columns.frame is not None:
        raw.frame = sheet.numbers(columns.frame)
    if columns.body is not None:
        raw.body = body_numbers(sheet, columns.body)
    if states is not None:
        values = {joint: state_numbers(sheet, column) for joint, column in columns.confidence.items()}
        raw.state = states_of(values, states)
    raw.notes += sheet.notes
    return raw, columns


def state_numbers(sheet: Sheet, column: int) -> FloatArray:
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


def body_numbers(sheet: Sheet, column: int) -> FloatArray:
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


def states_of(confidence: dict[str, FloatArray], states: StateReader) -> dict[str, NDArray[np.int8]]:
    """States of all joints; where no value of a Kinect v2's is above 1, they are shares of one.

    Parameters
    ----------
    confidence : dict of str to ndarray, shape (N,)
        As written, by joint.
    states : callable
        The format's reading of them.
    """
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
    """Joints with positions that are never tracked count as inferred, with a note."""
    joints = []
    for joint, state in raw.state.items():
        there = np.isfinite(raw.position[joint]).all(axis=1) & (raw.position[joint] != 0).any(axis=1)
        if there.any() and not state.any():
            state[there] = JointState.INFERRED
            joints.append(joint)
    if joints:
        raw.notes.append(
            f"{', '.join(joints)}: confidence 0 in every frame, though with positions; they count as"
            " inferred, so they are kept and not measured by."
        )


def _counts_frames(time: FloatArray) -> bool:
    """Whether a column of times is a count of frames: whole numbers, the next one at nearly every row."""
    step = np.diff(time[np.isfinite(time)])
    return bool(len(step) > 2 and (step == 1).mean() > 0.5 and np.isin(step, np.arange(100)).all())
