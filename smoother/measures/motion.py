"""What is measured of a recovery, as arrays on an even grid: hand, shoulder, angles, the trunk's axes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..angles import shoulder_angles
from ..array_types import BoolArray, FloatArray
from ..joint_angles import defined, elbow_bend, recovery_angles, torso_axes
from ..linalg import by_columns, interpolate, median_rate_hz, nearest, runs
from ..result import Recovery
from .measure import Smoothing

#: Samples further apart than this, in periods, do not belong to one run.
APART_PERIODS = 4.0
#: A run shorter than this is not measured: a filter of 6 Hz needs a few periods, s.
SHORTEST_RUN_S = 0.5


@dataclass(frozen=True)
class TimeGrid:
    """Even times in runs that have an answer throughout."""

    t_s: FloatArray  # (n,) s: increasing; even within a run
    rate_hz: float  # Of the grid
    runs: tuple[slice, ...]  # Rows without a pause between them


def grid_of(recovery: Recovery, settings: Smoothing) -> TimeGrid:
    """The even times at which a recovery is measured."""
    rate = min(median_rate_hz(recovery.t_s), settings.most_rate_hz)
    known = recovery.answered
    times, places, count = [], [], 0
    if len(recovery) > 1 and known.any():
        rows = np.flatnonzero(known)
        apart = np.diff(recovery.t_s[rows]) > APART_PERIODS / median_rate_hz(recovery.t_s)
        for some in np.split(rows, np.flatnonzero(apart) + 1):
            start, end = recovery.t_s[some[0]], recovery.t_s[some[-1]]
            if end - start < SHORTEST_RUN_S:
                continue
            times.append(start + np.arange(int((end - start) * rate) + 1) / rate)
            places.append(slice(count, count + len(times[-1])))
            count += len(times[-1])
    return TimeGrid(np.concatenate(times) if times else np.empty(0), rate, tuple(places))


def on_grid(recovery: Recovery, grid: TimeGrid, cutoff_hz: float) -> Recovery:
    """The recovery at a grid's times, low-passed; its covariances are left out.

    A second-order Butterworth filter run forth and back, so without delay (Winter, Biomechanics and Motor
    Control of Human Movement, 2009, section 2.2.4.4). Quaternions are filtered by component, with one sign
    all along, and brought back to length one.
    """
    # measures assume an upright trunk unless an IMU is on it
    trunk = recovery.trunk if recovery.trunk is None or recovery.trunk.by_imu else None
    tracks = {"position": recovery.position, "quaternion": recovery.quaternion}
    tracks |= {f"joint {joint}": position for joint, position in recovery.joints.items()}
    for name, motion in recovery.segments.items():
        tracks |= {f"{name} position": motion.position, f"{name} quaternion": motion.quaternion}
    if trunk is not None:
        tracks["trunk quaternion"] = trunk.quaternion

    def filtered(values: FloatArray) -> FloatArray:
        return low_passed(interpolate(recovery.t_s, values, grid.t_s), grid, cutoff_hz)

    turns = [name for name in tracks if name.endswith("quaternion")]
    even = by_columns(filtered, tracks | {name: one_sign(tracks[name]) for name in turns})
    with np.errstate(invalid="ignore"):
        even |= {name: even[name] / np.linalg.norm(even[name], axis=1, keepdims=True) for name in turns}
    n = len(grid.t_s)
    if trunk is not None:
        trunk = replace(trunk, quaternion=even["trunk quaternion"], covariance=_zeros(n, 3, 3))
    return replace(
        recovery,
        t_s=grid.t_s,
        occluded=recovery.occluded[nearest(recovery.t_s, grid.t_s)],
        position=even["position"],
        quaternion=even["quaternion"],
        velocity=interpolate(recovery.t_s, recovery.velocity, grid.t_s),
        pose_covariance=_zeros(n, 6, 6),
        velocity_covariance=_zeros(n, 3, 3),
        joints={joint: even[f"joint {joint}"] for joint in recovery.joints},
        joint_covariance={joint: _zeros(n, 3, 3) for joint in recovery.joint_covariance},
        segments={
            name: replace(
                motion,
                position=even[f"{name} position"],
                quaternion=even[f"{name} quaternion"],
                pose_covariance=_zeros(n, 6, 6),
            )
            for name, motion in recovery.segments.items()
        },
        trunk=trunk,
        draws=None,
    )


def low_passed(values: FloatArray, grid: TimeGrid, cutoff_hz: float) -> FloatArray:
    """Values (n, k) on a grid without what is faster than the cut-off; runs that are too short stay."""
    from scipy.signal import butter, sosfiltfilt

    smooth = values.copy()
    if cutoff_hz >= 0.45 * grid.rate_hz:
        return smooth
    sections = butter(2, cutoff_hz, fs=grid.rate_hz, output="sos")
    pad = round(grid.rate_hz / cutoff_hz)
    for run in grid.runs:
        known = np.asarray(np.isfinite(values[run]).all(axis=1))
        for inner in runs(known):
            rows = slice(run.start + inner.start, run.start + inner.stop)
            if inner.stop - inner.start > 2 * pad:
                smooth[rows] = sosfiltfilt(sections, values[rows], axis=0, padlen=pad)
    return smooth


def slope(values: FloatArray, grid: TimeGrid) -> FloatArray:
    """Derivative by time of values (n, ...) on a grid, by central differences within each run."""
    change = np.full_like(values, np.nan)
    for run in grid.runs:
        if run.stop - run.start > 1:
            change[run] = np.gradient(values[run], 1.0 / grid.rate_hz, axis=0)
    return change


def one_sign(quaternion: FloatArray) -> FloatArray:
    """Quaternions (n, 4) that do not jump to their negative; nan where there is none."""
    even = quaternion.copy()
    known = np.flatnonzero(np.isfinite(quaternion).all(axis=1))
    turns = np.where((even[known][1:] * even[known][:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    even[known[1:]] *= np.cumprod(turns)[:, None]
    return even


def _zeros(*shape: int) -> FloatArray:
    """Zeros of that shape, which take no memory."""
    return np.broadcast_to(np.zeros(()), shape)


#: The angles that are measured, in the order of the tables.
MEASURED_ANGLES = (
    "elbow_flexion",
    "pronation",
    "shoulder_elevation",
    "shoulder_plane",
    "shoulder_rotation",
    "shoulder_elevation_trunk",
    "shoulder_plane_trunk",
    "shoulder_rotation_trunk",
)
#: What represents the hand, the best first; the IMU's own place where there is none of them.
HAND_JOINTS = ("hand", "wrist", "strap")


@dataclass(frozen=True)
class Motion:
    """An arm's motion on an even grid, low-passed: answer, drawn motion or truth."""

    grid: TimeGrid  # Of n times
    occluded: BoolArray  # bool (n,): the camera did not see the forearm
    hand: FloatArray  # (n, 3) m: in {K}
    hand_joint: str  # Which joint represents it: one of `HAND_JOINTS`, or "imu"
    velocity: FloatArray  # (n, 3) m/s: of the hand
    joints: dict[str, FloatArray]  # dict of (n, 3) m: in {K}
    angles: dict[str, FloatArray]  # dict of (n,) deg: by the names in `MEASURED_ANGLES`
    missing: dict[str, str]  # Why an angle is not known at all, by its name
    R_K_T: FloatArray | None  # (n, 3, 3) or (3, 3): axes of the thorax (x forward, y up, z to its right)
    side: str  # "left", "right" or ""
    # (n, 3) rad: Rotation vector from the upper arm's direction to the forearm's, in the IMU's axes
    bend: FloatArray | None = None

    @property
    def speed(self) -> FloatArray:
        """(n,) of the hand, m/s."""
        return np.asarray(np.linalg.norm(self.velocity, axis=1))

    def in_trunk(self, vectors: FloatArray) -> FloatArray | None:
        """Vectors (n, 3) of {K} in the thorax's axes, mirrored to a right arm's; None without them."""
        if self.R_K_T is None:
            return None
        axes = self.R_K_T if self.R_K_T.ndim == 3 else np.broadcast_to(self.R_K_T, (len(vectors), 3, 3))
        turned = np.einsum("nji,nj->ni", axes, vectors)
        return turned * np.array([1.0, 1.0, -1.0]) if self.side == "left" else turned


