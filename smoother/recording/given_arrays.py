"""Arrays that a user gives, checked and made into what a recording contains; see `Recording.from_arrays`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..errors import RecordingError
from .imu_stream import ImuStream
from .joint_tracks import JOINTS, JointState, JointTracks


def times_of(values: FloatArray, what: str, name: str) -> FloatArray:
    """Times (n,), at least two, that increase; `what` they are for the message."""
    t = _rows(values, np.shape(values)[:1] or (0,), what, name, finite=True)
    if len(t) < 2 or not (np.diff(t) > 0).all():
        raise RecordingError(f"{name}: {what} must contain at least two times that increase")
    return t


def checked_imu(imu: ImuStream, whose: str, name: str) -> ImuStream:
    """An IMU with arrays that fit each other; `whose` it is for the message."""
    t = times_of(imu.t_s, f"{whose or 'imu_'}t_s", name)
    acc, gyro = (
        _rows(values, (len(t), 3), f"{whose}{what}", name, finite=True)
        for what, values in (("acc", imu.acc), ("gyro", imu.gyro))
    )
    mag = None if imu.mag is None else _rows(imu.mag, (len(t), 3), f"{whose}mag", name)
    return replace(imu, t_s=t, acc=acc, gyro=gyro, mag=mag)


def joints_of(
    t: FloatArray, joints: Mapping[str, FloatArray], states: Mapping[str, NDArray], name: str
) -> JointTracks:
    """Joints by name at checked times (n,); tracked where they are finite, if states are not given."""
    unknown = sorted({*joints, *states} - set(JOINTS))
    if unknown:
        raise RecordingError(f"{name}: {unknown[0]} is not a joint; joints are {', '.join(JOINTS)}")
    position = np.full((len(t), len(JOINTS), 3), np.nan)
    state = np.zeros((len(t), len(JOINTS)), np.int8)
    for joint, values in joints.items():
        column = JOINTS.index(joint)
        position[:, column] = _rows(values, (len(t), 3), joint, name)
        state[np.isfinite(position[:, column]).all(axis=1), column] = JointState.TRACKED
    for joint, values in states.items():
        state[:, JOINTS.index(joint)] = _rows(values, (len(t),), f"the state of {joint}", name)
    state[~np.isfinite(position).all(axis=2)] = JointState.NOT_TRACKED
    return JointTracks("camera", t, position, state)


def direction_of(down: FloatArray, name: str) -> FloatArray:
    """The direction of down (3,)."""
    direction = _rows(down, (3,), "gravity_hint", name, finite=True)
    if not 1e-6 < np.linalg.norm(direction) < 1e6:
        raise RecordingError(f"{name}: gravity_hint is not a direction; give the direction of down")
    return direction


def _rows(
    values: FloatArray, shape: tuple[int, ...], what: str, name: str, finite: bool = False
) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise RecordingError(f"{name}: {what} has the shape {array.shape}; it must be {shape}")
    if finite and not np.isfinite(array).all():
        raise RecordingError(f"{name}: {what} contains values that are not finite; take those samples out")
    return array
