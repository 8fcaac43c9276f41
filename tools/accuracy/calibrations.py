"""Clocks on simulated data: `clock [sound|broadcast|motion|skew]`.

Beeps in rooms with a voice, broadcasts with missing and late receptions (steps of 0.3125 ms), the realistic
arm, and 15 minutes of it with a clock that runs 390 ppm fast.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from calib.clock import clock_from_motion, solve_clocks
from calib.sound import find_beeps
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.rig import beep, broadcast
from tools.accuracy.check import ONE_PROCESS, check, parts_option, rms, seeds_option

SKEW = 390e-6


#: What is stated of an offset, s: how far off it is and its sigma; of a clock that runs fast, ppm off.
Stated = Iterator[tuple[float, float, float]]


def row(name: str, found: Stated, of_skew: str = "") -> str:
    """A line of figures."""
    error, sigma, skew = np.array(list(found)).T * [[1e3], [1e3], [1.0]]
    skews = {"rms": f"skew rms {rms(skew):.2f} ppm", "max": f"skew max {np.abs(skew).max():.1f} ppm off"}
    return (
        f"{name:34} rms {rms(error):7.3f} ms  max {np.abs(error).max():7.3f} ms  stated"
        f" {np.median(sigma):6.3f} ms  squared error / sigma^2 {np.mean((error / sigma) ** 2):5.2f} "
        f" {skews.get(of_skew, '')}"
    )


def beeps(seeds: range, rate_hz: int, quiet_db: float) -> Stated:
    for seed in seeds:
        samples, end, _ = beep(seed, rate_hz, quiet_db)
        nearest = min(find_beeps(samples, rate_hz), key=lambda each: abs(each.end_s - end))
        yield nearest.end_s - end, nearest.sigma_s, np.nan


def receptions(seeds: range, nodes: int, rounds: int, span_s: float) -> Stated:
    for seed in seeds:
        clocks, heard = broadcast(seed, nodes=nodes, rounds=rounds, span_s=span_s)
        for link in solve_clocks([heard]).links():
            yield clocks.error_s(link), link.sigma_s, clocks.skew_error_ppm(link)


def moved(seeds: range, fast: float, **settings: Any) -> Stated:
    """By the motion of the realistic arm; the IMU's clock runs fast."""
    for seed in seeds:
        made = simulate_arm(ArmSimulation.preset("realistic", **settings), seed)
        imu = made.recording.imu
        recording = replace(made.recording, imu=replace(imu, t_s=imu.t_s * (1 + fast)))
        link = clock_from_motion(recording, None, ONE_PROCESS).link
        at_s = link.at_s if fast else 0.0
        true = (at_s + made.parameters["clock_offset_s"]) * (1 + fast) - at_s
        yield link.offset_s - true, link.sigma_s, link.skew_ppm - 1e6 * fast


CLOCKS = ("sound", "broadcast", "motion", "skew")


@check(
    parts_option(*CLOCKS),
    seeds_option("16"),
)
def clock(options: argparse.Namespace) -> Iterator[str]:
    """Clock offsets by a beep, by broadcasts and by motion, against the simulated ones."""
    parts, seeds = options.parts or CLOCKS, options.seeds
    if "sound" in parts:
        for rate_hz, quiet_db in ((16000, 25.0), (44100, 25.0), (16000, 10.0)):
            name = f"sound, {rate_hz} Hz, noise -{quiet_db:.0f} dB"
            yield row(name, beeps(seeds, rate_hz, quiet_db))
    if "broadcast" in parts:
        for nodes, rounds, span_s in ((2, 20, 900.0), (5, 20, 900.0), (3, 20, 5.0), (3, 8, 60.0)):
            name = f"broadcast, {nodes} nodes, {rounds} in {span_s:.0f} s"
            yield row(name, receptions(seeds, nodes, rounds, span_s), "rms")
    if "motion" in parts:
        yield row("motion, realistic arm", moved(seeds, 0.0))
    if "skew" in parts:
        few = seeds[: max(len(seeds) // 8, 2)]
        found = moved(few, SKEW, protocol="random", duration_s=900.0)
        yield row("motion, 15 minutes, 390 ppm", found, "max")