def motion_of(recovery: Recovery, grid: TimeGrid, cutoff_hz: float) -> Motion:
    """The arrays of a recovery that measures are made of."""
    even = on_grid(recovery, grid, cutoff_hz)
    hand_joint = next((joint for joint in HAND_JOINTS if _is_there(even, joint)), "imu")
    hand = even.position if hand_joint == "imu" else even.joints[hand_joint]
    angles, missing = _angles(even)
    return Motion(
        grid,
        even.occluded,
        hand,
        hand_joint,
        slope(hand, grid),
        {joint: place for joint, place in even.joints.items() if _is_there(even, joint)},
        angles,
        missing,
        _thorax(even),
        even.side,
        elbow_bend(even),
    )


def _is_there(recovery: Recovery, joint: str) -> bool:
    return joint in recovery.joints and bool(np.isfinite(recovery.joints[joint]).any())


def _angles(recovery: Recovery) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """The angles (n,) where they are defined, and why the others are not known."""
    angles = recovery_angles(recovery)
    good = defined(angles)
    measured = {name: np.where(good[name], angles[name], np.nan) for name in angles}
    if recovery.upper is not None:  # the upper arm's own IMU shows its turning for a straight elbow, too
        own, _ = shoulder_angles(recovery)
        if recovery.trunk is not None:
            to_trunk, _ = shoulder_angles(recovery, recovery.trunk)
            own |= {f"{name}_trunk": values for name, values in to_trunk.items()}
        own = {name: values for name, values in own.items() if np.isfinite(values).any()}
        for name, values in own.items():
            elevation = own[f"shoulder_elevation{'_trunk' if name.endswith('_trunk') else ''}"]
            with np.errstate(invalid="ignore"):
                raised = (elevation >= 15.0) & (elevation <= 165.0)
            measured[name] = (
                values if name.startswith("shoulder_elevation") else np.where(raised, values, np.nan)
            )
    known = {name: values for name, values in measured.items() if name in MEASURED_ANGLES}
    known = {name: values for name, values in known.items() if np.isfinite(values).any()}
    missing = {name: _why(recovery, name) for name in MEASURED_ANGLES[:5] if name not in known}
    return known, missing


