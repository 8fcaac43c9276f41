"""The held pose and the strap on simulated data: `forearm [pose|strap]`.

`pose`: realistic arms; whether pose and motion agree, and whether lever arms and roll are as good as stated.
`strap`: rendered images with joints 8 mm off, markers beside the strap, a body before the arm.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator

import numpy as np

from calib.forearm.forearm_summary import compare
from calib.forearm.held_pose import calibrate_forearm
from calib.intrinsics import Intrinsics, PlacedCamera
from calib.strap.strap_in_image import Depth, find_strap
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.strap import Arm, StrapImageNoise, render
from tools.accuracy.check import ONE_PROCESS, Check, parts_option, rms, seeds_option

COLOUR = PlacedCamera(Intrinsics(960, 540, 600.0, 600.0, 480.0, 270.0), t_C_K=np.array([0.05, 0.0, 0.0]))
INFRARED = PlacedCamera(Intrinsics(512, 424, 366.0, 366.0, 256.0, 212.0))


def pose(seeds: range) -> Iterator[str]:
    """Pose against motion, with the strap seen and with the strap's place by ruler."""
    for seen in (True, False):
        agree, asked = Counter[str](), Counter[str]()
        levers, rolls = [], []
        for seed in seeds:
            arm = simulate_arm(ArmSimulation.preset("realistic", repetitions=1, strap=seen), seed)
            to_wrist = None if seen else arm.parameters["strap_to_wrist_m"]
            found = calibrate_forearm(
                arm.recording,
                radius_m=None if seen else 0.035,
                strap_to_wrist_m=to_wrist,
                config=ONE_PROCESS,
            )
            for row in compare(found):
                asked[row.name] += 1
                agree[row.name] += row.agrees
            for joint, lever in found.calibration.lever_arms.items():
                error = lever.position_m - arm.calibration.lever_arms[joint].position_m
                levers += np.square(error / lever.sigma_m).tolist()
            if found.calibration.R_F_A is not None and arm.calibration.R_F_A is not None:
                turn = found.calibration.R_F_A @ arm.calibration.R_F_A.T
                rolls.append(np.degrees(np.arctan2(turn[0, 2], turn[0, 0])))
        yield ("strap seen" if seen else "strap by ruler")
        yield "  agree: " + ", ".join(f"{name} {agree[name]} of {asked[name]}" for name in asked)
        nees = np.mean(levers)
        yield (f"  lever arms: squared error / sigma^2 {nees:.2f}; roll rms {rms(rolls):.0f} degrees")


def strap(seeds: range) -> Iterator[str]:
    """The arm's core under the strap; and what is accepted where no strap can be seen."""
    for sigma_m in (0.0, 0.003, 0.008):
        errors, nees, reasons, wrong = [], [], Counter[str](), 0
        for seed in range(5 * len(seeds)):
            rng = np.random.default_rng(seed)
            along = rng.normal(size=3) * [1.0, 1.0, 0.5]
            elbow = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), rng.uniform(1.5, 2.5)])
            length = rng.uniform(0.23, 0.28)
            wrist = elbow + length * along / np.linalg.norm(along)
            marker = (None, 0.03, -0.03)[int(rng.integers(3))]
            arm = Arm(elbow, wrist, rng.uniform(0.03, 0.04), length - rng.uniform(0.03, 0.07), marker=marker)
            body = (0.5 * (elbow + wrist) - [0.0, 0.0, 0.3], np.array([0.22, 0.4, 0.12]))
            hidden = Arm(elbow, wrist, arm.radius, arm.strap, trunk=body)
            for one in (arm, hidden):
                noise = StrapImageNoise(rng=rng)
                grey, _ = render(one, COLOUR, noise)
                depth = Depth(render(one, INFRARED, noise)[1], INFRARED)
                ends = [end + rng.normal(0, sigma_m, 3) for end in (elbow, wrist)]
                seen = find_strap(
                    grey, COLOUR, depth, *ends, radius_m=arm.radius, joint_sigma_m=max(sigma_m, 0.003)
                )
                if one is hidden:
                    wrong += seen.found
                    continue
                reasons[seen.reason or "found"] += 1
                if seen.found:
                    error = seen.core - arm.strap_core
                    errors.append(error)
                    nees.append(error @ np.linalg.solve(seen.covariance, error) / 3)
        size = 1e3 * np.linalg.norm(errors, axis=1)
        yield (
            f"joints {1e3 * sigma_m:.0f} mm off: core rms {rms(size):.1f} mm, max {size.max():.1f} mm,"
            f" squared error / sigma^2 {np.mean(nees):.2f}; {dict(reasons)}; accepted behind a body: {wrong}"
        )


PARTS = {"pose": pose, "strap": strap}


def forearm(options: argparse.Namespace) -> Iterator[str]:
    """The forearm by its held pose and by the strap in images, against the simulated one."""
    for part in options.parts or PARTS:
        yield from PARTS[part](options.seeds)


CHECKS = (
    Check(
        "forearm",
        forearm,
        (parts_option(*PARTS), seeds_option("20:32", "`strap`: five for each")),
    ),
)
