"""Where a sensor lay still: found from the recording itself, whatever its noise is."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import binary_dilation, uniform_filter1d

from smoother.array_types import BoolArray, FloatArray
from smoother.linalg import runs, unit
from smoother.recording import ImuStream

#: Stillness is judged over so long, s, and a rest lasts so long at least.
LOOK_S = 0.5
SHORTEST_S = 0.8
#: Still is what varies less than so many times the quietest part of the recording ..
TIMES_QUIETEST = 3.0
QUIETEST_PERCENT = 2.0
#: .. or less than this in any case (m/s^2, rad/s), so that a sensor without noise has rests too ..
STILL_ACC, STILL_GYRO = 0.04, 0.015
#: .. and never more than this: so much is motion in any sensor.
MOVING_ACC, MOVING_GYRO = 1.0, 0.15
#: A slow turn: the means of a look's two halves differ by more than their noise and this.
CREEP_ACC, CREEP_GYRO = 0.03, 0.01
#: A rest that an impact interrupts goes on if the acceleration is the same after it, m/s^2.
KNOCKED_ACC = 0.2
#: A rest that goes on in the same direction is the same pose, rad.
SAME_POSE_RAD = np.radians(8.0)


@dataclass(frozen=True)
class Rests:
    """Times in which a sensor lay still.

    Attributes
    ----------
    ranges : ndarray, shape (n, 2)
        First sample of each, and the one after the last.
    acc, gyro : ndarray, shape (n, 3)
        Means, m/s^2 and rad/s.
    acc_sigma, gyro_sigma : ndarray, shape (3,)
        Standard deviation of a sample at rest.
    pose : ndarray, shape (n,)
        Number of the pose; rests in the same direction share one.
    """

    ranges: np.ndarray
    acc: FloatArray
    gyro: FloatArray
    acc_sigma: FloatArray
    gyro_sigma: FloatArray
    pose: np.ndarray

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def poses(self) -> int:
        """How many different directions gravity was seen from."""
        return len(np.unique(self.pose))

    @property
    def samples(self) -> int:
        """Still samples in all."""
        return int(np.sum(self.ranges[:, 1] - self.ranges[:, 0])) if len(self) else 0

    def longest(self) -> slice:
        """Samples of the longest rest."""
        k = int(np.argmax(self.ranges[:, 1] - self.ranges[:, 0]))
        return slice(int(self.ranges[k, 0]), int(self.ranges[k, 1]))


def find_rests(imu: ImuStream) -> Rests:
    """All rests of a stream.

    A sample is at rest when accelerometer and gyroscope vary little around it, measured against the
    quietest part of the same recording, and their means do not creep. A rest is cut at pauses of the
    stream, and its ends, where the hand lets go, are left out.
    """
    rate = imu.rate_hz
    width = max(round(LOOK_S * rate), 5) | 1
    if len(imu) < 2 * width:
        return _none()
    still = _still(imu.acc, width, STILL_ACC, MOVING_ACC, CREEP_ACC)
    still &= _still(imu.gyro, width, STILL_GYRO, MOVING_GYRO, CREEP_GYRO)
    # less than half a look, so that two rests with nothing but a jump between them stay two
    let_go = max(width // 6, 1)
    still = binary_dilation(still, iterations=width // 2 - let_go)
    edges = np.array([(rows.start, rows.stop) for rows in runs(still)], dtype=int).reshape(-1, 2)
    edges = _joined(edges, imu.acc, width // 2)
    gaps = np.flatnonzero(np.diff(imu.t_s) > max(5.0 / rate, 0.1)) + 1
    ranges = [
        (a, b)
        for first, last in edges.reshape(-1, 2).tolist()
        for a, b in _between(first, last, gaps)
        if imu.t_s[b - 1] - imu.t_s[a] >= SHORTEST_S
    ]
    if not ranges:
        return _none()
    acc = np.array([imu.acc[a:b].mean(axis=0) for a, b in ranges])
    gyro = np.array([imu.gyro[a:b].mean(axis=0) for a, b in ranges])
    length = np.array([b - a for a, b in ranges], float)
    return Rests(
        ranges=np.array(ranges),
        acc=acc,
        gyro=gyro,
        acc_sigma=_pooled([imu.acc[a:b].var(axis=0) for a, b in ranges], length),
        gyro_sigma=_pooled([imu.gyro[a:b].var(axis=0) for a, b in ranges], length),
        pose=_poses(acc),
    )


def _still(values: FloatArray, width: int, floor: float, moving: float, creep: float) -> BoolArray:
    """Samples (N,) about which a signal (N, 3) varies as little as anywhere in the recording."""
    centred = values - values.mean(axis=0)
    mean = uniform_filter1d(centred, width, axis=0, mode="nearest")
    square = uniform_filter1d(centred**2, width, axis=0, mode="nearest")
    deviation = np.sqrt(np.maximum(square - mean**2, 0.0).sum(axis=1) / 3.0)
    quietest = float(np.percentile(deviation, QUIETEST_PERCENT))
    limit = min(max(TIMES_QUIETEST * quietest, floor), moving)
    # the second half of the look against the first
    half, quarter = width // 2, width // 4
    part = uniform_filter1d(centred, half, axis=0, mode="nearest")
    ahead, behind = np.roll(part, -quarter, axis=0), np.roll(part, quarter, axis=0)
    ahead[-quarter:], behind[:quarter] = part[-1], part[0]
    drift = np.linalg.norm(ahead - behind, axis=1)
    noise = min(quietest, moving) * np.sqrt(6.0 / half)
    return np.asarray((deviation <= limit) & (drift <= creep + 3.0 * noise))


def _joined(ranges: np.ndarray, acc: FloatArray, half: int) -> np.ndarray:
    """Ranges (n, 2), neighbours as one where an impact parts them and the pose is the same after it."""
    if len(ranges) < 2:
        return ranges
    apart = []
    for last, first in zip(ranges[:-1, 1].tolist(), ranges[1:, 0].tolist(), strict=True):
        before, after = (np.median(acc[a:b], axis=0) for a, b in ((last - half, last), (first, first + half)))
        apart.append(first - last > half or float(np.linalg.norm(after - before)) > KNOCKED_ACC)
    return np.column_stack([ranges[np.r_[True, apart], 0], ranges[np.r_[apart, True], 1]])


def _between(first: int, last: int, cuts: np.ndarray) -> list[tuple[int, int]]:
    inside = cuts[(cuts > first) & (cuts < last)]
    edges = [first, *inside.tolist(), last]
    return list(pairwise(edges))


def _pooled(variances: list[FloatArray], length: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.average(np.array(variances), axis=0, weights=length)))


def _poses(acc: FloatArray) -> np.ndarray:
    """Number the directions (n, 3): one within `SAME_POSE_RAD` of an earlier one has its number."""
    up = unit(acc)
    first: list[int] = []
    pose = np.zeros(len(acc), int)
    for k, direction in enumerate(up):
        angle = np.arccos(np.clip(up[first] @ direction, -1.0, 1.0)) if first else np.empty(0)
        if len(angle) and angle.min() < SAME_POSE_RAD:
            pose[k] = int(np.argmin(angle))
        else:
            pose[k] = len(first)
            first.append(k)
    return pose


def _none() -> Rests:
    nothing = np.zeros((0, 3))
    return Rests(np.zeros((0, 2), int), nothing, nothing, np.zeros(3), np.zeros(3), np.zeros(0, int))
