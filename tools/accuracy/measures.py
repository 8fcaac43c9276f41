"""How well measures hold, and changes of them between sessions: `measures`, `movements`, `progress`.

`measures`, for each preset: how often the 95 % interval of a measure contains the truth's, its rms error and
its bias; occlusions are those of the simulated body. The truth is measured by the same functions: a session's
means over movements are of the truth's own movements, a movement's measures are over the same samples. The
elbow's measures are repeated for an arm that moves about with a straight, stiff elbow (0 to 7 degrees). Then
the elbow's range of motion with two thirds of each extreme hidden, and SPARC's bias from recovered samples:
movements in a gap against the same movements with the camera's view whole.

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
from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from smoother.calibration import ArmCalibration
from smoother.evaluation.measure_agreement import same_samples
from smoother.evaluation.metrics import truth_at
from smoother.evaluation.progress import (
    LESS,
    MORE,
    UNKNOWN,
    SessionValue,
    change_between,
    is_main,
    without_like_movements,
)
from smoother.measures import Measure, MeasureSettings, measure
from smoother.measures.layout import BY_MOVEMENT, SESSION
from smoother.measures.measure import Reach
from smoother.measures.measuring import Measuring
from smoother.measures.motion import motion_of
from smoother.recording import Truth
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.arm import SimulatedArm, random_streams, record_arm
from smoother.simulation.body import FLEXION, draw_measures
from smoother.simulation.motion import draw_stage
from smoother.simulation.protocol import perform
from smoother.smoothing import smooth
from tools.accuracy.check import DRAWS, Check, option, preset_option, seeds_option

MEASURED = ("realistic", "azure")
#: Ends the name of a preset whose arm moves about with a straight elbow, and how far that bends, rad.
STRAIGHT, STRAIGHT_RAD = "-straight", (0.01, 0.11)
#: Of a joint's extreme this part is hidden, in the time that the angle is within 20 degrees of it.
HIDDEN_PART, NEAR_DEG = 2.0 / 3.0, 20.0


@dataclass(frozen=True)
class Sample:
    """One measure of one recording: answer, truth, interval."""

    key: str
    scope: str
    value: float
    truth: float
    share: float
    low: float
    high: float


def true_recovery(recovery: Recovery, truth: Truth) -> Recovery:
    """The truth in a recovery's place, at its samples."""
    at = truth_at(truth, recovery.t_s)
    joints = {joint: at.joints[joint] for joint in recovery.joints if joint in at.joints}
    return replace(recovery, position=at.position, quaternion=at.quaternion, joints=joints, draws=None)


def recovered(
    simulated: SimulatedArm, draws: int, seed: int, calibration: ArmCalibration | None = None
) -> Recovery:
    """The recording smoothed without its truth; the forearm's axes in the IMU are given."""
    recording = replace(simulated.recording, truth=None)
    recovery = smooth(recording, calibration, processes=1, draws=draws, seed=seed)
    assert recovery.calibration is not None
    return replace(recovery, calibration=replace(recovery.calibration, R_F_A=simulated.calibration.R_F_A))


def samples_of(simulated: SimulatedArm, recovery: Recovery, settings: MeasureSettings) -> Iterator[Sample]:
    """Every measure of answer and truth."""
    measuring = Measuring.of(recovery, settings)
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


def simulation_of(name: str) -> ArmSimulation:
    """What to simulate, by a preset's name: "azure", or "azure-straight" for the stiff elbow."""
    preset = name.removesuffix(STRAIGHT)
    if preset == name:
        return ArmSimulation.preset(preset)
    return ArmSimulation.preset(preset, protocol="random", flexion_rad=STRAIGHT_RAD)


def accuracy(name: str, seeds: range, draws: int) -> list[Sample]:
    """The samples of some seeds."""
    samples: list[Sample] = []
    for seed in seeds:
        simulated = simulate_arm(simulation_of(name), seed)
        samples += samples_of(simulated, recovered(simulated, draws, seed), MeasureSettings())
        print(f"{name} seed {seed}: done", file=sys.stderr, flush=True)
    return samples


def coverage_table(samples: list[Sample]) -> list[dict[str, object]]:
    """By scope and key: coverage, rms error, bias; zones of an angle together."""
    groups: dict[tuple[str, str], list[Sample]] = defaultdict(list)
    for sample in samples:
        key = f"{sample.key.partition('_zone_')[0]}_zones_percent" if "_zone_" in sample.key else sample.key
        if np.isfinite(sample.value) and np.isfinite(sample.truth):
            groups[sample.scope, key].append(sample)
    rows: list[dict[str, object]] = []
    for (scope, key), group in groups.items():
        held, widths = [], []
        for sample in group:
            if np.isfinite(sample.low):
                held.append(sample.low - 1e-9 <= sample.truth <= sample.high + 1e-9)
                widths.append(sample.high - sample.low)
        off = np.array([sample.value - sample.truth for sample in group])
        rows.append(
            {
                "scope": scope,
                "key": key,
                "cases": len(group),
                "coverage": float(np.mean(held)) if held else float("nan"),
                "rms": float(np.sqrt(np.mean(off**2))),
                "bias": float(off.mean()),
                "width": float(np.mean(widths)) if widths else float("nan"),
                "truth": float(np.mean([sample.truth for sample in group])),
            }
        )
    return rows


