"""Whole motions drawn from the posterior: what the answer might have been, each consistent over time."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ..array_types import FloatArray
from ..body import FURTHER, SEGMENTS
from ..errors import UnoccludeError
from ..linalg import by_columns
from ..rotation import Rotation
from ..splines import natural_spline

#: Names of the columns of joints begin so, those of further segments' rotations end so.
JOINT, TURN = "joint_", "_rotation"
#: This many motions are drawn by default: three lie beyond the ends of a 95 % interval.
USUAL_DRAWS = 64
#: Drawn times further apart than this do not belong to one motion, s.
APART_S = 1.0


@dataclass(frozen=True)
class Draws:
    """Whole motions drawn from the posterior, as deviations from the answer.

    Attributes
    ----------
    t_s : ndarray, shape (m,), s
        Increasing times on the IMU's clock, within the recording.
    seed : int
        Of the random numbers.
    position : ndarray of float32, shape (n, m, 3), m
        Of the IMU in {K}, drawn minus answer; nan where there is no answer.
    rotation : ndarray of float32, shape (n, m, 3), rad
        In {K}: R_drawn = Exp(rotation) R_answer.
    joints : dict of str to ndarray of float32, shape (n, m, 3), m
        By joint in {K}, drawn minus answer.
    turns : dict of str to ndarray of float32, shape (n, m, 3), rad
        The same of IMUs on further segments, by the segment's name.
    """

    t_s: FloatArray
    seed: int
    position: FloatArray
    rotation: FloatArray
    joints: dict[str, FloatArray] = field(default_factory=dict)
    turns: dict[str, FloatArray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.position)

    def columns(self) -> dict[str, FloatArray]:
        """All quantities by the names that files have for them."""
        columns = {"position": self.position, "rotation": self.rotation}
        columns |= {JOINT + joint: drawn for joint, drawn in self.joints.items()}
        return columns | {SEGMENTS[name].prefix + TURN: drawn for name, drawn in self.turns.items()}

    @classmethod
    def from_columns(cls, t_s: FloatArray, seed: int, columns: dict[str, FloatArray]) -> Draws:
        """What `columns` gives."""
        joints = {name.removeprefix(JOINT): v for name, v in columns.items() if name.startswith(JOINT)}
        turns = {body.name: columns[body.prefix + TURN] for body in FURTHER if body.prefix + TURN in columns}
        return cls(t_s, seed, columns["position"], columns["rotation"], joints, turns)

    def at(self, k: int, t_s: FloatArray) -> Deviation:
        """How far a drawn motion is from the answer at other times.

        Between the drawn times the deviation follows a cubic spline, so that speeds are smooth.

        Parameters
        ----------
        k : int
            Number of the motion, from 0.
        t_s : ndarray, shape (N,), s
            On the IMU's clock, increasing.

        Returns
        -------
        deviation : Deviation
            Nan where nothing was drawn within a second.

        Raises
        ------
        UnoccludeError
            There is no such motion.
        """
        if not 0 <= k < len(self):
            raise UnoccludeError(f"there is no drawn motion {k}: {len(self)} were drawn, numbered from 0")
        drawn = {name: values[k] for name, values in self.columns().items()}
        at = by_columns(partial(_at_times, self.t_s, t_s), drawn)
        return Deviation(
            at["position"],
            _at_times(self.t_s, t_s, self.position[k], 1),
            at["rotation"],
            {joint: at[JOINT + joint] for joint in self.joints},
            {segment: at[SEGMENTS[segment].prefix + TURN] for segment in self.turns},
        )


@dataclass(frozen=True)
class Deviation:
    """A drawn motion minus the answer, sample by sample."""

    position: FloatArray  # (N, 3), m: of the IMU in {K}
    velocity: FloatArray  # (N, 3), m/s
    rotation: FloatArray  # (N, 3), rad: In {K}: R_drawn = Exp(rotation) R_answer
    joints: dict[str, FloatArray]  # (N, 3), m: By joint in {K}, those that were drawn
    turns: dict[str, FloatArray]  # (N, 3), rad: Of IMUs on further segments


def turned_by(rotation: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Quaternions (n, 4; qw first) turned by rotation vectors (n, 3) in {K}; nan where either is nan."""
    turned = np.full_like(quaternion, np.nan)
    known = np.isfinite(rotation).all(axis=1) & np.isfinite(quaternion).all(axis=1)
    if known.any():
        R = Rotation.from_rotvec(rotation[known]) * Rotation.from_quat(quaternion[known], scalar_first=True)
        turned[known] = R.as_quat(scalar_first=True)
    return turned


def _at_times(t: FloatArray, at: FloatArray, drawn: FloatArray, order: int = 0) -> FloatArray:
    """Deviations (m, k) at other times (n, k), held beyond the drawn ones; derivatives with `order` 1."""
    value = np.full((len(at), drawn.shape[1]), np.nan)
    known = np.flatnonzero(np.isfinite(drawn).all(axis=1))
    if not len(known):
        return value
    starts = np.flatnonzero(np.diff(t[known], prepend=-np.inf) > APART_S)
    for rows in np.split(known, starts[1:]):
        first, last = np.searchsorted(at, [t[rows[0]] - 0.5 * APART_S, t[rows[-1]] + 0.5 * APART_S])
        inside = np.clip(at[first:last], t[rows[0]], t[rows[-1]])
        if len(rows) == 1:
            value[first:last] = 0.0 if order else drawn[rows[0]]
            continue
        spline = natural_spline(t[rows], drawn[rows].astype(np.float64))
        value[first:last] = spline(inside, order)
        if order:
            value[first:last][inside != at[first:last]] = 0.0
    return value
