"""The segments of a recording, between the pauses of its IMU, each with its inertial attitude."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..array_types import BoolArray, CameraNumbers, FloatArray
from ..recording import JOINTS, ImuStream, JointState, JointTracks, Recording
from .clock import LARGEST_OFFSET_S, Clock
from .inertial import ImuRun, InertialAttitude, InertialSignal, inertial_attitude
from .rays import of_rays, origins_of
from .timestamps import dejitter, split_at_pauses, synthetic_stamps
from .visibility import MISSING_S, accepted_samples, enough_joints, joints_needed, seen_by_any

#: A single sample of the gyroscope that jumps by more than this and back is an error, rad/s.
SPIKE_RAD_S = 15.0
#: Samples that are looked at at once.
SPIKE_BATCH = 100_000
#: A segment shorter than this is not worth a filter, samples.
FEWEST_SAMPLES = 8
#: Frames kept on both sides of a time range: the largest clock offset and what a local fit needs, s.
AROUND_S = LARGEST_OFFSET_S + 1.0


@dataclass(frozen=True)
class Segment:
    """A segment of the recording (no pause of the IMU) as it was recorded, or a time range of it."""

    signal: InertialSignal  # The IMU, always of the whole segment
    attitude: InertialAttitude  # Its orientation in {E} (z up, heading drifting)
    frame_t_camera: FloatArray  # (f,) s: frames on the camera's clock
    position: FloatArray  # (f, 5, 3) m: the joints in {K}
    accepted: BoolArray  # bool (f, 5): samples that may be used
    reason: NDArray[np.uint8]  # (f, 5): why a tracked sample was rejected, as a code of `Rejection`
    down: FloatArray  # (3,): rough direction of gravity in {K}; zero where nothing is known
    needed: int  # Accepted forearm joints that make a frame visible
    frames: slice  # Rows of the recording's frames
    start_s: float  # The time range to use, on the IMU's clock
    end_s: float  # The time range to use, on the IMU's clock
    recording: int = 0  # Which recording of several
    synthetic_stamps: bool = False  # The camera's stamps were not measured (`timestamps.synthetic_stamps`)
    down_sigma_rad: float | None = None  # How well `down` is known, per axis; None = roughly
    core_start_s: float = -np.inf  # What the answer is wanted for; the time around it only supports it
    core_end_s: float = np.inf  # What the answer is wanted for; the time around it only supports it
    further: tuple[ImuRun, ...] = ()  # Of IMUs on other segments, on this one's clock, between their pauses
    camera: CameraNumbers | None = None  # int (f,): which camera each frame is of; None where all are of one
    # (c, 3) m: Where the rays of each camera without depth begin (`JointTracks.ray_origin_m`)
    ray_origin_m: FloatArray | None = None
    focal_share: float = 0.0  # As that of the `JointTracks`

    def between(self, start_s: float, end_s: float) -> Segment:
        """The same segment with a narrower time range (IMU clock), and the frames in and around it."""
        start_s, end_s = max(start_s, self.start_s), min(end_s, self.end_s)
        first, last = np.searchsorted(self.frame_t_camera, [start_s - AROUND_S, end_s + AROUND_S])
        rows = slice(int(first), int(last))
        frames = slice(self.frames.start + rows.start, self.frames.start + rows.stop)
        return replace(self.of_frames(rows), frames=frames, start_s=start_s, end_s=end_s)

    def of_frames(self, rows: slice | BoolArray) -> Segment:
        """The same with some of its frames."""
        return replace(
            self,
            frame_t_camera=self.frame_t_camera[rows],
            position=self.position[rows],
            accepted=self.accepted[rows],
            reason=self.reason[rows],
            camera=None if self.camera is None else self.camera[rows],
        )

    @property
    def frame_origins(self) -> FloatArray | None:
        """Where the rays of the frames begin, (f, 3) m in {K}; nan or None of cameras with depth."""
        return origins_of(self.ray_origin_m, self.camera, len(self.frame_t_camera))

    @property
    def with_depth(self) -> BoolArray:
        """Accepted samples (f, 5) whose depth counts: of cameras with depth where there are any."""
        if self.ray_origin_m is None or np.isfinite(self.ray_origin_m[:, 0]).all():
            return self.accepted
        flat = of_rays(self.frame_origins, len(self.frame_t_camera))
        return np.asarray(self.accepted & ~flat[:, None])

    def distances(self, first: str, second: str, used: BoolArray) -> FloatArray:
        """Between two joints (k,) m, in frames in which both are used (f, 5)."""
        one, other = JOINTS.index(first), JOINTS.index(second)
        both = used[:, one] & used[:, other]
        return np.linalg.norm(self.position[both, one] - self.position[both, other], axis=1)

    def frame_t_imu(self, clock: Clock) -> FloatArray:
        """The frames (f,) on the IMU's clock, s."""
        return self.frame_t_camera + clock.at(self.frame_t_camera)