def print_rows(title: str, rows: list[dict[str, object]]) -> Iterator[str]:
    """As a table."""
    yield (f"\n{title}\n{'measure':44} cases  covered   rms error      bias  interval's width    mean")
    for row in rows:
        yield (
            f"{row['key']:44} {row['cases']:5} {100 * row['coverage']:6.0f} % {row['rms']:11.4g}"
            f" {row['bias']:+9.3g} {row['width']:14.4g} {row['truth']:11.4g}"
        )


def hidden_extremes(simulated: SimulatedArm) -> SimulatedArm:
    """The same, and two thirds of the time about the elbow's largest and smallest flexion hidden as well."""
    from smoother.joint_angles import arm_angles
    from smoother.linalg import runs

    recording = simulated.recording
    assert recording.truth is not None
    joints, t = recording.truth.joints, recording.truth.t_s
    flexion = arm_angles(joints, len(t))["elbow_flexion"]
    frames = recording.arm.t_s + simulated.parameters["clock_offset_s"]
    hidden = np.zeros(len(frames), dtype=bool)
    for near in (flexion >= flexion.max() - NEAR_DEG, flexion <= flexion.min() + NEAR_DEG):
        extreme = int(np.argmax(flexion)) if near[np.argmax(flexion)] else int(np.argmin(flexion))
        for run in runs(near):
            if not run.start <= extreme < run.stop:
                continue
            length = HIDDEN_PART * (t[run.stop - 1] - t[run.start])
            start = np.clip(t[extreme] - 0.5 * length, t[run.start], t[run.stop - 1] - length)
            hidden |= (frames >= start) & (frames <= start + length)
    return replace(simulated, recording=replace(recording, arm=recording.arm.hide(hidden)))


def hidden_range(preset: str, seeds: range) -> Iterator[str]:
    """The elbow's range with nothing hidden, and with two thirds of both extremes hidden."""
    config = ArmSimulation.preset(preset, protocol="random", occlusion_lengths_s=())
    for words, is_hidden, is_calibrated in (
        ("nothing hidden", False, False),
        ("two thirds of both extremes hidden", True, False),
        ("the same, the arm calibrated", True, True),
    ):
        errors: dict[str, list[float]] = defaultdict(list)
        for seed in seeds:
            simulated = simulate_arm(config, seed)
            simulated = hidden_extremes(simulated) if is_hidden else simulated
            calibration = simulated.calibration if is_calibrated else None
            recovery = recovered(simulated, 0, seed, calibration)
            for sample in samples_of(simulated, recovery, MeasureSettings()):
                if sample.scope == "session":
                    errors[sample.key].append(sample.value - sample.truth)
        figures = "  ".join(
            f"{what} {np.sqrt(np.mean(np.square(off))):.2f} ({np.mean(off):+.2f})"
            for what in ("range", "max", "min")
            for off in [errors[f"elbow_flexion_{what}_deg"]]
        )
        yield (f"{preset}: elbow, {words}: rms (bias), degrees: {figures}; {len(seeds)} seeds")


def sparc_bias(preset: str, samples: list[Sample]) -> Iterator[str]:
    """SPARC of movements that are recovered by half or more, and of those that the camera saw."""
    rows = [
        s for s in samples if s.scope == "movement" and s.key == "sparc" and np.isfinite(s.value - s.truth)
    ]
    for words, some in (
        ("recovered by half or more", [s for s in rows if s.share >= 0.5]),
        ("with recovered samples", [s for s in rows if s.share > 0.0]),
        ("seen", [s for s in rows if s.share == 0.0]),
    ):
        off = np.array([s.value - s.truth for s in some])
        if len(off):
            yield (
                f"{preset}: SPARC, movements {words}: bias {off.mean():+.4f}, rms {off.std():.4f}, {len(off)}"
            )


def accuracy_csv(tables: dict[str, list[dict[str, object]]]) -> str:
    """docs/tables/measures_accuracy.csv: by measure how often its interval holds, and its rms error."""
    by_key = {(preset, row["scope"], row["key"]): row for preset, rows in tables.items() for row in rows}
    columns = ("sessions_inside_percent", "sessions", "movements_inside_percent", "movements", "sessions_rms")
    lines = [["measure", *(f"{preset}_{column}" for preset in tables for column in columns)]]
    for key in dict.fromkeys(row["key"] for rows in tables.values() for row in rows):
        cells = [str(key)]
        for preset in tables:
            session, movement = (by_key.get((preset, scope, key)) for scope in ("session", "movement"))
            for row in (session, movement):
                cells += [f"{100 * row['coverage']:.0f}", f"{row['cases']}"] if row else ["", ""]
            cells.append(f"{session['rms']:.2g}" if session else "")
        lines.append(cells)
    return "\n".join(map(",".join, lines))


