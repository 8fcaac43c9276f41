"""Whole motions drawn from the posterior: what the answer might have been, each consistent over time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import UnoccludeError
from ..recording import FloatArray
from ..rotation import Rotation

if TYPE_CHECKING:
    from .recovery import Recovery

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
    upper_rotation : ndarray of float32, shape (n, m, 3), rad, or None
        The same of an IMU on the upper arm; None without one.
    """

    t_s: FloatArray
    seed: int
    position: FloatArray
    rotation: FloatArray
    joints: dict[str, FloatArray] = field(default_factory=dict)
    upper_rotation: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.position)

    def first(self, count: int) -> Draws:
        """The first few of them: a draw does not depend on how many others there are."""
        return replace(
            self,
            position=self.position[:count],
            rotation=self.rotation[:count],
            joints={joint: drawn[:count] for joint, drawn in self.joints.items()},
            upper_rotation=None if self.upper_rotation is None else self.upper_rotation[:count],
        )

    def recovery(self, recovery: Recovery, k: int) -> Recovery:
        """A drawn motion at the recording's samples, in place of the answer.

        Between the drawn times the deviation follows a cubic spline, so that speeds are smooth.

        Parameters
        ----------
        recovery : Recovery
            That the deviations are from.
        k : int
            Number of the motion, from 0.

        Returns
        -------
        drawn : Recovery
            Position, orientation, velocity and joints as drawn; its covariances are zero, all else is the
            answer's.

        Raises
        ------
        UnoccludeError
            There is no such motion.
        """
        if not 0 <= k < len(self):
            raise UnoccludeError(f"there is no drawn motion {k}: {len(self)} were drawn, numbered from 0")
        t = recovery.t_s
        moved, speed = _at_samples(self.t_s, self.position[k], t)
        upper = recovery.upper
        if upper is not None:
            turned = upper.quaternion
            if self.upper_rotation is not None:
                turned = turned_by(_at_samples(self.t_s, self.upper_rotation[k], t)[0], turned)
            upper = replace(upper, quaternion=turned, pose_covariance=_zeros(upper.pose_covariance))
        joints = {
            joint: position + _at_samples(self.t_s, self.joints[joint][k], t)[0]
            if joint in self.joints
            else position
            for joint, position in recovery.joints.items()
        }
        return replace(
            recovery,
            position=recovery.position + moved,
            quaternion=turned_by(_at_samples(self.t_s, self.rotation[k], t)[0], recovery.quaternion),
            velocity=recovery.velocity + speed,
            pose_covariance=_zeros(recovery.pose_covariance),
            velocity_covariance=_zeros(recovery.velocity_covariance),
            joints=joints,
            joint_covariance={joint: _zeros(each) for joint, each in recovery.joint_covariance.items()},
            upper=upper,
            draws=None,
        )


def turned_by(rotation: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Quaternions (n, 4; qw first) turned by rotation vectors (n, 3) in {K}; nan where either is nan."""
    turned = np.full_like(quaternion, np.nan)
    known = np.isfinite(rotation).all(axis=1) & np.isfinite(quaternion).all(axis=1)
    if known.any():
        R = Rotation.from_rotvec(rotation[known]) * Rotation.from_quat(quaternion[known], scalar_first=True)
        turned[known] = R.as_quat(scalar_first=True)
    return turned


def _at_samples(t: FloatArray, drawn: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A deviation (m, 3) and its derivative at other times (n, 3); held beyond the drawn times.

    Nan where nothing was drawn within a second.
    """
    from scipy.interpolate import CubicSpline  # only where motions were drawn

    value, slope = np.full((len(at), 3), np.nan), np.full((len(at), 3), np.nan)
    known = np.flatnonzero(np.isfinite(drawn).all(axis=1))
    if not len(known):
        return value, slope
    starts = np.flatnonzero(np.diff(t[known], prepend=-np.inf) > APART_S)
    for rows in np.split(known, starts[1:]):
        first, last = np.searchsorted(at, [t[rows[0]] - 0.5 * APART_S, t[rows[-1]] + 0.5 * APART_S])
        inside = np.clip(at[first:last], t[rows[0]], t[rows[-1]])
        if len(rows) == 1:
            value[first:last], slope[first:last] = drawn[rows[0]], 0.0
            continue
        spline = CubicSpline(t[rows], drawn[rows].astype(np.float64), bc_type="natural")
        value[first:last], slope[first:last] = spline(inside), spline(inside, 1)
        slope[first:last][inside != at[first:last]] = 0.0
    return value, slope


def _zeros(values: FloatArray) -> FloatArray:
    """Zeros of that shape, which take no memory."""
    return np.broadcast_to(np.zeros(()), values.shape)
