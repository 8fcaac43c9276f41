"""Arrays that a user gives, checked and made into what a recording contains; see `Recording.from_arrays`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..errors import RecordingError
from .camera import CameraFrame
from .imu_stream import ImuStream
from .joint_tracks import JOINTS, JointState, JointTracks


def times_of(values: FloatArray, what: str, name: str) -> FloatArray:
    """Times (n,), at least two, that increase; `what` they are for the message."""
    t = _rows(values, np.shape(values)[:1] or (0,), what, name, finite=True)
    if len(t) < 2 or not (np.diff(t) > 0).all():
        raise RecordingError(f"{name}: {what} must contain at least two times that increase")
    return t


def camera_frame_of(named: CameraFrame | str | None, name: str) -> CameraFrame | None:
    """A convention of the camera's axes by its name."""
    try:
        return None if named is None else CameraFrame(named)
    except ValueError as error:
        names = ", ".join(CameraFrame)
        raise RecordingError(f"{name}: the camera's frame is one of {names}, not {named}") from error


def imu_of(t: FloatArray, acc: FloatArray, gyro: FloatArray, mag: FloatArray | None, name: str) -> ImuStream:
    """The samples of an IMU at checked times (n,)."""
    shape = (len(t), 3)
    return ImuStream(
        "imu",
        t,
        _rows(acc, shape, "acc", name, finite=True),
        _rows(gyro, shape, "gyro", name, finite=True),
        None if mag is None else _rows(mag, shape, "mag", name),
    )


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


def check_imu(imu: ImuStream, whose: str, name: str) -> None:
    """Refuse an IMU whose arrays do not fit each other."""
    shape = (len(times_of(imu.t_s, f"{whose}t_s", name)), 3)
    for what, values in (("acc", imu.acc), ("gyro", imu.gyro)):
        _rows(values, shape, f"{whose}{what}", name, finite=True)


def _rows(
    values: FloatArray, shape: tuple[int, ...], what: str, name: str, finite: bool = False
) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise RecordingError(f"{name}: {what} has the shape {array.shape}; it must be {shape}")
    if finite and not np.isfinite(array).all():
        raise RecordingError(f"{name}: {what} contains values that are not finite; take those samples out")
    return array
