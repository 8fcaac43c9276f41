"""Piecewise cubics, as far as the recovery needs them (SciPy's take half a second to load)."""

from __future__ import annotations

import numpy as np

from .array_types import FloatArray

#: This many unknowns of a tridiagonal system are solved as a dense one.
FEW_UNKNOWNS = 12


class PiecewiseCubic:
    """The cubic pieces that have given values and slopes (n, k) at their knots (n,)."""

    def __init__(self, t: FloatArray, value: FloatArray, slope: FloatArray) -> None:
        step = np.diff(t)[:, None]
        secant = np.diff(value, axis=0) / step
        bend = (slope[:-1] + slope[1:] - 2 * secant) / step
        self._t = t
        # of one piece together: a point reads one row
        self._powers = np.stack(
            [value[:-1], slope[:-1], (secant - slope[:-1]) / step - bend, bend / step], axis=1
        )

    def __call__(self, at: FloatArray, order: int = 0) -> FloatArray:  # (...) -> (..., k)
        """Values, or first derivatives with `order` 1; the end pieces go on beyond the ends."""
        piece = np.clip(np.searchsorted(self._t, at, side="right") - 1, 0, len(self._t) - 2)
        c = self._powers[piece]
        h = (at - self._t[piece])[..., None]
        if order:
            return np.asarray((3 * c[..., 3, :] * h + 2 * c[..., 2, :]) * h + c[..., 1, :])
        return np.asarray(((c[..., 3, :] * h + c[..., 2, :]) * h + c[..., 1, :]) * h + c[..., 0, :])


def natural_spline(t: FloatArray, value: FloatArray) -> PiecewiseCubic:
    """The cubic spline through values (n, k) that is straight at its ends (de Boor, 1978)."""
    step = np.diff(t)
    if not (step > 0).all():
        raise ValueError("the spline's knots do not increase")
    secant = np.diff(value, axis=0) / step[:, None]
    right = np.empty(value.shape)
    right[0], right[-1] = 3 * secant[0], 3 * secant[-1]
    right[1:-1] = 3 * (step[1:, None] * secant[:-1] + step[:-1, None] * secant[1:])
    before, after = np.concatenate(([0.0], step[1:], [1.0])), np.concatenate(([1.0], step[:-1], [0.0]))
    return PiecewiseCubic(t, value, _tridiagonal(before, 2.0 * (before + after), after, right))


def _tridiagonal(before: FloatArray, own: FloatArray, after: FloatArray, right: FloatArray) -> FloatArray:
    """Solve before[i] x[i - 1] + own[i] x[i] + after[i] x[i + 1] = right[i], (n, k).

    Every second unknown is eliminated at once until few are left (cyclic reduction: Hockney, J. ACM 1965).
    """
    if len(own) <= FEW_UNKNOWNS:
        whole = np.diag(own) + np.diag(before[1:], -1) + np.diag(after[:-1], 1)
        return np.asarray(np.linalg.solve(whole, right))
    # an odd x is rest - low * (the even x before it) - high * (the even x after it)
    low, high, rest = before[1::2] / own[1::2], after[1::2] / own[1::2], right[1::2] / own[1::2, None]
    # put into the even rows, which have one after them, and all but the first one before
    has_next, inner = slice(0, len(low)), slice(0, (len(own) - 1) // 2)
    down, up = before[2::2], after[::2][has_next]
    fewer, known = own[::2].copy(), right[::2].copy()
    fewer[1:] -= down * high[inner]
    known[1:] -= down[:, None] * rest[inner]
    fewer[has_next] -= up * low
    known[has_next] -= up[:, None] * rest
    further = np.append(-up * high, 0.0)[: len(fewer)]
    even = _tridiagonal(np.concatenate(([0.0], -down * low[inner])), fewer, further, known)
    solved = np.empty(right.shape)
    solved[::2] = even
    rest -= low[:, None] * even[has_next]
    rest[inner] -= high[inner, None] * even[1:]
    solved[1::2] = rest
    return solved
