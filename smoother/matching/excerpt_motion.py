"""Camera and IMU motion over the same seconds, smoothed alike on one grid, free of mounting and heading.

A limb, one of the two segments of every arm that the camera saw, gives its direction and the acceleration of
a point on it, in {K}; an IMU its orientation `R_E_A` and its acceleration in a frame {E} of its own, with z
up and an unknown heading. The IMU's samples reach farther on both sides, so that clocks may be apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..errors import RecordingError
from ..filters import gaussian_smoothed
from ..linalg import unit
from ..measurements.inertial import InertialSignal, inertial_attitude
from ..measurements.rigid import GRID_HZ, SMOOTH_S, known_at
from ..measurements.timestamps import split_at_pauses
from ..recording import JOINTS, ImuStream, JointState, JointTracks
from ..units import GRAVITY

#: A segment's joints: from, to; and how far along it the IMU's acceleration is taken.
SEGMENTS = {"wrist": ("elbow", "wrist", 1.0), "upper_arm": ("shoulder", "elbow", 0.7)}
#: Where the camera saw no wrist, the point used for the forearm's IMU.
_INSTEAD = ("strap", "hand", "elbow")


@dataclass(frozen=True)
class Limb:
    """One place for an IMU: the forearm (called by its wrist) or the upper arm, of one arm of one body."""

    tracks: JointTracks  # The arm
    segment: str  # "wrist" or "upper_arm"
    body: int = 0  # The camera's number of the body
    side: str = ""  # "left", "right" or ""
    skeleton: str = ""  # Topic that the arm came from

    @property
    def arm(self) -> tuple[str, int, str]:
        """Whose it is: skeleton, body and side."""
        return self.skeleton, self.body, self.side

    @property
    def joint(self) -> str:
        """Its name in a match, as "wrist_right"."""
        return f"{self.segment}_{self.side}" if self.side else self.segment

    @property
    def label(self) -> str:
        """For messages: joint and body."""
        return f"{self.joint} of body {self.body}"

    def between(self, start_s: float, end_s: float) -> Limb:
        """The same limb in the frames of some time, s on the camera's clock."""
        rows = slice(*np.searchsorted(self.tracks.t_s, [start_s, end_s]).tolist())
        return replace(self, tracks=self.tracks.select(rows))

    def seen_from_to(self) -> tuple[float, float]:
        """First and last time at which any of its joints is tracked, s."""
        first, second, _ = SEGMENTS[self.segment]
        joints = [JOINTS.index(joint) for joint in (first, second, *_INSTEAD)]
        rows = np.flatnonzero((self.tracks.state[:, joints] == JointState.TRACKED).any(axis=1))
        return float(self.tracks.t_s[rows[0]]), float(self.tracks.t_s[rows[-1]])

    def ends(self) -> tuple[FloatArray, FloatArray, BoolArray]:
        """The segment's two joints (F, 3), m in {K}, and the frames (F,) in which both are tracked."""
        first, second, _ = SEGMENTS[self.segment]
        arm = self.tracks
        return arm.joint(first), arm.joint(second), arm.tracked(first) & arm.tracked(second)

    def point(self) -> tuple[FloatArray, BoolArray]:
        """The point (F, 3), m in {K}, nearest to where an IMU sits, and the frames (F,) that show it."""
        first, second, both = self.ends()
        along = SEGMENTS[self.segment][2]
        if both.any():
            return first + along * (second - first), both
        for joint in ("wrist", *_INSTEAD) if self.segment == "wrist" else ():
            tracked = self.tracks.tracked(joint)
            if tracked.any():
                return self.tracks.joint(joint), tracked
        return first, both


def limbs_of(tracks: JointTracks, body: int = 0, side: str = "", skeleton: str = "") -> tuple[Limb, ...]:
    """The places on one arm that the camera saw at all."""
    limbs = [Limb(tracks, segment, body, side, skeleton) for segment in SEGMENTS]
    return tuple(limb for limb in limbs if limb.point()[1].any())


#: So much beside what was not seen is left out, s.
BESIDE_S = 0.04
#: Length of an excerpt and how many are read of a longer recording, s.
EXCERPT_S, EXCERPTS = 10.0, 12
#: Data read around an excerpt, s, so that filters have settled.
CONTEXT_S = 1.5
#: Camera and IMU must share this much, s.
SHORTEST_S = 1.0


@dataclass(frozen=True)
class LimbMotion:
    """A limb in an excerpt, smoothed, in {K}."""

    direction: FloatArray  # (n, 3): along the segment; 0 where not seen
    acceleration: FloatArray  # (n, 3) m/s^2: of the point nearest to an IMU; 0 where not seen
    measured: FloatArray  # (n, 3) m: that point as the camera measured it
    has_direction: BoolArray  # bool (n,): where directions are known
    has_point: BoolArray  # bool (n,): where points are known


@dataclass(frozen=True)
class ImuMotion:
    """An IMU in an excerpt and `reach` grid steps beyond on both sides, smoothed; N = n + 2 reach."""

    R_E_A: FloatArray  # (N, 3, 3): smoothed entry by entry; 0 where there are no samples
    acceleration: FloatArray  # (N, 3) m/s^2: in {E}, without gravity
    measured: FloatArray  # (N, 3) m/s^2: the same as it was measured
    rate: FloatArray  # (N,) rad/s: length of the angular rate
    there: BoolArray  # bool (N,): Where the sensor has samples


