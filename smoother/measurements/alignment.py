"""Initial values, from visible data only.

Orientation: an offline inertial filter (VQF; Laidig and Seel, Information Fusion 2023) gives the
sensor in a frame {E} with z up whose heading drifts slowly; the camera's view of the forearm's
direction and of a joint's acceleration then gives `R_K_E` over time (Wahba's problem, SIAM Review
1965). Positions and velocities: local polynomials through the camera's samples, cubic bridges over
the gaps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..body import SEGMENTS
from ..calibration import ArmCalibration
from ..linalg import interpolate, nearest_rotation
from ..recording import FOREARM_JOINTS, JOINTS
from ..rotation import Rotation, Slerp
from ..units import GRAVITY
from .inertial import InertialAttitude, InertialSignal
from .segment import Segment

#: How fast the inertial filter's heading may drift: alignments share data over this time, s.
ALIGN_MEMORY_S = 30.0
ALIGN_STEP_S = 2.0
#: Camera accelerations are fitted over this time on both sides, s.
ACCELERATION_HALF_S = 0.4
#: Frames that a parabola needs.
FEWEST_FRAMES = 6
#: Standard deviations: of a joint per axis, of the inertial filter's attitude, of an acceleration (m/s^2),
#: of the rough direction of gravity.
POINT_SIGMA_M = 0.012
FILTER_SIGMA_RAD = np.radians(3.0)
ACCELERATION_SIGMA = 0.1
HINT_SIGMA_RAD = np.radians(15.0)


@dataclass(frozen=True)
class VectorPairs:
    """Unit vectors, or accelerations (m/s^2), in both frames: in_K = R_K_E (in_E + turn lever_A)."""

    t: FloatArray  # (n,) s: on the IMU's clock
    in_K: FloatArray  # (n, 3): by the camera
    in_E: FloatArray  # (n, 3): by the IMU
    weight: FloatArray  # (n,): 1 / variance
    turn: FloatArray | None = None  # (n, 3, 3) 1/s^2: what a lever arm in {A} adds to an acceleration `in_E`

    def with_lever(self, lever_A: FloatArray) -> VectorPairs:
        """The accelerations of a joint that sits at lever_A (3,) m in {A}."""
        assert self.turn is not None
        return replace(self, in_E=self.in_E + self.turn @ lever_A)


def direction_pairs(
    t: FloatArray, elbow: FloatArray, wrist: FloatArray, attitude: InertialAttitude, along_A: FloatArray
) -> VectorPairs:
    """The forearm's direction in both frames, at frames where both joints are visible."""
    along_K = wrist - elbow
    length = np.linalg.norm(along_K, axis=1)
    in_E = attitude.at(t).apply(along_A)
    sigma = np.hypot(np.sqrt(2.0) * POINT_SIGMA_M / np.median(length), FILTER_SIGMA_RAD)
    return VectorPairs(t, along_K / length[:, None], in_E, np.full(len(t), sigma**-2))


def acceleration_pairs(
    t: FloatArray, point: FloatArray, attitude: InertialAttitude, signal: InertialSignal
) -> VectorPairs:
    """A joint's acceleration from the camera and from the IMU, both by the same local parabolas."""
    none = VectorPairs(*(np.zeros(shape) for shape in (0, (0, 3), (0, 3), 0, (0, 3, 3))))
    inside_signal = (t >= signal.start_s) & (t <= signal.end_s)
    if np.count_nonzero(inside_signal) < FEWEST_FRAMES:
        return none
    t, point = t[inside_signal], point[inside_signal]
    step = 0.01
    grid = np.arange(max(signal.start_s, t[0] - 0.1), min(signal.end_s, t[-1] + 0.1), step)
    force = signal.mean(grid[:-1], grid[1:])[:, :3]
    acc_E = attitude.at(0.5 * (grid[1:] + grid[:-1])).apply(force) - np.array([0.0, 0.0, GRAVITY])
    velocity = np.vstack([np.zeros(3), np.cumsum(acc_E * step, axis=0)])
    path = np.vstack([np.zeros(3), np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * step, axis=0)])
    inertial = interpolate(grid, path, t)
    R_E_A = attitude.at(t).as_matrix()
    half = ACCELERATION_HALF_S
    centre = np.arange(t[0] + half, t[-1] - half, 0.5 * half)
    lo, hi = np.searchsorted(t, [centre - half, centre + half])
    if not len(centre) or (hi - lo).max() < FEWEST_FRAMES:
        return none
    # every parabola as one row of indices, short ones filled up and masked
    index = np.minimum(lo[:, None] + np.arange((hi - lo).max()), len(t) - 1)
    inside = np.arange(index.shape[1]) < (hi - lo)[:, None]
    u = np.where(inside, t[index] - centre[:, None], 0.0)
    first, last = t[lo], t[np.maximum(hi - 1, 0)]
    longest = np.where(inside[:, 1:], np.diff(t[index], axis=1), 0.0).max(axis=1)
    good = (hi - lo >= FEWEST_FRAMES) & (longest < 0.35 * half) & (last - first > 1.6 * half)
    u, index, inside, centre = u[good], index[good], inside[good], centre[good]
    basis = np.stack([inside.astype(float), u, u**2], axis=2)
    normal = np.einsum("wka,wkb->wab", basis, basis)
    functional = 2.0 * np.linalg.solve(normal, np.swapaxes(basis, 1, 2))[:, 2]
    variance = POINT_SIGMA_M**2 * np.sum(functional**2, axis=1) + ACCELERATION_SIGMA**2
    return VectorPairs(
        centre,
        np.einsum("wk,wka->wa", functional, point[index]),
        np.einsum("wk,wka->wa", functional, inertial[index]),
        1.0 / variance,
        np.einsum("wk,wkab->wab", functional, R_E_A[index]),
    )


