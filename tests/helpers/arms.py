"""Small recordings and recoveries made by hand, for the tests of evaluation, report and cli."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from measured_arms import recovery_of
from scipy.spatial.transform import Rotation

from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.evaluation.validate import Validation
from smoother.measurements.visibility import Gap, occluded_at
from smoother.recording import JOINTS, Recording, Truth
from smoother.report import write_report
from smoother.result import Estimates, FrameResiduals, Recovery

LEVERS = {"elbow": np.array([0.0, -0.15, 0.0]), "wrist": np.array([0.0, 0.07, 0.0])}
LEVERS["hand"] = np.array([0.0, 0.15, 0.0])


def path(t: np.ndarray) -> np.ndarray:
    """A smooth path of the IMU, m in the camera frame."""
    return np.column_stack([0.2 * np.sin(1.3 * t), 0.1 * np.cos(0.9 * t), 2.0 + 0.05 * np.sin(t)])


def turn(t: np.ndarray) -> Rotation:
    return Rotation.from_rotvec(np.column_stack([0.3 * np.sin(t), 0.8 * np.cos(0.7 * t), 0.2 * t / 10]))


def make_truth(t: np.ndarray) -> Truth:
    score = np.ones(len(t), dtype=bool)
    return Truth(t, path(t), turn(t).as_quat(scalar_first=True), score)


def make_joint_truth(t: np.ndarray) -> Truth:
    """With the joints of `make_recovery` too."""
    joints = {name: path(t) + turn(t).apply(lever) for name, lever in LEVERS.items()}
    joints["shoulder"] = np.tile([0.0, 0.3, 2.1], (len(t), 1))
    return replace(make_truth(t), joints=joints)


def write_page(
    recovery: Recovery,
    path: Path,
    recording: Recording | None = None,
    validation: Validation | None = None,
    truth: Truth | None = None,
    force: bool = False,
) -> None:
    """The report of one arm."""
    write_report([(recording, recovery, validation, truth)], path, force=force)


def make_recording(
    duration_s: float = 20.0,
    *,
    offset_s: float = 0.0,
    noise_m: float = 0.0,
    truth: bool = True,
    seed: int = 0,
) -> Recording:
    """An arm whose camera runs `offset_s` behind the IMU's clock (t_imu = t_camera + offset)."""
    t, frames = np.arange(0, duration_s, 0.0125), np.arange(0.1, duration_s - 0.1, 1 / 30)
    noise = noise_m * np.random.default_rng(seed).normal(size=(len(frames), len(JOINTS), 3))
    joints = make_joint_truth(frames + offset_s).joints
    joints = {name: place + noise[:, JOINTS.index(name)] for name, place in joints.items()}
    acc, gyro, known = np.tile([0, 9.81, 0.0], (len(t), 1)), np.zeros((len(t), 3)), make_truth(t)
    made = Recording.from_arrays(t, acc, gyro, frames, joints, side="right", name="made by hand")
    imu, arm = replace(made.imu, name="/imu/forearm_right"), replace(made.arm, name="/skeleton")
    return replace(made, imu=imu, arm=arm, truth=known if truth else None)


def make_recovery(
    recording: Recording, *, error_m: float = 0.0, sigma_m: float = 0.01, offset_s: float = 0.0, seed: int = 0
) -> Recovery:
    """A recovery that knows the path; `error_m` white noise on it, stated as `sigma_m`."""
    rng, t, arm = np.random.default_rng(seed), recording.imu.t_s, recording.arm
    truth, shift = make_joint_truth(t), error_m * rng.normal(size=(len(t), 3))
    joints = {name: place + (0.0 if name == "shoulder" else shift) for name, place in truth.joints.items()}
    covariance = np.tile(np.diag([sigma_m**2] * 3 + [0.01**2] * 3), (len(t), 1, 1))
    seen, on_imu = arm.t_s[arm.tracked("wrist")] + offset_s, replace(arm, t_s=arm.t_s + offset_s)
    gaps = tuple(Gap(float(seen[k]), float(seen[k + 1])) for k in np.flatnonzero(np.diff(seen) > 0.1))
    residual, used = 0.008 * rng.normal(size=arm.position.shape), np.isfinite(arm.position).all(axis=2)
    levers = {name: LeverArm(lever, np.full(3, 0.004)) for name, lever in LEVERS.items()}
    return replace(
        recovery_of(t, joints, "right"),
        occluded=occluded_at(t, gaps),
        position=truth.position + shift,
        quaternion=truth.quaternion,
        velocity=np.gradient(truth.position, t, axis=0),
        pose_covariance=covariance,
        velocity_covariance=np.tile(np.eye(3) * 1e-4, (len(t), 1, 1)),
        joint_covariance={name: covariance[:, :3, :3] for name in joints},
        gaps=gaps,
        calibration=ArmCalibration("right", levers, Length(0.31, 0.01)),
        clock_offset_s=offset_s,
        clock_offset_sigma_s=0.002,
        arm=on_imu,
        residuals=FrameResiduals(on_imu.t_s, residual, used, np.zeros(arm.state.shape, np.uint8)),
        origin_ns=0,
        name=recording.name,
        notes=("The path was made by hand.",),
        estimates=Estimates(),
    )
