"""Joint angles and measures against the truth, and changes between sessions.

`angles`: errors of joint angles with their sigmas, by preset, in gaps and in view.

`measures`, for each preset: how often the 95 % interval of a measure contains the truth's, its rms error and
its bias; occlusions are those of the simulated body. The truth is measured by the same functions: a session's
means over movements are of the truth's own movements, a movement's measures are over the same samples. The
elbow's measures are repeated for an arm that moves about with a straight, stiff elbow (0 to 7 degrees); and
SPARC's errors by the share of recovered samples.

`movements`: for several kinds of sessions, how often the interval of a mean over movements contains the mean
over the truth's own movements, and between all pairs of sessions how often `progress` calls a change, and
how often one in the wrong direction.

`progress`: simulated persons, each with three sessions: the same motion twice (other sensor errors, another
mounting of the sensor, other errors of the camera), then with the elbow bending less. A change is called as
`unocclude progress` calls it. False alarms: calls between the first two sessions. Found: calls of the elbow's
range between the first and the third. Held: how often the interval of a difference contains the true one.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np

from smoother.angles.definitions import SHOULDER_TRUNK, arm_angles, forearm_axes, wrapped_deg
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
from smoother.linalg import interpolate
from smoother.measures import Measure, MeasureSettings, measure
from smoother.measures.definitions import BY_MOVEMENT
from smoother.measures.measure import Reach
from smoother.measures.measuring import SESSION, Measuring
from smoother.measures.motion import motion_of
from smoother.recording import Truth
from smoother.result import Recovery
from smoother.rotation import Rotation
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.simulation.arm import draw_person, random_streams, record_arm
from smoother.simulation.motion import FLEXION
from smoother.smoothing import smooth
from tools.accuracy.check import (
    CHANGES,
    DRAWS,
    PRESETS,
    Z_95,
    changes,
    check,
    error_table,
    option,
    seeds_option,
    table,
)

MEASURED = ("realistic", "azure")
#: How far a straight elbow bends, rad.
STRAIGHT_RAD = (0.01, 0.11)


def true_recovery(recovery: Recovery, truth: Truth) -> Recovery:
    """The truth in a recovery's place, at its samples."""
    at = truth_at(truth, recovery.t_s)
    joints = {joint: at.joints[joint] for joint in recovery.joints if joint in at.joints}
    return replace(recovery, position=at.position, quaternion=at.quaternion, joints=joints, draws=None)


def recovered(simulated: SimulatedArm, draws: int, seed: int) -> tuple[Recovery, Recovery]:
    """The recording smoothed, the forearm's axes in the IMU given, and its truth in a recovery's place."""
    recording, truth = replace(simulated.recording, truth=None), simulated.recording.truth
    recovery = smooth(recording, processes=1, draws=draws, seed=seed)
    assert recovery.calibration is not None and truth is not None
    calibration = replace(recovery.calibration, R_F_A=simulated.calibration.R_F_A)
    recovery = replace(recovery, calibration=calibration)
    return recovery, true_recovery(recovery, truth)


def errors_of(recovery: Recovery, truth: Recovery) -> Iterator[dict[str, Any]]:
    """Every measure of an answer against the truth's: zones of an angle by one name."""
    settings = MeasureSettings()
    measuring = Measuring(recovery, settings)
    true = motion_of(truth, measuring.motion.grid, settings.smoothing.cutoff_hz)
    by_place = measuring.layout.figures(true)
    for place, figures in measuring.answer.items():
        if place[0] == "repetition":
            continue
        zones = {key for key in by_place[place] if "_zone_" in key} if place == SESSION else set()
        for key in (*figures, *(zones - figures.keys())):
            name, in_zone, _ = key.partition("_zone_")
            absent = 0.0 if in_zone else np.nan
            value, share = figures.get(key, (0.0, 0.0))
            right = by_place[place][key].value if key in by_place[place] else absent
            low, high, _ = measuring.interval(place, key, value)
            yield {
                "scope": place[0],
                "measure": f"{name}_zones_percent" if in_zone else key,
                "off": value - right,
                "sigma": (high - low) / (2 * Z_95),
                "inside": low - 1e-9 <= right <= high + 1e-9 if np.isfinite(low) else None,
                "recovered": share,
            }


