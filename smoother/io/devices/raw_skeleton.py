"""From a file's numbers to skeletons: unit, axes, states and times decided, and said, in one place."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame
from ..markers.trajectories import METRES, without_origin
from .arm_lengths import LARGEST, axis_words, down_of, frame_of, half_arm, unit_by_arm, up_axis
from .body_rows import SCALE_NAMES, BodyRows, time_unit, tracked_where_finite, without_position
from .joint_names import JointName
from .marker_joints import require_arm
from .protocol import SkeletonTable

#: Rate of a file without times, Hz: that of the cameras' usual mode.
USUAL_RATE_HZ = 30.0


@dataclass(frozen=True)
class Conventions:
    """What a format settles.

    Attributes
    ----------
    unit : str
        "m" or "mm", what the format is written in as a rule; "" where it has no rule.
    frame : CameraFrame, optional
        Axes of the camera that the format has; None = axes of a room, found by how the body stands.
    relative : bool
        Positions are about the hips.
    rate_hz : float, Hz
        Counts where the file has no times.
    """

    unit: str = ""
    frame: CameraFrame | None = None
    relative: bool = False
    rate_hz: float = USUAL_RATE_HZ


@dataclass
class RawSkeleton:
    """Numbers of a file as written, a row a frame and body.

    Attributes
    ----------
    path : Path
        The file.
    position : dict of str to ndarray, shape (N, 3)
        By joint and side, in the file's unit.
    state : dict of str to ndarray of int8, shape (N,)
        `JointState` values where the file has them; other joints are tracked where they have a position.
    time : ndarray, shape (N,), optional
        As written.
    time_scale : float, s, optional
        In a unit of `time`, where the file states it.
    frame : ndarray, shape (N,), optional
        Numbers of the frames.
    body : ndarray, shape (N,), optional
        Numbers of the bodies, nan where a frame has none.
    rest : list of (JointName, ndarray of shape (N, 3))
        Hips, feet and head.
    rate_hz : float, Hz, optional
        As the file states it.
    notes : list of str
        What was decided in reading.
    """

    path: Path
    position: dict[str, FloatArray]
    state: dict[str, NDArray[np.int8]] = field(default_factory=dict)
    time: FloatArray | None = None
    time_scale: float | None = None
    frame: FloatArray | None = None
    body: FloatArray | None = None
    rest: list[tuple[JointName, FloatArray]] = field(default_factory=list)
    rate_hz: float | None = None
    notes: list[str] = field(default_factory=list)

    def skeletons(self, conventions: Conventions) -> list[SkeletonTable]:
        """One skeleton a body.

        Parameters
        ----------
        conventions : Conventions
            What the format settles.

        Returns
        -------
        list of SkeletonTable
            In order of the bodies' numbers.

        Raises
        ------
        RecordingError
            No arm has an elbow and a wrist, or there is no frame with a position.
        """
        self._drop_empty()
        self._drop_row_numbers()
        require_arm(self.position, self.path, "joints", list(self.position))
        unit, metres = self._unit(conventions)
        frame, down = self._axes(conventions)
        time, seconds, rate = self._times(conventions)
        position = {joint: rows * metres for joint, rows in self.position.items()}
        state = {
            joint: without_position(self.state[joint], rows)
            if joint in self.state
            else tracked_where_finite(rows)
            for joint, rows in position.items()
        }
        pattern = SkeletonTable(
            0, None, {}, {}, frame, down, rate, conventions.relative, unit, list(self.notes)
        )
        tables = BodyRows(time, self.body, position, state).skeletons(pattern, seconds)
        if not tables:
            raise RecordingError(
                f"{self.path} holds no frame with a body; record again with the person in view."
            )
        return tables

    def _drop_empty(self) -> None:
        """Lost joints, written as (0, 0, 0), have no position; joints that never have one are left out."""
        filled = {joint: without_origin(rows) for joint, rows in self.position.items()}
        for rows in filled.values():
            rows[~(np.abs(rows) < LARGEST).all(axis=1)] = np.nan
        there = {joint: rows for joint, rows in filled.items() if np.isfinite(rows).any()}
        if filled and not there:
            raise RecordingError(
                f"{self.path} names joints and holds no position of any; record again with the person in"
                " view."
            )
        self.position = there
        self.rest = [
            (name, np.where(np.abs(rows) < LARGEST, without_origin(rows), np.nan)) for name, rows in self.rest
        ]

    def _drop_row_numbers(self) -> None:
        """A column of bodies that counts rows (an `id`) names no bodies."""
        if self.body is None:
            return
        numbers, rows = np.unique(self.body[np.isfinite(self.body)], return_counts=True)
        if len(numbers) > 10 and np.median(rows) < 3:
            self.body = None
            self.notes.append("The column of the body counts rows; the file counts as one body.")

    def _unit(self, conventions: Conventions) -> tuple[str, float]:
        """Name of the unit and metres in it."""
        fits = unit_by_arm(self.position)
        length = half_arm(self.position)
        if fits is None:
            if conventions.unit and not np.isfinite(length):
                return conventions.unit, METRES[conventions.unit]
            raise RecordingError(
                f"{self.path}: upper arms and forearms are {length:.3g} long, which is an arm's length"
                " neither in"
                " m nor in cm nor in mm; export positions in metres, not pixels or parts of the image."
            )
        unit, metres = fits
        if conventions.unit and unit != conventions.unit:
            self.notes.append(
                f"Positions count as {unit}, not {conventions.unit} as the format has them as a rule: arms"
                f" are {length * metres:.2f} m long so."
            )
        elif not conventions.unit:
            self.notes.append(f"Positions count as {unit}: half an arm is {length * metres:.2f} m long so.")
        return unit, metres

    def _axes(self, conventions: Conventions) -> tuple[CameraFrame | None, FloatArray | None]:
        """Convention of the axes, and the direction of down where they are a room's."""
        shoulders = [
            (JointName("shoulder", side), self.position[f"shoulder_{side}"])
            for side in ("left", "right")
            if f"shoulder_{side}" in self.position
        ]
        upright = up_axis([*self.rest, *shoulders])
        if conventions.frame is not None:
            stated = {CameraFrame.KINECT: (1, 1), CameraFrame.OPTICAL: (1, -1)}.get(conventions.frame)
            if upright is None or stated is None or upright != (1, -stated[1]):
                return conventions.frame, None
            self.notes.append(
                f"Axes count as {axis_words(*upright)}, against the format's rule: so the body stands or sits"
                " in most frames."
            )
            return frame_of(*upright, camera=True), None
        if upright is None:
            self.notes.append(
                "Which axis is up is not known: the file does not state it, nor does the body show it."
            )
            return None, None
        self.notes.append(f"Axes count as {axis_words(*upright)}: so the body stands or sits in most frames.")
        return frame_of(*upright, camera=False), down_of(*upright)

    def _times(self, conventions: Conventions) -> tuple[FloatArray, float | None, float | None]:
        """What tells frames apart, seconds in a unit of it (None: no times), the rate without times."""
        if self.time is not None and np.isfinite(self.time).any():
            self.time = np.where(np.isfinite(self.time), self.time, np.nan)
            scale = time_unit(self.time, self.time_scale)
            if scale is None:
                raise RecordingError(
                    f"{self.path}: its times make no camera's rate in s, ms, us or ns; export the times of"
                    " the frames."
                )
            if scale != self.time_scale:
                self.notes.append(
                    f"Times count as {SCALE_NAMES.get(scale, scale)}: so they make a camera's rate."
                )
            return self.time, scale, None
        rate = self.rate_hz or conventions.rate_hz
        if self.rate_hz is None:
            self.notes.append(
                f"The file has no times: {rate:g} frames a second count, evenly; a file with times is better."
            )
        count = len(next(iter(self.position.values())))
        if self.frame is not None and np.isfinite(self.frame).all():
            return self.frame, 1.0 / rate, rate
        return np.arange(count, dtype=float), None, rate
