"""Start values, from visible data only.

Orientation: an offline inertial filter (VQF; Laidig and Seel, Information Fusion 2023) gives the
sensor in a frame {E} with z up whose heading drifts slowly; the camera's view of the forearm's
direction and of a joint's acceleration then gives `R_K_E` over time (Wahba's problem, SIAM Review
1965). Positions and velocities: local polynomials through the camera's samples, cubic bridges over
the gaps.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from .arrays import interpolate
from .inertial import InertialSignal
from .recording import FloatArray
from .window import States

#: How fast the inertial filter's heading may drift: alignments share data over this time, s.
ALIGN_SPAN_S = 30.0
ALIGN_STEP_S = 2.0
#: Camera accelerations are taken over windows of this half width, s.
ACCELERATION_HALF_S = 0.4
#: Half width of the time over which the sensor's liveliness is judged, s.
LIVELY_HALF_S = 0.5
#: Frames that a parabola needs.
FEWEST_FRAMES = 6
#: Standard deviations of the pairs that are matched.
POINT_SIGMA_M = 0.012
FILTER_SIGMA_RAD = np.radians(3.0)
ACCELERATION_SIGMA = 0.1
HINT_SIGMA_RAD = np.radians(15.0)


@dataclass(frozen=True)
class InertialAttitude:
    """The sensor's orientation in {E}: `R_E_A` at times t (n,), and the gyro bias (3,) rad/s."""

    t: FloatArray
    R_E_A: Rotation
    gyroscope_bias: FloatArray

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "_curve"}  # made again

    @cached_property
    def _curve(self) -> Slerp:
        return Slerp(self.t, self.R_E_A)

    def at(self, t: FloatArray) -> Rotation:
        """`R_E_A` at the given times, held beyond the ends."""
        return self._curve(np.clip(t, self.t[0], self.t[-1]))


def inertial_attitude(signal: InertialSignal, rate_hz: float) -> InertialAttitude:
    """Run the offline filter on the signal, resampled evenly."""
    from vqf import offlineVQF

    count = max(int(np.floor((signal.end_s - signal.start_s) * rate_hz)), 2)
    edges = np.linspace(signal.start_s, signal.end_s, count + 1)
    mean = signal.mean(edges[:-1], edges[1:])
    step = float(edges[1] - edges[0])
    acc, gyro = np.ascontiguousarray(mean[:, :3]), np.ascontiguousarray(mean[:, 3:])
    answer = offlineVQF(gyro, acc, None, step)
    quaternion = answer["quat6D"][:, [1, 2, 3, 0]]
    # the filter's answer holds at the end of each sample's interval
    return InertialAttitude(edges[1:], Rotation.from_quat(quaternion), np.median(answer["bias"], axis=0))


@dataclass(frozen=True)
class VectorPairs:
    """Unit or physical vectors seen from both frames: in_K = R_K_E in_E, weight = 1 / variance."""

    t: FloatArray
    in_K: FloatArray
    in_E: FloatArray
    weight: FloatArray


def direction_pairs(
    t: FloatArray, elbow: FloatArray, wrist: FloatArray, attitude: InertialAttitude, along_A: FloatArray
) -> VectorPairs:
    """The forearm's direction in both frames, at frames where both joints are seen."""
    along_K = wrist - elbow
    length = np.linalg.norm(along_K, axis=1)
    in_E = attitude.at(t).apply(along_A)
    sigma = np.hypot(np.sqrt(2.0) * POINT_SIGMA_M / np.median(length), FILTER_SIGMA_RAD)
    return VectorPairs(t, along_K / length[:, None], in_E, np.full(len(t), sigma**-2))


@dataclass(frozen=True)
class AccelerationPairs:
    """A joint's acceleration from camera and IMU: in_K = R_K_E (in_E + turn lever_A), (n, ...) each."""

    t: FloatArray
    in_K: FloatArray
    in_E: FloatArray
    turn: FloatArray
    weight: FloatArray

    def with_lever(self, lever_A: FloatArray) -> VectorPairs:
        """Vector pairs for a joint that sits at lever_A (3,) m in {A}."""
        return VectorPairs(self.t, self.in_K, self.in_E + self.turn @ lever_A, self.weight)