def accuracy(config: ArmSimulation, seeds: range, draws: int) -> list[dict[str, Any]]:
    """The errors of some seeds."""
    errors = []
    for seed in seeds:
        errors += errors_of(*recovered(simulate_arm(config, seed), draws, seed))
        print(f"seed {seed}: done", file=sys.stderr, flush=True)
    return [each for each in errors if np.isfinite(each["off"])]


def accuracy_csv(found: dict[str, list[dict[str, Any]]]) -> str:
    """docs/tables/measures_accuracy.csv: by measure how often its interval holds, and its rms error."""
    columns = []
    for preset in found:
        for scope in ("session", "movement"):
            own = f"filter (where preset = '{preset}' and scope = '{scope}')"
            columns.append(f"round(100 * avg(inside::double) {own})::int as {preset}_{scope}s_inside_percent")
            columns.append(f"count(*) {own} as {preset}_{scope}s")
        own = f"filter (where preset = '{preset}' and scope = 'session')"
        columns.append(f"format('{{:.2g}}', sqrt(avg(off * off) {own})) as {preset}_sessions_rms")
    rows = [{"preset": preset} | each for preset, errors in found.items() for each in errors]
    lines = table(f"select measure, {', '.join(columns)} from found group by measure order by measure", rows)
    head, *body = (line.partition("\n")[0][2:-2].replace(" | ", ",") for line in lines)
    return "\n".join([head, *body]) + "\n"


@check(
    option("--presets", nargs="+", default=list(MEASURED), choices=MEASURED),
    seeds_option("20"),
    DRAWS,
    option("--csv", type=Path, help="write docs/tables/measures_accuracy.csv"),
)
def measures(options: argparse.Namespace) -> Iterator[str]:
    """How often the 95 % interval of a measure contains the truth's, its rms error and its bias."""
    found = {}
    for preset in options.presets:
        found[preset] = accuracy(ArmSimulation.preset(preset), options.seeds, options.draws)
        straight = ArmSimulation.preset(preset, protocol="random", flexion_rad=STRAIGHT_RAD)
        stiff = accuracy(straight, options.seeds, options.draws)
        stiff = [each for each in stiff if each["measure"].startswith("elbow_flexion")]
        sparc = [each for each in found[preset] if each["measure"] == "sparc" and each["scope"] == "movement"]
        sparc = [each | {"recovered": float(np.ceil(2 * each["recovered"]) / 2)} for each in sparc]
        yield f"\n{preset}"
        yield from error_table(found[preset], "scope, measure")
        yield f"\n{preset}, a straight and stiff elbow"
        yield from error_table(stiff, "scope, measure")
        yield f"\n{preset}, SPARC of movements by the share of recovered samples, up to"
        yield from error_table(sparc, "recovered")
    if options.csv is not None:
        options.csv.write_text(accuracy_csv(found), encoding="utf-8")


#: Of the elbow's bending that is left in the third session.
BENDING = 0.75


def sessions_of(config: ArmSimulation, seed: int) -> list[SimulatedArm]:
    """A person's sessions: body and motion of the seed, errors of each session's own."""
    measures, stage, performance, _ = draw_person(config, seed)
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


Measured = tuple[dict[str, Measure], dict[str, Measure]]


