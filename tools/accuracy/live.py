"""The figures of the live smoother: `live [--gap-s 1]`.

Simulated arms (preset `realistic`, 100 Hz IMU, 30 Hz camera that is 0.1 s late) are played into the live
smoother on a simulated clock, as fast as it goes: it takes its times from the data, so the answers are those
of a recording played at 1x. Processor time is the live thread's; the calibration in the background is apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np

from smoother.evaluation.metrics import CHI2_95_3, lag_s, squared_sigmas
from smoother.live.answers import LiveOutput, LiveState
from smoother.live.buffers import SkeletonFrame
from smoother.live.calibrations import InlineCalibrator
from smoother.live.smoother import LiveSmoother
from smoother.recording import ImuStream, Recording
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from tools.accuracy.check import check, error_table, option, seeds_option

LATENCY_S, OFFSET_S = 0.1, -0.02
#: Answers are asked for at this rate, Hz.
RATE_HZ = 30.0
#: Borders of the time since the last frame, s.
BORDERS_S = (0.0, 0.25, 0.5, 1.0, 1.5, 2.2)
#: The first answers are those of this time, s: until about the second calibration.
FIRST_S = 7.0


def scored(
    simulation: SimulatedArm, outputs: list[LiveOutput], kind: str
) -> tuple[dict[str, Any], float | None]:
    """Of each answer the time since the last frame, s, and its error, cm; the lag in view, s."""
    estimates = [each for each in (getattr(output, kind) for output in outputs) if each is not None]
    t_s = np.array([each.t_s for each in estimates])
    true = simulation.motion.imu_pose(t_s)[1]
    shown = np.array([each.position for each in estimates])
    covariance = np.array([each.pose_covariance[:3, :3] for each in estimates])
    since = np.array([-1.0 if each.since_s is None else each.t_s - each.since_s for each in estimates])
    squared = squared_sigmas(shown - true, covariance)
    found = {
        "answer": kind,
        "since_s": np.array([-1.0, *BORDERS_S])[np.searchsorted(BORDERS_S, since, "right")],
        "first": t_s - t_s[0] < FIRST_S,
        "off": 100 * np.linalg.norm(shown - true, axis=1),
        "sigma": 100 * np.sqrt(np.trace(covariance, axis1=1, axis2=2)),
        "squared": squared / 3.0,
        "inside": squared <= CHI2_95_3,
    }
    shown[[each.state is not LiveState.VISIBLE for each in estimates]] = np.nan
    return found, lag_s(t_s, shown, true)


def arrivals(recording: Recording) -> Iterator[tuple[float, ImuStream, list[SkeletonFrame]]]:
    """Step by step what has arrived since the last one: the time, samples, frames."""
    imu, arm = recording.imu, recording.arm
    arrival_s = np.asarray(arm.t_s) + OFFSET_S + LATENCY_S
    first = frame = 0
    for now_s in np.arange(float(imu.t_s[0]), float(imu.t_s[-1]), 1.0 / RATE_HZ).tolist():
        last = int(np.searchsorted(imu.t_s, now_s, side="right"))
        until = int(np.searchsorted(arrival_s, now_s, side="right"))
        frames = [
            SkeletonFrame(float(arm.t_s[k]), float(arrival_s[k]), np.array(arm.position[k]), arm.state[k])
            for k in range(frame, until)
        ]
        yield now_s, imu.select(slice(first, last)), frames
        first, frame = last, until


def play(simulation: SimulatedArm) -> list[LiveOutput]:
    """All answers of one recording."""
    recording, outputs = simulation.recording, []
    further, before_s = recording.further_imus, -np.inf
    with LiveSmoother(
        recording.side,
        camera_frame=recording.camera_frame,
        calibrator=InlineCalibrator(15),
        further=list(further),
    ) as live:
        for now_s, samples, frames in arrivals(recording):
            live.add_imu(samples)
            for segment, imu in further.items():
                live.add_imu(imu.select((imu.t_s > before_s) & (imu.t_s <= now_s)), segment)
            before_s = now_s
            for frame in frames:
                live.add_frame(frame)
            outputs.append(live.step(now_s))
    return outputs


@check(
    seeds_option("1:11"),
    option("--gap-s", type=float, nargs="+", default=[1.0]),
    option("--duration-s", type=float, default=60.0),
    option("--imus", default="wrist", help="where IMUs are worn, as `simulate arm --imus`"),
)
def live(options: argparse.Namespace) -> Iterator[str]:
    """Errors of what is shown now and a lag ago, by the time since the last frame; lag and processor time."""
    config = ArmSimulation.preset(
        "realistic",
        protocol="random",
        duration_s=options.duration_s,
        imu_rate_hz=100,
        occlusion_lengths_s=tuple(options.gap_s),
        imus=options.imus,
    )
    found, step_ms, lags_s = [], list[float](), list[float]()
    for seed in options.seeds:
        simulation = simulate_arm(config, seed)
        outputs = play(simulation)
        for kind in ("now", "settled"):
            errors, lag = scored(simulation, outputs, kind)
            found.append(errors)
            lags_s += [lag] if kind == "now" and lag is not None else []
        step_ms += [output.step_ms for output in outputs if output.now is not None]
        yield f"seed {seed} done"
    yield "errors, cm, by the time since the last frame (-1: visible), and of the first seconds"
    yield from error_table(found, "answer, since_s")
    yield from error_table(found, "answer, since_s < 0, first")
    ms = np.array(step_ms)
    yield f"lag left while visible, by arm: {np.round(1e3 * np.array(lags_s), 1)} ms"
    yield (
        f"processor time a step: mean {ms.mean():.1f}, 99 % {np.percentile(ms, 99):.1f}, longest"
        f" {ms.max():.1f} ms; load {3 * ms.mean():.0f} % of a core at 30 Hz"
    )
