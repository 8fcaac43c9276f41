"""Published ways to match: by lengths alone, by accelerations (ShakeID), by a joint likelihood.

Lengths alone: |specific force| against |joint's acceleration - gravity|, and rates.

No frame has to be solved for, so it needs least data to be computed and shows least: whatever turns a
motion as a whole leaves the lengths as they are. The gyroscope's rate can only be larger than the limb's
turning rate, which does not see the rotation about the limb itself.

Two published ways that compare accelerations: ShakeID, and the distance on one axis.

ShakeID (Rofouei et al., CHI 2012) as Feng describes it (Glasgow thesis, 2014, 5.7 and 5.8): a Kalman filter
with position, velocity and acceleration as its state gives the joint's acceleration, which is compared on
three axes with the device's in windows of 1 s. The other is Feng's direct comparison (5.9): the distance on
one axis, accumulated from the start. The thesis gives no process noise for ShakeID; here it is that of its
own filter (section 3.3: q = 2000 in mm, 8 mm). A device's heading is not known: ShakeID's three axes are
compared at the heading that fits best in every window, and the one axis is the vertical.

Neither states a probability. The evidence here is the same as for our method: half the number of
independent values times the log of how much less is left than of a limb at rest.

Feng's matching: the joint likelihood of positions and accelerations under one Gaussian process.

Feng (Glasgow thesis, 2014), section 5.3, equations 5.1 to 5.5: positions have a Gaussian-process prior,
accelerations are a linear map of them, and the pair whose joint log-likelihood is largest is the match. As
in the thesis' experiments with a pocket and with walking, the vertical axis alone is compared: a device's
heading is not known. What is ours:
each excerpt's positions have their mean removed; the joint log-likelihood less those of either alone is
what is compared, so that limbs that move much and little compare; small shifts of the clocks are tried. The
likelihood is as published, with 100 mm/s^2 for what the accelerations may differ by: far more sure of
itself than a strap some centimetres from the joint allows.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg import cho_factor, cho_solve

from ..array_types import BoolArray, FloatArray
from ..errors import UnoccludeError
from ..measurements.position_process import Kernel, joint_covariance
from ..units import GRAVITY
from .excerpt_motion import GRID_HZ, SHORTEST_S, MatchExcerpt, independent_samples

#: What the camera's noise leaves of an acceleration and of a turning rate, m/s^2 and rad/s.
FORCE_SIGMA, RATE_SIGMA = 0.3, 0.15
#: What mounting and stamps spoil, as a part of the motion.
SPOILT = 0.2


def magnitudes(
    excerpts: list[MatchExcerpt], imu: int, down: FloatArray | None, shift_cost: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Evidence that an IMU is on each limb by lengths alone; parameters and returns as `rigid_evidence`.

    Without a direction of gravity only the rates are compared.
    """
    reach = excerpts[0].reach
    limbs = len(excerpts[0].limbs)
    evidence, best = np.zeros(limbs), np.zeros(limbs)
    for limb in range(limbs):
        force, rate = _Left(2 * reach + 1), _Left(2 * reach + 1)
        for excerpt in excerpts:
            arm, sensor = excerpt.limbs[limb], excerpt.imus[imu]
            turning = np.linalg.norm(np.gradient(arm.direction, 1 / GRID_HZ, axis=0), axis=1)
            seen = arm.has_direction.copy()
            seen[1:-1] &= arm.has_direction[2:] & arm.has_direction[:-2]
            rate.add(turning, 0.0, seen, sensor.rate, sensor.there, one_sided=True)
            if down is not None:
                size = np.linalg.norm(arm.acceleration - GRAVITY * down, axis=1)
                force.add(size, GRAVITY, arm.has_point, sensor.force, sensor.there)
        enough = np.maximum(force.count, rate.count) >= SHORTEST_S * GRID_HZ
        value = force.evidence(FORCE_SIGMA) + rate.evidence(RATE_SIGMA) - shift_cost
        if enough.any():
            k = int(np.argmax(np.where(enough, value, -np.inf)))
            evidence[limb], best[limb] = value[k], (k - reach) / GRID_HZ
    return evidence, best


