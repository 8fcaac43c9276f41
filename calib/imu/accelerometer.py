"""Accelerometer: offset, scale and cross-axis from rest poses.

At rest the length of the specific force is gravity's, whatever the pose: offset O and symmetric
matrix S minimise mean((|S (V - O)|^2 - g^2)^2) over the poses' means V (Le et al., eq 1-3, after
Frosio et al. 2009). A rotation of the sensor's axes changes no length and cannot be seen, hence the
symmetric matrix: nine unknowns, nine poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import unit

from .rests import Rests
from .sphere_coverage import axis_words, sphere_points

#: Unknowns, and so many different poses at least.
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
    """corrected = matrix @ (raw - offset), m/s^2.

    Attributes
    ----------
    offset : ndarray, shape (3,), m/s^2
    matrix : ndarray, shape (3, 3)
        Symmetric.
    covariance : ndarray, shape (9, 9)
        Of offset and the matrix' upper triangle (xx, xy, xz, yy, yz, zz).
    poses : int
        Different directions that gravity was seen from.
    residual : ndarray, shape (n,), m/s^2
        Corrected length less gravity, a rest each.
    sigma : float, m/s^2
        Root mean square over all directions of the corrected length's standard deviation.
    worst_sigma : float, m/s^2
        Its largest.
    worst_direction : ndarray, shape (3,)
        Where that is.
    remarks : tuple of str
        What is worth a word, one sentence each.
    """

    offset: FloatArray
    matrix: FloatArray
    covariance: FloatArray
    poses: int
    residual: FloatArray
    sigma: float
    worst_sigma: float
    worst_direction: FloatArray
    remarks: tuple[str, ...] = ()

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, m/s^2."""
        return float(np.sqrt(np.mean(self.residual**2)))

    def apply(self, raw: FloatArray) -> FloatArray:
        """Corrected samples (N, 3) of raw ones (N, 3), m/s^2."""
        return (raw - self.offset) @ self.matrix.T

    def sigma_towards(self, up: FloatArray, gravity: float) -> FloatArray:
        """Standard deviation of the corrected length with these directions (N, 3) up, m/s^2 (N,)."""
        raw = gravity * np.linalg.solve(self.matrix, up.T).T + self.offset
        p = np.concatenate([self.offset, self.matrix[_ROWS, _COLUMNS]])
        rows = _jacobian(p, raw, gravity) / (2.0 * gravity)
        return np.asarray(np.sqrt(np.einsum("ni,ij,nj->n", rows, self.covariance, rows)))


def calibrate_accelerometer(rests: Rests, gravity: float) -> AccelerometerCalibration:
    """Fit offset and matrix to the rests' means.

    Parameters
    ----------
    gravity : float, m/s^2

    Returns
    -------
    AccelerometerCalibration

    Raises
    ------
    CalibrationError
        There are fewer than nine different poses, or they leave a direction open; the text says
        which pose to add.
    """
    if rests.poses < FEWEST_POSES:
        raise CalibrationError(
            f"{_poses_words(rests)}, and offset, scale and cross-axis are nine unknowns: {FEWEST_POSES} poses"
            " at least, twelve for comfort; lay the sensor still for three seconds on each of its six sides"
            " and on six edges between them."
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
            "the rest poses fit no accelerometer; lay the sensor on its six sides and on six edges between"
            " them."
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
            f"the {rests.poses} rest poses leave the sensor's {axis_words(weak)} open; add rests in which it "
            f"points up, and others in which it points down, until all six sides and some edges have been up."
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
        return "the sensor never lay still"
    same = f" in {len(rests)} rests" if len(rests) > rests.poses else ""
    return f"the recording holds {rests.poses} different rest pose{'s' * (rests.poses != 1)}{same}"


def _remarks(worst: float, weak: FloatArray, residual: FloatArray) -> list[str]:
    said = []
    if worst > DOUBTED_SIGMA:
        said.append(
            f"with the sensor's {axis_words(weak)} up the answer is known to {worst:.3f} m/s^2 only; "
            "add rests in that direction and in the opposite one"
        )
    if np.abs(residual).max() > LARGE_RESIDUAL:
        k = int(np.argmax(np.abs(residual)))
        said.append(
            f"rest {k + 1} misses gravity by {abs(residual[k]):.3f} m/s^2: it was not quite still, or"
            " the sensor is not linear; lay it on something firm"
        )
    return said
