"""Camera frames carried to the node beside them by what the IMU saw in between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..measurements.inertial import InertialSignal, integrate_between
from ..recording import FloatArray, IntArray
from .problem import States


@dataclass(frozen=True)
class RelativeMotion:
    """The IMU's motion from each frame's node to the frame, in {K}.

    Attributes
    ----------
    R_node, R_frame : (k, 3, 3) orientations `R_K_A`.
    position, speed : (k, 3) change of the IMU's position, m, and velocity, m/s.
    rate : (k, 3) angular rate at the frame, rad/s in {A}.
    """

    R_node: FloatArray
    R_frame: FloatArray
    position: FloatArray
    speed: FloatArray
    rate: FloatArray

    def shift(self, lever_A: FloatArray) -> FloatArray:
        """Change of position (k, 3), m, of a point at the lever arm (3,) m in {A}."""
        return self.position + (self.R_frame - self.R_node) @ lever_A

    def velocity(self, lever_A: FloatArray) -> FloatArray:
        """Velocity (k, 3), m/s, of that point at the frame less the IMU's at the node."""
        around = np.cross(self.rate, lever_A)
        return self.speed + np.einsum("kij,kj->ki", self.R_frame, around)


#: The angular rate at a frame is the mean over so long, s.
RATE_S = 0.02


def propagate(
    signal: InertialSignal,
    t: FloatArray,
    states: States,
    frame_t: FloatArray,
    node: IntArray,
    gravity: FloatArray,
    bias: FloatArray,
) -> RelativeMotion:
    """Follow the IMU from nodes to frames, forwards or backwards.

    A velocity that is wrong at the node moves the frames before and after it by as much in opposite
    directions: over a group that lies evenly about its node it cancels.

    Parameters
    ----------
    t, states : (n,) nodes, s, and what is held of them.
    frame_t, node : (k,) frame times inside the signal, s, and the node of each.
    gravity : (3,) m/s^2 in {K}.
    bias : (6,) of accelerometer and gyroscope.
    """
    R = states.R[node]
    away = np.flatnonzero(np.abs(frame_t - t[node]) > 1e-6)
    frame, at = frame_t[away], t[node][away]
    back = (frame < at)[:, None]
    legs = integrate_between(signal, np.minimum(frame, at), np.maximum(frame, at), bias)
    dt = legs.dt[:, None]
    R_frame, speed, position = R.copy(), np.zeros((len(R), 3)), np.zeros((len(R), 3))
    # backwards the increments are seen from the frame's axes, and the leg starts with the frame's velocity
    R_frame[away] = R[away] @ np.where(back[:, :, None], np.swapaxes(legs.delta_R, 1, 2), legs.delta_R)
    R_start = np.where(back[:, :, None], R_frame[away], R[away])
    gained = np.einsum("kij,kj->ki", R_start, legs.delta_v) + gravity * dt
    v_start = states.v[node[away]] - np.where(back, gained, 0.0)
    gone = v_start * dt + 0.5 * gravity * dt**2 + np.einsum("kij,kj->ki", R_start, legs.delta_p)
    speed[away], position[away] = np.where(back, -gained, gained), np.where(back, -gone, gone)
    inside = np.clip(frame_t, signal.start_s + 0.5 * RATE_S, signal.end_s - 0.5 * RATE_S)
    rate = signal.mean(inside - 0.5 * RATE_S, inside + 0.5 * RATE_S)[:, 3:] - bias[3:]
    return RelativeMotion(R, R_frame, position, speed, rate)
