"""Simulated arms for the live smoother, and its answers scored."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from smoother.live.answers import LiveOutput
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm


def simulated(
    seed: int,
    duration_s: float = 30.0,
    gaps_s: tuple[float, ...] = (1.0,),
    imus: Literal["wrist", "wrist,upper-arm", "wrist,hand"] = "wrist",
) -> SimulatedArm:
    """A realistic arm with 100 Hz IMUs."""
    config = ArmSimulation.preset(
        "realistic",
        protocol="random",
        duration_s=duration_s,
        imu_rate_hz=100,
        occlusion_lengths_s=gaps_s,
        imus=imus,
    )
    return simulate_arm(config, seed)


def errors(
    simulation: SimulatedArm,
    outputs: list[LiveOutput],
    kind: str = "now",
    which: Callable[[LiveOutput], bool] = lambda output: True,
) -> np.ndarray:
    """Error (n,), m, and squared error over variance (n,) / 3 of the IMU's position: (n, 2)."""
    rows = []
    for output in outputs:
        estimate = getattr(output, kind)
        if estimate is None or not which(output):
            continue
        true = simulation.motion.imu_pose(np.array([estimate.t_s]))[1][0]
        off = estimate.position - true
        nees = off @ np.linalg.solve(estimate.pose_covariance[:3, :3], off) / 3.0
        rows.append((np.linalg.norm(off), nees))
    return np.array(rows)


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
