"""The cameras of a recording as a table, and what two of them say of one arm.

What both saw at the same moments; their clocks against each other, by what is the same from everywhere:
speeds and distances; and depths on the rays of cameras without depth, so that every joint has a place to
start from. Only what is across a ray was measured (`measurements.rays`): depths are start values, and decide
how far a pixel is. They come from a camera with depth at the same moments, or from the rays of a second one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import masked_correlation, peaks
from ..measurements.visibility import accepted_samples
from ..recording import JOINTS, CameraPose, JointTracks


@dataclass(frozen=True)
class RelativeClock:
    """t_first = t_own + offset, which may drift."""

    offset_s: float = 0.0  # At the time `middle_s`
    skew: float = 0.0  # Steady drift
    middle_s: float = 0.0  # On the camera's own clock
    sigma_s: float = 0.0  # One standard deviation of the offset

    def to_first(self, t: FloatArray) -> FloatArray:
        """Own times (n,) on the first camera's clock, s."""
        return t + self.offset_s + self.skew * (t - self.middle_s)

    def from_first(self, t: FloatArray) -> FloatArray:
        """The other way round."""
        return self.middle_s + (t - self.offset_s - self.middle_s) / (1.0 + self.skew)


@dataclass(frozen=True)
class RigCamera:
    """A camera of a recording, where it stands, and its clock."""

    name: str
    pose: CameraPose | None = None  # In the first camera's frame; None where it could not be found
    clock: RelativeClock = field(default_factory=RelativeClock)  # Against the first camera's
    # (5, 3) m: How far its joints lie from the first camera's, in {K}, beyond its pose
    joint_offset_m: FloatArray = field(default_factory=lambda: np.zeros((len(JOINTS), 3)))
    # Median distance between its joints and the first camera's, all that is constant taken off
    misfit_m: float = float("nan")
    together_s: float = float("nan")  # Time during which both saw some part of the arm
    reason: str = ""  # Why it was left out; "" where it is used
    note: str = ""  # What is to be known of one that is used, after its name
    # On the first camera's clock, between when it or the first one was moved
    moved_s: tuple[float, float] | None = None

    @property
    def takes_part(self) -> bool:
        """It is one of the cameras of the answer."""
        return not self.reason


def first_camera(name: str) -> RigCamera:
    """The camera in whose frame results stand."""
    return RigCamera(name, CameraPose(np.eye(3), np.zeros(3), 0.0, 0.0), misfit_m=0.0)


@dataclass(frozen=True)
class CameraRig:
    """All cameras of a recording."""

    cameras: tuple[RigCamera, ...]  # The first one, then the further ones in their order

    def __len__(self) -> int:
        return len(self.cameras)

    @property
    def used(self) -> tuple[RigCamera, ...]:
        """Those that are used; a joined frame's `camera` counts them."""
        return tuple(camera for camera in self.cameras if camera.takes_part)

    @property
    def cautions(self) -> tuple[str, ...]:
        """A sentence for each camera that was left out, or of which something is to be known."""
        return tuple(
            f"{camera.name} was left out: {camera.reason}"
            if camera.reason
            else f"{camera.name} {camera.note}"
            for camera in self.cameras
            if camera.reason or camera.note
        )


def joint_centre(offsets_m: Sequence[FloatArray]) -> FloatArray:
    """The mean over cameras of what their joints (5, 3) lie off the first one's, m."""
    return np.asarray(np.mean([np.zeros((len(JOINTS), 3)), *offsets_m], axis=0))


#: Frames of the other camera before and after a moment are no farther apart than this, s.
APART_S = 0.12
#: Velocities are differences over this many frames on both sides.
BESIDE = 2
#: More moments than this do not improve a pose.
MOST_MOMENTS = 12_000


@dataclass(frozen=True)
class Overlap:
    """Joints that both cameras track, at the first one's frames."""

    t: FloatArray  # (n,) s: on the first camera's clock
    first: FloatArray  # (n, 5, 3) m: in {K}
    other: FloatArray  # (n, 5, 3) m: in {C}, between its frames
    # (n, 5, 3) m/s: Of the first camera's joints, by frames on both sides of each moment
    velocity: FloatArray
    both: BoolArray  # bool (n, 5): tracked by both
    step_s: float  # Time that a moment represents

    def __len__(self) -> int:
        return len(self.t)

    @property
    def length_s(self) -> float:
        """Time during which both saw elbow, wrist or another joint of the forearm, s."""
        return float(self.both[:, 1:].any(axis=1).sum()) * self.step_s

    def rows(self, rows: slice | BoolArray) -> Overlap:
        """Some of the moments."""
        points = self.first[rows], self.other[rows], self.velocity[rows]
        return Overlap(self.t[rows], *points, self.both[rows], self.step_s)

    def mirrored(self) -> Overlap:
        """As if the other camera's x axis pointed the other way."""
        flip = np.array([-1.0, 1.0, 1.0])
        return replace(self, other=self.other * flip)


