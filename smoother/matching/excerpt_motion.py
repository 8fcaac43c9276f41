"""Camera and IMU motion over the same seconds, low-passed alike on one grid, free of mounting and heading.

An excerpt is up to 10 s of the recording. A limb, one of the two segments of every arm that the camera saw,
gives its direction and the acceleration of a point on it, in {K}. An IMU gives its orientation `R_E_A` and
its acceleration in a frame {E} of its own, with z up and an unknown heading, by an offline inertial
filter (VQF; Laidig and Seel, Information Fusion 2023). The IMU's samples reach farther on both sides, so that
clocks may be apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..errors import RecordingError
from ..linalg import unit
from ..measurements.timestamps import split_at_pauses
from ..recording import JOINTS, ImuStream, JointState, JointTracks
from ..rotation import Rotation
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


#: Both sides are compared on this grid, below this frequency, Hz: above it a camera's joints are noise.
GRID_HZ, LOW_PASS_HZ = 25.0, 2.0
#: Length of an excerpt and how many are read of a longer recording, s.
EXCERPT_S, EXCERPTS = 10.0, 12
#: Data read around an excerpt, s, so that filters have settled.
CONTEXT_S = 1.5
#: Frames or samples farther apart than this are not bridged, s.
BRIDGED_S = 0.25
#: So much at the edge of what was seen has no acceleration, s.
EDGE_S = 0.12
#: Independent samples are this part of what the low-pass leaves, as joints' errors have a memory; and of
#: however many, no more than this many count, as joints' constant errors and the strap's slip do not average
#: out.
INDEPENDENT, MOST_INDEPENDENT = 0.5, 20.0
#: Camera and IMU must share this much, s.
SHORTEST_S = 1.0


@dataclass(frozen=True)
class LimbMotion:
    """A limb in an excerpt, low-passed, in {K}."""

    direction: FloatArray  # (n, 3): along the segment; 0 where not seen
    acceleration: FloatArray  # (n, 3) m/s^2: of the point nearest to an IMU; 0 where not seen
    measured: FloatArray  # (n, 3) m: that point as the camera measured it, not low-passed
    has_direction: BoolArray  # bool (n,): where directions are known
    has_point: BoolArray  # bool (n,): where points are known


@dataclass(frozen=True)
class ImuMotion:
    """An IMU in an excerpt and `reach` grid steps beyond on both sides, low-passed; N = n + 2 reach."""

    R_E_A: FloatArray  # (N, 3, 3): low-passed entry by entry; 0 where there are no samples
    acceleration: FloatArray  # (N, 3) m/s^2: in {E}, without gravity
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
    frame_t = limb.tracks.t_s
    first, second, both = limb.ends()
    along, has_direction = _low_passed(frame_t, unit(second - first), both, t)
    point, seen = limb.point()
    position, has_point = _low_passed(frame_t, point, seen, t, edge_s=EDGE_S)
    acceleration = _second_derivative(position)
    measured = np.zeros_like(position)
    if seen.any():
        measured = np.stack([np.interp(t, frame_t[seen], column) for column in point[seen].T], axis=1)
    for values, known in ((along, has_direction), (acceleration, has_point), (measured, has_point)):
        values[~known] = 0.0
    return LimbMotion(along, acceleration, measured, has_direction, has_point)


def imu_motion(imu: ImuStream, t: FloatArray) -> ImuMotion:
    """An IMU's motion at grid times (N,)."""
    n = len(t)
    R, acceleration = np.zeros((n, 9)), np.zeros((n, 3))
    rate, there = np.zeros(n), np.zeros(n, bool)
    near = slice(*np.searchsorted(imu.t_s, [t[0] - CONTEXT_S, t[-1] + CONTEXT_S]))
    samples = imu.select(near)
    # heading and tilt start anew after a pause: the longest part without one is read
    runs_ = split_at_pauses(samples) if len(samples) > 2 else []
    rows = max(runs_, key=lambda rows: rows.stop - rows.start, default=slice(0, 0))
    samples = samples.select(rows)
    if len(samples) > 2 and samples.t_s[-1] - samples.t_s[0] >= SHORTEST_S:
        values = _levelled(samples)
        passed, there = _low_passed(samples.t_s, values, np.ones(len(samples), bool), t)
        passed[~there] = 0.0
        R, acceleration, rate = passed[:, :9], passed[:, 9:12], passed[:, 12]
    return ImuMotion(R.reshape(n, 3, 3), acceleration, rate, there)


def _levelled(imu: ImuStream) -> FloatArray:
    """(N, 13): `R_E_A`, acceleration in {E} without gravity, |rate|."""
    from vqf import offlineVQF

    step = float(imu.t_s[-1] - imu.t_s[0]) / (len(imu) - 1)
    acc, gyro = np.ascontiguousarray(imu.acc), np.ascontiguousarray(imu.gyro)
    answer = offlineVQF(gyro, acc, None, step)
    R = Rotation.from_quat(answer["quat6D"][:, [1, 2, 3, 0]]).as_matrix()
    level = np.einsum("nij,nj->ni", R, acc) - [0.0, 0.0, GRAVITY]
    return np.hstack([R.reshape(-1, 9), level, np.linalg.norm(gyro, axis=1)[:, None]])


def _low_passed(
    times: FloatArray, values: FloatArray, usable: BoolArray, t: FloatArray, edge_s: float = 0.0
) -> tuple[FloatArray, BoolArray]:
    """Values (N, c) below `LOW_PASS_HZ` at grid times, and where they were known."""
    from scipy.signal import butter, sosfiltfilt

    usable = usable & np.isfinite(values).all(axis=1)
    times, values = times[usable], values[usable]
    known = np.zeros(len(t), bool)
    if len(times) < 3:
        return np.zeros((len(t), values.shape[1])), known
    rate = max(GRID_HZ, min(100.0, 1.0 / float(np.median(np.diff(times)))))
    count = max(int(np.ceil((times[-1] - times[0]) * rate)), 2)
    even = np.linspace(times[0], times[-1], count)
    on_grid = np.stack([np.interp(even, times, column) for column in values.T], axis=1)
    rate = (count - 1) / (times[-1] - times[0])
    sos = butter(2, LOW_PASS_HZ / (rate / 2), output="sos")
    passed = sosfiltfilt(sos, on_grid, axis=0, padlen=min(count - 1, int(2 * rate)))
    after = np.clip(np.searchsorted(times, t, side="right"), 1, len(times) - 1)
    before, behind = times[after - 1], times[after]
    inside = (t >= times[0]) & (t <= times[-1])
    known = inside & ((behind - before <= BRIDGED_S) | (t == before))
    if edge_s:
        gaps = np.flatnonzero(np.diff(times) > BRIDGED_S)
        borders = np.concatenate([times[[0, -1]], times[gaps], times[gaps + 1]])
        known &= np.abs(t[:, None] - borders).min(axis=1) >= edge_s
    return np.stack([np.interp(t, even, column) for column in passed.T], axis=1), known


def _second_derivative(position: FloatArray) -> FloatArray:
    """(n, 3) m/s^2 by central differences on the grid."""
    if len(position) < 3:
        return np.zeros_like(position)
    inner = (position[2:] - 2 * position[1:-1] + position[:-2]) * GRID_HZ**2
    return np.concatenate([inner[:1], inner, inner[-1:]])


def independent_samples(count: FloatArray) -> FloatArray:
    """How many independent samples grid samples are treated as."""
    independent = INDEPENDENT * 2 * LOW_PASS_HZ / GRID_HZ * count
    return np.asarray(independent / (1.0 + independent / MOST_INDEPENDENT))
