"""How well measures hold, and changes of them between sessions: `measures`, `movements`, `progress`.

`measures`, for each preset: how often the 95 % interval of a measure contains the truth's, its rms error and
its bias; occlusions are those of the simulated body. The truth is measured by the same functions: a session's
means over movements are of the truth's own movements, a movement's measures are over the same samples. The
elbow's measures are repeated for an arm that moves about with a straight, stiff elbow (0 to 7 degrees); and
SPARC's bias from recovered samples.

`movements`: for several kinds of sessions, how often the interval of a mean over movements contains the mean
over the truth's own movements, and between all pairs of sessions how often `progress` calls a change, and
how often one in the wrong direction.

`progress`: simulated persons, each with three sessions: the same motion twice (other sensor errors, another
mounting of the sensor, other errors of the camera), then with the elbow bending less. Each session is
recovered from its recording and measured; a change is called as `unocclude progress` calls it.

- False alarms: calls between the first two sessions, though their motion is the same.
- Found: calls of the elbow's range between the first and the third session.
- Held: how often the interval of a difference contains the true one (both pairs).
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from smoother.evaluation.measure_agreement import same_samples
from smoother.evaluation.metrics import truth_at
from smoother.evaluation.progress import (
    LESS,
    MORE,
    UNKNOWN,
    SessionValue,
    change_between,
    without_like_movements,
)
from smoother.evaluation.words import is_main
from smoother.measures import Measure, MeasureSettings, measure
from smoother.measures.definitions import BY_MOVEMENT
from smoother.measures.measure import Reach
from smoother.measures.measuring import SESSION, Measuring
from smoother.measures.motion import motion_of
from smoother.recording import Truth
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.arm import SimulatedArm, random_streams, record_arm
from smoother.simulation.motion import FLEXION, draw_measures, draw_stage, perform
from smoother.smoothing import smooth
from tools.accuracy.check import DRAWS, PRESET, check, option, rms, seeds_option

MEASURED = ("realistic", "azure")
#: How far a straight elbow bends, rad.
STRAIGHT_RAD = (0.01, 0.11)


class Sample(NamedTuple):
    """One measure of one recording: answer, truth, interval."""

    key: str
    scope: str
    value: float
    truth: float
    share: float
    low: float
    high: float

    @property
    def off(self) -> float:
        """Answer less truth."""
        return self.value - self.truth


def true_recovery(recovery: Recovery, truth: Truth) -> Recovery:
    """The truth in a recovery's place, at its samples."""
    at = truth_at(truth, recovery.t_s)
    joints = {joint: at.joints[joint] for joint in recovery.joints if joint in at.joints}
    return replace(recovery, position=at.position, quaternion=at.quaternion, joints=joints, draws=None)


def recovered(simulated: SimulatedArm, draws: int, seed: int) -> Recovery:
    """The recording smoothed without its truth; the forearm's axes in the IMU are given."""
    recording = replace(simulated.recording, truth=None)
    recovery = smooth(recording, processes=1, draws=draws, seed=seed)
    assert recovery.calibration is not None
    return replace(recovery, calibration=replace(recovery.calibration, R_F_A=simulated.calibration.R_F_A))


def samples_of(simulated: SimulatedArm, recovery: Recovery, settings: MeasureSettings) -> Iterator[Sample]:
    """Every measure of answer and truth."""
    measuring = Measuring(recovery, settings)
    assert simulated.recording.truth is not None
    true = motion_of(
        true_recovery(recovery, simulated.recording.truth),
        measuring.motion.grid,
        settings.smoothing.cutoff_hz,
    )
    by_place = measuring.layout.figures(true)
    for place, figures in measuring.answer.items():
        if place[0] == "repetition":
            continue
        zones = {key for key in by_place[place] if "_zone_" in key} if place == SESSION else set()
        for key in (*figures, *(zones - figures.keys())):
            absent = 0.0 if "_zone_" in key else np.nan
            value, share = figures.get(key, (0.0, 0.0))
            truth = by_place[place][key].value if key in by_place[place] else absent
            low, high, _ = measuring.interval(place, key, value)
            yield Sample(key, place[0], value, truth, share, low, high)


def accuracy(config: ArmSimulation, seeds: range, draws: int) -> list[Sample]:
    """The samples of some seeds."""
    samples: list[Sample] = []
    for seed in seeds:
        simulated = simulate_arm(config, seed)
        samples += samples_of(simulated, recovered(simulated, draws, seed), MeasureSettings())
        print(f"seed {seed}: done", file=sys.stderr, flush=True)
    return samples


