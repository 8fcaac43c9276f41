"""A recording taken apart at the pauses of its IMU, each piece with its inertial attitude."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..recording import BoolArray, FloatArray, ImuStream, JointTracks, Recording
from .attitude import InertialAttitude, inertial_attitude
from .clock import LARGEST_OFFSET_S
from .inertial import InertialSignal
from .timestamps import dejitter, split_at_pauses, synthetic_stamps
from .visibility import accepted_samples, enough_joints, joints_needed

#: The inertial filter runs no faster than this, Hz.
FILTER_RATE_HZ = 120.0
#: A piece shorter than this is not worth a filter, samples.
FEWEST_SAMPLES = 8
#: Frames kept beside a part of a piece: the largest clock offset and what a local fit needs, s.
AROUND_S = LARGEST_OFFSET_S + 1.0


@dataclass(frozen=True)
class Segment:
    """A stretch of the recording without a pause of the IMU, as it was recorded.

    Attributes
    ----------
    signal, attitude : the IMU, and its orientation in {E} (z up, heading drifting).
    frame_t : (f,) camera frames on the camera's clock, s.
    position, accepted : (f, 5, 3) m in {K}, (f, 5) samples that may take part.
    reason : (f, 5) why a tracked sample was set aside, as a code of `screen.REASONS`.
    down : (3,) rough direction of gravity in {K}; zero where nothing is known.
    needed : accepted forearm joints that make a frame visible.
    frames : rows of the recording's frames.
    start_s, end_s : the part to look at, on the IMU's clock.
    core_start_s, core_end_s : the part of it to answer for; the rest is there for its sake.
    recording : which recording of several.
    synthetic_stamps : the camera's stamps were made up (`clock.stamps_made_up`).
    down_sigma_rad : how well `down` is known, an axis; None = roughly.
    """

    signal: InertialSignal
    attitude: InertialAttitude
    frame_t: FloatArray
    position: FloatArray
    accepted: BoolArray
    reason: NDArray[np.uint8]
    down: FloatArray
    needed: int
    frames: slice
    start_s: float
    end_s: float
    recording: int = 0
    synthetic_stamps: bool = False
    down_sigma_rad: float | None = None
    core_start_s: float = -np.inf
    core_end_s: float = np.inf

    def between(self, start_s: float, end_s: float) -> Segment:
        """The same piece, of which only a part (IMU clock) is looked at, with the frames around it."""
        start_s, end_s = max(start_s, self.start_s), min(end_s, self.end_s)
        first, last = np.searchsorted(self.frame_t, [start_s - AROUND_S, end_s + AROUND_S])
        some = slice(int(first), int(last))
        return replace(
            self,
            frame_t=self.frame_t[some],
            position=self.position[some],
            accepted=self.accepted[some],
            reason=self.reason[some],
            frames=slice(self.frames.start + some.start, self.frames.start + some.stop),
            start_s=start_s,
            end_s=end_s,
        )


@dataclass(frozen=True)
class SegmentTraits:
    """What holds for all pieces of a recording; see `Segment`."""

    down: FloatArray
    down_sigma_rad: float | None
    needed: int
    synthetic_stamps: bool
    recording: int = 0


def traits_of(recording: Recording, number: int = 0) -> SegmentTraits:
    """The traits of a recording; `number`: which of several."""
    return SegmentTraits(
        down=down_hint(recording),
        down_sigma_rad=None if recording.gravity_hint is None else recording.gravity_sigma_rad,
        needed=joints_needed(recording.arm),
        synthetic_stamps=synthetic_stamps(recording.arm.t_s),
        recording=number,
    )


def split_into_segments(recording: Recording, slack_s: float, number: int = 0) -> list[Segment]:
    """The pieces of a recording that hold at least two frames with a forearm joint.

    Parameters
    ----------
    slack_s : clock offset that frames at the ends are kept for, s.
    number : which recording of several.
    """
    traits = traits_of(recording, number)
    segments = []
    for samples in split_at_pauses(recording.imu):
        imu = recording.imu.select(samples)
        if len(imu) < FEWEST_SAMPLES:
            continue
        first, last = np.searchsorted(recording.arm.t_s, [imu.t_s[0] - slack_s, imu.t_s[-1] + slack_s])
        frames = slice(int(first), int(last))
        segment = make_segment(imu, dejitter(imu.t_s), recording.arm.select(frames), frames, traits)
        if segment is not None:
            segments.append(segment)
    return segments


def make_segment(
    imu: ImuStream, steady_t: FloatArray, arm: JointTracks, frames: slice, traits: SegmentTraits
) -> Segment | None:
    """One piece with its inertial attitude; None without two frames with a forearm joint.

    Parameters
    ----------
    imu : samples without a pause; `steady_t` (n,) their steadied times (`timing.steady`).
    arm : its frames, which are the rows `frames` of the recording's.
    """
    accepted = accepted_samples(arm)
    if enough_joints(accepted, 1).sum() < 2:
        return None
    signal = InertialSignal(replace(imu, t_s=steady_t))
    return Segment(
        signal=signal,
        attitude=inertial_attitude(signal, min(imu.rate_hz, FILTER_RATE_HZ)),
        frame_t=arm.t_s,
        position=arm.position,
        accepted=accepted,
        reason=np.zeros(accepted.shape, np.uint8),
        down=traits.down,
        needed=traits.needed,
        frames=frames,
        start_s=float(imu.t_s[0]),
        end_s=float(imu.t_s[-1]),
        recording=traits.recording,
        synthetic_stamps=traits.synthetic_stamps,
        down_sigma_rad=traits.down_sigma_rad,
    )


def down_hint(recording: Recording) -> FloatArray:
    """Rough direction of gravity in {K}: the hint, or a camera that stands level."""
    if recording.gravity_hint is not None:
        return recording.gravity_hint / np.linalg.norm(recording.gravity_hint)
    if recording.camera_frame is not None:
        return recording.camera_frame.down
    return np.zeros(3)
