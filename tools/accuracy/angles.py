"""Joint angles against the truth, with their sigmas: `angles [PRESET ..]`."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from smoother.angles.definitions import JOINT_ANGLES, SHOULDER_TRUNK
from smoother.joint_angles import arm_angles, forearm_axes, wrapped_deg
from smoother.linalg import interpolate
from smoother.rotation import Rotation
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import CHANGES, PRESETS, changes, check, option, rms, seeds_option

#: Of a normal number 95 of 100 lie within this many standard deviations.
Z_95 = 1.96
#: The protocols that every seed of a preset is measured on.
PROTOCOLS = {"behind": {}, "random": {"protocol": "random", "duration_s": 30.0}}


@dataclass(frozen=True)
class AngleErrors:
    """Errors of an angle in one recording, (n,) degrees each, and whether the camera saw the forearm."""

    name: str
    off: np.ndarray
    sigma: np.ndarray
    occluded: np.ndarray


def angle_errors(made: SimulatedArm, imus: int) -> list[AngleErrors]:
    """Errors of every angle that a recovery of a simulated arm has."""
    recorded = replace(made.recording, truth=None, trunk=None)
    if made.recording.trunk is not None:  # a skeleton of two arms, without the IMU
        recorded = replace(recorded, opposite=made.recording.trunk.other_arm)
    if imus == 1:
        recorded = replace(recorded, further_imus={})
    recovery = smooth(recorded, processes=1)
    table, true = recovery.angles(), true_angles(made, recovery.t_s)
    errors = []
    for angle in table.angles:
        off = wrapped_deg(table.values[angle.name] - true[angle.name])
        sigma = table.sigmas[angle.name]
        known = np.isfinite(off) & np.isfinite(sigma)
        if known.any():
            errors.append(AngleErrors(angle.name, off[known], sigma[known], recovery.occluded[known]))
    return errors


def true_angles(made: SimulatedArm, t_s: np.ndarray) -> dict[str, np.ndarray]:
    """The angles of a simulated arm at some times (n,), deg, by the names of the table."""
    truth, side = made.recording.truth, made.recording.side
    assert truth is not None
    joints = {name: interpolate(truth.t_s, place, t_s) for name, place in truth.joints.items()}
    turn, _ = made.motion.imu_pose(t_s)
    quaternion = Rotation.from_matrix(turn).as_quat(scalar_first=True)
    assert made.calibration.R_F_A is not None
    axes = forearm_axes(quaternion, made.calibration.R_F_A)
    angles = arm_angles(joints, len(t_s), axes, side, made.parameters["gravity"])
    if made.trunk_motion is not None:
        R_K_T = made.trunk_motion.thorax(t_s)
        in_T = {name: np.einsum("nji,nj->ni", R_K_T, place) for name, place in joints.items()}
        down, forward = np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0])
        to_trunk = arm_angles(in_T, len(t_s), None, side, down, forward=forward)
        angles |= {angle.name: to_trunk[angle.name.removesuffix("_trunk")] for angle in SHOULDER_TRUNK}
    return angles


def simulated(seed: int, preset: str, settings: dict[str, object]) -> SimulatedArm:
    """An arm with IMUs on upper arm and trunk; every other one is a left arm."""
    side = "left" if seed % 2 else "right"
    config = {"imus": "wrist,upper-arm,trunk", "side": side, "trunk_turn_deg": 5.0} | settings
    return simulate_arm(ArmSimulation.preset(preset, **config), seed=seed)


def _job(seed: int, preset: str, settings: dict[str, object], imus: int) -> list[AngleErrors]:
    return angle_errors(simulated(seed, preset, settings), imus)


@check(
    option("--presets", nargs="+", default=list(PRESETS), choices=PRESETS, help="cameras"),
    option("--imus", type=int, choices=(1, 2), default=1, help="worn on the arm [1]"),
    CHANGES,
    seeds_option("6"),
)
def angles(options: argparse.Namespace) -> Iterator[str]:
    """Errors of joint angles in gaps and in view, and how many lie inside their 95 % intervals."""
    yield f"seeds {options.seeds.start} to {options.seeds.stop - 1}, IMUs: {options.imus}"
    yield f"{'':10} {'':26} {'':7} arms   rms, deg  sigma, deg  squared error / sigma^2  inside 95 %"
    everything: list[AngleErrors] = []
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        for preset in options.presets:
            found: list[AngleErrors] = []
            for protocol in PROTOCOLS.values():
                job = partial(_job, preset=preset, settings=protocol | changes(options), imus=options.imus)
                found += [each for errors in workers.map(job, options.seeds) for each in errors]
            yield from rows(preset, found)
            everything += found
    if len(options.presets) > 1:
        yield from rows("all", everything)


def rows(preset: str, errors: list[AngleErrors]) -> Iterator[str]:
    """A line an angle, in gaps and in view."""
    for name in (angle.name for angle in JOINT_ANGLES):
        mine = [each for each in errors if each.name == name]
        for where, hidden in (("gaps", True), ("in view", False)):
            picked = [each.occluded == hidden for each in mine]
            if not any(rows.any() for rows in picked):
                continue
            off, sigma = (
                np.concatenate([getattr(each, what)[rows] for each, rows in zip(mine, picked, strict=True)])
                for what in ("off", "sigma")
            )
            ratio = off / sigma
            yield (
                f"{preset:10} {name:26} {where:7} {len(mine):4} {rms(off):10.2f} {np.median(sigma):11.2f}"
                f" {np.mean(ratio**2):24.2f} {100 * np.mean(np.abs(ratio) < Z_95):10.1f} %"
            )
