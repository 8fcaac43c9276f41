"""How good the clocks are: `clock [sound|broadcast|motion|skew]`.

Everything is simulated, with its truth: beeps in rooms with a voice, broadcasts with missing and late
receptions (steps of 0.3125 ms), the realistic arm, and 15 minutes of it with a clock that runs 390 ppm fast.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib.clock.beeps import find_beeps
from calib.clock.motion_clock import clock_from_motion
from calib.clock.network import solve_clocks
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.clocks import beep, broadcast
from tools.accuracy.check import ONE_PROCESS, Check, parts_option, rms, seeds_option

SKEW = 390e-6


def show(name: str, errors_ms: list[float], sigmas_ms: list[float], more: str = "") -> Iterator[str]:
    """Print one line of figures."""
    error, sigma = np.array(errors_ms), np.array(sigmas_ms)
    yield (
        f"{name:34} rms {rms(error):7.3f} ms  max {np.abs(error).max():7.3f} ms  stated"
        f" {np.median(sigma):6.3f} ms  squared error / sigma^2 {np.mean((error / sigma) ** 2):5.2f}  {more}"
    )


def sound(seeds: range) -> Iterator[str]:
    """The end of a beep."""
    for rate_hz, quiet_db in ((16000, 25.0), (44100, 25.0), (16000, 10.0)):
        errors, sigmas = [], []
        for seed in seeds:
            samples, end, _ = beep(seed, rate_hz, quiet_db)
            nearest = min(find_beeps(samples, rate_hz), key=lambda each: abs(each.end_s - end))
            errors.append(1e3 * (nearest.end_s - end))
            sigmas.append(1e3 * nearest.sigma_s)
        yield from show(f"sound, {rate_hz} Hz, noise -{quiet_db:.0f} dB", errors, sigmas)


def broadcasts(seeds: range) -> Iterator[str]:
    """Offsets from receptions."""
    for nodes, rounds, span_s in ((2, 20, 900.0), (5, 20, 900.0), (3, 20, 5.0), (3, 8, 60.0)):
        errors, sigmas, skews = [], [], []
        for seed in seeds:
            clocks, heard = broadcast(seed, nodes=nodes, rounds=rounds, span_s=span_s)
            for link in solve_clocks([heard]).links():
                errors.append(1e3 * clocks.error_s(link))
                sigmas.append(1e3 * link.sigma_s)
                skews.append(clocks.skew_error_ppm(link))
        name = f"broadcast, {nodes} nodes, {rounds} in {span_s:.0f} s"
        yield from show(name, errors, sigmas, f"skew rms {rms(skews):.2f} ppm")


def motion(seeds: range) -> Iterator[str]:
    """Offset of the realistic arm (30-40 s) from motion."""
    errors, sigmas = [], []
    for seed in seeds:
        simulated = simulate_arm(ArmSimulation.preset("realistic"), seed)
        link = clock_from_motion(simulated.recording, None, ONE_PROCESS).link
        errors.append(1e3 * (link.offset_s - simulated.parameters["clock_offset_s"]))
        sigmas.append(1e3 * link.sigma_s)
    yield from show("motion, realistic arm", errors, sigmas)


def skew(seeds: range) -> Iterator[str]:
    """15 minutes of the realistic arm with an IMU whose clock runs 390 ppm fast."""
    errors, sigmas, skews = [], [], []
    for seed in seeds[: max(len(seeds) // 8, 2)]:
        config = ArmSimulation.preset("realistic", protocol="random", duration_s=900.0)
        simulated = simulate_arm(config, seed)
        imu = simulated.recording.imu
        fast = replace(simulated.recording, imu=replace(imu, t_s=imu.t_s * (1 + SKEW)))
        link = clock_from_motion(fast, None, ONE_PROCESS).link
        true = (link.at_s + simulated.parameters["clock_offset_s"]) * (1 + SKEW) - link.at_s
        errors.append(1e3 * (link.offset_s - true))
        sigmas.append(1e3 * link.sigma_s)
        skews.append(link.skew_ppm - 1e6 * SKEW)
    yield from show(
        "motion, 15 minutes, 390 ppm", errors, sigmas, f"skew max {np.abs(skews).max():.1f} ppm off"
    )


PARTS = {"sound": sound, "broadcast": broadcasts, "motion": motion, "skew": skew}


def clock(options: argparse.Namespace) -> Iterator[str]:
    """Clock offsets by a beep, by broadcasts and by motion, against the simulated ones."""
    for part in options.parts or PARTS:
        yield from PARTS[part](options.seeds)


CHECKS = (Check("clock", clock, (parts_option(*PARTS), seeds_option("16"))),)