def acceleration_pairs(
    t: FloatArray, point: FloatArray, attitude: InertialAttitude, signal: InertialSignal, gravity: float
) -> AccelerationPairs:
    """A joint's acceleration from the camera and from the IMU, both by the same local parabolas.

    The camera's samples p(t_j), the IMU's double integral and the lever's turning go through the same
    linear functional (the quadratic coefficient of a least-squares parabola), so no filter differs.
    """
    step = 0.01
    grid = np.arange(max(signal.start_s, t[0] - 0.1), min(signal.end_s, t[-1] + 0.1), step)
    force = signal.mean(grid[:-1], grid[1:])[:, :3]
    acc_E = attitude.at(0.5 * (grid[1:] + grid[:-1])).apply(force) - np.array([0.0, 0.0, gravity])
    velocity = np.vstack([np.zeros(3), np.cumsum(acc_E * step, axis=0)])
    path = np.vstack([np.zeros(3), np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * step, axis=0)])
    inertial = interpolate(grid, path, t)
    R_E_A = attitude.at(t).as_matrix()
    half = ACCELERATION_HALF_S
    centre = np.arange(t[0] + half, t[-1] - half, 0.5 * half)
    lo, hi = np.searchsorted(t, [centre - half, centre + half])
    if not len(centre) or (hi - lo).max() < FEWEST_FRAMES:
        none = np.zeros((0, 3))
        return AccelerationPairs(np.zeros(0), none, none, np.zeros((0, 3, 3)), np.zeros(0))
    # every window as one row of indices, short ones filled up and masked
    index = np.minimum(lo[:, None] + np.arange((hi - lo).max()), len(t) - 1)
    inside = np.arange(index.shape[1]) < (hi - lo)[:, None]
    u = np.where(inside, t[index] - centre[:, None], 0.0)
    first, last = t[lo], t[np.maximum(hi - 1, 0)]
    hole = np.where(inside[:, 1:], np.diff(t[index], axis=1), 0.0).max(axis=1)
    good = (hi - lo >= FEWEST_FRAMES) & (hole < 0.35 * half) & (last - first > 1.6 * half)
    u, index, inside, centre = u[good], index[good], inside[good], centre[good]
    basis = np.stack([inside.astype(float), u, u**2], axis=2)
    functional = (
        2.0 * np.linalg.solve(np.einsum("wka,wkb->wab", basis, basis), np.swapaxes(basis, 1, 2))[:, 2]
    )
    variance = POINT_SIGMA_M**2 * np.sum(functional**2, axis=1) + ACCELERATION_SIGMA**2
    return AccelerationPairs(
        centre,
        np.einsum("wk,wka->wa", functional, point[index]),
        np.einsum("wk,wka->wa", functional, inertial[index]),
        np.einsum("wk,wkab->wab", functional, R_E_A[index]),
        1.0 / variance,
    )


def liveliness(signal: InertialSignal, attitude: InertialAttitude, t: FloatArray) -> FloatArray:
    """How much the sensor's acceleration varies about each time, m/s^2 (n,), one sigma over its axes.

    Standard deviation over `LIVELY_HALF_S` on both sides, so that the inertial attitude's slow error,
    which turns gravity into a constant acceleration, does not count.
    """
    step = 0.02
    around = LIVELY_HALF_S + step
    edges = np.arange(max(signal.start_s, t[0] - around), min(signal.end_s, t[-1] + around), step)
    force = signal.mean(edges[:-1], edges[1:])[:, :3]
    acc = attitude.at(0.5 * (edges[1:] + edges[:-1])).apply(force)
    acc -= acc.mean(axis=0)
    lo, hi = np.searchsorted(edges[:-1], [t - LIVELY_HALF_S, t + LIVELY_HALF_S])
    hi = np.maximum(hi, lo + 1)
    sums = np.vstack([np.zeros(3), np.cumsum(acc, axis=0)])
    squares = np.concatenate([[0.0], np.cumsum(np.sum(acc**2, axis=1))])
    count = (hi - lo).astype(float)
    mean = (sums[hi] - sums[lo]) / count[:, None]
    variance = (squares[hi] - squares[lo]) / count - np.sum(mean**2, axis=1)
    return np.sqrt(np.maximum(variance, 0.0) / 3.0)


@dataclass(frozen=True)
class Alignment:
    """`R_K_E` over time and its covariance (3, 3) rad^2 in {K} at each of the times t (n,)."""

    t: FloatArray
    R_K_E: Rotation
    covariance: FloatArray

    def at(self, t: FloatArray) -> Rotation:
        """`R_K_E` at the given times, held beyond the ends."""
        if len(self.t) == 1:
            return Rotation.from_matrix(np.tile(self.R_K_E.as_matrix(), (len(t), 1, 1)))
        return self._curve(np.clip(t, self.t[0], self.t[-1]))

    @cached_property
    def _curve(self) -> Slerp:
        return Slerp(self.t, self.R_K_E)

    def covariance_at(self, t: float) -> FloatArray:
        """Covariance at the nearest of its times."""
        return self.covariance[int(np.argmin(np.abs(self.t - t)))]


