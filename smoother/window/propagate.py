"""The IMU's motion between a node and the camera frames beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray, IntArray
from ..measurements.inertial import InertialSignal, integrate_between
from .problem import States


@dataclass(frozen=True)
class RelativeMotion:
    """The IMU's motion from each frame's node to the frame, in {K}.

    Attributes
    ----------
    R_node, R_frame : ndarray, shape (k, 3, 3)
        Orientations `R_K_A`.
    position_change : ndarray, shape (k, 3), m
        Of the IMU.
    velocity_change : ndarray, shape (k, 3), m/s
        Of the IMU.
    rate : ndarray, shape (k, 3), rad/s
        Angular rate at the frame in {A}.
    """

    R_node: FloatArray
    R_frame: FloatArray
    position_change: FloatArray
    velocity_change: FloatArray
    rate: FloatArray

    def shift(self, lever_A: FloatArray) -> FloatArray:
        """Change of position (k, 3), m, of a point at the lever arm (3,) m in {A}."""
        return self.position_change + (self.R_frame - self.R_node) @ lever_A

    def velocity(self, lever_A: FloatArray) -> FloatArray:
        """Velocity (k, 3), m/s, of that point at the frame less the IMU's at the node."""
        around = np.cross(self.rate, lever_A)
        return self.velocity_change + np.einsum("kij,kj->ki", self.R_frame, around)


#: The angular rate at a frame is the mean over so long, s.
RATE_S = 0.02


def propagate(
    signal: InertialSignal,
    t: FloatArray,
    states: States,
    frame_t_imu: FloatArray,
    node: IntArray,
    gravity: FloatArray,
    bias: FloatArray,
) -> RelativeMotion:
    """Follow the IMU from nodes to frames, forwards or backwards (Forster et al., TRO 2017, eq 32).

    A velocity that is wrong at the node moves the frames before and after it by as much in opposite
    directions: over a group that lies evenly about its node it cancels.

    Parameters
    ----------
    signal : InertialSignal
    t : ndarray, shape (n,), s
        Nodes.
    states : States
        Estimate at the nodes.
    frame_t_imu : ndarray, shape (k,), s
        Frame times on the IMU's clock, inside the signal.
    node : ndarray of int, shape (k,)
        The node of each frame.
    gravity : ndarray, shape (3,), m/s^2
        In {K}.
    bias : ndarray, shape (6,), m/s^2 and rad/s
        Of accelerometer and gyroscope.

    Returns
    -------
    motion : RelativeMotion
        Of the k frames.
    """
    R = states.R[node]
    away = np.flatnonzero(np.abs(frame_t_imu - t[node]) > 1e-6)
    frame, at = frame_t_imu[away], t[node][away]
    back = (frame < at)[:, None]
    delta = integrate_between(signal, np.minimum(frame, at), np.maximum(frame, at), bias)
    dt = delta.dt[:, None]
    R_frame, velocity_change, position_change = R.copy(), np.zeros((len(R), 3)), np.zeros((len(R), 3))
    # backwards the increments are in the frame's axes, and begin with the frame's velocity
    R_frame[away] = R[away] @ np.where(back[:, :, None], np.swapaxes(delta.delta_R, 1, 2), delta.delta_R)
    R_start = np.where(back[:, :, None], R_frame[away], R[away])
    dv = np.einsum("kij,kj->ki", R_start, delta.delta_v) + gravity * dt
    v_start = states.v[node[away]] - np.where(back, dv, 0.0)
    dp = v_start * dt + 0.5 * gravity * dt**2 + np.einsum("kij,kj->ki", R_start, delta.delta_p)
    velocity_change[away], position_change[away] = np.where(back, -dv, dv), np.where(back, -dp, dp)
    inside = np.clip(frame_t_imu, signal.start_s + 0.5 * RATE_S, signal.end_s - 0.5 * RATE_S)
    rate = signal.mean(inside - 0.5 * RATE_S, inside + 0.5 * RATE_S)[:, 3:] - bias[3:]
    return RelativeMotion(R, R_frame, position_change, velocity_change, rate)