def _why(recovery: Recovery, angle: str) -> str:
    """Why an angle is not known, in a sentence."""
    for joint in ("shoulder", "elbow", *(() if angle == "shoulder_elevation" else ("wrist",))):
        if not _is_there(recovery, joint):
            return f"The recording has no {joint}."
    if angle == "pronation" and (recovery.calibration is None or recovery.calibration.R_F_A is None):
        return (
            "How the IMU is turned on the forearm (R_F_A) is not known: `unocclude calibrate forearm`"
            " measures it, `smooth --calibration` takes it."
        )
    if angle.startswith("shoulder") and not np.isfinite(recovery.gravity_direction).all():
        return f"The method {recovery.method} does not solve the direction of gravity."
    return "The arm was never 15 degrees or more from the posture in which this angle is not determined."


def _thorax(recovery: Recovery) -> FloatArray | None:
    if recovery.trunk is not None and np.isfinite(recovery.trunk.quaternion).any():
        axes = np.full((len(recovery), 3, 3), np.nan)
        known = np.isfinite(recovery.trunk.quaternion).all(axis=1)
        turns = Rotation.from_quat(recovery.trunk.quaternion[known], scalar_first=True)
        axes[known] = turns.as_matrix()
        return axes
    if not np.isfinite(recovery.gravity_direction).all():
        return None
    return torso_axes(recovery.gravity_direction)