def align(pairs: list[VectorPairs], start_s: float, end_s: float, down_K: FloatArray) -> Alignment:
    """`R_K_E` over time by Wahba's problem on pairs weighted by their distance in time.

    Parameters
    ----------
    down_K : (3,) rough direction of gravity in {K}; decides only what the pairs leave open.
    """
    t = np.arange(start_s, max(end_s, start_s + 1e-3), ALIGN_STEP_S)
    times = np.concatenate([pair.t for pair in pairs])
    in_K = np.vstack([pair.in_K for pair in pairs])
    in_E = np.vstack([pair.in_E for pair in pairs])
    weight = np.concatenate([pair.weight for pair in pairs])
    cell = np.clip(((times - start_s) / ALIGN_STEP_S).astype(int), 0, len(t) - 1)
    profile = np.zeros((len(t), 3, 3))
    outer = weight[:, None, None] * in_K[:, :, None] * in_E[:, None, :]
    np.add.at(profile, cell, outer)
    profile = _spread(profile, np.exp(-ALIGN_STEP_S / ALIGN_SPAN_S))
    profile += np.outer(down_K, [0.0, 0.0, -1.0]) / HINT_SIGMA_RAD**2
    U, _, Vt = np.linalg.svd(profile)
    sign = np.sign(np.linalg.det(U @ Vt))
    middle = np.tile(np.eye(3), (len(t), 1, 1))
    middle[:, 2, 2] = sign
    R = U @ middle @ Vt
    # information of Wahba's loss about the attitude, in {K}: tr(M) I - M with M = R B' symmetrised
    M = R @ np.swapaxes(profile, 1, 2)
    information = np.trace(M, axis1=1, axis2=2)[:, None, None] * np.eye(3) - 0.5 * (M + np.swapaxes(M, 1, 2))
    covariance = np.linalg.inv(information + np.eye(3)) + FILTER_SIGMA_RAD**2 * np.eye(3)
    return Alignment(t, Rotation.from_matrix(R), covariance)


def _spread(cells: FloatArray, keep: float) -> FloatArray:
    """Exponentially weighted sum over the neighbours on both sides."""
    forward, backward = cells.copy(), cells.copy()
    for i in range(1, len(cells)):
        forward[i] += keep * forward[i - 1]
        backward[-1 - i] += keep * backward[-i]
    return forward + backward - cells


def states_from_camera(t: FloatArray, R: FloatArray, frame_t: FloatArray, position: FloatArray) -> States:
    """Position and velocity at the nodes from the IMU's positions at visible frames.

    Parameters
    ----------
    t, R : (n,) node times and (n, 3, 3) orientations.
    frame_t, position : (k,) and (k, 3) m in {K}, increasing times.
    """
    p, v = _local_lines(frame_t, position)
    if len(frame_t) == 1:
        return States(R, np.tile(p[0], (len(t), 1)), np.zeros((len(t), 3)))
    curve = CubicHermiteSpline(frame_t, p, v)
    inside = np.clip(t, frame_t[0], frame_t[-1])
    out = t != inside
    velocity = curve(inside, 1)
    velocity[out] = 0.0
    return States(R, curve(inside), velocity)


def _local_lines(t: FloatArray, x: FloatArray, half_s: float = 0.12) -> tuple[FloatArray, FloatArray]:
    """Value and slope at each time of the least-squares line over +- half_s (prefix sums)."""
    lo, hi = np.searchsorted(t, [t - half_s, t + half_s + 1e-9])
    ones = np.ones_like(t)

    def window_sum(y: FloatArray) -> FloatArray:
        total = np.concatenate([np.zeros((1, *y.shape[1:])), np.cumsum(y, axis=0)])
        return total[hi] - total[lo]

    origin = t[len(t) // 2]
    u, mean = t - origin, x.mean(axis=0)
    n, su, suu = window_sum(ones), window_sum(u), window_sum(u * u)
    sx, sux = window_sum(x - mean), window_sum(u[:, None] * (x - mean))
    determinant = n * suu - su**2
    good = (n >= 3) & (determinant > 1e-9 * n)
    safe = np.where(good, determinant, 1.0)[:, None]
    slope = np.where(good[:, None], (n[:, None] * sux - su[:, None] * sx) / safe, 0.0)
    value = np.where(good[:, None], (sx + slope * (n * u - su)[:, None]) / n[:, None] + mean, x)
    return value, np.clip(slope, -6.0, 6.0)
