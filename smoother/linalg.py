"""Small operations on arrays and stacks of them: one place for each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from .array_types import BoolArray, FloatArray, IntArray

#: Of a root: a double one is halved in distance by each, others are met after a few.
NEWTON_STEPS = 40


def interpolate(t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """Linear interpolation of values (n, ...) at times t (n,) to times (k,), held beyond the ends."""
    if len(t) == 1:
        return np.repeat(values, len(at), axis=0)
    right = np.clip(np.searchsorted(t, at), 1, len(t) - 1)
    u = np.clip((at - t[right - 1]) / (t[right] - t[right - 1]), 0.0, 1.0)
    u = u.reshape(-1, *([1] * (values.ndim - 1)))
    return (1.0 - u) * values[right - 1] + u * values[right]


Columns = TypeVar("Columns")


def rows_of(value: Columns, rows: Any, *names: str) -> Columns:
    """A dataclass with some rows of these columns, each an array, arrays by name, or None."""

    def part(column: Any) -> Any:
        if isinstance(column, Mapping):
            return {name: part(each) for name, each in column.items()}
        return None if column is None else column[rows]

    return replace(value, **{name: part(getattr(value, name)) for name in names})  # type: ignore[type-var]


def by_columns(
    function: Callable[[FloatArray], FloatArray],
    arrays: dict[str, FloatArray],  # arrays dict of (n, k)
) -> dict[str, FloatArray]:  # dict of (m, k)
    """A function that treats each column alone, applied to those arrays together that are finite alike."""
    alike: dict[bytes, list[str]] = {}
    for name, array in arrays.items():
        alike.setdefault(np.isfinite(array).all(axis=1).tobytes(), []).append(name)
    results = dict.fromkeys(arrays, np.empty(0))
    for names in alike.values():
        ends = np.cumsum([arrays[name].shape[1] for name in names])
        together = function(np.concatenate([arrays[name] for name in names], axis=1))
        for name, columns in zip(names, np.split(together, ends[:-1], axis=1), strict=True):
            results[name] = np.ascontiguousarray(columns)
    return results


def median_rate_hz(t_s: FloatArray) -> float:
    """Median rate of increasing times (n,), Hz; nan for fewer than two."""
    return float(1.0 / np.median(np.diff(t_s))) if len(t_s) > 1 else float("nan")


def rotate_covariance(R: FloatArray, covariance: FloatArray) -> FloatArray:
    """R C R' for stacks (..., 3, 3)."""
    return R @ covariance @ np.swapaxes(R, -1, -2)


def rotation_sigma_deg(covariance: FloatArray) -> FloatArray:
    """Square root of the trace of rotation vectors' covariances (n, 3, 3), rad^2: (n,), degrees."""
    return np.degrees(np.sqrt(np.trace(covariance, axis1=1, axis2=2)))


