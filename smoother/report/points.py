"""The points of the arm that the report draws: the sensor and the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..recording import Truth
from ..result import Recovery
from .decimate import decimate

SENSOR = "sensor"
#: Most camera samples of a point that are drawn.
MOST_DOTS = 1500


@dataclass(frozen=True)
class Point:
    """One point of the arm over time.

    Attributes
    ----------
    name : str
        "sensor" (the IMU on the forearm) or a joint.
    position, sigma : ndarray, shape (n, 3), m
        In {K}, at the recovery's times.
    camera_t_s, camera : ndarray, shape (f,) and (f, 3), s and m
        What the camera tracked, on the IMU's clock; some thousand samples of it.
    truth_t_s, truth : ndarray, shape (m,) and (m, 3), s and m
        The reference, empty without one.
    """

    name: str
    position: FloatArray
    sigma: FloatArray
    camera_t_s: FloatArray
    camera: FloatArray
    truth_t_s: FloatArray
    truth: FloatArray


def points(recovery: Recovery, truth: Truth | None) -> list[Point]:
    """The points to show, the one that the camera sees best first."""
    joints = [_joint(recovery, name, truth) for name in ("wrist", "elbow", "hand") if name in recovery.joints]
    sensor = _point(SENSOR, recovery, recovery.position, recovery.sigma_m, "strap", truth, None)
    tracked = [point for point in joints if len(point.camera)]
    return [*tracked[:1], sensor, *tracked[1:2]]


def _joint(recovery: Recovery, name: str, truth: Truth | None) -> Point:
    covariance = recovery.joint_covariance.get(name)
    sigma = np.full((len(recovery), 3), np.nan)
    if covariance is not None:
        sigma = np.sqrt(np.einsum("nii->ni", covariance))
    return _point(name, recovery, recovery.joints[name], sigma, name, truth, name)


def _point(
    name: str,
    recovery: Recovery,
    position: FloatArray,
    sigma: FloatArray,
    joint: str,
    truth: Truth | None,
    truth_joint: str | None,
) -> Point:
    arm = recovery.arm
    tracked = [part.tracked(joint) for part in recovery.frame_batches()]
    frames = np.flatnonzero(np.concatenate(tracked)) if tracked else np.zeros(0, np.int64)
    frames = frames[decimate(np.zeros(len(frames), bool), MOST_DOTS)]
    reference = np.zeros((0, 3))
    if truth is not None:
        reference = truth.position if truth_joint is None else truth.joints.get(truth_joint, reference)
    truth_t = truth.t_s if truth is not None and len(reference) else np.zeros(0)
    return Point(name, position, sigma, arm.t_s[frames], arm.joint(joint)[frames], truth_t, reference)
