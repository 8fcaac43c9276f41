"""Piecewise cubics: all of splines that the recovery needs (SciPy takes two tenths of a second to load)."""

from __future__ import annotations

import numpy as np

from .array_types import FloatArray

#: This many unknowns of a tridiagonal system are solved as a dense one.
FEW_UNKNOWNS = 12


class PiecewiseCubic:
    """The cubic pieces that have given values and slopes at their knots."""

    def __init__(self, t: FloatArray, value: FloatArray, slope: FloatArray) -> None:
        step = np.diff(t)[:, None]
        secant = np.diff(value, axis=0) / step
        bend = (slope[:-1] + slope[1:] - 2 * secant) / step
        self._t = np.asarray(t, float)
        # of one piece together: a point reads one row
        self._powers = np.stack(
            [value[:-1], slope[:-1], (secant - slope[:-1]) / step - bend, bend / step], axis=1
        )

    def __call__(self, at: FloatArray, order: int = 0) -> FloatArray:  # at (...) -> (..., k)
        """Values, or first derivatives with `order` 1, at any times; the end pieces go on beyond the ends."""
        piece = np.clip(np.searchsorted(self._t, at, side="right") - 1, 0, len(self._t) - 2)
        h = (at - self._t[piece])[..., None]
        c = self._powers[piece]
        if order:
            return np.asarray((3 * c[..., 3, :] * h + 2 * c[..., 2, :]) * h + c[..., 1, :])
        return np.asarray(((c[..., 3, :] * h + c[..., 2, :]) * h + c[..., 1, :]) * h + c[..., 0, :])


def cubic_spline(t: FloatArray, value: FloatArray, natural: bool = False) -> PiecewiseCubic:
    """The interpolating cubic spline of values (n, k) (de Boor, A Practical Guide to Splines, 1978)."""
    step = np.diff(t)
    if not (step > 0).all():
        raise ValueError("the spline's knots do not increase")
    secant = np.diff(value, axis=0) / step[:, None]
    if len(t) == 2:
        return PiecewiseCubic(t, value, np.repeat(secant, 2, axis=0))
    if len(t) == 3 and not natural:
        bend = (secant[1] - secant[0]) / (t[2] - t[0])
        middle = secant[0] + bend * step[0]
        return PiecewiseCubic(
            t, value, np.stack([secant[0] - bend * step[0], middle, middle + 2 * bend * step[1]])
        )
    right = np.empty_like(value, dtype=float)
    right[1:-1] = 3 * (step[1:, None] * secant[:-1] + step[:-1, None] * secant[1:])
    if natural:
        right[0], right[-1] = 3 * secant[0], 3 * secant[-1]
        lower, upper = np.append(step[1:], 1.0), np.append(1.0, step[:-1])
        diagonal = np.concatenate(([2.0], 2 * (step[:-1] + step[1:]), [2.0]))
        return PiecewiseCubic(t, value, _tridiagonal(lower, diagonal, upper, right))
    first, last = step[0] + step[1], step[-1] + step[-2]
    right[0] = ((step[0] + 2 * first) * step[1] * secant[0] + step[0] ** 2 * secant[1]) / first
    right[-1] = (step[-1] ** 2 * secant[-2] + (2 * last + step[-1]) * step[-2] * secant[-1]) / last
    lower = np.append(step[1:], last)
    diagonal = np.concatenate(([step[1]], 2 * (step[:-1] + step[1:]), [step[-2]]))
    upper = np.append(first, step[:-1])
    return PiecewiseCubic(t, value, _tridiagonal(lower, diagonal, upper, right))


def _tridiagonal(lower: FloatArray, diagonal: FloatArray, upper: FloatArray, right: FloatArray) -> FloatArray:
    """Solve a tridiagonal system (n, n), diagonally dominant but for its ends, for right sides (n, k).

    Every second unknown is eliminated at once until few are left (cyclic reduction: Hockney, J. ACM 1965);
    `lower` and `upper` are of length n - 1.
    """
    count = len(diagonal)
    if count <= FEW_UNKNOWNS:
        whole = np.diag(diagonal) + np.diag(lower, -1) + np.diag(upper, 1)
        return np.asarray(np.linalg.solve(whole, right))
    # row i: before[i] x[i - 1] + diagonal[i] x[i] + after[i] x[i + 1] = right[i]
    before, after = np.append(0.0, lower), np.append(upper, 0.0)
    # an odd x is rest - low * (the even x before it) - high * (the even x after it)
    odd = slice(1, None, 2)
    low, high = before[odd] / diagonal[odd], after[odd] / diagonal[odd]
    rest = right[odd] / diagonal[odd, None]
    # put into the even rows, which have one after them, and all but the first one before
    has_next, inner = slice(0, count // 2), slice(0, (count - 1) // 2)
    down, up = before[2::2], after[::2][has_next]
    own, known = diagonal[::2].copy(), right[::2].copy()
    own[1:] -= down * high[inner]
    known[1:] -= down[:, None] * rest[inner]
    own[has_next] -= up * low
    known[has_next] -= up[:, None] * rest
    even = _tridiagonal(-down * low[inner], own, (-up * high)[inner], known)
    solved = np.empty_like(right)
    solved[::2] = even
    rest -= low[:, None] * even[has_next]
    rest[inner] -= high[inner, None] * even[1:]
    solved[odd] = rest
    return solved
