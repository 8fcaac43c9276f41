"""A recording cut into sections of about a minute: what is read, solved and written at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..measurements.clock import Clock
from ..measurements.segment import FEWEST_SAMPLES, Segment, SegmentTraits, make_segment, traits_of
from ..measurements.timestamps import dejitter, split_at_pauses
from ..measurements.visibility import MISSING_S, enough_joints, joints_needed
from ..recording import FloatArray, ImuStream, JointState, JointTracks, Recording
from ..window.cut import KEEP_S

#: Length aimed at, s.
SECTION_S = 60.0
#: What is read more on both sides, s: for the inertial filter, the alignment and the margins of the windows.
CONTEXT_S = 12.0
#: A border may be so far from its even place, as a part of the sections' length; there is none otherwise.
FARTHEST = 0.45
#: Visible time that a border lacks around it counts as so many times as much distance from its place.
LACKS = 5.0


@dataclass(frozen=True)
class Section:
    """A part of a stretch of the IMU without a pause, with what is read around it.

    Attributes
    ----------
    samples, frames : rows of the recording's IMU and camera, context included.
    start_s, end_s : the part to answer for, on the IMU's clock; infinite at the stretch's ends.
    length_s : of that part.
    """

    samples: slice
    frames: slice
    start_s: float
    end_s: float
    length_s: float


@dataclass(frozen=True)
class SectionData:
    """A section with its samples: what travels to a worker process.

    Attributes
    ----------
    section : what it is.
    imu, arm : its samples and frames.
    steady_t : (n,) the samples' steadied times, s.
    traits : of the recording.
    """

    section: Section
    imu: ImuStream
    arm: JointTracks
    steady_t: FloatArray
    traits: SegmentTraits

    def segment(self) -> Segment | None:
        """The section as a piece; None where the camera saw nothing of the forearm."""
        segment = make_segment(self.imu, self.steady_t, self.arm, self.section.frames, self.traits)
        if segment is None:
            return None
        return replace(segment, core_start_s=self.section.start_s, core_end_s=self.section.end_s)


class Sections:
    """The sections of a recording, in the order of time.

    Parameters
    ----------
    recording : as long as it may be; its samples are read a section at a time.
    clock : takes the camera's times to the IMU's.
    """

    def __init__(self, recording: Recording, clock: Clock) -> None:
        self._recording = recording
        self._traits = traits_of(recording)
        frame_t = recording.arm.t_s + clock.at(recording.arm.t_s)
        state = recording.arm.state
        visible = enough_joints(state == JointState.TRACKED, joints_needed(recording.arm))
        runs = _runs(frame_t[visible])
        self.all: list[Section] = []
        self._steady: dict[int, FloatArray] = {}  # by the stretch's first sample
        self._stretch: list[int] = []
        for stretch in split_at_pauses(recording.imu):
            if stretch.stop - stretch.start < FEWEST_SAMPLES:
                continue
            own = list(_sections(recording.imu.t_s, stretch, frame_t, runs))
            self.all += own
            self._stretch += [stretch.start] * len(own)
            self._steady[stretch.start] = dejitter(recording.imu.t_s[stretch])

    def __iter__(self) -> Iterator[SectionData]:
        """The sections with their samples, which are read when their turn comes."""
        for section, first in zip(self.all, self._stretch, strict=True):
            imu, arm = self._recording.imu.select(section.samples), self._recording.arm.select(section.frames)
            samples = slice(section.samples.start - first, section.samples.stop - first)
            yield SectionData(
                section, _imu_here(imu), _arm_here(arm), self._steady[first][samples], self._traits
            )


def _imu_here(imu: ImuStream) -> ImuStream:
    """The samples in memory, whatever they live in."""
    mag = None if imu.mag is None else _here(imu.mag)
    return replace(imu, t_s=_here(imu.t_s), acc=_here(imu.acc), gyro=_here(imu.gyro), mag=mag)


def _arm_here(arm: JointTracks) -> JointTracks:
    return replace(arm, t_s=_here(arm.t_s), position=_here(arm.position), state=np.array(arm.state))


def _here(values: FloatArray) -> FloatArray:
    return np.array(values, dtype=np.float64, subok=False)


def _runs(seen_t: FloatArray) -> FloatArray:
    """Start and end of each run of visible frames, (r, 2) s."""
    if not len(seen_t):
        return np.zeros((0, 2))
    breaks = np.flatnonzero(np.diff(seen_t) > MISSING_S)
    first, last = np.concatenate(([0], breaks + 1)), np.append(breaks, len(seen_t) - 1)
    return np.stack([seen_t[first], seen_t[last]], axis=1)


def _sections(imu_t: FloatArray, stretch: slice, frame_t: FloatArray, runs: FloatArray) -> Iterator[Section]:
    t = imu_t[stretch]
    for a, b in pairwise([-np.inf, *_borders(float(t[0]), float(t[-1]), runs), np.inf]):
        around = [a - CONTEXT_S, b + CONTEXT_S]
        first, last = np.searchsorted(t, around)
        reach = np.clip(around, t[0] - MISSING_S, t[-1] + MISSING_S)
        frames = np.searchsorted(frame_t, reach)
        yield Section(
            samples=slice(stretch.start + int(first), stretch.start + int(last)),
            frames=slice(int(frames[0]), int(frames[1])),
            start_s=float(a),
            end_s=float(b),
            length_s=float(min(b, t[-1]) - max(a, t[0])),
        )


def _borders(start_s: float, end_s: float, runs: FloatArray) -> list[float]:
    """Times inside, in the middle of visible runs and near to evenly spaced ones."""
    count = max(round((end_s - start_s) / SECTION_S), 1)
    step = (end_s - start_s) / count
    if count == 1 or not len(runs):
        return []
    keep = np.minimum(KEEP_S, 0.5 * (runs[:, 1] - runs[:, 0]))
    borders: list[float] = []
    for k in range(1, count):
        even = start_s + k * step
        place = np.clip(even, runs[:, 0] + keep, runs[:, 1] - keep)
        best = int(np.argmin(np.abs(place - even) + LACKS * (KEEP_S - keep)))
        if abs(place[best] - even) < FARTHEST * step:
            borders.append(float(place[best]))
    return borders
