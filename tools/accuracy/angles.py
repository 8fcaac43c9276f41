"""Joint angles against the truth, with their sigmas: `angles [PRESET ..]`."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from smoother.angles.definitions import SHOULDER_TRUNK
from smoother.joint_angles import arm_angles, forearm_axes, wrapped_deg
from smoother.linalg import interpolate
from smoother.rotation import Rotation
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import CHANGES, PRESETS, changes, check, error_table, option, seeds_option

#: The protocols that every seed of a preset is measured on.
PROTOCOLS = ({}, {"protocol": "random", "duration_s": 30.0})


def angle_errors(case: tuple[str, dict[str, Any], int], more: dict[str, Any], imus: int) -> list[Any]:
    """Errors of every angle that a recovery of an arm with IMUs on upper arm and trunk has, degrees."""
    preset, protocol, seed = case
    side = "left" if seed % 2 else "right"
    config = {"imus": "wrist,upper-arm,trunk", "side": side, "trunk_turn_deg": 5.0} | protocol | more
    made = simulate_arm(ArmSimulation.preset(preset, **config), seed=seed)
    recorded = replace(made.recording, truth=None, trunk=None)
    if made.recording.trunk is not None:  # a skeleton of two arms, without the IMU
        recorded = replace(recorded, opposite=made.recording.trunk.other_arm)
    if imus == 1:
        recorded = replace(recorded, further_imus={})
    recovery = smooth(recorded, processes=1)
    table, true, errors = recovery.angles(), true_angles(made, recovery.t_s), []
    place = np.where(recovery.occluded, "gaps", "in view")
    for angle in table.angles:
        off, sigma = wrapped_deg(table.values[angle.name] - true[angle.name]), table.sigmas[angle.name]
        known = np.isfinite(off) & np.isfinite(sigma)
        labels = {"preset": preset, "angle": angle.name, "place": place[known]}
        errors.append(labels | {"off": off[known], "sigma": sigma[known]})
    return errors


def true_angles(made: SimulatedArm, t_s: np.ndarray) -> dict[str, np.ndarray]:
    """The angles of a simulated arm at some times (n,), deg, by the names of the table."""
    truth, side = made.recording.truth, made.recording.side
    assert truth is not None and made.calibration.R_F_A is not None
    joints = {name: interpolate(truth.t_s, place, t_s) for name, place in truth.joints.items()}
    quaternion = Rotation.from_matrix(made.motion.imu_pose(t_s)[0]).as_quat(scalar_first=True)
    axes = forearm_axes(quaternion, made.calibration.R_F_A)
    angles = arm_angles(joints, len(t_s), axes, side, made.parameters["gravity"])
    if made.trunk_motion is not None:
        R_K_T = made.trunk_motion.thorax(t_s)
        in_T = {name: np.einsum("nji,nj->ni", R_K_T, place) for name, place in joints.items()}
        down, forward = np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0])
        to_trunk = arm_angles(in_T, len(t_s), None, side, down, forward=forward)
        angles |= {angle.name: to_trunk[angle.name.removesuffix("_trunk")] for angle in SHOULDER_TRUNK}
    return angles


@check(
    option("--presets", nargs="+", default=list(PRESETS), choices=PRESETS, help="cameras"),
    option("--imus", type=int, choices=(1, 2), default=1, help="worn on the arm [1]"),
    CHANGES,
    seeds_option("6"),
)
def angles(options: argparse.Namespace) -> Iterator[str]:
    """Errors of joint angles in gaps and in view, degrees, and how many lie inside their 95 % intervals."""
    cases = [*product(options.presets, PROTOCOLS, options.seeds)]
    job = partial(angle_errors, more=changes(options), imus=options.imus)
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        found = [each for errors in workers.map(job, cases) for each in errors]
    yield from error_table(found, "preset, angle, place")
