"""What is measured of a recovery, as arrays on an even grid: hand, shoulder, angles, the trunk's axes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..angles.definitions import SINGULAR_DEG, arm_angles, defined, forearm_axes, torso_axes
from ..angles.found import SHOULDER_NAMES, humerus_angles
from ..array_types import BoolArray, FloatArray
from ..linalg import by_columns, interpolate, median_rate_hz, nearest, runs, unit
from ..result import Recovery
from .definitions import MEASURED_ANGLES
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
    def hand_from_shoulder(self) -> FloatArray:
        """The hand's places (n, 3) from the shoulder, where there is one, m."""
        return self.hand - self.joints["shoulder"] if "shoulder" in self.joints else self.hand

    @cached_property
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
    """The arrays of a recovery that measures are made of, at a grid's times and low-passed.

    A second-order Butterworth filter run forth and back, so without delay (Winter, Biomechanics and Motor
    Control of Human Movement, 2009, section 2.2.4.4). Quaternions are filtered by component, with one sign
    all along.
    """
    places = {"imu": recovery.position, **recovery.joints}
    turns = {"forearm": recovery.quaternion}
    if recovery.upper is not None:
        turns["upper arm"] = recovery.upper.quaternion
    if recovery.trunk is not None and recovery.trunk.by_imu:  # else it is assumed upright
        turns["trunk"] = recovery.trunk.quaternion

    def filtered(values: FloatArray) -> FloatArray:
        return low_passed(interpolate(recovery.t_s, values, grid.t_s), grid, cutoff_hz)

    even = by_columns(filtered, places | {f"R {name}": one_sign(turn) for name, turn in turns.items()})
    joints = {joint: even[joint] for joint in recovery.joints if np.isfinite(even[joint]).any()}
    hand_joint = next((joint for joint in HAND_JOINTS if joint in joints), "imu")
    hand = even["imu"] if hand_joint == "imu" else joints[hand_joint]
    axes = {name: forearm_axes(even[f"R {name}"], np.eye(3)) for name in turns}
    angles, missing = _angles(recovery, joints, axes)
    thorax = axes.get("trunk")
    if (thorax is None or not np.isfinite(thorax).any()) and _knows_down(recovery):
        thorax = torso_axes(recovery.gravity_direction)
    return Motion(
        grid,
        recovery.occluded[nearest(recovery.t_s, grid.t_s)],
        hand,
        hand_joint,
        slope(hand, grid),
        joints,
        angles,
        missing,
        thorax,
        recovery.side,
        elbow_bend(joints, axes["forearm"]),
    )


def _angles(
    recovery: Recovery, joints: dict[str, FloatArray], axes: dict[str, FloatArray]
) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """The angles (n,) where they are defined, and why the others are not known."""
    calibration, side, down = recovery.calibration, recovery.side, recovery.gravity_direction
    mounting = None if calibration is None else calibration.R_F_A
    R_K_F = None if mounting is None else axes["forearm"] @ mounting.T
    angles = arm_angles(joints, len(axes["forearm"]), R_K_F, side, down)
    measured = {name: np.where(good, angles[name], np.nan) for name, good in defined(angles).items()}
    R_U_B = None if calibration is None else calibration.R_U_B
    if "upper arm" in axes and R_U_B is not None:
        # the upper arm's own IMU shows its turning for a straight elbow, too
        humerus = axes["upper arm"] @ R_U_B.T
        own = dict(zip(SHOULDER_NAMES, humerus_angles(humerus, side, down), strict=True))
        if "trunk" in axes:
            to_trunk = humerus_angles(np.swapaxes(axes["trunk"], 1, 2) @ humerus, side)
            own |= {f"{name}_trunk": of for name, of in zip(SHOULDER_NAMES, to_trunk, strict=True)}
        for name, values in own.items():
            elevation = own[f"shoulder_elevation{'_trunk' if name.endswith('_trunk') else ''}"]
            with np.errstate(invalid="ignore"):
                raised = (elevation >= SINGULAR_DEG) & (elevation <= 180.0 - SINGULAR_DEG)
            if np.isfinite(values).any():
                measured[name] = np.where(raised | name.startswith("shoulder_elevation"), values, np.nan)
    known = {
        name: measured[name]
        for name in MEASURED_ANGLES
        if name in measured and np.isfinite(measured[name]).any()
    }
    usual = [name for name in MEASURED_ANGLES if not name.endswith("_trunk") and name not in known]
    return known, {name: _why(recovery, name) for name in usual}


def _knows_down(recovery: Recovery) -> bool:
    return bool(np.isfinite(recovery.gravity_direction).all())


def _why(recovery: Recovery, angle: str) -> str:
    """Why an angle is not known, in a sentence."""
    for joint in ("shoulder", "elbow", *(() if angle == "shoulder_elevation" else ("wrist",))):
        if joint not in recovery.joints or not np.isfinite(recovery.joints[joint]).any():
            return f"The recording has no {joint}."
    if angle == "pronation" and (recovery.calibration is None or recovery.calibration.R_F_A is None):
        return (
            "How the IMU is turned on the forearm (R_F_A) is not known: `unocclude calibrate forearm`"
            " measures it, `smooth --calibration` takes it."
        )
    if angle.startswith("shoulder") and not _knows_down(recovery):
        return f"The method {recovery.method} does not solve the direction of gravity."
    return "The arm was never 15 degrees or more from the posture in which this angle is not determined."


def elbow_bend(joints: dict[str, FloatArray], R_K_A: FloatArray) -> FloatArray | None:  # -> (n, 3) rad
    """The rotation that bends the straight arm, (n, 3), rad, in the IMU's axes {A}; its length is flexion."""
    if not {"shoulder", "elbow", "wrist"} <= set(joints):
        return None
    upper, fore = unit(joints["elbow"] - joints["shoulder"]), unit(joints["wrist"] - joints["elbow"])
    across = np.cross(upper, fore)
    sine = np.linalg.norm(across, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = np.arctan2(sine, (upper * fore).sum(axis=1))
        by_sine = np.where(sine > 1e-12, angle / sine, 1.0)
    return np.asarray(np.einsum("nji,nj->ni", R_K_A, by_sine[:, None] * across))


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

    def corrected(self, motion: Motion, quantile: float = 0.5, is_drawn: bool = False) -> Motion:
        """A motion with the flexion that is left; a drawn one has the error twice."""
        left = self.left(quantile) * (self.of_draws if is_drawn else 1.0)
        flexion = lessened(motion.angles["elbow_flexion"], left)
        return replace(motion, angles=motion.angles | {"elbow_flexion": flexion})

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
