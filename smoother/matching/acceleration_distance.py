"""Two published ways that compare accelerations: ShakeID, and the distance on one axis.

ShakeID (Rofouei et al., CHI 2012) as Feng describes it (Glasgow thesis, 2014, 5.7 and 5.8): a Kalman filter
with position, velocity and acceleration as its state gives the joint's acceleration, which is compared on
three axes with the device's in windows of 1 s. The other is Feng's direct comparison (5.9): the distance on
one axis, accumulated from the start. The thesis gives no process noise for ShakeID; here it is that of its
own filter (section 3.3: q = 2000 in mm, 8 mm). A device's heading is not known: ShakeID's three axes are
compared at the heading that fits best in every window, and the one axis is the vertical.

Neither states a probability. The evidence here is the same as for our method: half the number of
independent values times the log of how much less is left than of a limb at rest.
"""

from __future__ import annotations

import numpy as np

from ..array_types import BoolArray, FloatArray
from .excerpt_motion import GRID_HZ, SHORTEST_S, MatchExcerpt, independent_samples
from .joint_likelihood import published_shifts, vertical

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
