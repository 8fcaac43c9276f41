"""Magnetometer: hard and soft iron from samples of a sensor that was turned about all its axes.

The samples lie on an ellipsoid (Jatesiktat and Ang, section II-E.1, eq 3; Petrov 2009): its nine
coefficients by linear least squares, then the same nine parameters by geometric least squares,
so that noise does not shrink the ellipsoid. The symmetric matrix takes it to the unit sphere; a
rotation of the sensor's axes cannot be seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import robust_sigma, unit

from .accelerometer import Coverage, axis_words, cover

#: Fewer samples than this are not taken for a calibration.
FEWEST_SAMPLES = 200
#: Samples beyond this many add nothing; evenly spread ones are taken.
MOST_SAMPLES = 20_000
#: A hole in the coverage that refuses, and one that is worth a word.
LARGEST_HOLE_RAD = np.radians(60.0)
LARGE_HOLE_RAD = np.radians(35.0)
#: Spread across the flattest direction, as a part of the widest: below it all samples lie in a plane.
FLATTEST = 0.2
#: Longest to shortest radius: beyond it the ellipsoid was made of noise, or of a magnet.
LONGEST_RATIO = 3.0
#: Residuals (of a radius of 1) that refuse, and that are worth a word.
LARGEST_RESIDUAL = 0.15
LARGE_RESIDUAL = 0.04
#: Residuals farther off than this many scaled median deviations pull no more than one there.
_FAR = 3.0
#: Samples this many scaled median deviations off are strays, and so large a share of them is worth a word.
_STRAY = 6.0
STRAY_SHARE = 0.005


@dataclass(frozen=True)
class MagnetometerCalibration:
    """corrected = matrix @ (raw - offset), of length 1 where the field is the local one."""

    offset: FloatArray  # (3,): hard iron, in the sensor's unit
    matrix: FloatArray  # (3, 3): symmetric, one over the sensor's unit
    residual: float  # Root mean square departure of the corrected length from 1
    radii: FloatArray  # (3,): the ellipsoid's radii, in the sensor's unit, ascending
    samples: int  # How many were used
    coverage: Coverage  # Of the sphere by the corrected samples
    remarks: tuple[str, ...] = ()  # What is worth a word, one sentence each

    def apply(self, raw: FloatArray) -> FloatArray:
        """Corrected samples (N, 3) of raw ones (N, 3)."""
        return (raw - self.offset) @ self.matrix.T


def calibrate_magnetometer(raw: FloatArray) -> MagnetometerCalibration:
    """Fit the ellipsoid to raw samples (N, 3), in any unit."""
    samples = raw[np.isfinite(raw).all(axis=1)]
    if len(samples) < FEWEST_SAMPLES:
        raise CalibrationError(
            f"there are {len(samples)} magnetometer samples and {FEWEST_SAMPLES} are needed at least; turn "
            "the sensor slowly about all its axes for a minute."
        )
    samples = samples[:: -(-len(samples) // MOST_SAMPLES)]
    _check_solid(samples)
    # about the middle and in units of the spread, so that the equations are well scaled
    middle, scale = samples.mean(axis=0), float(np.sqrt(np.mean(np.var(samples, axis=0)) * 3.0))
    even = (samples - middle) / scale
    first = fit_ellipsoid(even)
    rough = np.linalg.norm((even - first[0]) @ first[1], axis=1) - 1.0
    _check_residual(0.5 * float(np.sqrt(np.mean(rough**2))))  # a magnet that passed may have pulled it
    offset, matrix = refine(even, *first)
    radii = np.sort(scale / np.linalg.eigvalsh(matrix))
    found = MagnetometerCalibration(
        offset=middle + scale * offset,
        matrix=matrix / scale,
        residual=0.0,
        radii=radii,
        samples=len(samples),
        coverage=Coverage(np.pi, np.zeros(3), 0.0),
    )
    corrected = found.apply(samples)
    length = np.linalg.norm(corrected, axis=1)
    residual = float(np.sqrt(np.mean((length - 1.0) ** 2)))
    coverage = cover(corrected / length[:, None])
    _check(radii, residual, coverage)
    return MagnetometerCalibration(
        found.offset,
        found.matrix,
        residual,
        radii,
        len(samples),
        coverage,
        tuple(_remarks(length - 1.0, residual, coverage)),
    )


def fit_ellipsoid(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre (3,) and symmetric matrix (3, 3) that takes the ellipsoid to the unit sphere.

    Linear least squares on the nine coefficients of
    a x^2 + b y^2 + c z^2 + 2 d yz + 2 e xz + 2 f xy + 2 g x + 2 h y + 2 i z = 1 (Petrov 2009).
    """
    x, y, z = points.T
    design = np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y, 2 * x, 2 * y, 2 * z], axis=1)
    a, b, c, d, e, f, g, h, i = np.linalg.lstsq(design, np.ones(len(points)), rcond=None)[0]
    quadric = np.array([[a, f, e], [f, b, d], [e, d, c]])
    linear = np.array([g, h, i])
    values, axes = np.linalg.eigh(quadric)
    if not values.min() > 1e-6 * abs(values.max()):
        raise CalibrationError(
            "the magnetometer's samples do not lie on an ellipsoid; turn the sensor slowly about all its"
            " axes, away from iron and electronics."
        )
    centre = -np.linalg.solve(quadric, linear)
    level = 1.0 + centre @ quadric @ centre
    return centre, (axes * np.sqrt(values / level)) @ axes.T