#: Of a measure in a scope: cases, share inside the interval, rms error, bias, width of the interval, truth.
Coverage = dict[tuple[str, str], tuple[int, float, float, float, float, float]]


def coverage_of(samples: list[Sample]) -> Coverage:
    """By scope and key; zones of an angle together."""
    groups: dict[tuple[str, str], list[Sample]] = defaultdict(list)
    for sample in samples:
        key = f"{sample.key.partition('_zone_')[0]}_zones_percent" if "_zone_" in sample.key else sample.key
        if np.isfinite(sample.off):
            groups[sample.scope, key].append(sample)
    found: Coverage = {}
    for place, group in groups.items():
        stated = [each for each in group if np.isfinite(each.low)]
        held = [each.low - 1e-9 <= each.truth <= each.high + 1e-9 for each in stated]
        off, widths = np.array([each.off for each in group]), [each.high - each.low for each in stated]
        coverage, width = (float(np.mean(each)) if each else math.nan for each in (held, widths))
        truth = float(np.mean([each.truth for each in group]))
        found[place] = len(group), coverage, rms(off), float(off.mean()), width, truth
    return found


def coverage_rows(title: str, found: Coverage, keys: str = "") -> Iterator[str]:
    """A table for sessions and one for movements, of the measures whose name begins so."""
    for scope in ("session", "movement"):
        yield f"\n{title}, {scope}"
        yield f"{'measure':44} cases  covered   rms error      bias  interval's width    mean"
        for (of, key), (cases, coverage, off, bias, width, truth) in found.items():
            if of == scope and key.startswith(keys):
                figures = f"{cases:5} {100 * coverage:6.0f} % {off:11.4g} {bias:+9.3g}"
                yield f"{key:44} {figures} {width:14.4g} {truth:11.4g}"


def sparc_bias(preset: str, samples: list[Sample]) -> Iterator[str]:
    """SPARC of movements that are recovered by half or more, and of those that the camera saw."""
    rows = [s for s in samples if s.scope == "movement" and s.key == "sparc" and np.isfinite(s.off)]
    for words, low, high in (
        ("recovered by half or more", 0.5, 1.0),
        ("with recovered samples", 1e-9, 1.0),
        ("seen", 0.0, 0.0),
    ):
        off = np.array([s.off for s in rows if low <= s.share <= high])
        if len(off):
            figures = f"bias {off.mean():+.4f}, rms {off.std():.4f}, {len(off)}"
            yield f"{preset}: SPARC, movements {words}: {figures}"


def accuracy_csv(tables: dict[str, Coverage]) -> str:
    """docs/tables/measures_accuracy.csv: by measure how often its interval holds, and its rms error."""
    columns = ("sessions_inside_percent", "sessions", "movements_inside_percent", "movements", "sessions_rms")
    lines = [["measure", *(f"{preset}_{column}" for preset in tables for column in columns)]]
    for key in dict.fromkeys(key for found in tables.values() for _, key in found):
        cells = [key]
        for found in tables.values():
            both = [found.get((scope, key)) for scope in ("session", "movement")]
            for row in both:
                cells += [f"{100 * row[1]:.0f}", f"{row[0]}"] if row else ["", ""]
            cells.append(f"{both[0][2]:.2g}" if both[0] else "")
        lines.append(cells)
    return "\n".join(map(",".join, lines))


@check(
    option("--presets", nargs="+", default=list(MEASURED), choices=MEASURED),
    seeds_option("20"),
    DRAWS,
    option("--csv", type=Path, help="write docs/tables/measures_accuracy.csv"),
)
def measures(options: argparse.Namespace) -> Iterator[str]:
    """How often the 95 % interval of a measure contains the truth's, its rms error and its bias."""
    tables = {}
    for preset in options.presets:
        samples = accuracy(ArmSimulation.preset(preset), options.seeds, options.draws)
        tables[preset] = coverage_of(samples)
        yield from coverage_rows(preset, tables[preset])
        yield from sparc_bias(preset, samples)
        # an arm that moves about with a straight elbow
        straight = ArmSimulation.preset(preset, protocol="random", flexion_rad=STRAIGHT_RAD)
        found = coverage_of(accuracy(straight, options.seeds, options.draws))
        yield from coverage_rows(f"{preset}, a straight and stiff elbow", found, "elbow_flexion")
    if options.csv is not None:
        options.csv.write_text(accuracy_csv(tables) + "\n", encoding="utf-8")


#: Of the elbow's bending that is left in the third session.
BENDING = 0.75


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
    interval = (row.low, row.high, row.sigma)
    return SessionValue("s", math.nan, row.value, *interval, row.recovered_share, row.n_draws)


