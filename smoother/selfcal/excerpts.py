"""Which parts of a recording its self-calibration looks at: those that tell most, spread over the whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np

from ..measurements.clock import LARGEST_OFFSET_S
from ..measurements.segment import Segment, make_segment, split_into_segments, traits_of
from ..measurements.timestamps import dejitter, split_at_pauses
from ..measurements.visibility import enough_joints, joints_needed
from ..recording import FloatArray, JointState, Recording

#: Blocks that the calibration looks at: so long each, and so much in all, s.
EXCERPT_S = 20.0
EXCERPTS_S = 80.0
WANTED = int(EXCERPTS_S / EXCERPT_S)
#: The inertial filter runs over so much more on both sides of a block, s.
CONTEXT_S = 12.0
#: Turning is judged over so long, s.
TURN_S = 0.1

Block = TypeVar("Block")


@dataclass(frozen=True)
class Excerpt:
    """A block of a recording: what it looks at, s on the IMU's clock, and the rows that hold it and more."""

    start_s: float
    end_s: float
    samples: slice
    frames: slice


def spread_excerpts(
    recording: Recording, count: int, around_s: float, samples_around_s: float | None = None
) -> list[Excerpt]:
    """Blocks that tell most, as many as asked for, spread over the recording, with so much around each.

    Parameters
    ----------
    samples_around_s : as much of the IMU around each, if more than of the camera.
    """
    imu_around_s = around_s if samples_around_s is None else samples_around_s
    t, arm_t = recording.imu.t_s, recording.arm.t_s
    seen_t = arm_t[enough_joints(recording.arm.state == JointState.TRACKED, joints_needed(recording.arm))]
    parts = split_at_pauses(recording.imu)
    blocks = [(part, a, b) for part in parts for a, b in _even(float(t[part.start]), float(t[part.stop - 1]))]

    def worth(block: tuple[slice, float, float]) -> float:
        _, a, b = block
        rows = slice(*np.searchsorted(t, [a, b]).tolist())
        inside = seen_t[slice(*np.searchsorted(seen_t, [a, b]).tolist())]
        turning = _turning(t[rows], recording.imu.gyro[rows])
        return _worth(inside, turning)

    spans = []
    for part, a, b in _best(blocks, worth, count):
        first, last = part.start + np.searchsorted(t[part], [a - imu_around_s, b + imu_around_s])
        rows = np.searchsorted(arm_t, [a - around_s, b + around_s])
        spans.append(Excerpt(a, b, slice(int(first), int(last)), slice(int(rows[0]), int(rows[1]))))
    return spans


def excerpts_of(recording: Recording) -> list[Segment]:
    """The blocks of a recording as pieces; all of it where it is short.

    Of a long recording only the blocks are read (and what the inertial filter needs around them).
    """
    parts = split_at_pauses(recording.imu)
    t = recording.imu.t_s
    if sum(t[part.stop - 1] - t[part.start] for part in parts) <= 1.5 * EXCERPTS_S:
        return split_into_segments(recording, LARGEST_OFFSET_S)
    traits, segments = traits_of(recording), []
    for span in spread_excerpts(recording, WANTED, CONTEXT_S):
        imu, arm = recording.imu.select(span.samples), recording.arm.select(span.frames)
        segment = make_segment(imu, dejitter(imu.t_s), arm, span.frames, traits)
        if segment is not None:
            segments.append(segment.between(span.start_s, span.end_s))
    return segments


def choose_excerpts(segments: list[Segment]) -> list[Segment]:
    """Parts of pieces that tell most: forearm visible and turning, spread over the whole."""
    total = sum(segment.end_s - segment.start_s for segment in segments)
    if total <= 1.5 * EXCERPTS_S:
        return segments
    blocks = [segment.between(a, b) for segment in segments for a, b in _even(segment.start_s, segment.end_s)]
    return _best(blocks, _worth_of, WANTED)


def _even(start_s: float, end_s: float) -> Iterator[tuple[float, float]]:
    """Blocks of equal length, from start to end."""
    return pairwise(np.linspace(start_s, end_s, max(round((end_s - start_s) / EXCERPT_S), 1) + 1).tolist())


def _best(blocks: Sequence[Block], worth: Callable[[Block], float], wanted: int) -> list[Block]:
    """Of as many parts of the whole as blocks are wanted the best block each."""
    groups = np.array_split(np.arange(len(blocks)), min(wanted, len(blocks)))
    worths = [worth(block) for block in blocks]
    return [blocks[max(group.tolist(), key=lambda k: worths[k])] for group in groups]


def _worth_of(segment: Segment) -> float:
    inside = (segment.frame_t_camera >= segment.start_s) & (segment.frame_t_camera <= segment.end_s)
    edges = np.arange(segment.start_s, segment.end_s, TURN_S)
    turning = np.linalg.norm(segment.signal.mean(edges[:-1], edges[1:])[:, 3:], axis=1)
    return _worth(segment.frame_t_camera[enough_joints(segment.accepted, segment.needed) & inside], turning)


def _worth(seen_t: FloatArray, turning: FloatArray) -> float:
    """Visible time (s) times how much the sensor turns (rad/s, up to 1)."""
    if len(seen_t) < 3 or not len(turning):
        return 0.0
    return float(len(seen_t) * np.median(np.diff(seen_t)) * np.minimum(turning, 1.0).mean())


def _turning(t: FloatArray, gyro: FloatArray) -> FloatArray:
    """Size of the mean angular rate over each `TURN_S`, rad/s."""
    if not len(t):
        return np.zeros(0)
    start = np.flatnonzero(np.diff(np.floor((t - t[0]) / TURN_S), prepend=-1.0) > 0)
    mean = np.add.reduceat(np.asarray(gyro), start, axis=0) / np.diff(np.append(start, len(t)))[:, None]
    return np.linalg.norm(mean, axis=1)
