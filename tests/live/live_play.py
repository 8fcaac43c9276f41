"""Recordings played into a live smoother on a simulated clock, and its answers scored."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np

from smoother.live.answers import LiveOutput
from smoother.live.buffers import SkeletonFrame
from smoother.live.calibrations import InlineCalibrator
from smoother.live.smoother import LiveSmoother
from smoother.recording import ImuStream
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm

LATENCY_S = 0.1
#: The realistic preset stamps frames late by so much: t_imu = t_camera - 0.02.
OFFSET_S = -0.02

#: What arrives when: a frame, or samples of the IMU on a segment.
Event = tuple[float, SkeletonFrame | tuple[ImuStream, str]]


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


def events(simulation: SimulatedArm) -> list[Event]:
    """Arrivals in order of time: IMU samples by fives, frames after the camera's latency."""
    recording, arm = simulation.recording, simulation.recording.arm
    arrivals: list[Event] = []
    for segment, imu in {"forearm": recording.imu, **recording.further_imus}.items():
        for first in range(0, len(imu), 5):
            samples = imu.select(slice(first, first + 5))
            arrivals.append((float(samples.t_s[-1]), (samples, segment)))
    for t, position, state in zip(arm.t_s, arm.position, arm.state, strict=True):
        arrival = float(t) + OFFSET_S + LATENCY_S
        arrivals.append((arrival, SkeletonFrame(float(t), arrival, position, state)))
    return sorted(arrivals, key=lambda event: event[0])


def play(
    arrivals: list[Event], smoother: LiveSmoother | None = None, step_s: float = 1 / 30
) -> Iterator[LiveOutput]:
    """The answers of a live smoother, a step every `step_s`."""
    live = smoother or LiveSmoother("right", calibrator=InlineCalibrator(5))
    with live:
        next_s = arrivals[0][0] + step_s
        for at, event in arrivals:
            while at > next_s:
                yield live.step(next_s)
                next_s += step_s
            if isinstance(event, tuple):
                live.add_imu(*event)
            else:
                live.add_frame(event)
        yield live.step(next_s)


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
