"""Accelerometer: where a sensor lay still, and offset, scale and cross-axis from those rest poses."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import binary_dilation, uniform_filter1d
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from smoother.array_types import BoolArray, FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import runs, unit
from smoother.recording import ImuStream

#: Directions that the sphere is looked at; neighbours are some 4 degrees apart.
_GRID = 2000
#: Cells that a sphere's coverage is counted in; each is some 20 degrees across.
_CELLS = 100


@dataclass(frozen=True)
class Coverage:
    """What was covered of the sphere."""

    hole_rad: float  # Radius of the largest cap without a direction in it
    towards: FloatArray  # (3,): unit vector, the middle of that cap
    share: float  # Part of the sphere's 100 cells that contain a direction, 0 to 1


def cover(direction: FloatArray) -> Coverage:
    """Coverage by unit vectors (N, 3)."""
    grid = sphere_points(_GRID)
    apart, _ = cKDTree(direction).query(grid)
    worst = int(np.argmax(apart))
    _, cell = cKDTree(sphere_points(_CELLS)).query(direction)
    return Coverage(
        hole_rad=2.0 * float(np.arcsin(min(apart[worst] / 2.0, 1.0))),
        towards=grid[worst],
        share=len(np.unique(cell)) / _CELLS,
    )


def sphere_points(count: int) -> FloatArray:
    """Unit vectors (count, 3) spread evenly over the sphere (Fibonacci's lattice)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def axis_words(direction: FloatArray) -> str:
    """A direction in the sensor's axes in words: "+z", or "between +x and -z"."""
    order = np.argsort(-np.abs(direction))
    parts = [f"{'+' if direction[i] > 0 else '-'}{'xyz'[i]}" for i in order]
    if abs(direction[order[0]]) > np.cos(np.radians(25.0)):
        return parts[0]
    if abs(direction[order[2]]) < np.sin(np.radians(20.0)):
        return f"between {parts[0]} and {parts[1]}"
    return f"between {parts[0]}, {parts[1]} and {parts[2]}"


#: Stillness is judged over this time, s, and a rest lasts at least this long, s.
LOOK_S = 0.5
SHORTEST_S = 0.8
#: Still is what varies less than this many times the quietest part of the recording ..
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
    """Times in which a sensor lay still."""

    ranges: np.ndarray  # (n, 2): first sample of each, and the one after the last
    acc: FloatArray  # (n, 3): means, m/s^2 and rad/s
    gyro: FloatArray  # (n, 3): means, m/s^2 and rad/s
    acc_sigma: FloatArray  # (3,): standard deviation of a sample at rest
    gyro_sigma: FloatArray  # (3,): standard deviation of a sample at rest
    pose: np.ndarray  # (n,): number of the pose; rests in the same direction share one

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
    """All rests of a stream."""
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


#: Unknowns, and this many different poses at least.
FEWEST_POSES = 9
#: What a pose's mean is worth at best, m/s^2: a table that gives, a breath of air.
POSE_SIGMA = 0.002
#: What is less certain than this in some direction is refused, or deserves a word, m/s^2.
REFUSED_SIGMA = 0.15
DOUBTED_SIGMA = 0.02
#: Poses that miss gravity by more than this are worth a word, m/s^2.
LARGE_RESIDUAL = 0.03
#: Directions in which the certainty is looked at.
_DIRECTIONS = 400


@dataclass(frozen=True)
class AccelerometerCalibration:
    """corrected = matrix @ (raw - offset), m/s^2."""

    offset: FloatArray  # (3,) m/s^2
    matrix: FloatArray  # (3, 3): symmetric
    covariance: FloatArray  # (9, 9): of offset and the matrix' upper triangle (xx, xy, xz, yy, yz, zz)
    poses: int  # Different directions that gravity was seen from
    residual: FloatArray  # (n,) m/s^2: corrected length less gravity, a rest each
    sigma: float  # m/s^2: root mean square over all directions of the corrected length's standard deviation
    worst_sigma: float  # m/s^2: its largest
    worst_direction: FloatArray  # (3,): Where that is
    remarks: tuple[str, ...] = ()  # What is worth a word, one sentence each

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, m/s^2."""
        return float(np.sqrt(np.mean(self.residual**2)))

    def apply(self, raw: FloatArray) -> FloatArray:
        """Corrected samples (N, 3) of raw ones (N, 3), m/s^2."""
        return (raw - self.offset) @ self.matrix.T


def calibrate_accelerometer(rests: Rests, gravity: float) -> AccelerometerCalibration:
    """Fit offset and matrix to the rests' means."""
    if rests.poses < FEWEST_POSES:
        raise CalibrationError(
            f"{_poses_words(rests)}; at least {FEWEST_POSES} poses are needed, better twelve: lay the sensor"
            " still for three seconds on each of its six sides and on six edges between them."
        )
    answer = least_squares(
        _misfit,
        np.concatenate([np.zeros(3), _IDENTITY]),
        args=(rests.acc, gravity),
        jac=_jacobian,
        x_scale="jac",
    )
    offset, matrix = answer.x[:3], symmetric(answer.x[3:])
    if not np.linalg.eigvalsh(matrix).min() > 0:
        raise CalibrationError(
            "the rest poses do not fit an accelerometer; lay the sensor on its six sides and on six"
            " edges between them."
        )
    residual = np.linalg.norm((rests.acc - offset) @ matrix, axis=1) - gravity
    freedom = max(len(rests) - 9, 1)
    length = (rests.ranges[:, 1] - rests.ranges[:, 0]).astype(float)
    sampling = float(np.sqrt(np.mean(rests.acc_sigma**2) * np.mean(1.0 / length)))
    pose_sigma = max(float(np.sqrt(np.sum(residual**2) / freedom)), float(np.hypot(sampling, POSE_SIGMA)))
    # |S(V-O)|^2 - g^2 over 2g is the length's own error
    design = _jacobian(answer.x, rests.acc, gravity) / (2.0 * gravity)
    covariance = np.asarray(np.linalg.pinv(design.T @ design, rcond=1e-14) * pose_sigma**2, float)
    directions = sphere_points(_DIRECTIONS)
    raw = gravity * np.linalg.solve(matrix, directions.T).T + offset
    rows = _jacobian(answer.x, raw, gravity) / (2.0 * gravity)
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", rows, covariance, rows))
    if np.linalg.matrix_rank(design / np.linalg.norm(design, axis=0), tol=1e-4) < 9:
        sigma = np.full(len(directions), np.inf)
        weak = np.linalg.svd(unit(rests.acc))[2][2]
    else:
        weak = directions[int(np.argmax(sigma))]
    worst = float(sigma.max())
    if worst > REFUSED_SIGMA:
        raise CalibrationError(
            f"the {rests.poses} rest poses leave the sensor's {axis_words(weak)} undetermined; add rests"
            " in which it points up, and others in which it points down, until all six sides and some"
            " edges have been up."
        )
    return AccelerometerCalibration(
        offset=offset,
        matrix=matrix,
        covariance=covariance,
        poses=rests.poses,
        residual=residual,
        sigma=float(np.sqrt(np.mean(sigma**2))),
        worst_sigma=worst,
        worst_direction=weak,
        remarks=tuple(_remarks(worst, weak, residual)),
    )


_ROWS, _COLUMNS = np.triu_indices(3)
_IDENTITY = np.eye(3)[_ROWS, _COLUMNS]


def symmetric(upper: FloatArray) -> FloatArray:
    """The symmetric matrix (3, 3) of an upper triangle (6,): xx, xy, xz, yy, yz, zz."""
    matrix = np.zeros((3, 3))
    matrix[_ROWS, _COLUMNS] = matrix[_COLUMNS, _ROWS] = upper
    return matrix


def _misfit(p: FloatArray, raw: FloatArray, gravity: float) -> FloatArray:
    """|S (V - O)|^2 - g^2 (n,)."""
    corrected = (raw - p[:3]) @ symmetric(p[3:])
    return np.asarray(np.sum(corrected**2, axis=1) - gravity**2)


def _jacobian(p: FloatArray, raw: FloatArray, gravity: float) -> FloatArray:
    """Its derivatives (n, 9)."""
    S, v = symmetric(p[3:]), raw - p[:3]
    corrected = v @ S
    by_matrix = corrected[:, _ROWS] * v[:, _COLUMNS]
    by_matrix += np.where(_ROWS == _COLUMNS, 0.0, corrected[:, _COLUMNS] * v[:, _ROWS])
    return np.asarray(2.0 * np.hstack([-corrected @ S, by_matrix]))


def _poses_words(rests: Rests) -> str:
    if not len(rests):
        return "the sensor was never still"
    same = f" in {len(rests)} rests" if len(rests) > rests.poses else ""
    return f"the recording contains {rests.poses} different rest pose{'s' * (rests.poses != 1)}{same}"


def _remarks(worst: float, weak: FloatArray, residual: FloatArray) -> list[str]:
    said = []
    if worst > DOUBTED_SIGMA:
        said.append(
            f"with the sensor's {axis_words(weak)} up the result is known to {worst:.3f} m/s^2 only; "
            "add rests in that direction and in the opposite one"
        )
    if np.abs(residual).max() > LARGE_RESIDUAL:
        k = int(np.argmax(np.abs(residual)))
        said.append(
            f"rest {k + 1} is off gravity by {abs(residual[k]):.3f} m/s^2: it was not quite still, or"
            " the sensor is not linear; lay it on something firm"
        )
    return said