class _Left:
    """Squares of what is left at every shift, with the limb and with a limb at rest."""

    def __init__(self, shifts: int) -> None:
        self.match, self.none, self.count = np.zeros(shifts), np.zeros(shifts), np.zeros(shifts)

    def add(
        self,
        camera: FloatArray,
        at_rest: float,
        seen: BoolArray,
        sensed: FloatArray,
        there: BoolArray,
        one_sided: bool = False,
    ) -> None:
        """Take an excerpt: camera (n,), sensor (n + shifts - 1,); one-sided = the sensor's may be larger."""
        both = sliding_window_view(there, len(camera)) & seen
        left = camera - sliding_window_view(sensed, len(camera))
        if one_sided:
            left = np.maximum(left, 0.0)
        self.match += (left**2 * both).sum(axis=1)
        self.none += ((camera - at_rest) ** 2 * both).sum(axis=1)
        self.count += both.sum(axis=1)

    def evidence(self, sigma: float) -> FloatArray:
        """Half the independent samples times the log of the ratio of mean squares, by shift."""
        number = np.maximum(self.count, 1.0)
        none, match = self.none / number, self.match / number
        ratio = ((1 + SPOILT**2) * none + sigma**2) / (match + SPOILT**2 * none + sigma**2)
        return np.asarray(0.5 * independent_samples(self.count) * np.log(ratio))


#: Of the Kalman filter: intensity of the acceleration's random walk, m^2/s^5, and the camera's sigma, m.
PROCESS_NOISE, POSITION_SIGMA = 2000e-3, 0.008
#: ShakeID compares windows of this length, s.
WINDOW_S = 1.0


def shakeid(
    excerpts: list[MatchExcerpt], imu: int, down: FloatArray | None, shift_cost: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Evidence by ShakeID (5.8); parameters and returns as `rigid_evidence`, `down` is needed."""
    return _compared(excerpts, imu, vertical(down, "shakeid"), shift_cost, axes=3)


def accumulated_distance(
    excerpts: list[MatchExcerpt], imu: int, down: FloatArray | None, shift_cost: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Evidence by the accumulated distance (5.9).

    Parameters and returns as `rigid_evidence`; `down` is needed.
    """
    return _compared(excerpts, imu, vertical(down, "acceleration-distance"), shift_cost, axes=1)


def _compared(
    excerpts: list[MatchExcerpt], imu: int, up: FloatArray, shift_cost: FloatArray, axes: int
) -> tuple[FloatArray, FloatArray]:
    reach = excerpts[0].reach
    shifts = published_shifts(reach)
    shape = (len(excerpts[0].limbs), len(shifts))
    left, rest, count = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    level = _axes_of(up)
    for excerpt in excerpts:
        sensor, n = excerpt.imus[imu], len(excerpt.t)
        for limb, arm in enumerate(excerpt.limbs):
            joint = kalman_acceleration(arm.measured @ level.T, arm.has_point)
            for k, shift in enumerate(shifts):
                rows = slice(shift, shift + n)
                both = arm.has_point & sensor.there[rows]
                device = sensor.acceleration[rows]
                window = (np.arange(n) / (WINDOW_S * GRID_HZ)).astype(int) if axes == 3 else None
                left[limb, k] += _distance(
                    joint[both], device[both], None if window is None else window[both]
                )
                rest[limb, k] += (device[both][:, 3 - axes :] ** 2).sum()
                count[limb, k] += both.sum()
    enough = count >= SHORTEST_S * GRID_HZ
    ratio = (rest + 1e-6) / (left + 1e-6)
    value = np.where(
        enough, 0.5 * axes * independent_samples(count) * np.log(ratio) - shift_cost[shifts], -np.inf
    )
    best = np.argmax(value, axis=1)
    evidence = value[np.arange(len(value)), best]
    return np.where(np.isfinite(evidence), evidence, 0.0), (shifts[best] - reach) / GRID_HZ


def _axes_of(up: FloatArray) -> FloatArray:
    """Level axes as rows (3, 3): two horizontal ones of no particular heading, then up."""
    first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first), up])


def _distance(joint: FloatArray, device: FloatArray, window: np.ndarray | None) -> float:
    """Sum of squared distances: vertical alone, or of three axes at each window's best heading."""
    total = float(((joint[:, 2] - device[:, 2]) ** 2).sum())
    if window is None or not len(window):
        return total
    a, b = joint[:, 0] + 1j * joint[:, 1], device[:, 0] + 1j * device[:, 1]
    turned = np.zeros(int(window.max()) + 1, complex)
    np.add.at(turned, window, a * np.conj(b))
    squares = float((np.abs(a) ** 2 + np.abs(b) ** 2).sum())
    return total + squares - 2 * float(np.abs(turned).sum())


