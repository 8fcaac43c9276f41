"""Rotations of space, as far as the recovery needs them.

`Rotation` and `Slerp` behave like the classes of these names in `scipy.spatial.transform`, whose import takes
a tenth of the time that a recording of half a minute takes in all. Everything else that is
not needed to recover a recording uses SciPy's.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from .array_types import BoolArray, FloatArray, IntArray

#: Below this angle its sine is taken from a series, rad.
_SMALL_RAD = 1e-3


class Rotation:
    """One rotation, or a stack of them, held as matrices."""

    def __init__(self, matrix: FloatArray) -> None:
        self._matrix = matrix

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> Rotation:
        """From matrices (3, 3) or (n, 3, 3)."""
        return cls(np.asarray(matrix, float))

    @classmethod
    def from_rotvec(cls, rotvec: ArrayLike) -> Rotation:
        """From rotation vectors (3,) or (n, 3), rad (Rodrigues' formula)."""
        rotvec = np.asarray(rotvec, float)
        half = 0.5 * np.sqrt(np.einsum("...i,...i->...", rotvec, rotvec))
        scale = np.divide(np.sin(half), 2.0 * half, out=np.full_like(half, 0.5), where=half > 0.0)
        return cls(_matrix_of(np.cos(half), *(scale * rotvec[..., axis] for axis in range(3))))

    @classmethod
    def from_quat(cls, quaternion: ArrayLike, *, scalar_first: bool = False) -> Rotation:
        """From quaternions (4,) or (n, 4) of any length but zero."""
        unit = np.array(quaternion, float)
        length = np.linalg.norm(unit, axis=-1, keepdims=True)
        if (length == 0.0).any():
            raise ValueError("a quaternion of length zero is not a rotation")
        unit /= length
        w, x, y, z = (unit[..., k] for k in ((0, 1, 2, 3) if scalar_first else (3, 0, 1, 2)))
        return cls(_matrix_of(w, x, y, z))

    @classmethod
    def about_z(cls, angle: FloatArray) -> Rotation:
        """About z by angles, shape () or (n,), rad."""
        matrix = np.zeros((*np.shape(angle), 3, 3))
        matrix[..., 0, 0] = matrix[..., 1, 1] = np.cos(angle)
        matrix[..., 1, 0] = np.sin(angle)
        matrix[..., 0, 1] = -matrix[..., 1, 0]
        matrix[..., 2, 2] = 1.0
        return cls(matrix)

    def as_matrix(self) -> FloatArray:
        """Matrices (3, 3) or (n, 3, 3)."""
        return self._matrix

    def as_quat(self, canonical: bool = False, *, scalar_first: bool = False) -> FloatArray:
        """Quaternions (4,) or (n, 4) of length one; `canonical`: the scalar part is not negative.

        Otherwise the largest of its parts is positive. (Shepperd, J. Guidance and Control 1978.)
        """
        m = self._matrix
        diagonal = np.diagonal(m, axis1=-2, axis2=-1)
        trace = diagonal.sum(axis=-1)[..., None]
        # the symmetric matrix 4 q q' of q = (w, x, y, z): its row with the largest diagonal, made a unit
        product = np.empty((*m.shape[:-2], 4, 4))
        product[..., 0, 0] = 1.0 + trace[..., 0]
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            product[..., i + 1, i + 1] = 1.0 - trace[..., 0] + 2.0 * m[..., i, i]
            product[..., 0, i + 1] = product[..., i + 1, 0] = m[..., k, j] - m[..., j, k]
            product[..., j + 1, i + 1] = product[..., i + 1, j + 1] = m[..., j, i] + m[..., i, j]
        largest = np.argmax(np.concatenate([trace, diagonal], axis=-1), axis=-1)
        quaternion = np.take_along_axis(product, largest[..., None, None], axis=-2)[..., 0, :]
        quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
        if canonical:
            quaternion = np.where(quaternion[..., :1] < 0.0, -quaternion, quaternion)
        return quaternion if scalar_first else np.roll(quaternion, -1, axis=-1)

    def as_rotvec(self) -> FloatArray:
        """Rotation vectors (3,) or (n, 3), rad, of length pi at most."""
        quaternion = self.as_quat(canonical=True, scalar_first=True)
        sine = np.linalg.norm(quaternion[..., 1:], axis=-1)
        angle = 2.0 * np.arctan2(sine, quaternion[..., 0])
        series = 2.0 + angle**2 / 12.0 + 7.0 * angle**4 / 2880.0
        scale = np.where(angle < _SMALL_RAD, series, angle / np.maximum(sine, 0.25 * _SMALL_RAD))
        return np.asarray(scale[..., None] * quaternion[..., 1:])

    def magnitude(self) -> FloatArray:
        """Angles () or (n,), rad."""
        return np.asarray(np.linalg.norm(self.as_rotvec(), axis=-1))

    def apply(self, vectors: ArrayLike) -> FloatArray:
        """Vectors (3,) or (n, 3), turned; one rotation turns many vectors, or many one."""
        return np.asarray((self._matrix @ np.asarray(vectors, float)[..., None])[..., 0])

    def inv(self) -> Rotation:
        """The inverse of each."""
        return Rotation(np.swapaxes(self._matrix, -1, -2))

    def __mul__(self, first: Rotation) -> Rotation:
        """The first one, then this one; one and a stack, or stacks of one length."""
        return Rotation(self._matrix @ first._matrix)

    def __getitem__(self, rows: int | slice | IntArray | BoolArray) -> Rotation:
        return Rotation(np.asarray(self._matrix[rows]))

    def __len__(self) -> int:
        return len(self._matrix)


class Slerp:
    """Between rotations at times: each step at a constant rate about a constant axis."""

    def __init__(self, t: FloatArray, rotations: Rotation) -> None:
        self._t, self._from = np.asarray(t, float), rotations
        self._rate = (rotations[:-1].inv() * rotations[1:]).as_rotvec() / np.diff(self._t)[:, None]

    def __call__(self, at: FloatArray) -> Rotation:  # at (k,)
        """At times between the first and the last."""
        step = np.clip(np.searchsorted(self._t, at) - 1, 0, len(self._rate) - 1)
        turn = (at - self._t[step])[:, None] * self._rate[step]
        return self._from[step] * Rotation.from_rotvec(turn)


def chained(turns: FloatArray) -> FloatArray:  # turns (n, 3, 3) -> (n + 1, 3, 3)
    """Matrices after each of some turns, in turned axes: the identity, `turns[0]`, `turns[0] @ turns[1]`
    ..
    """
    width = max(math.isqrt(len(turns)), 1)  # in parts of this length, which are multiplied side by side
    parts = np.tile(np.eye(3), (-(-len(turns) // width) * width, 1, 1))
    parts[: len(turns)] = turns
    parts = parts.reshape(-1, width, 3, 3)
    for k in range(1, width):
        parts[:, k] = parts[:, k - 1] @ parts[:, k]
    start = np.empty((len(parts), 3, 3))
    here = np.eye(3)
    for number, last in enumerate(parts[:, -1]):
        start[number], here = here, here @ last
    after = (start[:, None] @ parts).reshape(-1, 3, 3)
    return np.concatenate([np.eye(3)[None], after[: len(turns)]])


def matrix_of(rotvec: FloatArray) -> FloatArray:
    """One rotation vector (3,), rad, as a matrix (3, 3): `Rotation.from_rotvec` without arrays' overhead."""
    x, y, z = rotvec.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    w, half = math.cos(0.5 * angle), math.sin(0.5 * angle) / angle if angle > 0.0 else 0.5
    x, y, z = half * x, half * y, half * z
    xx, yy, zz, xy, yz, zx = x * x, y * y, z * z, x * y, y * z, z * x
    wx, wy, wz = w * x, w * y, w * z
    return np.array(
        [
            [1.0 - 2.0 * (yy + zz), 2.0 * (xy - wz), 2.0 * (zx + wy)],
            [2.0 * (xy + wz), 1.0 - 2.0 * (xx + zz), 2.0 * (yz - wx)],
            [2.0 * (zx - wy), 2.0 * (yz + wx), 1.0 - 2.0 * (xx + yy)],
        ]
    )


def rotvec_of(matrix: FloatArray) -> FloatArray:
    """One matrix (3, 3) as a rotation vector (3,), rad: `Rotation.as_rotvec` without arrays' overhead."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    x, y, z, trace = h - f, c - g, d - b, a + e + i
    sine, cosine = 0.5 * math.sqrt(x * x + y * y + z * z), 0.5 * (trace - 1.0)
    if cosine < -0.5:  # the axis shows badly in the differences
        return Rotation(matrix).as_rotvec()
    angle = math.atan2(sine, cosine)
    scale = 0.5 * angle / sine if sine > 1e-6 else 0.5
    return np.array([scale * x, scale * y, scale * z])


def _matrix_of(w: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) of unit quaternions, by their parts (...)."""
    matrix = np.empty((*w.shape, 3, 3))
    xx, yy, zz = x * x, y * y, z * z
    matrix[..., 0, 0] = 1.0 - 2.0 * (yy + zz)
    matrix[..., 1, 1] = 1.0 - 2.0 * (xx + zz)
    matrix[..., 2, 2] = 1.0 - 2.0 * (xx + yy)
    for i, j, u, v, s in ((0, 1, x, y, z), (1, 2, y, z, x), (2, 0, z, x, y)):
        product, turned = u * v, w * s
        matrix[..., i, j] = 2.0 * (product - turned)
        matrix[..., j, i] = 2.0 * (product + turned)
    return matrix