def measures(options: argparse.Namespace) -> Iterator[str]:
    """How often the 95 % interval of a measure contains the truth's, its rms error and its bias."""
    seeds = options.seeds
    tables = {}
    for preset in options.presets:
        samples = accuracy(preset, seeds, options.draws)
        rows = coverage_table(samples)
        tables[preset] = rows
        for scope in ("session", "movement"):
            yield from print_rows(f"{preset}, {scope}", [row for row in rows if row["scope"] == scope])
        yield from sparc_bias(preset, samples)
        straight = coverage_table(accuracy(preset + STRAIGHT, seeds, options.draws))
        straight = [row for row in straight if str(row["key"]).startswith("elbow_flexion")]
        for scope in ("session", "movement"):
            rows_of = [row for row in straight if row["scope"] == scope]
            yield from print_rows(f"{preset}, a straight and stiff elbow, {scope}", rows_of)
        yield from hidden_range(preset, seeds)
    if options.csv is not None:
        options.csv.write_text(accuracy_csv(tables) + "\n", encoding="utf-8")


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
    keys: Collection[str] | None = None,
) -> Iterator[str]:
    """Count what is said of two sessions, of all measures or of some."""
    for key in first[0].keys() & last[0].keys() if keys is None else keys:
        if not is_main(key) or not (first[1][key].is_known and last[1][key].is_known):
            continue
        change = change_between(value(first[0][key]), value(last[0][key]))
        if not math.isfinite(change.p):
            continue
        found = [value(each[0]["movement_count"]) for each in (first, last)]
        if key in BY_MOVEMENT:
            change = without_like_movements(change, *found)
        if change.word == UNKNOWN:
            counts[key]["unknown"] += 1
            continue
        true = last[1][key].value - first[1][key].value
        what = "same" if same else "other"
        counts[key]["held"] += change.low <= true <= change.high
        counts[key]["pairs"] += 1
        counts[key][what] += 1
        counts[key][f"{what}_called"] += change.word in (MORE, LESS)
        counts[key]["wrong"] += change.word in (MORE, LESS) and change.difference * true <= 0
        if not change.low <= true <= change.high:
            half = 0.5 * (change.high - change.low)
            counted = [each.value for each in found]
            numbers = f"{change.difference:.3g} (true {true:.3g}, half {half:.3g}, movements {counted})"
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
    """False alarms, detected changes and coverage of intervals, between simulated persons' sessions."""
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


#: Kinds of sessions for means over movements: the preset, and what is changed of it. In `random` motion the
#: hand rarely rests, so that one movement more or less changes a mean most.
KINDS: dict[str, tuple[str, dict[str, Any]]] = {
    "exercises": ("realistic", {}),
    "tremor": ("azure", {"tremor_rad": 0.004, "speed": 0.7}),
    "slow": ("realistic", {"protocol": "random", "speed": 0.5}),
    "random": ("realistic", {"protocol": "random"}),
    "azure": ("azure", {"protocol": "random"}),
    "long gaps": (
        "realistic",
        {
            "protocol": "random",
            "duration_s": 40.0,
            "occlusion_lengths_s": (3.0, 6.0),
            "occlusion_every_s": 10.0,
        },
    ),
}


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
        counts: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
        for first, last in combinations(sessions, 2):
            yield from count_pair(counts, first, last, same=False, keys=BY_MOVEMENT)
        total = {
            name: sum(each[name] for each in counts.values())
            for name in ("unknown", "pairs", "other_called", "wrong")
        }
        yield (
            f"{kind}: {len(sessions)} sessions, {math.comb(len(sessions), 2)} pairs; changes of"
            f" {len(BY_MOVEMENT)} measures: cannot be assessed {total['unknown']}, compared {total['pairs']},"
            f" clear {total['other_called']}, in the wrong direction {total['wrong']}"
        )


CHECKS = (
    Check(
        "measures",
        measures,
        (
            option("--presets", nargs="+", default=list(MEASURED), choices=MEASURED),
            seeds_option("20"),
            DRAWS,
            option("--csv", type=Path, help="write docs/tables/measures_accuracy.csv"),
        ),
    ),
    Check(
        "movements",
        movements,
        (
            option("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS)),
            seeds_option("20"),
            DRAWS,
        ),
    ),
    Check(
        "progress",
        progress,
        (
            seeds_option("6", "a person each"),
            preset_option("realistic"),
            option("--duration-s", type=float, default=20.0),
            DRAWS,
        ),
    ),
)
