"""Recoveries to measure: the truth of a simulated arm in an answer's place, with deviations as draws."""

from __future__ import annotations

from dataclasses import replace

import made_results
import numpy as np

from smoother.array_types import FloatArray
from smoother.measurements.visibility import Gap
from smoother.result import Draws, Estimates, Recovery
from smoother.simulation import ArmSimulation, simulate_arm


def recovery_of(
    t_s: FloatArray, joints: dict[str, FloatArray], side: str = "right", down: FloatArray | None = None
) -> Recovery:
    """A recovery of some joints; gravity along -y, which is level for a Kinect, if not said."""
    n = len(t_s)
    base = made_results.recovery(side=side)
    hand = next(joints[name] for name in ("hand", "wrist", "elbow") if name in joints)
    return replace(
        base,
        t_s=t_s,
        occluded=np.zeros(n, dtype=bool),
        position=hand,
        quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        velocity=np.gradient(hand, t_s, axis=0),
        pose_covariance=np.zeros((n, 6, 6)),
        velocity_covariance=np.zeros((n, 3, 3)),
        joints=joints,
        joint_covariance={name: np.zeros((n, 3, 3)) for name in joints},
        gaps=(),
        gravity_direction=np.array([0.0, -1.0, 0.0]) if down is None else down,
        estimates=Estimates(trusted=True),
        trunk=None,
        draws=None,
    )


def simulated(seed: int = 0, side: str = "right", **changes: object) -> Recovery:
    """The truth of a simulated arm as an answer; its gaps are those of the camera."""
    config = ArmSimulation.preset("clean", side=side, **changes)  # type: ignore[arg-type]
    arm = simulate_arm(config, seed)
    truth = arm.recording.truth
    down = arm.parameters["gravity"] / np.linalg.norm(arm.parameters["gravity"])
    recovery = recovery_of(truth.t_s, dict(truth.joints), side, down)
    frames = arm.recording.arm.t_s
    occluded = np.interp(truth.t_s, frames, arm.occluded.astype(float)) > 0.5
    return replace(
        recovery,
        quaternion=truth.quaternion,
        position=truth.position,
        occluded=occluded,
        calibration=arm.calibration,
        name=f"simulated {seed}",
        gaps=(Gap(0.1, 0.2),),
    )


def with_draws(recovery: Recovery, count: int = 30, sigma_m: float = 0.01, seed: int = 0) -> Recovery:
    """With slow deviations of the wrist and the hand: sinusoids of random phase, below 1 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(recovery.t_s[0], recovery.t_s[-1], 0.1)
    frequency, phase = rng.uniform(0.1, 0.8, (count, 1, 3)), rng.uniform(0, 2 * np.pi, (count, 1, 3))
    swing = np.sqrt(2.0) * sigma_m * np.sin(2 * np.pi * frequency * t[:, None] + phase)
    still = np.zeros_like(swing)
    joints = {name: swing if name in ("wrist", "hand") else still for name in recovery.joints}
    return replace(recovery, draws=Draws(t, seed, swing, still, joints))


def minimum_jerk(t_s: FloatArray, start_s: float, end_s: float) -> FloatArray:
    """Way (n,) from 0 to 1 of a movement of minimum jerk between two times (Flash and Hogan 1985)."""
    u = np.clip((t_s - start_s) / (end_s - start_s), 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
