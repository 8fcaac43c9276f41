"""The figures of the live smoother: `live [--gap-s 1]`.

Simulated arms (preset `realistic`, 100 Hz IMU, 30 Hz camera that is 0.1 s late) are played into the live
smoother on a simulated clock, as fast as it goes: it takes its times from the data, so the answers are those
of a recording played at 1x. Processor time is the live thread's; the calibration in the background is apart.
`--hours H` plays the arm over and over instead, and looks at the memory.
"""

from __future__ import annotations

import argparse
import resource
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from smoother.evaluation.compare import arrivals
from smoother.evaluation.metrics import lag_s
from smoother.live.answers import LiveOutput, LiveState
from smoother.live.buffers import ImuBatch
from smoother.live.calibrations import InlineCalibrator
from smoother.live.smoother import LiveSmoother
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from tools.accuracy.check import check, option, rms, seeds_option

LATENCY_S, OFFSET_S = 0.1, -0.02
#: Borders of the time since the last frame, s.
BORDERS_S = (0.0, 0.25, 0.5, 1.0, 1.5, 2.2)
#: The first answers are those of this time, s: until about the second calibration.
FIRST_S = 7.0


@dataclass
class Errors:
    """Errors of all answers."""

    # Time since the last frame (s, 0 where visible), error (m), squared error over variance / 3, time since
    # the first answer (s)
    now: list[tuple[float, float, float, float]] = field(default_factory=list)
    # Time since the last frame (s, 0 where visible), error (m), squared error over variance / 3, time since
    # the first answer (s)
    settled: list[tuple[float, float, float, float]] = field(default_factory=list)
    step_ms: list[float] = field(default_factory=list)
    lags_s: list[float] = field(default_factory=list)

    def add(self, simulation: SimulatedArm, outputs: list[LiveOutput]) -> None:
        """Score one recording's answers."""
        for rows, kind in ((self.now, "now"), (self.settled, "settled")):
            estimates = [e for e in (getattr(output, kind) for output in outputs) if e is not None]
            true = simulation.motion.imu_pose(np.array([e.t_s for e in estimates]))[1]
            for estimate, place in zip(estimates, true, strict=True):
                off = estimate.position - place
                nees = float(off @ np.linalg.solve(estimate.pose_covariance[:3, :3], off)) / 3.0
                since = 0.0 if estimate.since_s is None else estimate.t_s - estimate.since_s
                rows.append((since, float(np.linalg.norm(off)), nees, estimate.t_s - estimates[0].t_s))
            if kind == "now":
                t = np.array([e.t_s for e in estimates])
                shown = np.array([e.position for e in estimates])
                shown[[e.state is not LiveState.VISIBLE for e in estimates]] = np.nan
                lag = lag_s(t, shown, true)
                if lag is not None:
                    self.lags_s.append(lag)
        self.step_ms += [output.step_ms for output in outputs if output.now is not None]

    def show(self) -> Iterator[str]:
        """Print the table."""
        for kind, rows in (("now", np.array(self.now)), ("settled", np.array(self.settled))):
            visible = rows[:, 0] == 0.0
            yield (
                f"{kind}, visible: {100 * rms(rows[visible, 1]):.2f} cm, NEES {rows[visible, 2].mean():.2f}"
            )
            for least, most in pairwise(BORDERS_S):
                part = ~visible & (rows[:, 0] >= least) & (rows[:, 0] < most)
                if part.any():
                    yield (
                        f"  gap since {least:g} to {most:g} s: {100 * rms(rows[part, 1]):.2f} cm,"
                        f" NEES {rows[part, 2].mean():.2f}, {part.sum()} answers"
                    )
            first = visible & (rows[:, 3] < FIRST_S)
            if first.any():
                yield (
                    f"  visible, first {FIRST_S:g} s: {100 * rms(rows[first, 1]):.2f} cm,"
                    f" NEES {rows[first, 2].mean():.2f}"
                )
            hidden = ~visible
            if hidden.any():
                yield (f"  all gaps: {100 * rms(rows[hidden, 1]):.2f} cm, NEES {rows[hidden, 2].mean():.2f}")
        ms = np.array(self.step_ms)
        yield (f"lag left while visible, by arm: {np.round(1e3 * np.array(self.lags_s), 1)} ms")
        yield (
            f"processor time a step: mean {ms.mean():.1f}, 99 % {np.percentile(ms, 99):.1f}, longest"
            f" {ms.max():.1f} ms; load {3 * ms.mean():.0f} % of a core at 30 Hz"
        )


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
        for now_s, batches, frames in arrivals(recording, OFFSET_S, LATENCY_S):
            for batch in batches:
                live.add_imu(batch)
            for segment, imu in further.items():
                new = imu.select((imu.t_s > before_s) & (imu.t_s <= now_s))
                live.add_further_imu(segment, ImuBatch(new.t_s, new.acc, new.gyro))
            before_s = now_s
            for frame in frames:
                live.add_frame(frame)
            outputs.append(live.step(now_s))
    return outputs


def memory(simulation: SimulatedArm, hours: float) -> Iterator[str]:
    """Play the arm over and over and print the memory that is in use."""
    recording, at_s = simulation.recording, 0.0
    length_s = float(recording.imu.t_s[-1]) + 0.01
    with LiveSmoother(
        recording.side, camera_frame=recording.camera_frame, calibrator=InlineCalibrator(15)
    ) as live:
        while at_s < 3600.0 * hours:
            for now_s, batches, frames in arrivals(recording, OFFSET_S, LATENCY_S):
                for batch in batches:
                    live.add_imu(ImuBatch(batch.t_s + at_s, batch.acc, batch.gyro))
                for frame in frames:
                    live.add_frame(replace(frame, t_s=frame.t_s + at_s, arrival_s=frame.arrival_s + at_s))
                live.step(now_s + at_s)
            at_s += length_s
            with open("/proc/self/statm") as file:
                used = int(file.read().split()[1]) * resource.getpagesize() / 1e6
            yield (f"{at_s / 60:.0f} min: {used:.1f} MB")


@check(
    seeds_option("1:11"),
    option("--gap-s", type=float, nargs="+", default=[1.0]),
    option("--duration-s", type=float, default=60.0),
    option("--imus", default="wrist", help="where IMUs are worn, as `simulate arm --imus`"),
    option("--hours", type=float, default=0.0, help="play the arm over and over and print the memory"),
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
    if options.hours:
        yield from memory(simulate_arm(config, options.seeds.start), options.hours)
        return
    errors = Errors()
    for seed in options.seeds:
        simulation = simulate_arm(config, seed)
        errors.add(simulation, play(simulation))
        yield f"seed {seed} done"
    yield from errors.show()