@dataclass(frozen=True)
class Alignment:
    """`R_K_E` over time."""

    t: FloatArray  # (n,) s: on the IMU's clock, increasing
    R_K_E: Rotation  # Maps a vector from the inertial frame to the camera's
    covariance: FloatArray  # (n, 3, 3) rad^2: in {K}

    def at(self, t: FloatArray) -> Rotation:
        """`R_K_E` at the given times, held beyond the ends."""
        if len(self.t) == 1:
            return Rotation.from_matrix(np.tile(self.R_K_E.as_matrix(), (len(t), 1, 1)))
        return self._curve(np.clip(t, self.t[0], self.t[-1]))

    @cached_property
    def _curve(self) -> Slerp:
        return Slerp(self.t, self.R_K_E)


def align(pairs: list[VectorPairs], start_s: float, end_s: float, down_K: FloatArray) -> Alignment:
    """`R_K_E` over time by Wahba's problem (SIAM Review 1965) on pairs weighted by their distance in time."""
    t = np.arange(start_s, max(end_s, start_s + 1e-3), ALIGN_STEP_S)
    none = np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    each = [none, *((pair.t, pair.in_K, pair.in_E, pair.weight) for pair in pairs)]
    times, in_K, in_E, weight = (np.concatenate(column) for column in zip(*each, strict=True))
    nearest = np.clip(((times - start_s) / ALIGN_STEP_S).astype(int), 0, len(t) - 1)
    profile = np.zeros((len(t), 3, 3))
    outer = weight[:, None, None] * in_K[:, :, None] * in_E[:, None, :]
    np.add.at(profile, nearest, outer)
    # exponentially weighted, over the neighbours on both sides
    forward, backward, decay = profile.copy(), profile.copy(), np.exp(-ALIGN_STEP_S / ALIGN_MEMORY_S)
    for i in range(1, len(t)):
        forward[i] += decay * forward[i - 1]
        backward[-1 - i] += decay * backward[-i]
    profile = forward + backward - profile
    profile += np.outer(down_K, [0.0, 0.0, -1.0]) / HINT_SIGMA_RAD**2
    R = nearest_rotation(profile)
    # information of Wahba's loss about the attitude, in {K}: tr(M) I - M with M = R B' symmetrised
    M = R @ np.swapaxes(profile, 1, 2)
    information = np.trace(M, axis1=1, axis2=2)[:, None, None] * np.eye(3) - 0.5 * (M + np.swapaxes(M, 1, 2))
    covariance = np.linalg.inv(information + np.eye(3)) + FILTER_SIGMA_RAD**2 * np.eye(3)
    return Alignment(t, Rotation.from_matrix(R), covariance)


def located(calibration: ArmCalibration) -> BoolArray:
    """(5,) joints that can be used: of the others the place on the arm is unknown."""
    known = {"shoulder", *(joint for joint in JOINTS if lever_of(calibration, joint) is not None)}
    for name, mounting in calibration.mountings.items():
        known |= set(SEGMENTS[name].camera_joints) & mounting.lever_arms.keys()
    return np.array([joint in known for joint in JOINTS])


def lever_of(calibration: ArmCalibration, joint: str) -> FloatArray | None:
    """A joint's lever arm (3,) m in {A}; zero for the strap, None where unknown."""
    if joint in calibration.lever_arms:
        return calibration.lever_arms[joint].position_m
    return np.zeros(3) if joint == "strap" else None


def imu_positions(
    position: FloatArray, used: BoolArray, R_K_A: FloatArray, calibration: ArmCalibration
) -> tuple[FloatArray, IntArray]:  # (f, 5, 3) m, (f, 5), (f, 3, 3) -> (f, 3) m, nan without joints; (f,)
    """Where joints of known lever arms have the IMU, in the mean over them, and how many they are."""
    total, count = np.zeros((len(position), 3)), np.zeros(len(position), int)
    for joint in FOREARM_JOINTS:
        lever, column = lever_of(calibration, joint), JOINTS.index(joint)
        if lever is not None:
            seen = used[:, column]
            total[seen] += position[seen, column] - R_K_A[seen] @ lever
            count[seen] += 1
    with np.errstate(invalid="ignore"):
        return total / count[:, None], count


def pairs(
    segment: Segment, frame_t_imu: FloatArray, accepted: BoolArray, calibration: ArmCalibration
) -> list[VectorPairs]:
    """What camera and IMU both measure: the forearm's direction, and the acceleration of one joint."""
    vectors: list[VectorPairs] = []
    elbow, wrist = JOINTS.index("elbow"), JOINTS.index("wrist")
    along_A = calibration.forearm_direction
    both = accepted[:, elbow] & accepted[:, wrist]
    if along_A is not None and both.any():
        position = segment.position[both]
        t = frame_t_imu[both]
        vectors.append(direction_pairs(t, position[:, elbow], position[:, wrist], segment.attitude, along_A))
    for joint in ("strap", "wrist", "hand", "elbow"):  # the first that is known: nearest to the IMU
        lever, column = lever_of(calibration, joint), JOINTS.index(joint)
        rows = accepted[:, column]
        if lever is not None and rows.sum() >= 8:
            t, point = frame_t_imu[rows], segment.position[rows, column]
            accelerations = acceleration_pairs(t, point, segment.attitude, segment.signal)
            vectors.append(accelerations.with_lever(lever))
            break
    return vectors
