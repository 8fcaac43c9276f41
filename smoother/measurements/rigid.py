"""What the camera sees of a limb is the IMU's motion, turned: fitted in closed form at every clock offset.

With the limb's direction a in the sensor and the constant rotation Q from {E} to {K}, d_K(t) = Q R_E_A(t +
offset) a; accelerations, where they are used, are a_K(t) = Q a_E(t + offset). For one offset Q and a follow
in closed form alternately (Wahba's problem, SIAM Review 1965, for Q); over all offsets the sums that they
need are correlations, which the Fourier transform gives.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import largest_trace, nearest_rotation

#: Both sides are taken on this grid, Hz, smoothed with a Gaussian of this sigma, s: above 2 Hz a camera's
#: joints are noise. Frames farther apart than the third are not bridged, s.
GRID_HZ, SMOOTH_S, BRIDGED_S = 25.0, 0.12, 0.25
#: Rounds of the alternation from all start values, and as many from the best of them.
ROUNDS, KEPT = 3, 2
NEWTON_STEPS = 6
#: Offsets are worked on in batches of this many.
BATCH = 1024


def known_at(grid: FloatArray, t: FloatArray, beside_s: float) -> BoolArray:
    """Which grid times (k,) lie within times (n,), off their ends and off gaps that are not bridged."""
    known = (grid > t[0] + beside_s) & (grid < t[-1] - beside_s)
    for row in np.flatnonzero(np.diff(t) > BRIDGED_S):
        start, stop = np.searchsorted(grid, [t[row] - beside_s, t[row + 1] + beside_s])
        known[start:stop] = False
    return known


def fits_along(T: FloatArray, C: FloatArray, along: FloatArray, heading_only: bool) -> FloatArray:
    """2 tr(Q' T a) - a' C a with the best rotation Q, for each of some directions a (d, 3): (d, n)."""
    M = np.einsum("nijk,dk->dnij", T, along)
    if heading_only:
        trace = np.hypot(M[..., 0, 0] + M[..., 1, 1], M[..., 1, 0] - M[..., 0, 1]) + M[..., 2, 2]
    else:
        trace = largest_trace(M)
    return np.asarray(2.0 * trace - np.einsum("di,nij,dj->dn", along, C, along))


def best_fits(
    T: FloatArray,
    C: FloatArray,
    heading_only: bool,
    F: FloatArray | None = None,
    pull: FloatArray | None = None,
    rounds: int = ROUNDS,
) -> FloatArray:
    """The largest 2 tr(Q' T a) - a' C a + 2 tr(Q' F) over rotations Q and unit vectors a: both parts (2, n).

    T (n, 3, 3, 3) and F (n, 3, 3); for a Q that is free also (n, e, ..), of parts with a Q each, and there is
    a pull (3, 3) on Q that is not counted.
    """
    F, pull = (np.zeros(T.shape[:-1]) if F is None else F), np.zeros((3, 3)) if pull is None else pull
    answers = [np.zeros((2, 0))]
    for some in (slice(k, k + BATCH) for k in range(0, len(T), BATCH)):
        width, axes = np.linalg.eigh(C[some])
        # a = axes y: in these axes C is diagonal
        turning = (T[some].reshape(len(axes), -1, 3) @ axes).reshape(len(axes), -1, 9, 3)
        turned = _by_heading(turning) if heading_only else _freely(turning, F[some], pull)
        widths = _columns(width)
        starts = np.ascontiguousarray(axes.transpose(2, 1, 0))  # the sensor's axes
        fit, y = _alternate(turned, widths, np.concatenate([starts, -starts], axis=1), rounds)
        best = np.argsort(-fit.sum(axis=0), axis=0)[:KEPT]
        fit, _ = _alternate(turned, widths, np.take_along_axis(y, best[None], axis=1), rounds)
        best = fit.sum(axis=0).argmax(axis=0)
        answers.append(np.take_along_axis(fit, best[None, None], axis=1)[:, 0])
    return np.concatenate(answers, axis=1)


def _columns(vectors: FloatArray) -> FloatArray:
    """Vectors (n, 3) as (3, 1, n): sums over three, and all else, are fast with the many in a row."""
    return np.ascontiguousarray(vectors.T)[:, None]


_Turned = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


def _alternate(
    turned: _Turned, width: FloatArray, y: FloatArray, rounds: int
) -> tuple[FloatArray, FloatArray]:
    """Rounds of Q for y and y for Q from start values (3, s, n): what they reach (2, s, n), and their y."""
    for _ in range(rounds):
        z, aside = turned(y)
        y = _on_sphere(z, width)
    return np.stack([((2.0 * z - width * y) * y).sum(axis=0), 2.0 * aside]), y


def _on_sphere(z: FloatArray, width: FloatArray) -> FloatArray:
    """The unit vector y that maximises 2 z'y - y' diag(width) y: y = z / (width + shift), by its shift."""
    z = np.where(np.abs(z) < 1e-12, 1e-12, z)
    shift = np.maximum(np.sqrt((z * z).sum(axis=0)) - width[2], np.abs(z[0]) - width[0])
    for _ in range(NEWTON_STEPS):
        inverse = 1.0 / (width + shift)
        squares = (z * inverse) ** 2
        square, slope = squares.sum(axis=0), (squares * inverse).sum(axis=0)
        shift = shift + (np.sqrt(square) - 1.0) * square / slope
    y = z / (width + shift)
    return np.asarray(y / np.sqrt((y * y).sum(axis=0)))


def _freely(T: FloatArray, F: FloatArray, pull: FloatArray) -> _Turned:
    """For vectors y (3, s, n) the z of z'y = tr(Q' T y) with the best rotations Q, and tr(Q' F)."""
    aside = F.reshape(*T.shape[:2], 1, 9)  # T is (n, e, 9, 3)

    def turned(y: FloatArray) -> tuple[FloatArray, FloatArray]:
        M = y.transpose(2, 1, 0)[:, None] @ np.swapaxes(T, 2, 3) + aside + pull.ravel()  # (n, e, s, 9)
        Q = nearest_rotation(M.reshape(*M.shape[:3], 3, 3)).reshape(M.shape)
        z = (Q @ T).sum(axis=1)
        return np.ascontiguousarray(z.transpose(2, 1, 0)), (Q * aside).sum(axis=(1, 3)).T

    return turned


def _by_heading(T: FloatArray) -> _Turned:
    """`_freely` with a rotation Q about the third axis: then three vectors are all that counts of T."""
    xx, xy, _, yx, yy, *_, zz = np.moveaxis(T[:, 0], 1, 0)
    cosine, sine, along = _columns(xx + yy), _columns(yx - xy), _columns(zz)

    def turned(y: FloatArray) -> tuple[FloatArray, FloatArray]:
        c, s = (cosine * y).sum(axis=0), (sine * y).sum(axis=0)
        length = np.maximum(np.hypot(c, s), 1e-300)
        return (c / length) * cosine + (s / length) * sine + along, np.zeros(c.shape)

    return turned


def correlation(x: FloatArray, y: FloatArray) -> FloatArray:
    """Sum over t of x_i(t) y_j(t + lag) for lag = -(n - 1) .. m - 1: (n + m - 1, p, q)."""
    n, m = len(x), len(y)
    size = 1 << (n + m - 2).bit_length()
    fx, fy = np.fft.rfft(x[::-1], size, axis=0), np.fft.rfft(y, size, axis=0)
    answer = np.empty((n + m - 1, x.shape[1], y.shape[1]))
    for i in range(x.shape[1]):
        answer[:, i] = np.fft.irfft(fx[:, [i]] * fy, size, axis=0)[: n + m - 1]
    return answer
