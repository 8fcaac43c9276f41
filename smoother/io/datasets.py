"""Recordings of published data sets: BROAD and UTD-MHAD."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..errors import RecordingError
from ..recording import JOINTS, CameraFrame, ImuStream, JointState, JointTracks, Recording, Truth
from ..runtime.inputs import check_input, crashes_in_subprocess
from ..units import STANDARD_GRAVITY

_UTD_RATE_HZ = 50.0
#: Rows of UTD-MHAD's Kinect v1 skeleton, right arm.
_UTD_ROWS = {"shoulder": 8, "elbow": 9, "wrist": 10, "hand": 11}


def import_broad(
    mat: str | os.PathLike[str], *, rate_hz: float = 30.0, noise_m: float = 0.008, seed: int = 0
) -> Recording:
    """Make a recording of a trial of BROAD (Laidig et al., Data 6(7):72, 2021)."""
    fields = _load(
        mat, ("imu_gyr", "imu_acc", "imu_mag", "opt_quat", "opt_pos", "sampling_rate", "movement"), "BROAD"
    )
    rate = float(fields["sampling_rate"].ravel()[0])
    position = fields["opt_pos"].astype(float)
    t_s = np.arange(len(position)) / rate
    frames = np.arange(0.0, t_s[-1] + 0.5 / rate, 1.0 / rate_hz)
    frames = frames[frames <= t_s[-1]]
    # A nan on either side makes the interpolated position nan: such a frame is not tracked.
    observed = np.stack([np.interp(frames, t_s, axis) for axis in position.T], axis=1)
    observed = observed + np.random.default_rng(seed).normal(0.0, noise_m, observed.shape)
    joints, state = _empty_tracks(len(frames))
    joints[:, JOINTS.index("strap")] = observed
    state[:, JOINTS.index("strap")] = np.where(
        np.isfinite(observed).all(axis=1), JointState.TRACKED, JointState.NOT_TRACKED
    )
    joints[state == JointState.NOT_TRACKED] = np.nan
    truth = Truth(t_s, position, fields["opt_quat"].astype(float), fields["movement"].ravel().astype(bool))
    imu = ImuStream(
        "/imu/forearm",
        t_s,
        fields["imu_acc"].astype(float),
        fields["imu_gyr"].astype(float),
        fields["imu_mag"].astype(float),
    )
    note = (
        f"Optical positions at {rate_hz:g} Hz with {noise_m * 1000:g} mm of white noise (seed {seed}) serve "
        "as the camera."
    )
    return Recording(
        imu=imu,
        arm=JointTracks("/skeleton", frames, joints, state),
        camera_frame=CameraFrame.ZUP,
        truth=truth,
        name=Path(mat).name,
        notes=(note,),
    )


def import_utd_mhad(inertial_mat: str | os.PathLike[str], skeleton_mat: str | os.PathLike[str]) -> Recording:
    """Make a recording of a trial of UTD-MHAD (Chen, Jafari, Kehtarnavaz, ICIP 2015), actions 1-21."""
    inertial = _load(inertial_mat, ("d_iner",), "UTD-MHAD (inertial)")["d_iner"].astype(float)
    skeleton = _load(skeleton_mat, ("d_skel",), "UTD-MHAD (skeleton)")["d_skel"].astype(float)
    if inertial.ndim != 2 or inertial.shape[1] != 6 or skeleton.ndim != 3 or skeleton.shape[:2] != (20, 3):
        raise RecordingError(
            f"{inertial_mat}, {skeleton_mat}: shapes {inertial.shape} and {skeleton.shape} are not "
            "UTD-MHAD's (N, 6) and (20, 3, n)."
        )
    samples, frames = len(inertial), skeleton.shape[2]
    t_s = np.asarray((np.arange(samples) + 0.5) / _UTD_RATE_HZ, np.float64)
    frame_s = (np.arange(frames) + 0.5) * (samples / _UTD_RATE_HZ / frames)
    joints, state = _empty_tracks(frames)
    for joint, row in _UTD_ROWS.items():
        joints[:, JOINTS.index(joint)] = skeleton[row].T
        state[:, JOINTS.index(joint)] = JointState.TRACKED
    # The Kinect writes zeros for a body that it does not have.
    nothing = ~np.isfinite(joints).all(axis=2) | (np.abs(joints).max(axis=2) < 1e-9)
    state[nothing], joints[nothing] = JointState.NOT_TRACKED, np.nan
    acc: FloatArray = inertial[:, :3] * STANDARD_GRAVITY
    gyro: FloatArray = inertial[:, 3:] * (np.pi / 180)
    return Recording(
        imu=ImuStream("/imu/forearm_right", t_s, acc, gyro),
        arm=JointTracks("/skeleton", frame_s, joints, state),
        side="right",
        camera_frame=CameraFrame.KINECT,
        name=Path(inertial_mat).name.removesuffix("_inertial.mat").removesuffix(".mat"),
        notes=("Frame times are spread evenly over the IMU's interval, as the files have none.",),
    )


def _empty_tracks(frames: int) -> tuple[FloatArray, NDArray[np.int8]]:
    return np.full((frames, len(JOINTS), 3), np.nan), np.zeros((frames, len(JOINTS)), np.int8)


def _load(path: str | os.PathLike[str], fields: tuple[str, ...], kind: str) -> dict[str, NDArray]:
    from scipy.io import loadmat

    check_input(path, RecordingError)
    if not Path(path).exists():
        raise RecordingError(f"{path} does not exist; check the name.")
    if crashes_in_subprocess(Path(path), loadmat):  # a damaged type of data leads it past its table
        raise RecordingError(f"{path} is a damaged Matlab file; download it again.")
    try:
        data = loadmat(path)
    except Exception as error:  # scipy raises many kinds on files that are not Matlab's
        raise RecordingError(f"{path} cannot be read as a Matlab file: {error}.") from error
    missing = [name for name in fields if name not in data]
    if missing:
        raise RecordingError(f"{path} is not a trial of {kind}: it lacks {', '.join(missing)}.")
    return {name: np.asarray(data[name]) for name in fields}