@dataclass(frozen=True)
class MatchExcerpt:
    """Some seconds of all limbs and all IMUs."""

    t: FloatArray  # (n,) s: grid of `GRID_HZ` on the camera's clock
    limbs: list[LimbMotion]
    imus: list[ImuMotion]
    reach: int  # Grid steps that the IMUs reach beyond both ends


def read_excerpts(imus: Sequence[ImuStream], limbs: Sequence[Limb], reach_s: float) -> list[MatchExcerpt]:
    """All of a short recording, or the liveliest 10 s of every twelfth of a long one."""
    seen = [limb.seen_from_to() for limb in limbs]
    first, last = min(start for start, _ in seen), max(end for _, end in seen)
    if last - first < SHORTEST_S:
        raise RecordingError(
            f"the camera shows the arms for {last - first:.1f} s, too short to match IMUs to them; "
            "record some seconds of motion"
        )
    count = max(math.ceil((last - first) / EXCERPT_S), 1)
    if count <= EXCERPTS:
        edges = np.linspace(first, last, count + 1)
        chosen = list(pairwise(edges))
    else:
        starts: FloatArray = first + EXCERPT_S * np.arange(count - 1, dtype=np.float64)
        merit = _liveliness(limbs, starts)
        parts = np.array_split(np.arange(len(starts)), EXCERPTS)
        best = [rows[np.argmax(merit[rows])] for rows in parts]
        chosen = [(starts[row], starts[row] + EXCERPT_S) for row in best]
    reach = round(reach_s * GRID_HZ)
    excerpts = []
    for start, end in chosen:
        t = start + np.arange(max(math.floor((end - start) * GRID_HZ), 2)) / GRID_HZ
        wide = start + np.arange(-reach, len(t) + reach) / GRID_HZ
        excerpts.append(
            MatchExcerpt(
                t, [limb_motion(limb, t) for limb in limbs], [imu_motion(imu, wide) for imu in imus], reach
            )
        )
    return excerpts


def _liveliness(limbs: Sequence[Limb], starts: FloatArray) -> FloatArray:
    """How much the limbs move in the time after each start, all together, m."""
    merit = np.zeros(len(starts))
    for limb in limbs:
        for k, start in enumerate(starts.tolist()):
            point, seen = limb.between(start, start + EXCERPT_S).point()
            if seen.sum() > 10:
                merit[k] += float(np.linalg.norm(point[seen].std(axis=0)) * seen.mean())
    return merit


def limb_motion(limb: Limb, t: FloatArray) -> LimbMotion:
    """A limb's motion at grid times (n,)."""
    limb = limb.between(t[0] - CONTEXT_S, t[-1] + CONTEXT_S)
    frame_t, (first, second, both), (point, seen) = limb.tracks.t_s, limb.ends(), limb.point()
    along, _, has_direction = _on_grid(frame_t[both], unit(second - first)[both], t)
    position, measured, has_point = _on_grid(frame_t[seen], point[seen], t)
    step = 1.0 / GRID_HZ
    acceleration = np.gradient(np.gradient(position, step, axis=0), step, axis=0)
    for values, known in ((along, has_direction), (acceleration, has_point), (measured, has_point)):
        values[~known] = 0.0
    return LimbMotion(along, acceleration, measured, has_direction, has_point)


def _on_grid(
    times: FloatArray, values: FloatArray, t: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Values (N, 3) at grid times, smoothed and as they are, and where they were known."""
    is_value = np.isfinite(values).all(axis=1)  # two joints in one place have no direction
    times, values = times[is_value], values[is_value]
    if len(times) < 3:
        return np.zeros((len(t), 3)), np.zeros((len(t), 3)), np.zeros(len(t), bool)
    more = np.arange(1, round(4.0 * SMOOTH_S * GRID_HZ) + 1) / GRID_HZ
    wide = np.concatenate([t[0] - more[::-1], t, t[-1] + more])
    here = np.stack([np.interp(wide, times, column) for column in values.T], axis=1)
    rows = slice(len(more), -len(more))
    return gaussian_smoothed(here, SMOOTH_S * GRID_HZ)[rows], here[rows], known_at(t, times, BESIDE_S)


def imu_motion(imu: ImuStream, t: FloatArray) -> ImuMotion:
    """An IMU's motion at grid times (N,)."""
    values, measured, there = np.zeros((len(t), 13)), np.zeros((len(t), 3)), np.zeros(len(t), bool)
    near = slice(*np.searchsorted(imu.t_s, [t[0] - CONTEXT_S, t[-1] + CONTEXT_S]))
    samples = imu.select(near)
    # heading and tilt start anew after a pause: the longest part without one is read
    runs = split_at_pauses(samples) if len(samples) > 2 else []
    samples = samples.select(max(runs, key=lambda rows: rows.stop - rows.start, default=slice(0, 0)))
    if len(samples) > 2 and samples.t_s[-1] - samples.t_s[0] >= SHORTEST_S:
        there = (t >= samples.t_s[0]) & (t <= samples.t_s[-1])
    if there.any():
        signal, half = InertialSignal(samples), 0.5 / GRID_HZ
        turn = inertial_attitude(signal, samples.rate_hz).at(t[there])
        mean = signal.mean(t[there] - half, t[there] + half)
        measured[there] = turn.apply(mean[:, :3]) - [0.0, 0.0, GRAVITY]
        rate = np.linalg.norm(mean[:, 3:], axis=1)
        levelled = np.hstack([turn.as_matrix().reshape(-1, 9), measured[there], rate[:, None]])
        values[there] = gaussian_smoothed(levelled, SMOOTH_S * GRID_HZ)
    return ImuMotion(values[:, :9].reshape(-1, 3, 3), values[:, 9:12], measured, values[:, 12], there)