def measured(simulated: SimulatedArm, draws: int) -> Measured | None:
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
    option("--preset", default="realistic", help="of `unocclude simulate arm` [realistic]"),
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
            both = recovered(simulate_arm(ArmSimulation.preset(preset, **changes), seed), options.draws, seed)
            if both[0].estimates.trusted is not False:
                answer, truth = (measure(each, settings).by_key for each in both)
                sessions.append((answer, truth))
        for key in BY_MOVEMENT:
            rows = [(answer[key], truth[key].value) for answer, truth in sessions]
            held = [row.low <= true <= row.high for row, true in rows if row.has_interval and true == true]
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


#: The protocols that every seed of a preset is measured on.
PROTOCOLS = ({}, {"protocol": "random", "duration_s": 30.0})


def angle_errors(case: tuple[str, dict[str, Any], int], more: dict[str, Any], imus: int) -> list[Any]:
    """Errors of every angle that a recovery of an arm with IMUs on upper arm and trunk has, degrees."""
    preset, protocol, seed = case
    side = "left" if seed % 2 else "right"
    config = {"imus": "wrist,upper-arm,trunk", "side": side, "trunk_turn_deg": 5.0} | protocol | more
    made = simulate_arm(ArmSimulation.preset(preset, **config), seed=seed)
    recorded = replace(made.recording, truth=None, trunk=None)
    if made.recording.trunk is not None:  # a skeleton of two arms, without the IMU
        recorded = replace(recorded, opposite=made.recording.trunk.other_arm)
    if imus == 1:
        recorded = replace(recorded, further_imus={})
    recovery = smooth(recorded, processes=1)
    table, true, errors = recovery.angles(), true_angles(made, recovery.t_s), []
    place = np.where(recovery.occluded, "gaps", "in view")
    for angle in table.angles:
        off, sigma = wrapped_deg(table.values[angle.name] - true[angle.name]), table.sigmas[angle.name]
        known = np.isfinite(off) & np.isfinite(sigma)
        labels = {"preset": preset, "angle": angle.name, "place": place[known]}
        errors.append(labels | {"off": off[known], "sigma": sigma[known]})
    return errors


def true_angles(made: SimulatedArm, t_s: np.ndarray) -> dict[str, np.ndarray]:
    """The angles of a simulated arm at some times (n,), deg, by the names of the table."""
    truth, side = made.recording.truth, made.recording.side
    assert truth is not None and made.calibration.R_F_A is not None
    joints = {name: interpolate(truth.t_s, place, t_s) for name, place in truth.joints.items()}
    quaternion = Rotation.from_matrix(made.motion.imu_pose(t_s)[0]).as_quat(scalar_first=True)
    axes = forearm_axes(quaternion, made.calibration.R_F_A)
    angles = arm_angles(joints, len(t_s), axes, side, made.parameters["gravity"])
    if made.trunk_motion is not None:
        R_K_T = made.trunk_motion.thorax(t_s)
        in_T = {name: np.einsum("nji,nj->ni", R_K_T, place) for name, place in joints.items()}
        down, forward = np.array([0.0, -1.0, 0.0]), np.array([1.0, 0.0, 0.0])
        to_trunk = arm_angles(in_T, len(t_s), None, side, down, forward=forward)
        angles |= {angle.name: to_trunk[angle.name.removesuffix("_trunk")] for angle in SHOULDER_TRUNK}
    return angles


@check(
    option("--presets", nargs="+", default=list(PRESETS), choices=PRESETS, help="cameras"),
    option("--imus", type=int, choices=(1, 2), default=1, help="worn on the arm [1]"),
    CHANGES,
    seeds_option("6"),
)
def angles(options: argparse.Namespace) -> Iterator[str]:
    """Errors of joint angles in gaps and in view, degrees, and how many lie inside their 95 % intervals."""
    cases = [*product(options.presets, PROTOCOLS, options.seeds)]
    job = partial(angle_errors, more=changes(options), imus=options.imus)
    with ProcessPoolExecutor(os.cpu_count()) as workers:
        found = [each for errors in workers.map(job, cases) for each in errors]
    yield from error_table(found, "preset, angle, place")