def skew(v: FloatArray) -> FloatArray:
    """The matrix of the cross product, [v]x, for stacks (..., 3)."""
    matrix = np.zeros((*v.shape[:-1], 3, 3))
    matrix[..., 0, 1], matrix[..., 0, 2], matrix[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return matrix - np.swapaxes(matrix, -1, -2)


def skew_of(v: FloatArray) -> FloatArray:
    """`skew` of one vector (3,), in a quarter of the time."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def length(v: FloatArray) -> float:
    """Of one vector (n,): `numpy.linalg.norm` takes five times as long."""
    return math.sqrt(float(v @ v))


def middle(values: FloatArray) -> float:
    """Median of values (n,) without nan: `numpy.median` of some hundred takes ten times as long."""
    order = np.sort(values)
    half = len(order) // 2
    return float(order[half] if len(order) % 2 else 0.5 * (order[half - 1] + order[half]))


def inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of symmetric matrices (..., n, n), kept symmetric."""
    answer = np.linalg.inv(matrix)
    return np.asarray(0.5 * (answer + np.swapaxes(answer, -1, -2)), dtype=np.float64)


def scaled_inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a positive definite matrix (n, n), scaled to unit diagonal first."""
    if not len(matrix):
        return matrix
    diagonal = np.diag(matrix)
    if not (diagonal > 0).all():
        raise np.linalg.LinAlgError("a quantity is left free")
    scale = 1.0 / np.sqrt(diagonal)
    scaled = matrix * scale[:, None] * scale
    np.linalg.cholesky(scaled)  # raises where it is not positive definite
    return inverse(scaled) * scale[:, None] * scale


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors (..., k) of length one; nan where the length is zero."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def runs(mask: BoolArray) -> list[slice]:
    """Runs of True in a mask (n,), in order."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).tolist()
    return [slice(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def nearest(t: FloatArray, at: FloatArray) -> IntArray:
    """Rows (k,) of the increasing times (n,) nearest to each time (k,)."""
    after = np.clip(np.searchsorted(t, at), 1, max(len(t) - 1, 1))
    before, after = after - 1, np.minimum(after, len(t) - 1)
    return np.asarray(np.where(at - t[before] < t[after] - at, before, after))


def upright(up: FloatArray) -> FloatArray:
    """A rotation (3, 3) whose third column is up (3,)."""
    third = unit(up)
    side = unit(np.cross(third, np.eye(3)[int(np.abs(third).argmin())]))
    return np.stack([side, np.cross(third, side), third], axis=1)


def robust_sigma(residual: FloatArray, axis: int | None = None) -> FloatArray:
    """Standard deviation about zero that outliers hardly move: 1.4826 times the median size."""
    return np.asarray(1.4826 * np.median(np.abs(residual), axis=axis))


def nearest_rotation(matrix: FloatArray) -> FloatArray:  # matrix (..., 3, 3) -> (..., 3, 3)
    """Rotation matrices (..., 3, 3) nearest to M: maximise trace(R' M) (Wahba's problem, SIAM Review 1965).

    With M the sum of `w a_i b_i'` over pairs of vectors this is the R of `a = R b` in the sense of least
    squares (Kabsch, Acta Crystallographica A32, 1976).
    """
    U, _, Vt = np.linalg.svd(matrix)
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return np.asarray(U @ Vt)


def largest_trace(matrix: FloatArray) -> FloatArray:  # matrix (..., 3, 3) -> (...)
    """The trace of R' M for the `nearest_rotation` R, without R: the largest root of a quartic.

    (Markley, J. Astronautical Sciences 41, 1993, eq 17, by Newton's method from above, as his FOAM does.)
    """
    a, b, c = np.moveaxis(matrix, -2, 0)
    across = np.cross(b, c)
    det = np.einsum("...i,...i->...", a, across)
    minors = sum(np.einsum("...i,...i->...", v, v) for v in (across, np.cross(c, a), np.cross(a, b)))
    square = np.einsum("...ij,...ij->...", matrix, matrix)
    root = np.sqrt(3.0 * square)  # no sum of three singular values is larger
    for _ in range(NEWTON_STEPS):
        apart = root**2 - square
        slope = 4.0 * root * apart - 8.0 * det
        step = (apart**2 - 8.0 * root * det - 4.0 * minors) / np.where(slope > 0.0, slope, np.inf)
        root = root - step
        if (np.abs(step) <= 1e-12 * root).all():
            break
    return np.asarray(root)


def parabola_vertex(x: FloatArray, y: FloatArray) -> float:  # x (n,); y (n,)
    """Where the parabola through the lowest sample and its neighbours is lowest."""
    k = int(np.argmin(y))
    if k in (0, len(x) - 1):
        return float(x[k])
    before, here, after = y[k - 1], y[k], y[k + 1]
    curvature = before - 2 * here + after
    return float(x[k] + 0.5 * (x[1] - x[0]) * (before - after) / curvature) if curvature > 0 else float(x[k])


def peaks(y: FloatArray, height: float, distance: int, count: int) -> IntArray:  # y (n,) -> int (k,)
    """Local maxima of evenly spaced values: the highest first, and none nearer than that to a higher one."""
    # as scipy.signal.find_peaks, which takes a third of a second to load
    change = np.flatnonzero(np.diff(y))  # the last of equal neighbours
    if len(change) < 2:
        return np.zeros(0, int)
    rises = y[change + 1] > y[change]
    top = np.flatnonzero(rises[:-1] & ~rises[1:])
    rows = change[top] + 1
    rows = rows[y[rows] >= height]
    kept: list[int] = []
    for row in rows[np.argsort(-y[rows], kind="stable")].tolist():
        if all(abs(row - other) >= distance for other in kept):
            kept.append(row)
        if len(kept) == count:
            break
    return np.array(kept, int)


def nonnegative_pair(A: FloatArray, y: FloatArray) -> tuple[FloatArray, float]:
    """Least squares A x = y of two unknowns not negative (as `scipy.optimize.nnls`), and the misfit."""
    both, *_ = np.linalg.lstsq(A, y, rcond=None)
    candidates = [both] if (both >= 0).all() else []
    if not candidates:
        alone = np.maximum(A.T @ y, 0.0) / np.maximum((A**2).sum(axis=0), 1e-300)
        candidates = [np.array([alone[0], 0.0]), np.array([0.0, alone[1]])]
    misfits = [float(np.linalg.norm(A @ x - y)) for x in candidates]
    best = int(np.argmin(misfits))
    return np.asarray(candidates[best]), misfits[best]


def masked_correlation(a: FloatArray, b: FloatArray, least_variance: float) -> tuple[FloatArray, FloatArray]:
    """Pearson's correlation of two series at every shift, over the samples both have, and their count."""
    known_a, known_b = np.isfinite(a).astype(float), np.isfinite(b).astype(float)
    a, b = np.where(known_a > 0, a, 0.0), np.where(known_b > 0, b, 0.0)
    # near one: what comes out of the Fourier transform must not drown in its rounding
    a, b = a / max(float(a.std()), 1e-12), b / max(float(b.std()), 1e-12)
    size = 1 << (len(a) + len(b) - 2).bit_length()

    def shifted(x: FloatArray, y: FloatArray) -> FloatArray:
        # as scipy.signal.correlate, whose import would cost more memory than a section of a recording
        product = np.fft.rfft(x, size) * np.fft.rfft(y[::-1], size)
        return np.asarray(np.fft.irfft(product, size)[: len(a) + len(b) - 1])

    n = np.maximum(np.round(shifted(known_a, known_b)), 1.0)
    sum_a, sum_b = shifted(a, known_b), shifted(known_a, b)
    variance_a = shifted(a * a, known_b) / n - (sum_a / n) ** 2
    variance_b = shifted(known_a, b * b) / n - (sum_b / n) ** 2
    still = (variance_a < least_variance) | (variance_b < least_variance)
    covariance = shifted(a, b) / n - sum_a * sum_b / n**2
    r = covariance / np.sqrt(np.where(still, 1.0, variance_a * variance_b))
    return np.where(still, 0.0, np.clip(r, -1.0, 1.0)), n


def sphere(count: int) -> FloatArray:
    """Evenly spread directions (count, 3) (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    polar, turn = np.arccos(1 - 2 * k / count), np.pi * (1 + np.sqrt(5)) * k
    return np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)


def around(direction: FloatArray, steps: FloatArray) -> FloatArray:
    """Directions (k^2, 3) beside one (3,), by pairs of steps (k,) across it: about as many radians off."""
    across = np.linalg.svd(direction[None])[2][1:]
    u, v = (grid.reshape(-1, 1) for grid in np.meshgrid(steps, steps))
    return unit(direction + u * across[0] + v * across[1])
