"""The times of a recording, looked at once: segments, even stamps, visible frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..recording import JointState, Recording
from .segment import SegmentTraits, traits_of
from .timestamps import dejitter, split_at_pauses
from .visibility import MISSING_S, enough_joints


@dataclass(frozen=True)
class Timeline:
    """What every step needs to know of a recording's times.

    Attributes
    ----------
    segments : tuple of slice
        Rows of the IMU between its pauses, in order of time.
    even_t_imu : ndarray, shape (N,), s
        The IMU's stamps, dejittered segment by segment.
    visible : ndarray of bool, shape (F,)
        Frames in which the camera tracked enough of the forearm.
    seen : ndarray of bool, shape (F,)
        Frames in which it tracked anything of the forearm.
    traits : SegmentTraits
        What holds for all segments: gravity's rough direction, whether the camera's stamps are synthetic.
    """

    segments: tuple[slice, ...]
    even_t_imu: FloatArray
    visible: BoolArray
    seen: BoolArray
    traits: SegmentTraits

    @classmethod
    def of(cls, recording: Recording) -> Timeline:
        """The timeline of a recording; its samples are not read, only its stamps and the joints' states."""
        traits = traits_of(recording)
        segments = tuple(split_at_pauses(recording.imu))
        even_t = np.empty(len(recording.imu))
        for rows in segments:
            even_t[rows] = dejitter(np.asarray(recording.imu.t_s[rows]))
        tracked = recording.arm.state == JointState.TRACKED
        visible, seen = enough_joints(tracked, traits.needed), enough_joints(tracked, 1)
        return cls(segments, even_t, visible, seen, traits)

    @property
    def synthetic_stamps(self) -> bool:
        """The camera's frames were spread evenly by a program instead of measured."""
        return self.traits.synthetic_stamps

    def usual_gap_s(self, frame_t_s: FloatArray) -> float:
        """Median length of the times in which the frames (F,) did not see the forearm, s; 1 without any."""
        seen_t = np.asarray(frame_t_s)[self.visible]
        away_s = np.diff(seen_t)
        gaps_s = away_s[(away_s > MISSING_S) & (np.diff(np.flatnonzero(self.visible)) > 1)]
        return float(np.median(gaps_s)) if len(gaps_s) else 1.0

    def length_s(self) -> float:
        """Time in all segments together, s."""
        return sum(
            float(self.even_t_imu[rows.stop - 1] - self.even_t_imu[rows.start]) for rows in self.segments
        )