@dataclass(frozen=True)
class SegmentTraits:
    """What all segments of a recording have in common; see `Segment`."""

    down: FloatArray
    down_sigma_rad: float | None
    needed: int
    synthetic_stamps: bool
    recording: int = 0


def traits_of(recording: Recording, number: int = 0) -> SegmentTraits:
    """The traits of a recording, the `number`-th of several."""
    return SegmentTraits(
        down=down_hint(recording),
        down_sigma_rad=None if recording.gravity_hint is None else recording.gravity_sigma_rad,
        needed=joints_needed(recording.arm),
        synthetic_stamps=synthetic_stamps(recording.arm.of_first_camera.t_s),
        recording=number,
    )


def split_into_segments(recording: Recording, number: int = 0) -> list[Segment]:
    """The segments of a recording that contain at least two frames with a forearm joint."""
    traits = traits_of(recording, number)
    segments = []
    for samples in split_at_pauses(recording.imu):
        imu = recording.imu.select(samples)
        if len(imu) < FEWEST_SAMPLES:
            continue
        ends_s = imu.t_s[0] - LARGEST_OFFSET_S, imu.t_s[-1] + LARGEST_OFFSET_S
        first, last = np.searchsorted(recording.arm.t_s, ends_s)
        frames = slice(int(first), int(last))
        segment = make_segment(imu, dejitter(imu.t_s), recording.arm.select(frames), frames, traits)
        if segment is not None:
            segments.append(segment)
    return segments


def make_segment(
    imu: ImuStream, even_t: FloatArray, arm: JointTracks, frames: slice, traits: SegmentTraits
) -> Segment | None:
    """One segment with its inertial attitude."""
    accepted = accepted_samples(arm)
    if enough_joints(accepted, 1).sum() < 2:
        return None
    signal = InertialSignal(without_spikes(replace(imu, t_s=even_t)))
    return Segment(
        signal=signal,
        attitude=inertial_attitude(signal, imu.rate_hz),
        frame_t_camera=arm.t_s,
        position=arm.position,
        accepted=accepted,
        reason=np.zeros(accepted.shape, np.uint8),
        frames=frames,
        start_s=float(imu.t_s[0]),
        end_s=float(imu.t_s[-1]),
        **vars(traits),
        camera=arm.camera,
        ray_origin_m=arm.ray_origin_m,
        focal_share=arm.focal_share,
    )


def down_hint(recording: Recording) -> FloatArray:
    """Rough direction of gravity in {K}: the hint, or a level camera."""
    if recording.gravity_hint is not None:
        return recording.gravity_hint / np.linalg.norm(recording.gravity_hint)
    if recording.camera_frame is not None:
        return recording.camera_frame.down
    return np.zeros(3)


def spikes(gyro: FloatArray) -> BoolArray:  # gyro (N, 3) rad/s
    """Single samples (N,) that jump away from both neighbours, which agree: no arm turns like that."""
    wrong = np.zeros(len(gyro), dtype=bool)
    for first in range(1, len(gyro) - 1, SPIKE_BATCH):  # a long recording's samples are on disk
        last = min(first + SPIKE_BATCH, len(gyro) - 1)
        part = np.asarray(gyro[first - 1 : last + 1])
        before = np.linalg.norm(part[1:-1] - part[:-2], axis=1)
        after = np.linalg.norm(part[1:-1] - part[2:], axis=1)
        across = np.linalg.norm(part[2:] - part[:-2], axis=1)
        nearest = np.minimum(before, after)
        wrong[first:last] = (nearest > SPIKE_RAD_S) & (across < 0.3 * nearest)
    return wrong


def without_spikes(imu: ImuStream) -> ImuStream:
    """The samples with spikes of the gyroscope replaced by the mean of their neighbours."""
    rows = np.flatnonzero(spikes(imu.gyro))
    if not len(rows):
        return imu
    gyro = imu.gyro.copy()
    gyro[rows] = 0.5 * (imu.gyro[rows - 1] + imu.gyro[rows + 1])
    return replace(imu, gyro=gyro)


@dataclass(frozen=True)
class Timeline:
    """What every step needs of a recording's times."""

    segments: tuple[slice, ...]  # Rows of the IMU between its pauses, in order of time
    even_t_imu: FloatArray  # (N,) s: the IMU's stamps, dejittered segment by segment
    visible: BoolArray  # bool (F,): frames in which the camera tracked enough of the forearm
    seen: BoolArray  # bool (F,): frames in which it tracked anything of the forearm
    traits: SegmentTraits  # What all segments share

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
        visible = seen_by_any(recording.arm.t_s, visible, recording.arm.camera)
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
