"""Scenes made from simulated recordings with what a calibration would know: the one place that knows how."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from smoother.array_types import FloatArray
from smoother.baselines.scene import Path, Scene
from smoother.measurements.visibility import accepted_samples, find_gaps, visible_frames
from smoother.recording import FOREARM_JOINTS, JOINTS
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm

NO_GAPS: tuple[float, ...] = ()


def arm(preset: str, seed: int = 0, **changes: object) -> SimulatedArm:
    settings = {"protocol": "random", "duration_s": 20.0} | changes
    return simulate_arm(ArmSimulation.preset(preset, **settings), seed=seed)


def scene_of(made: SimulatedArm, tilt_deg: float = 0.0, sigma_m: float | None = None) -> Scene:
    """What a baseline would see of a simulated arm: true calibration and clock, orientation off by a tilt."""
    recording, truth = made.recording, made.recording.truth
    imu = recording.imu
    imu = replace(
        imu,
        acc=imu.acc - made.parameters["accelerometer_bias"],
        gyro=imu.gyro - made.parameters["gyroscope_bias"],
    )
    turn = Rotation.from_rotvec(np.radians(tilt_deg) * np.array([0.6, 0.0, 0.8]))
    R = (turn * Rotation.from_quat(truth.quaternion, scalar_first=True)).as_matrix()
    tracks = recording.arm
    frame_t = tracks.t_s + made.parameters["clock_offset_s"]
    inside = (frame_t >= imu.t_s[0]) & (frame_t <= imu.t_s[-1])
    accepted = accepted_samples(tracks)
    visible = visible_frames(tracks)[inside]
    frame_t = frame_t[inside]
    joints = np.where(accepted[inside, :, None], tracks.position[inside], np.nan)
    R_frames = Slerp(imu.t_s, Rotation.from_matrix(R))(frame_t).as_matrix()
    places = [
        joints[:, JOINTS.index(joint)] - R_frames @ made.calibration.lever_arms[joint].position_m
        for joint in FOREARM_JOINTS
        if joint in made.calibration.lever_arms
    ]
    point = np.where(visible[:, None], np.nanmean(np.where(visible[:, None], places, 0.0), axis=0), np.nan)
    if sigma_m is None:
        sigma_m = 0.008 / np.sqrt(3.0)
    gravity = made.parameters["gravity"]
    return Scene(
        imu=imu,
        R_K_A=R,
        attitude_sigma_rad=float(np.radians(max(tilt_deg, 0.1))),
        gravity=gravity,
        acceleration=np.einsum("nij,nj->ni", R, imu.acc) + gravity,
        frame_t=frame_t,
        joints=joints,
        camera_joints=tracks.position[inside],
        point=point,
        point_sigma_m=sigma_m,
        gaps=find_gaps(frame_t, visible, float(imu.t_s[0]), float(imu.t_s[-1])),
        calibration=made.calibration,
    )


def errors(made: SimulatedArm, path: Path) -> FloatArray:
    """Distance (n,) m of the answer from the truth."""
    truth = made.recording.truth
    return np.linalg.norm(path.position - truth.position, axis=1)


def turned_off(made: SimulatedArm, R_K_A: FloatArray) -> FloatArray:
    """Angle (n,) in degrees of orientations from the truth."""
    truth = made.recording.truth
    true = Rotation.from_quat(truth.quaternion, scalar_first=True)
    return np.degrees((Rotation.from_matrix(R_K_A) * true.inv()).magnitude())


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
