"""Which excerpts of a recording its self-calibration reads: the most informative, spread over the whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np

from ..array_types import FloatArray
from ..measurements.segment import Segment, Timeline, make_segment, split_into_segments
from ..measurements.visibility import enough_joints
from ..recording import Recording

#: Length of an excerpt, and of all that the self-calibration reads, s.
EXCERPT_S = 20.0
EXCERPTS_S = 80.0
WANTED = int(EXCERPTS_S / EXCERPT_S)
#: A recording that is read whole is read in parts of this length, s.
WHOLE_S = 60.0
#: The inertial filter runs over this much more on both sides of an excerpt, s.
CONTEXT_S = 12.0
#: Turning is judged over this long, s.
TURN_S = 0.1

Candidate = TypeVar("Candidate")


@dataclass(frozen=True)
class Excerpt:
    """An excerpt of a recording, with what is read around it."""

    start_s: float  # What it looks at, on the IMU's clock
    end_s: float  # What it looks at, on the IMU's clock
    samples: slice  # Rows of the IMU, context included
    frames: slice  # Rows of the camera, context included


def spread_excerpts(
    recording: Recording,
    timeline: Timeline,
    count: int,
    around_s: float,
    samples_around_s: float | None = None,
) -> list[Excerpt]:
    """Excerpts in which the forearm is visible and turns most, spread over a recording."""
    imu_around_s = around_s if samples_around_s is None else samples_around_s
    t, arm_t = recording.imu.t_s, recording.arm.t_s
    visible_t = arm_t[timeline.visible]
    candidates = [
        (segment, start_s, end_s)
        for segment in timeline.segments
        for start_s, end_s in _even(float(t[segment.start]), float(t[segment.stop - 1]))
    ]

    def information(candidate: tuple[slice, float, float]) -> float:
        _, *span = candidate
        samples = slice(*np.searchsorted(t, span).tolist())
        frames = slice(*np.searchsorted(visible_t, span).tolist())
        return _information(visible_t[frames], _turning(t[samples], recording.imu.gyro[samples]))

    excerpts = []
    for segment, start_s, end_s in _best(candidates, information, count):
        first, last = (
            np.searchsorted(t[segment], [start_s - imu_around_s, end_s + imu_around_s]) + segment.start
        )
        frames = np.searchsorted(arm_t, [start_s - around_s, end_s + around_s])
        excerpts.append(Excerpt(start_s, end_s, slice(int(first), int(last)), slice(*frames.tolist())))
    return excerpts


def is_read_whole(timeline: Timeline) -> bool:
    """Whether a recording is so short that self-calibration reads all of it."""
    return timeline.length_s() <= 1.5 * EXCERPTS_S


def informative_excerpts(recording: Recording, timeline: Timeline) -> list[Segment]:
    """The excerpts of a recording as segments; all of it where it is short."""
    if is_read_whole(timeline):
        return split_into_segments(recording)
    segments = []
    for excerpt in spread_excerpts(recording, timeline, WANTED, CONTEXT_S):
        imu, arm = recording.imu.select(excerpt.samples), recording.arm.select(excerpt.frames)
        even_t = timeline.even_t_imu[excerpt.samples]
        segment = make_segment(imu, even_t, arm, excerpt.frames, timeline.traits)
        if segment is None:
            continue
        segment = segment.between(excerpt.start_s, excerpt.end_s)
        if len(_visible_t(segment)) > 1:  # what the camera saw may be in the context alone
            segments.append(segment)
    return segments


def informative_recording(recording: Recording) -> Recording:
    """A recording of nothing but its most informative excerpts and what lies around them."""
    timeline = Timeline.of(recording)
    if is_read_whole(timeline):
        return recording
    samples, frames = np.zeros(len(recording.imu), bool), np.zeros(len(recording.arm), bool)
    for excerpt in spread_excerpts(recording, timeline, WANTED, CONTEXT_S):
        samples[excerpt.samples], frames[excerpt.frames] = True, True
    return replace(recording, imu=recording.imu.select(samples), arm=recording.arm.select(frames), truth=None)


def choose_excerpts(segments: list[Segment]) -> list[Segment]:
    """Excerpts of segments in which the forearm is visible and turns most; all where they are short."""
    is_short = sum(segment.end_s - segment.start_s for segment in segments) <= 1.5 * EXCERPTS_S
    candidates = [
        segment.between(start_s, end_s)
        for segment in segments
        for start_s, end_s in _even(segment.start_s, segment.end_s, WHOLE_S if is_short else EXCERPT_S)
    ]
    return candidates if is_short else _best(candidates, _information_of, WANTED)


def most_telling(segment: Segment, length_s: float) -> tuple[float, float]:
    """From when to when a part of this length of a segment is the most informative, s on the IMU's clock."""
    start_s, end_s = max(segment.start_s, segment.core_start_s), min(segment.end_s, segment.core_end_s)
    candidates = list(_even(start_s, end_s, length_s))
    return max(candidates, key=lambda part: _information_of(segment.between(*part)))


def _even(start_s: float, end_s: float, length_s: float = EXCERPT_S) -> Iterator[tuple[float, float]]:
    """Intervals of equal length, about the one given, from start to end."""
    return pairwise(np.linspace(start_s, end_s, max(round((end_s - start_s) / length_s), 1) + 1).tolist())


def _best(
    candidates: Sequence[Candidate], information: Callable[[Candidate], float], wanted: int
) -> list[Candidate]:
    """The candidates in as many groups as are wanted, and of each group the most informative one."""
    groups = np.array_split(np.arange(len(candidates)), min(wanted, len(candidates)))
    values = [information(candidate) for candidate in candidates]
    return [candidates[max(group.tolist(), key=lambda k: values[k])] for group in groups]


def _information_of(segment: Segment) -> float:
    return _information(_visible_t(segment), _turning_of(segment, segment.start_s, segment.end_s))


def _turning_of(segment: Segment, start_s: float, end_s: float) -> FloatArray:
    """Size of the mean angular rate over each `TURN_S` of a segment, rad/s."""
    edges = np.arange(start_s, end_s, TURN_S)
    return np.linalg.norm(segment.signal.means(edges)[:, 3:], axis=1)


def _visible_t(segment: Segment) -> FloatArray:
    """Times of the frames that it looks at and that see the forearm, s on the camera's clock."""
    t = segment.frame_t_camera
    inside = (t >= segment.start_s) & (t <= segment.end_s)
    return t[enough_joints(segment.accepted, segment.needed) & inside]


def _information(visible_t: FloatArray, turning: FloatArray) -> float:
    """Visible time (s) times how much the sensor turns (rad/s, up to 1)."""
    if len(visible_t) < 3 or not len(turning):
        return 0.0
    return float(len(visible_t) * np.median(np.diff(visible_t)) * np.minimum(turning, 1.0).mean())


def _turning(t: FloatArray, gyro: FloatArray) -> FloatArray:
    """Size of the mean angular rate over each `TURN_S`, rad/s."""
    if not len(t):
        return np.zeros(0)
    start = np.flatnonzero(np.diff(np.floor((t - t[0]) / TURN_S), prepend=-1.0) > 0)
    mean = np.add.reduceat(np.asarray(gyro), start, axis=0) / np.diff(np.append(start, len(t)))[:, None]
    return np.linalg.norm(mean, axis=1)