def kalman_acceleration(position: FloatArray, seen: BoolArray) -> FloatArray:
    """Acceleration by a Kalman filter of position, velocity and acceleration (3.1 to 3.7, 5.7).

    Parameters
    ----------
    position : ndarray, shape (n, 3), m
        On the grid of `GRID_HZ`.
    seen : ndarray of bool, shape (n,)
        Where the camera measured it.

    Returns
    -------
    acceleration : ndarray, shape (n, 3), m/s^2
        0 before the first sample.
    """
    dt = 1.0 / GRID_HZ
    F = np.array([[1, dt, dt**2 / 2], [0, 1, dt], [0, 0, 1]])
    G = [dt**5 / 20, dt**4 / 8, dt**3 / 6, dt**3 / 3, dt**2 / 2, dt]
    Q = PROCESS_NOISE * np.array([[G[0], G[1], G[2]], [G[1], G[3], G[4]], [G[2], G[4], G[5]]])
    out = np.zeros_like(position)
    rows = np.flatnonzero(seen)
    if not len(rows):
        return out
    state = np.zeros((3, 3))
    state[0] = position[rows[0]]
    P = np.diag([POSITION_SIGMA**2, 1.0, 100.0])
    for k in range(rows[0], len(position)):
        state, P = F @ state, F @ P @ F.T + Q
        if seen[k]:
            gain = P[:, 0] / (P[0, 0] + POSITION_SIGMA**2)
            state = state + np.outer(gain, position[k] - state[0])
            P = P - np.outer(gain, P[0])
        out[k] = state[2]
    return out


#: Section 5.3.2: v0 = 4.69e3 mm^2, w = 7.85 1/s^2, 8 mm, 100 mm/s^2.
PUBLISHED_FOR_MATCHING = Kernel(4.69e3 * 1e-6, 7.85, 0.008, 0.100)
#: The published methods take clocks as common: shifts up to this are tried, s.
PUBLISHED_REACH_S = 0.2
#: The published method has no `none`: an IMU's best limb gets this evidence against it.
BEST_AGAINST_NONE = 10.0


def published_shifts(reach: int) -> np.ndarray:
    """Shifts that the published methods try, counted from -reach."""
    steps = min(reach, round(PUBLISHED_REACH_S * GRID_HZ))
    return np.arange(reach - steps, reach + steps + 1)


def vertical(down: FloatArray | None, method: str) -> FloatArray:
    """Up in {K}, unit vector (3,).

    Raises
    ------
    UnoccludeError
        Nothing is known of it.
    """
    if down is None:
        raise UnoccludeError(
            f"the method {method} compares vertical motion and needs the camera's axes; "
            "state the camera's frame in the recording, or use the method motion"
        )
    return np.asarray(-down / np.linalg.norm(down))


def joint_likelihood(
    excerpts: list[MatchExcerpt], imu: int, down: FloatArray | None, shift_cost: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Evidence that an IMU is on each limb by Feng's joint likelihood (5.3).

    Parameters and returns as `rigid_evidence`; `down` is needed.
    """
    up = vertical(down, "joint-likelihood")
    reach = excerpts[0].reach
    shifts = published_shifts(reach)
    value = np.zeros((len(excerpts[0].limbs), len(shifts)))
    count = np.zeros_like(value)
    for excerpt in excerpts:
        sensor, n = excerpt.imus[imu], len(excerpt.t)
        there = np.stack([sensor.there[shift : shift + n] for shift in shifts])
        rows: BoolArray = np.asarray(there.all(axis=0))
        acceleration = np.stack([sensor.acceleration[shift : shift + n, 2] for shift in shifts], axis=1)[rows]
        for limb, arm in enumerate(excerpt.limbs):
            seen = arm.has_point
            if seen.sum() < SHORTEST_S * GRID_HZ or rows.sum() < SHORTEST_S * GRID_HZ:
                continue
            height = arm.measured[seen] @ up
            value[limb] += _log_ratio(excerpt.t, seen, rows, height - height.mean(), acceleration)
            count[limb] += (seen & rows).sum()
    value = np.where(count >= SHORTEST_S * GRID_HZ, value - shift_cost[shifts], -np.inf)
    best = np.argmax(value, axis=1)
    evidence = value[np.arange(len(value)), best]
    if np.isfinite(evidence).any():
        evidence = evidence - evidence.max() + BEST_AGAINST_NONE
    return np.where(np.isfinite(evidence), evidence, 0.0), (shifts[best] - reach) / GRID_HZ


def _log_ratio(
    t: FloatArray, seen: BoolArray, there: BoolArray, height: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """(L,) log L(p, a) (5.3) - log L(p) - log L(a), for accelerations (n, L) at L shifts."""
    f = len(height)
    C = joint_covariance(PUBLISHED_FOR_MATCHING, t[seen], t[there])
    targets = np.vstack([np.tile(height[:, None], acceleration.shape[1]), acceleration])
    total = np.zeros(acceleration.shape[1])
    for rows, sign in ((slice(None), 1.0), (slice(0, f), -1.0), (slice(f, None), -1.0)):
        factor = cho_factor(C[rows, rows], lower=True, check_finite=False)
        M = targets[rows]
        quadratic = (M * cho_solve(factor, M, check_finite=False)).sum(axis=0)
        # the terms N log(2 pi) cancel: the parts have as many rows as the whole
        total += sign * -0.5 * (quadratic + 2.0 * np.log(np.diag(factor[0])).sum())
    return total
