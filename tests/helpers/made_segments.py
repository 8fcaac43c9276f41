"""Segments made by hand, for tests of single rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from curve import G

from smoother.array_types import FloatArray
from smoother.measurements.inertial import InertialAttitude, InertialSignal
from smoother.measurements.segment import Segment
from smoother.recording import JOINTS, ImuStream
from smoother.rotation import Rotation

ELBOW, WRIST, HAND, STRAP = (JOINTS.index(joint) for joint in ("elbow", "wrist", "hand", "strap"))
FOREARM_M = 0.25


def still_imu(duration_s: float, rate: FloatArray | None = None) -> ImuStream:
    """A sensor at rest, z up, or (by its gyroscope alone) turning at a rate (3,) rad/s."""
    t = np.arange(0.0, duration_s, 0.01)
    gyro = np.tile(np.zeros(3) if rate is None else rate, (len(t), 1))
    return ImuStream("imu", t, np.tile([0.0, 0.0, G], (len(t), 1)), gyro)


def forearm(
    frames: int = 90,
    along: tuple[float, float, float] = (1.0, 0.0, 0.0),
    middle: tuple[float, float, float] = (0.0, 0.0, 2.0),
    rate: FloatArray | None = None,
) -> Segment:
    """Elbow, wrist, hand and strap on a line at rest in {K}, 30 Hz, a tenth of a millimetre of noise.

    The sensor's attitude is the identity throughout, also where it is said to turn.
    """
    t = np.arange(frames) / 30.0 + 0.1
    unit = np.array(along) / np.linalg.norm(along)
    position = np.full((frames, len(JOINTS), 3), np.nan)
    for column, share in ((ELBOW, -0.5), (WRIST, 0.5), (HAND, 0.8), (STRAP, 0.3)):
        position[:, column] = np.array(middle) + share * FOREARM_M * unit
    position += 1e-4 * np.random.default_rng(0).normal(size=position.shape)
    duration = float(t[-1]) + 0.5
    identity = Rotation.from_quat(np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)))
    return Segment(
        signal=InertialSignal(still_imu(duration, rate)),
        attitude=InertialAttitude(np.array([0.0, duration]), identity, np.zeros(3)),
        frame_t_camera=t,
        position=position,
        accepted=np.isfinite(position).all(axis=2),
        reason=np.zeros(position.shape[:2], np.uint8),
        down=np.array([0.0, -1.0, 0.0]),
        needed=2,
        frames=slice(0, frames),
        start_s=0.0,
        end_s=duration,
    )


def with_position(segment: Segment, rows: slice | list[int], column: int, value: FloatArray) -> Segment:
    """The segment with other positions of a joint in some frames."""
    position = segment.position.copy()
    position[rows, column] = value
    return replace(segment, position=position)
