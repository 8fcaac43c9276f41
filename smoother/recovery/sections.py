"""A recording cut into sections of about a minute: what is read, solved and written at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..array_types import FloatArray
from ..measurements.clock import Clock
from ..measurements.inertial import imu_run
from ..measurements.segment import FEWEST_SAMPLES, Segment, SegmentTraits, Timeline, make_segment
from ..measurements.visibility import MISSING_S
from ..recording import ImuStream, JointTracks, Recording
from ..selfcal.further_imu import FurtherImu
from ..window.prepare import REACH_S

#: Length aimed at, s.
SECTION_S = 60.0
#: What is read more on both sides, s: for the inertial filter, the alignment and the margins of the windows.
CONTEXT_S = 12.0
#: Of an IMU on another segment this much more, s: it has to cover the last node.
FURTHER_MORE_S = 0.5
#: Borders keep this far from gaps where the visible time between two gaps is long enough, s.
KEEP_S = 2.0
#: In longer gaps they also lie where the camera sees one joint, s: a section takes memory by its length.
PARTLY_S = 60.0
#: A border may be this far from its even place, as a share of the sections' length; there is none otherwise.
FARTHEST = 0.45
#: Visible time that a border lacks around it is treated as this many times as much distance from its place.
VISIBILITY_PENALTY = 5.0


@dataclass(frozen=True)
class Section:
    """About a minute of a segment, with what is read around it."""

    samples: slice  # Rows of the recording's IMU, context included
    frames: slice  # Rows of its camera, context included
    start_s: float  # The time to answer for, on the IMU's clock; infinite at the stretch's ends
    end_s: float  # The time to answer for, on the IMU's clock; infinite at the stretch's ends
    length_s: float  # Of that time


@dataclass(frozen=True)
class SectionData:
    """A section with its samples: what travels to a worker process."""

    section: Section
    imu: ImuStream  # Its samples, in memory
    arm: JointTracks  # Its frames, in memory
    even_t_imu: FloatArray  # (n,) s: the samples' dejittered times
    traits: SegmentTraits  # Of the recording
    # Of IMUs on other segments, by the segment's name, on the forearm IMU's clock, between their pauses
    further: tuple[tuple[str, ImuStream], ...] = ()

    def segment(self) -> Segment | None:
        """The section as a segment; None where the camera saw nothing of the forearm."""
        segment = make_segment(self.imu, self.even_t_imu, self.arm, self.section.frames, self.traits)
        if segment is None:
            return None
        runs = tuple(imu_run(name, imu) for name, imu in self.further)
        return replace(
            segment, core_start_s=self.section.start_s, core_end_s=self.section.end_s, further=runs
        )


class Sections:
    """The sections of a recording, in the order of time."""

    def __init__(
        self,
        recording: Recording,
        timeline: Timeline,
        clock: Clock,
        further: Sequence[FurtherImu] = (),
    ) -> None:
        self._recording, self._timeline, self._further = recording, timeline, further
        frame_t_imu = clock.to_imu(recording.arm.t_s)
        visible_times = _visible_times(frame_t_imu[timeline.visible], frame_t_imu[timeline.seen])
        self.all: list[Section] = []
        for segment in timeline.segments:
            for stretch in _stretches(recording.imu.t_s, segment, frame_t_imu[timeline.seen]):
                if stretch.stop - stretch.start >= FEWEST_SAMPLES:
                    self.all += _sections(recording.imu.t_s, stretch, frame_t_imu, visible_times)

    def __len__(self) -> int:
        return len(self.all)

    @property
    def name(self) -> str:
        """Of the recording, for messages."""
        return self._recording.name

    def __iter__(self) -> Iterator[SectionData]:
        """The sections with their samples, which are read when their turn comes."""
        for section in self.all:
            imu, arm = self._recording.imu.select(section.samples), self._recording.arm.select(section.frames)
            even_t = self._timeline.even_t_imu[section.samples]
            runs = tuple(
                (each.segment.name, run)
                for each in self._further
                for run in each.runs(imu.t_s[0] - FURTHER_MORE_S, imu.t_s[-1] + FURTHER_MORE_S)
            )
            yield SectionData(section, _imu_here(imu), _arm_here(arm), even_t, self._timeline.traits, runs)


def _imu_here(imu: ImuStream) -> ImuStream:
    """The samples in memory, whatever they live in."""
    mag = None if imu.mag is None else _here(imu.mag)
    return replace(imu, t_s=_here(imu.t_s), acc=_here(imu.acc), gyro=_here(imu.gyro), mag=mag)


def _arm_here(arm: JointTracks) -> JointTracks:
    return replace(arm, t_s=_here(arm.t_s), position=_here(arm.position), state=np.array(arm.state))


def _here(values: FloatArray) -> FloatArray:
    return np.array(values, dtype=np.float64, subok=False)


def _visible_times(visible_t: FloatArray, seen_t: FloatArray) -> FloatArray:
    """Start and end of each time without a gap, (r, 2) s; in long gaps, of each time that saw one joint."""
    whole = _runs(visible_t)
    ends = np.concatenate([[-np.inf], whole.ravel(), [np.inf]]).reshape(-1, 2)
    partly = [
        _runs(seen_t[(seen_t > start_s) & (seen_t < end_s)])
        for start_s, end_s in ends
        if end_s - start_s > PARTLY_S
    ]
    times = np.concatenate([whole, *(runs[runs[:, 1] - runs[:, 0] > 2.0 * KEEP_S] for runs in partly)])
    return times[np.argsort(times[:, 0])]


def _runs(frame_t: FloatArray) -> FloatArray:
    """Start and end of each run of frames without a gap, (r, 2) s."""
    if not len(frame_t):
        return np.zeros((0, 2))
    breaks = np.flatnonzero(np.diff(frame_t) > MISSING_S)
    first, last = np.concatenate(([0], breaks + 1)), np.append(breaks, len(frame_t) - 1)
    return np.stack([frame_t[first], frame_t[last]], axis=1)


def _stretches(imu_t: FloatArray, segment: slice, seen_t: FloatArray) -> Iterator[slice]:
    """The parts of a segment that lie within reach of what the camera saw of the forearm, with context."""
    t = imu_t[segment]
    seen_t = seen_t[(seen_t >= t[0]) & (seen_t <= t[-1])]
    if not len(seen_t):
        return
    breaks = np.flatnonzero(np.diff(seen_t) > 2.0 * REACH_S)
    first_s, last_s = seen_t[np.concatenate(([0], breaks + 1))], seen_t[np.append(breaks, len(seen_t) - 1)]
    around = REACH_S + CONTEXT_S
    first, last = np.searchsorted(t, first_s - around), np.searchsorted(t, last_s + around)
    for a, b in zip(first.tolist(), last.tolist(), strict=True):
        yield slice(segment.start + a, segment.start + b)


def _sections(
    imu_t: FloatArray, segment: slice, frame_t_imu: FloatArray, visible_times: FloatArray
) -> Iterator[Section]:
    """The sections of a stretch."""
    t = imu_t[segment]
    for a, b in pairwise([-np.inf, *section_borders(float(t[0]), float(t[-1]), visible_times), np.inf]):
        around = [a - CONTEXT_S, b + CONTEXT_S]
        first, last = np.searchsorted(t, around)
        reach = np.clip(around, t[0] - MISSING_S, t[-1] + MISSING_S)
        frames = np.searchsorted(frame_t_imu, reach)
        yield Section(
            samples=slice(segment.start + int(first), segment.start + int(last)),
            frames=slice(int(frames[0]), int(frames[1])),
            start_s=float(a),
            end_s=float(b),
            length_s=float(min(b, t[-1]) - max(a, t[0])),
        )


def section_borders(start_s: float, end_s: float, visible_times: FloatArray) -> list[float]:
    """Times inside, in the middle of visible time and near to evenly spaced ones."""
    count = max(round((end_s - start_s) / SECTION_S), 1)
    step = (end_s - start_s) / count
    if count == 1 or not len(visible_times):
        return []
    keep = np.minimum(KEEP_S, 0.5 * (visible_times[:, 1] - visible_times[:, 0]))
    borders: list[float] = []
    for k in range(1, count):
        even = start_s + k * step
        candidates = np.clip(even, visible_times[:, 0] + keep, visible_times[:, 1] - keep)
        best = int(np.argmin(np.abs(candidates - even) + VISIBILITY_PENALTY * (KEEP_S - keep)))
        if abs(candidates[best] - even) < FARTHEST * step:
            borders.append(float(candidates[best]))
    return borders