def overlap(
    first: JointTracks, other: JointTracks, clock: RelativeClock, most: int = MOST_MOMENTS
) -> Overlap:
    """The moments at which both cameras track a joint."""
    t = np.asarray(first.t_s)
    other_t = np.asarray(other.t_s)
    empty = np.zeros((0, len(JOINTS), 3))
    none = Overlap(np.zeros(0), empty, empty, empty, np.zeros((0, len(JOINTS)), bool), 0.0)
    if len(t) < 2 or len(other_t) < 2:
        return none
    at = clock.from_first(t)
    rows = np.flatnonzero((at >= other_t[0]) & (at <= other_t[-1]))
    every = -(-len(rows) // most) if len(rows) else 1
    rows = rows[::every]
    after = np.clip(np.searchsorted(other_t, at[rows], side="right"), 1, len(other_t) - 1)
    before = after - 1
    dt = other_t[after] - other_t[before]
    near = (dt > 0.0) & (dt <= APART_S)
    rows, after, before, dt = rows[near], after[near], before[near], dt[near]
    tracked, other_tracked = accepted_samples(first), accepted_samples(other)
    both = tracked[rows] & other_tracked[before] & other_tracked[after]
    some = both.any(axis=1)
    rows, after, before, dt, both = rows[some], after[some], before[some], dt[some], both[some]
    if not len(rows):
        return none
    share = ((at[rows] - other_t[before]) / dt)[:, None, None]
    a, b = np.asarray(other.position[before]), np.asarray(other.position[after])
    # velocities by central differences
    early, late = np.maximum(rows - BESIDE, 0), np.minimum(rows + BESIDE, len(t) - 1)
    span_s = t[late] - t[early]
    is_short = (span_s > 0.0) & (span_s < 2 * BESIDE * APART_S)
    change = np.asarray(first.position[late]) - np.asarray(first.position[early])
    velocity = change / np.maximum(span_s, 1e-6)[:, None, None]
    known = tracked[early] & tracked[late] & is_short[:, None]
    return Overlap(
        t[rows],
        np.asarray(first.position[rows]),
        a + share * (b - a),
        np.where(known[:, :, None], velocity, 0.0),
        both,
        float(np.median(np.diff(t))) * every,
    )


#: Signals are compared on this grid, s, and smoothed over this time, s.
STEP_S, SMOOTH_S = 0.04, 0.12
#: Frames farther apart than this leave a hole in a signal, s.
HOLE_S = 0.12
#: Shifts that leave less in common are not looked at: s, and as a share of the shorter signal.
LEAST_S, LEAST_SHARE = 8.0, 0.3
#: So much of a long recording is read, s.
READ_S = 1200.0
#: This many offsets are tried.
CANDIDATES = 6


def candidate_offsets(first: JointTracks, other: JointTracks) -> list[float]:
    """Offsets (first camera's clock less the other's) that the motion allows, the likeliest first."""
    start, signals = _signals(first)
    other_start, other_signals = _signals(other)
    total, weight = None, None
    for mine, theirs in zip(signals, other_signals, strict=True):
        if not np.isfinite(mine).any() or not np.isfinite(theirs).any():
            continue
        correlation, count = masked_correlation(mine, theirs, 1e-4)
        total = correlation * count if total is None else total + correlation * count
        weight = count if weight is None else weight + count
    if total is None or weight is None:
        return [0.0]
    signal = np.isfinite(signals).any(axis=0).sum(), np.isfinite(other_signals).any(axis=0).sum()
    needed = max(LEAST_S / STEP_S, LEAST_SHARE * min(signal)) * len(signals) * 0.5
    score = np.where(weight >= needed, total / np.maximum(weight, 1.0), 0.0)
    best = peaks(score, 0.2, round(0.3 / STEP_S), CANDIDATES)
    shifts = (best - (len(other_signals[0]) - 1)) * STEP_S + start - other_start
    ordered = [float(shift) for shift in shifts[np.argsort(-score[best], kind="stable")]]
    return [*ordered, 0.0] if all(abs(shift) > 0.5 * STEP_S for shift in ordered) else ordered


def _signals(arm: JointTracks) -> tuple[float, FloatArray]:
    """Start, s, and signals (3, n) on an even grid, nan where the camera saw too little."""
    t = np.asarray(arm.t_s)
    if len(t) < 3:
        return 0.0, np.full((3, 1), np.nan)
    inside = t <= t[0] + READ_S
    t = t[inside]
    grid = np.arange(t[0], t[-1], STEP_S)
    at = {joint: _on_grid(arm, joint, t, grid) for joint in ("shoulder", "elbow", "wrist")}
    reach = np.linalg.norm(at["wrist"] - at["shoulder"], axis=1)
    speeds = [np.linalg.norm(np.gradient(at[joint], STEP_S, axis=0), axis=1) for joint in ("elbow", "wrist")]
    if len(grid) < 3:
        return float(t[0]), np.full((3, max(len(grid), 1)), np.nan)
    return float(t[0]), np.stack([reach, *speeds])


def _on_grid(arm: JointTracks, joint: str, t: FloatArray, grid: FloatArray) -> FloatArray:
    """A joint's smoothed positions (n, 3) on the grid; nan in holes."""
    seen = arm.tracked(joint)[: len(t)]
    if seen.sum() < 3:
        return np.full((len(grid), 3), np.nan)
    known_t = t[seen]
    position = np.asarray(arm.position[: len(t), JOINTS.index(joint)])[seen]
    smooth = np.stack([np.interp(grid, known_t, position[:, k]) for k in range(3)], axis=1)
    width = max(round(SMOOTH_S / STEP_S), 1)
    kernel = np.ones(width) / width
    smooth = np.stack([np.convolve(smooth[:, k], kernel, "same") for k in range(3)], axis=1)
    after = np.clip(np.searchsorted(known_t, grid), 1, len(known_t) - 1)
    hole = known_t[after] - known_t[after - 1] > HOLE_S
    edge = (grid < known_t[0] + SMOOTH_S) | (grid > known_t[-1] - SMOOTH_S)
    smooth[hole | edge] = np.nan
    return smooth


#: Rays with a smaller angle between them, rad, do not determine a depth.
PARALLEL = 0.05


def depth_by_points(
    flat: JointTracks, pose: CameraPose, clock: RelativeClock, with_depth: JointTracks
) -> FloatArray:
    """Depths (F, 5) m of a camera's joints by those that a camera with depth saw in {K}, bridged between."""
    t = clock.to_first(np.asarray(flat.t_s))
    depth = np.full(flat.state.shape, np.nan)
    for column, joint in enumerate(JOINTS):
        rows = np.flatnonzero(with_depth.tracked(joint))
        if len(rows) < 2:
            continue
        seen_t = np.asarray(with_depth.t_s)[rows]
        points = (np.asarray(with_depth.position)[rows, column] - pose.p_K_C_m) @ pose.R_K_C
        depth[:, column] = np.interp(t, seen_t, points[:, 2])
    return _filled(depth)


def depth_by_rays(
    flat: JointTracks, pose: CameraPose, clock: RelativeClock, other: JointTracks, other_pose: CameraPose
) -> tuple[FloatArray, BoolArray]:
    """Depths (F, 5) m of a camera's joints where the rays of another one meet them, and where they do."""
    t, other_t = clock.to_first(np.asarray(flat.t_s)), np.asarray(other.t_s)
    after = np.clip(np.searchsorted(other_t, t), 1, max(len(other_t) - 1, 1))
    before = after - 1
    depth = np.full(flat.state.shape, np.nan)
    dt = other_t[after] - other_t[before]
    share = np.clip((t - other_t[before]) / np.maximum(dt, 1e-6), 0.0, 1.0)[:, None]
    apart = pose.p_K_C_m - other_pose.p_K_C_m
    for column, joint in enumerate(JOINTS):
        seen = other.tracked(joint)
        known = flat.tracked(joint) & seen[before] & seen[after] & (dt > 0) & (dt < APART_S)
        known &= (t >= other_t[0]) & (t <= other_t[-1])
        of_other = np.asarray(other.position)[:, column]
        b = (of_other[before] + share * (of_other[after] - of_other[before])) @ other_pose.R_K_C.T
        a = np.asarray(flat.position)[:, column] @ pose.R_K_C.T
        # the point of the first ray that is nearest to the second
        aa, ab, bb = np.sum(a * a, axis=1), np.sum(a * b, axis=1), np.sum(b * b, axis=1)
        determinant = aa * bb - ab**2
        z = (ab * (b @ apart) - bb * (a @ apart)) / np.where(determinant > 0, determinant, np.inf)
        with np.errstate(invalid="ignore"):
            known &= (determinant > PARALLEL**2 * aa * bb) & (z > 0.2) & (z < 20.0)
        depth[known, column] = z[known]
    met = np.isfinite(depth)
    own_t = np.asarray(flat.t_s)
    for column in range(len(JOINTS)):
        rows = np.flatnonzero(met[:, column])
        if len(rows) > 1:
            depth[:, column] = np.interp(own_t, own_t[rows], depth[rows, column])
    return _filled(depth), met


def _filled(depth: FloatArray) -> FloatArray:
    """Joints without a depth of their own take the mean of the others, 2 m where there is none."""
    with np.errstate(invalid="ignore"):
        known = np.isfinite(depth)
        mean = np.where(known, depth, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    mean[~known.any(axis=1)] = 2.0
    return np.where(known, np.maximum(depth, 0.2), mean[:, None])


def lifted(flat: JointTracks, depth_m: FloatArray) -> JointTracks:
    """The frames with a place for every joint in the camera's axes, where their rays begin."""
    points = np.asarray(flat.position) * depth_m[:, :, None]
    return replace(flat, position=points, pixel_rad=None, ray_origin_m=np.zeros((1, 3)))
