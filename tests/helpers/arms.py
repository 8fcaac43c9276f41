"""Small recordings and recoveries made by hand, for the tests of evaluation, report and cli."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.evaluation.validate import Validation
from smoother.measurements.visibility import Gap
from smoother.recording import JOINTS, JointTracks, Recording, Truth
from smoother.report import write_report
from smoother.result import FrameResiduals, Recovery

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
    rng = np.random.default_rng(seed)
    t = recording.imu.t_s
    count = len(t)
    shift = rng.normal(size=(count, 3)) * error_m
    covariance = np.tile(np.diag([sigma_m**2] * 3 + [0.01**2] * 3), (count, 1, 1))
    arm = recording.arm
    seen = arm.tracked("wrist")
    on_imu = JointTracks(arm.name, arm.t_s + offset_s, arm.position, arm.state)
    joints = {name: path(t) + shift + turn(t).apply(lever) for name, lever in LEVERS.items()}
    joints["shoulder"] = np.tile([0.0, 0.3, 2.1], (count, 1))
    gaps = []
    for index in np.flatnonzero(np.diff(arm.t_s[seen]) > 0.1):
        times = arm.t_s[seen] + offset_s
        gaps.append(Gap(float(times[index]), float(times[index + 1])))
    occluded = np.zeros(count, dtype=bool)
    for gap in gaps:
        occluded |= (t > gap.start_s) & (t < gap.end_s)
    residual = rng.normal(size=arm.position.shape) * 0.008
    return Recovery(
        method="graph",
        t_s=t,
        occluded=occluded,
        position=path(t) + shift,
        quaternion=turn(t).as_quat(scalar_first=True),
        velocity=np.gradient(path(t), t, axis=0),
        pose_covariance=covariance,
        velocity_covariance=np.tile(np.eye(3) * 1e-4, (count, 1, 1)),
        joints=joints,
        joint_covariance={name: covariance[:, :3, :3] for name in joints},
        gaps=tuple(gaps),
        calibration=ArmCalibration(
            "right",
            {name: LeverArm(lever, np.full(3, 0.004)) for name, lever in LEVERS.items()},
            Length(0.31, 0.01),
        ),
        gravity_direction=np.array([0.0, -1.0, 0.0]),
        clock_offset_s=offset_s,
        clock_offset_sigma_s=0.002,
        arm=on_imu,
        residuals=FrameResiduals(
            on_imu.t_s,
            residual,
            np.isfinite(arm.position).all(axis=2),
            np.zeros(arm.state.shape, np.uint8),
        ),
        side="right",
        name=recording.name,
        notes=("The path was made by hand.",),
        config={"camera": {"joint_sigma_m": 0.01}},
    )
