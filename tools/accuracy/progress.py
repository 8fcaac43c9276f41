"""Whether changes between sessions are called rightly: `progress`.

Simulated persons, each with three sessions: the same motion twice (other sensor errors, another mounting of
the sensor, other errors of the camera), then with the elbow bending less. Each session is recovered from its
recording and measured; a change is called as `unocclude progress` calls it.

- False alarms: calls between the first two sessions, though their motion is the same.
- Found: calls of the elbow's range between the first and the third session.
- Held: how often the interval of a difference holds the true one (both pairs).
"""

from __future__ import annotations

import argparse
import json
import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from smoother.evaluation.align import truth_at
from smoother.evaluation.measure_agreement import same_samples
from smoother.evaluation.progress import (
    LESS,
    MORE,
    UNKNOWN,
    SessionValue,
    change_between,
    without_like_movements,
)
from smoother.evaluation.quantity import BY_MOVEMENT, is_main
from smoother.measures import Measure, measure
from smoother.simulation import ArmSimulation
from smoother.simulation.arm import SimulatedArm, random_streams, record_arm
from smoother.simulation.body import FLEXION, draw_measures
from smoother.simulation.motion import draw_stage
from smoother.simulation.protocol import perform
from smoother.smoothing import smooth
from tools.accuracy.check import DRAWS, JSON, Check, option, preset_option, seeds_option

#: Of the elbow's bending that is left in the third session.
BENDING = 0.75
#: Sensor errors of each session; the second is the same motion.
SESSIONS = 3


def sessions_of(config: ArmSimulation, seed: int) -> list[SimulatedArm]:
    """A person's sessions: body and motion of the seed, errors of each session's own."""
    body_rng, *_ = random_streams(seed)
    measures = draw_measures(body_rng)
    stage = draw_stage(config.distance_m, config.camera_frame, body_rng)
    performance = perform(config, body_rng)
    posture = performance.posture.copy()
    middle = np.median(posture[:, FLEXION])
    posture[:, FLEXION] = middle + BENDING * (posture[:, FLEXION] - middle)
    performances = (performance, performance, replace(performance, posture=posture))
    return [
        record_arm(
            config, f"p{seed}/s{number}", measures, stage, each, random_streams([seed, 1 + number])[1:]
        )
        for number, each in enumerate(performances)
    ]


def measured(simulated: SimulatedArm, draws: int) -> tuple[dict[str, Measure], dict[str, Measure]] | None:
    """Measures of the answer and of the truth, by key; None where the answer is not to be trusted."""
    recovery = smooth(replace(simulated.recording, truth=None), processes=1, draws=draws)
    assert simulated.recording.truth is not None
    if recovery.estimates.trusted is False:
        return None
    answer, motion = same_samples(recovery, truth_at(simulated.recording.truth, recovery.t_s))
    return measure(answer).by_key, measure(motion).by_key


def value(row: Measure) -> SessionValue:
    """A measure as a session's value."""
    return SessionValue(
        "s", math.nan, row.value, row.low, row.high, row.sigma, row.recovered_share, row.n_draws
    )


def count_pair(
    counts: dict[str, dict[str, int]],
    first: tuple[dict[str, Measure], dict[str, Measure]],
    last: tuple[dict[str, Measure], dict[str, Measure]],
    same: bool,
) -> Iterator[str]:
    """Count what is said of two sessions."""
    for key in first[0].keys() & last[0].keys():
        if not is_main(key) or not (first[1][key].is_known and last[1][key].is_known):
            continue
        change = change_between(value(first[0][key]), value(last[0][key]))
        if not math.isfinite(change.p):
            continue
        movements = [each[0]["movement_count"].value for each in (first, last)]
        if key in BY_MOVEMENT:
            change = without_like_movements(change, *movements)
        if change.word == UNKNOWN:
            counts[key]["unknown"] += 1
            continue
        true = last[1][key].value - first[1][key].value
        what = "same" if same else "other"
        counts[key]["held"] += change.low <= true <= change.high
        counts[key]["pairs"] += 1
        counts[key][what] += 1
        counts[key][f"{what}_called"] += change.word in (MORE, LESS)
        if not change.low <= true <= change.high:
            half = 0.5 * (change.high - change.low)
            numbers = f"{change.difference:.3g} (true {true:.3g}, half {half:.3g}, movements {movements})"
            yield (f"  {what}: {key} {numbers}")


def summary(counts: dict[str, dict[str, int]]) -> str:
    """Of all measures so far, in a line."""
    total: dict[str, int] = defaultdict(int)
    for each in counts.values():
        for name, number in each.items():
            total[name] += number
    flexion = counts["elbow_flexion_range_deg"]
    return (
        f"false alarms {total['same_called']} of {total['same']}; held {total['held']} of {total['pairs']};"
        f" elbow range found {flexion['other_called']} of {flexion['other']}"
    )


def progress(options: argparse.Namespace) -> Iterator[str]:
    """False alarms, found changes and intervals that hold, between simulated persons' sessions."""
    config = ArmSimulation.preset(options.preset, protocol="random", duration_s=options.duration_s)
    counts: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for seed in options.seeds:
        rows = [measured(simulated, options.draws) for simulated in sessions_of(config, seed)]
        for number in (1, 2):
            first, last = rows[0], rows[number]
            if first is not None and last is not None:
                yield from count_pair(counts, first, last, same=number == 1)
        yield f"person {seed}: {summary(counts)}"
    for key, each in sorted(counts.items()):
        yield f"{key:40s} {dict(each)}"
    if options.json is not None:
        options.json.write_text(json.dumps(counts, indent=2) + "\n", encoding="utf-8")


CHECKS = (
    Check(
        "progress",
        progress,
        (
            seeds_option("6", "a person each"),
            preset_option("realistic"),
            option("--duration-s", type=float, default=20.0),
            DRAWS,
            JSON,
        ),
    ),
)