#: Stated variances of the error are good to this factor (one standard deviation of its logarithm).
VARIANCE_FACTOR = 2.0
#: Parts of the bend that may be left, densely where hardly anything is taken.
_LEFT = np.concatenate([np.linspace(0.002, 0.5, 100), 1.0 - np.geomspace(0.495, 1e-7, 300)])
_STEP = np.gradient(_LEFT)


# Flexion is the length of a vector, the bend, and errors of that vector make it longer: a straight arm
# known to 3 degrees per axis is 4 degrees bent on average and 12 at some time, and drawn motions, which have
# that error twice, are bent still more. Squares of sines add up: from the answer's mean square the stated
# variance of the error is taken, and all flexion is made smaller by the factor that this leaves. (The bias
# is that of the magnitude of noisy complex images: Koay and Basser, J Magn Reson 179:317-322, 2006; to
# match the second moment rather than each sample leaves extremes without bias: Louis, J Am Stat Assoc
# 79:393-398, 1984.) An elbow that bends by tens of degrees loses some tenths of a degree.
#
# How large the error is is itself only stated to a factor: each drawn motion is given another one that the
# answer allows, so that an interval reaches down to what the recording does not exclude.
@dataclass(frozen=True)
class ElbowBend:
    """How far the elbow is bent in an answer, and the error of that."""

    square: float  # Mean square of the sine of the answer's flexion
    variance: float  # rad^2: of the error of the bend, by the draws, along each of its two axes

    @classmethod
    def of(cls, answer: Motion, drawn: Iterable[Motion]) -> ElbowBend | None:
        """By an answer and some of its draws; None where the bend is not known."""
        if answer.bend is None or not np.isfinite(answer.bend).any():
            return None
        errors = [
            float(np.nanmean(((motion.bend - answer.bend) ** 2).sum(axis=1)))
            for motion in drawn
            if motion.bend is not None
        ]
        square = float(np.nanmean(np.sin(np.linalg.norm(answer.bend, axis=1)) ** 2))
        return cls(square, 0.5 * float(np.mean(errors))) if errors and square > 0.0 else None

    @property
    def of_draws(self) -> float:
        """What is left of a drawn motion's bend when the second error is taken from it, 0 to 1."""
        return float(1.0 / np.sqrt(1.0 + 2.0 * self.variance / self.square))

    def left(self, quantile: float) -> float:
        """What is left of the bend without the error's part, 0 to 1."""
        if not self.variance > 0.0:
            return 1.0
        # An error across the bend lengthens it; one along it only where there is hardly a bend.
        axes = 2.0 - _LEFT**2
        factor = self.square * (1.0 - _LEFT**2) / (axes * self.variance)
        weight = np.exp(-0.5 * (np.log(factor) / np.log(VARIANCE_FACTOR)) ** 2) / factor * _STEP
        below = np.cumsum(weight)
        if not below[-1] > 0.0:  # the error is far too small to be seen
            return 1.0
        return float(np.interp(quantile * below[-1], below, _LEFT))

    def corrected(self, answer: Motion) -> Motion:
        """An answer with the flexion that is left."""
        return _lessened(answer, self.left(0.5))

    def corrected_draw(self, drawn: Motion, quantile: float) -> Motion:
        """A drawn motion with the flexion that is left; it has the error twice."""
        return _lessened(drawn, self.left(quantile) * self.of_draws)

    def lower(self, low_deg: float) -> float:
        """The lower end of an angle's interval, where an error across the bend may have lengthened it."""
        cosine = np.cos(np.radians(max(low_deg, 0.0))) / np.cos(min(np.sqrt(self.variance), 1.5))
        return min(low_deg, float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def lessened(flexion: FloatArray, left: float) -> FloatArray:
    """Flexion (n,), degrees, of which a part is left: that part near straight, all of it from 90 degrees
    on.
    """
    angle = np.radians(flexion)
    return np.asarray(np.degrees(angle - (1.0 - left) * 0.5 * np.maximum(np.sin(2.0 * angle), 0.0)))


def _lessened(motion: Motion, left: float) -> Motion:
    return replace(
        motion, angles=motion.angles | {"elbow_flexion": lessened(motion.angles["elbow_flexion"], left)}
    )