def refine(points: FloatArray, centre: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same by least squares on the distance to the unit sphere; far samples (a magnet) pull less."""
    rows, columns = np.triu_indices(3)

    def unpack(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        S = np.zeros((3, 3))
        S[rows, columns] = S[columns, rows] = p[3:]
        return p[:3], S

    def residual(p: FloatArray) -> FloatArray:
        o, S = unpack(p)
        return np.asarray(np.linalg.norm((points - o) @ S, axis=1) - 1.0)

    def jacobian(p: FloatArray) -> FloatArray:
        o, S = unpack(p)
        v = points - o
        mapped = v @ S
        away = unit(mapped)
        by_matrix = away[:, rows] * v[:, columns] + np.where(
            rows == columns, 0.0, away[:, columns] * v[:, rows]
        )
        return np.hstack([-away @ S, by_matrix])

    start = np.concatenate([centre, matrix[rows, columns]])
    spread = float(robust_sigma(residual(start)))
    answer = least_squares(
        residual,
        start,
        jacobian,
        loss="soft_l1",
        f_scale=max(_FAR * spread, 1e-6),
        x_scale="jac",
        max_nfev=40,
    )
    return unpack(answer.x)


def _check_solid(samples: FloatArray) -> None:
    spread = np.linalg.svd(samples - samples.mean(axis=0), compute_uv=True, full_matrices=False)
    if not spread[1][0] > 0.0:
        raise CalibrationError("the magnetometer always reads the same; check that it is switched on.")
    if spread[1][2] < FLATTEST * spread[1][0]:
        about = axis_words(spread[2][2]).replace("+", "").replace("-", "")
        raise CalibrationError(
            "the magnetometer's samples lie in a plane: the sensor was turned about one axis only (its"
            f" {about} axis); turn it about the other two as well, until every side has pointed in every"
            " direction."
        )


def _check(radii: FloatArray, residual: float, coverage: Coverage) -> None:
    if coverage.hole_rad > LARGEST_HOLE_RAD:
        raise CalibrationError(
            f"the magnetometer's samples leave {np.degrees(coverage.hole_rad):.0f} degrees of the sphere"
            f" open around the sensor's {axis_words(coverage.towards)}; continue turning until the field"
            " has come from there as well."
        )
    if radii[2] > LONGEST_RATIO * radii[0]:
        raise CalibrationError(
            f"the magnetometer's ellipsoid is {radii[2] / radii[0]:.1f} times as long as it is wide, which"
            " soft iron does not do; turn the sensor about all its axes, away from magnets."
        )
    _check_residual(residual)


def _check_residual(residual: float) -> None:
    if residual > LARGEST_RESIDUAL:
        raise CalibrationError(
            f"the magnetometer's samples lie {100 * residual:.0f} % off their ellipsoid (root mean square):"
            " the field changed while it was recorded; record again on one spot, away from iron and"
            " electronics."
        )


def _remarks(off: FloatArray, residual: float, coverage: Coverage) -> list[str]:
    said = []
    spread = float(robust_sigma(off))
    stray = float(np.mean(np.abs(off) > max(_STRAY * spread, LARGE_RESIDUAL)))
    if stray > STRAY_SHARE:
        said.append(
            f"{100 * stray:.1f} % of the samples lie far off the rest and hardly counted: a magnetic"
            " object came near for a while"
        )
    if coverage.hole_rad > LARGE_HOLE_RAD:
        said.append(
            f"{np.degrees(coverage.hole_rad):.0f} degrees of the sphere around the sensor's "
            f"{axis_words(coverage.towards)} were not covered; the next recording should fill them"
        )
    if residual > LARGE_RESIDUAL:
        said.append(
            f"the samples lie {100 * residual:.1f} % off the ellipsoid (root mean square): the field was"
            " not homogeneous; record on one spot, half a metre from iron and electronics"
        )
    return said
