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
from tools.accuracy.check import ONE_PROCESS, check, error_table, parts_option, seeds_option

SKEW = 390e-6
#: What is stated of an offset: how far off it is and its sigma, s; of a clock that runs fast, ppm off.
Stated = Iterator[tuple[float, float, float]]


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
        yield link.offset_s - true, link.sigma_s, link.skew_ppm - 1e6 * fast if fast else np.nan


@check(parts_option("sound", "broadcast", "motion", "skew"), seeds_option("16"))
def clock(options: argparse.Namespace) -> Iterator[str]:
    """Clock offsets by a beep, by broadcasts and by motion, against the simulated ones."""
    seeds = options.seeds
    few = seeds[: max(len(seeds) // 8, 2)]
    sources = [
        (f"sound, {rate_hz} Hz, noise -{quiet_db:.0f} dB", beeps(seeds, rate_hz, quiet_db))
        for rate_hz, quiet_db in ((16000, 25.0), (44100, 25.0), (16000, 10.0))
    ]
    sources += [
        (f"broadcast, {nodes} nodes, {rounds} in {span_s:.0f} s", receptions(seeds, nodes, rounds, span_s))
        for nodes, rounds, span_s in ((2, 20, 900.0), (5, 20, 900.0), (3, 20, 5.0), (3, 8, 60.0))
    ]
    sources.append(("motion, realistic arm", moved(seeds, 0.0)))
    sources.append(("skew, 15 minutes, 390 ppm", moved(few, SKEW, protocol="random", duration_s=900.0)))
    found = []
    for name, stated in sources:
        if not options.parts or name.split(",")[0] in options.parts:
            error, sigma, skew = np.array(list(stated)).T
            found.append({"source": name, "what": "offset, ms", "off": 1e3 * error, "sigma": 1e3 * sigma})
            if np.isfinite(skew).any():
                found.append({"source": name, "what": "skew, ppm", "off": skew, "sigma": np.nan})
    yield from error_table(found, "source, what")
