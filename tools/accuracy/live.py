"""The live smoother on simulated arms: `live [--gap-s 1]`, and the rows of `oracle`.

Simulated arms (preset `realistic`, 100 Hz IMU, 30 Hz camera that is 0.1 s late) are played into the live
smoother on a simulated clock, as fast as it goes: it takes its times from the data, so the answers are those
of a recording played at 1x. Processor time is the live thread's; the calibration in the background is apart.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np

from smoother.live.answers import LiveOutput
from smoother.live.buffers import SkeletonFrame
from smoother.live.calibrations import InlineCalibrator
from smoother.live.smoother import LiveSmoother
from smoother.recording import ImuStream, Recording
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from tools.accuracy.check import check, option, seeds_option

LATENCY_S, OFFSET_S = 0.1, -0.02
#: Answers are asked for at this rate, Hz.
RATE_HZ = 30.0


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
    """Processor time of a step, by the live thread; errors are rows of `oracle`."""
    config = ArmSimulation.preset(
        "realistic",
        protocol="random",
        duration_s=options.duration_s,
        imu_rate_hz=100,
        occlusion_lengths_s=tuple(options.gap_s),
        imus=options.imus,
    )
    step_ms = list[float]()
    for seed in options.seeds:
        step_ms += [each.step_ms for each in play(simulate_arm(config, seed)) if each.now is not None]
        yield f"seed {seed} done"
    ms = np.array(step_ms)
    yield (
        f"processor time a step: mean {ms.mean():.1f}, 99 % {np.percentile(ms, 99):.1f}, longest"
        f" {ms.max():.1f} ms; load {3 * ms.mean():.0f} % of a core at 30 Hz"
    )