Measured = tuple[dict[str, Measure], dict[str, Measure]]
#: By measure: pairs, those whose interval holds the true difference, that are called a change, wrongly so, ..
Counts = dict[str, Counter[str]]


def count_pair(
    counts: Counts, first: Measured, last: Measured, what: str, keys: Collection[str] = ()
) -> None:
    """Count what is said of two sessions with the `same` motion or an `other`, of all measures or of some."""
    for key in keys or first[0].keys() & last[0].keys():
        if not is_main(key) or not (first[1][key].is_known and last[1][key].is_known):
            continue
        change = change_between(value(first[0][key]), value(last[0][key]))
        if not math.isfinite(change.p):
            continue
        if key in BY_MOVEMENT:
            found = [value(each[0]["movement_count"]) for each in (first, last)]
            change = without_like_movements(change, *found)
        if change.word == UNKNOWN:
            counts[key]["unknown"] += 1
            continue
        true, called = last[1][key].value - first[1][key].value, change.word in (MORE, LESS)
        counts[key] += Counter({"pairs": 1, what: 1, f"{what}_called": called})
        counts[key]["held"] += change.low <= true <= change.high
        counts[key]["wrong"] += called and change.difference * true <= 0


@check(
    seeds_option("6", "a person each"),
    PRESET,
    option("--duration-s", type=float, default=20.0),
    DRAWS,
)
def progress(options: argparse.Namespace) -> Iterator[str]:
    """False alarms, detected changes and coverage of intervals, between simulated persons' sessions."""
    config = ArmSimulation.preset(options.preset, protocol="random", duration_s=options.duration_s)
    counts: Counts = defaultdict(Counter)
    for seed in options.seeds:
        first, again, less = [measured(each, options.draws) for each in sessions_of(config, seed)]
        for last, what in ((again, "same"), (less, "other")):
            if first is not None and last is not None:
                count_pair(counts, first, last, what)
        total, flexion = sum(counts.values(), Counter[str]()), counts["elbow_flexion_range_deg"]
        yield (
            f"person {seed}: false alarms {total['same_called']} of {total['same']}; held {total['held']} of"
            f" {total['pairs']}; elbow range found {flexion['other_called']} of {flexion['other']}"
        )
    for key, each in sorted(counts.items()):
        yield f"{key:40s} {dict(each)}"


LONG_GAPS = {"occlusion_lengths_s": (3.0, 6.0), "occlusion_every_s": 10.0}
#: Kinds of sessions for means over movements: the preset, and what is changed of it. In `random` motion the
#: hand rarely rests, so that one movement more or less changes a mean most.
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "exercises": ("realistic", {}),
    "tremor": ("azure", {"tremor_rad": 0.004, "speed": 0.7}),
    "slow": ("realistic", {"protocol": "random", "speed": 0.5}),
    "random": ("realistic", {"protocol": "random"}),
    "azure": ("azure", {"protocol": "random"}),
    "long gaps": ("realistic", {"protocol": "random", "duration_s": 40.0} | LONG_GAPS),
}


@check(
    option("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS)),
    seeds_option("20"),
    DRAWS,
)
def movements(options: argparse.Namespace) -> Iterator[str]:
    """Means over movements against those over the truth's own, and the changes called between sessions."""
    settings = MeasureSettings(reach=Reach(voxel_m=0.2))  # its volume takes the time and is not needed
    for kind in options.kinds:
        preset, changes = KINDS[kind]
        sessions = []
        for seed in options.seeds:
            simulated = simulate_arm(ArmSimulation.preset(preset, **changes), seed)
            recovery = recovered(simulated, options.draws, seed)
            assert simulated.recording.truth is not None
            truth = true_recovery(recovery, simulated.recording.truth)
            if recovery.estimates.trusted is not False:
                sessions.append((measure(recovery, settings).by_key, measure(truth, settings).by_key))
        for key in BY_MOVEMENT:
            both = [(answer[key], truth[key].value) for answer, truth in sessions]
            held = [row.low <= true <= row.high for row, true in both if row.has_interval and true == true]
            yield f"{kind:10} {key:26} inside {sum(held):3} of {len(held)}"
        counts: Counts = defaultdict(Counter)
        for first, last in combinations(sessions, 2):
            count_pair(counts, first, last, "other", BY_MOVEMENT)
        total = sum(counts.values(), Counter[str]())
        yield (
            f"{kind}: {len(sessions)} sessions, {math.comb(len(sessions), 2)} pairs; changes of"
            f" {len(BY_MOVEMENT)} measures: cannot be assessed {total['unknown']}, compared {total['pairs']},"
            f" clear {total['other_called']}, in the wrong direction {total['wrong']}"
        )
