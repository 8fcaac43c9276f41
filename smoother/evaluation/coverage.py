"""Stated uncertainty against actual error: how many lie inside the region that should hold them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtr

from ..array_types import FloatArray
from ..recording import JOINTS
from ..result import Recovery
from .metrics import squared_sigmas

#: Most samples of a joint that are looked at, evenly spaced over the recording.
MOST = 50_000


@dataclass(frozen=True)
class StatedAndActual:
    """Errors of some samples with what was stated of them."""

    squared: FloatArray  # (n,): squared error in sigmas
    sigma_m: FloatArray  # (n,) m: stated standard deviation, mean over the axes
    error_m: FloatArray  # (n,) m: length of the error over the square root of 3: the part per axis

    def inside(self, level: float) -> float:
        """Share of the errors inside the region of one level; nan without samples."""
        return float((chdtr(3.0, self.squared) <= level).mean()) if len(self.squared) else float("nan")


def stated_and_actual(error_m: FloatArray, covariance: FloatArray) -> StatedAndActual:
    """Pair errors (n, 3) m with their covariances (n, 3, 3) m^2; what is not finite is left out."""
    squared = squared_sigmas(error_m, covariance)
    good = np.isfinite(squared)
    sigma = np.sqrt(np.trace(covariance[good], axis1=1, axis2=2) / 3.0)
    return StatedAndActual(squared[good], sigma, np.linalg.norm(error_m[good], axis=1) / np.sqrt(3.0))


def camera_residuals(recovery: Recovery) -> dict[str, StatedAndActual]:
    """The camera's samples that were used, by joint: residual against camera noise and joint covariance."""
    residuals = recovery.residuals
    noise, bias = recovery.estimates.camera_sigma_m, recovery.estimates.joint_bias_m or {}
    if residuals is None or noise is None or len(recovery) < 1:
        return {}
    by_joint = {}
    for joint, sigma_m in noise.items():
        spread = recovery.joint_covariance.get(joint)
        if spread is None and joint == "strap":
            spread = recovery.pose_covariance[:, :3, :3]
        if spread is None:
            continue
        column = JOINTS.index(joint)
        used = np.flatnonzero(residuals.used[:, column])
        used = used[np.linspace(0, len(used) - 1, min(len(used), MOST)).round().astype(int)]
        off = np.array(bias.get(joint, np.zeros(3)))
        nearest = np.clip(np.searchsorted(recovery.t_s, residuals.t_s[used]), 0, len(recovery) - 1)
        own = spread[nearest]
        variance = np.einsum("nii->n", own) / 3.0
        shared = np.nanmin(variance) if np.isfinite(variance).any() else 0.0
        # rather by a factor than by a difference: what is left is a covariance for certain
        covariance = own * (1.0 - shared / variance)[:, None, None] + float(sigma_m) ** 2 * np.eye(3)
        by_joint[joint] = stated_and_actual(residuals.residual[:, column][used] - off, covariance)
    return {joint: each for joint, each in by_joint.items() if len(each.squared)}
