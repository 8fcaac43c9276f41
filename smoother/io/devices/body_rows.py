"""Rows of bodies and frames to one skeleton a body, absent frames and all."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...recording import JointState
from .protocol import SkeletonTable

#: Body numbers above this do not fit a recording: they are counted from 0 instead.
_LARGEST_BODY = 2**31 - 1
#: Frame rates of cameras, Hz: a time in another unit makes none of them.
_RATES_HZ = (4.0, 260.0)
_SCALES = (1.0, 1e-3, 1e-6, 1e-9, 1e-7)  # s, ms, us, ns, ticks of 100 ns
SCALE_NAMES = {1.0: "s", 1e-3: "ms", 1e-6: "us", 1e-9: "ns", 1e-7: "ticks of 100 ns"}


@dataclass
class BodyRows:
    """What a file says of bodies, a row a frame and body.

    Attributes
    ----------
    time : ndarray, shape (N,)
        By which rows belong to one frame: the time in any unit, or the frame's number.
    body : ndarray, shape (N,), optional
        The body of each row; nan where the frame has none. None = one body.
    position : dict of str to ndarray, shape (N, 3), m
        By joint and side.
    state : dict of str to ndarray of int8, shape (N,)
        `JointState` values of the same joints.
    notes : list of str
        What was decided in reading.
    """

    time: FloatArray
    body: FloatArray | None
    position: dict[str, FloatArray]
    state: dict[str, NDArray[np.int8]]
    notes: list[str] = field(default_factory=list)

    def skeletons(self, pattern: SkeletonTable, seconds: float | None) -> list[SkeletonTable]:
        """One skeleton a body, on the times of all frames of the file.

        Parameters
        ----------
        pattern : SkeletonTable
            Frame, unit, rate and notes of all of them.
        seconds : float, s, optional
            In a unit of `time`; None where the file has no times.

        Returns
        -------
        list of SkeletonTable
            In order of the bodies' numbers.
        """
        frame, times = frames_of_rows(self.time, self.body)
        t_s = None if seconds is None else times * seconds
        bodies = np.zeros(len(frame)) if self.body is None else self.body
        numbers = np.unique(bodies[np.isfinite(bodies)])
        tables = []
        for count, number in enumerate(numbers.tolist()):
            rows = np.flatnonzero(bodies == number)
            fits = 0 <= number <= _LARGEST_BODY and number == int(number)
            notes = [*pattern.notes, *self.notes]
            if not fits:
                notes.append(f"Body {number:.0f} is called {count}.")
            position = {joint: np.full((len(times), 3), np.nan) for joint in self.position}
            state = {joint: np.zeros(len(times), np.int8) for joint in self.position}
            for joint in self.position:
                position[joint][frame[rows]] = self.position[joint][rows]
                state[joint][frame[rows]] = self.state[joint][rows]
            tables.append(
                SkeletonTable(
                    int(number) if fits else count,
                    None if t_s is None else t_s.copy(),
                    position,
                    state,
                    pattern.frame,
                    pattern.gravity_hint,
                    pattern.rate_hz,
                    pattern.relative,
                    pattern.units,
                    notes,
                )
            )
        return tables


def frames_of_rows(time: FloatArray, body: FloatArray | None) -> tuple[IntArray, FloatArray]:
    """Number of the frame that each row is of, and the frames' times.

    Rows of one body are frames as they stand, stamps that repeat or go back included. Where a file lists
    one body after the other, frames are the different times in order.
    """
    count = len(time)
    bodies = np.zeros(0) if body is None else np.unique(body[np.isfinite(body)])
    absent = body is not None and not np.isfinite(body).all()
    if len(bodies) < 2 and not absent:
        return np.arange(count), time
    known = np.isfinite(time)
    if np.any(np.diff(time[known]) < 0) and body is not None:
        ordered = all((np.diff(time[known & (body == one)]) >= 0).all() for one in bodies)
        if ordered and known.all():
            times, frame = np.unique(time, return_inverse=True)
            return frame, times
    is_new = np.append(True, time[1:] != time[:-1])[:count]
    return np.cumsum(is_new) - 1, time[is_new]


def time_unit(time: FloatArray, stated: float | None) -> float | None:
    """Seconds in a unit of frame times.

    Parameters
    ----------
    time : ndarray, shape (N,)
        As written.
    stated : float, s, optional
        What the column's name states.

    Returns
    -------
    float or None
        The stated unit where it makes a camera's rate, else the one that does; None where none does.
    """
    step = np.diff(time[np.isfinite(time)])
    step = step[step > 0]
    if not len(step):
        return stated
    typical = float(np.median(step))
    for scale in (*(() if stated is None else (stated,)), *_SCALES):
        if _RATES_HZ[0] <= 1.0 / (typical * scale) <= _RATES_HZ[1]:
            return scale
    return stated


def without_position(state: NDArray[np.int8], position: FloatArray) -> NDArray[np.int8]:
    """States (N,), not tracked where the position (N, 3) is missing."""
    return np.where(np.isfinite(position).all(axis=1), state, np.int8(JointState.NOT_TRACKED)).astype(np.int8)


def tracked_where_finite(position: FloatArray) -> NDArray[np.int8]:
    """States (N,) of a format without states: tracked where there is a position."""
    return without_position(np.full(len(position), JointState.TRACKED, np.int8), position)
