"""Shoulder angles relative to the trunk, with an IMU on it and without: `trunk`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.joint_angles import wrapped_deg
from smoother.result import Recovery
from smoother.result.segment_motion import SegmentMotion, TrunkMotion
from smoother.shoulder_angles import SHOULDER_ANGLES, TRUNK_ANGLES, shoulder_angles, trunk_angles
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import CHANGES, Check, changes, preset_option, rms, seeds_option

#: A humerus that is raised by less, or nearly upright, has no plane of elevation, degrees.
RAISED_DEG = (25.0, 155.0)


def compare_trunk(options: argparse.Namespace) -> Iterator[str]:
    """Shoulder angles relative to the thorax: by an IMU on it, and as if the trunk stood still."""
    settings = {
        "imus": "wrist,upper-arm,trunk",
        "protocol": "random",
        "duration_s": 60.0,
        "trunk_turn_deg": 10.0,
    } | changes(options)
    yield (f"preset {options.preset} {settings}")
    tilt, heading, squares = [], [], []
    angles: dict[str, list[np.ndarray]] = {}
    for seed in options.seeds:
        made = simulate_arm(ArmSimulation.preset(options.preset, **settings), seed=seed)
        recovery = smooth(replace(made.recording, truth=None), processes=1)
        if recovery.trunk is None or made.trunk_motion is None:
            yield (f"seed {seed}: {recovery.notes[-1]}")
            continue
        error, square = _thorax(recovery, made)
        tilt.append(error[:, [0, 2]])
        heading.append(error[:, 1])
        squares.append(square)
        yield (
            f"seed {seed:3}: lean {rms(error[:, [0, 2]]):.2f}, heading {rms(error[:, 1]):.2f} deg,"
            f" squared error / sigma^2 {np.mean(square):.2f}"
        )
        for name, errors in _angles(recovery, made).items():
            angles.setdefault(name, []).append(errors)
    if not tilt:
        return
    yield (
        f"all: lean {rms(np.vstack(tilt)):.2f}, heading {rms(np.concatenate(heading)):.2f} deg,"
        f" squared error / sigma^2 {np.mean(np.concatenate(squares)):.2f}"
    )
    for name, values in angles.items():
        with_imu, without, ratio = np.vstack(values).T
        yield (
            f"  {name:26} rms {rms(with_imu):5.2f} deg, without the trunk's IMU {rms(without):5.2f} deg,"
            f" squared error / sigma^2 {np.mean(ratio**2):.2f}"
        )


def _thorax(recovery: Recovery, made: SimulatedArm) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n, 3) about the thorax's axes, degrees, and squared errors over sigma^2 (n,)."""
    trunk = recovery.trunk
    assert trunk is not None and made.trunk_motion is not None
    known = np.isfinite(trunk.quaternion[:, 0])
    R = Rotation.from_quat(trunk.quaternion[known], scalar_first=True).as_matrix()
    true = made.trunk_motion.thorax(recovery.t_s[known])
    error = Rotation.from_matrix(np.swapaxes(true, 1, 2) @ R).as_rotvec()
    covariance = np.swapaxes(R, 1, 2) @ trunk.covariance[known] @ R + np.diag(trunk.mount_sigma_rad**2)
    return np.degrees(error), np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 3.0


def _angles(recovery: Recovery, made: SimulatedArm) -> dict[str, np.ndarray]:
    """By angle: error with the trunk's IMU, without it, degrees, and the first over sigma, (n, 3)."""
    assert made.trunk_motion is not None and made.upper_motion is not None and recovery.trunk is not None
    answer, sigma = trunk_angles(recovery)
    upright, _ = shoulder_angles(recovery)
    # the truth by the same functions, on the bone itself
    t, n = recovery.t_s, len(recovery)
    nothing = np.zeros((n, 6, 6))
    thorax = Rotation.from_matrix(made.trunk_motion.thorax(t)).as_quat(scalar_first=True)
    _, R_K_U = made.motion.upper_arm(t)  # type: ignore[attr-defined]
    bone = R_K_U @ made.upper_motion.mount.axes
    quaternion = Rotation.from_matrix(bone).as_quat(scalar_first=True)
    true = replace(
        recovery,
        calibration=made.calibration,
        trunk=TrunkMotion(thorax, nothing[:, :3, :3], np.eye(3), np.zeros(3)),
        segments={"upper_arm": SegmentMotion(np.zeros((n, 3)), quaternion, nothing, np.zeros(3))},
    )
    truth, _ = trunk_angles(true)
    elevation = truth["shoulder_elevation_trunk"]
    rows = (elevation > RAISED_DEG[0]) & (elevation < RAISED_DEG[1])
    rows &= np.isfinite(answer["shoulder_elevation_trunk"])
    out = {}
    for name, plain in zip(TRUNK_ANGLES, SHOULDER_ANGLES, strict=True):
        off = wrapped_deg(answer[name] - truth[name])[rows]
        out[name] = np.stack(
            [off, wrapped_deg(upright[plain] - truth[name])[rows], off / sigma[name][rows]], axis=1
        )
    return out


CHECKS = (Check("trunk", compare_trunk, (preset_option("realistic"), CHANGES, seeds_option("3"))),)
