"""Which camera and IMU belong together, `pairing`, and which IMU is on whom, `match`.

`pairing [PART ..]`: right pairs, and wrong ones (the skeleton of one recording, the IMU of another). For each
kind: how many are proved as files with unrelated clocks, how many are accepted as streams of one recorder,
and whether the clock is found within 0.2 s. Nothing is smoothed.

Parts: `simulated` takes random motion of 8 to 60 s; `exercise` the same scripted exercise in every recording,
of 30 and 75 s; `utd` real Kinect v1 of 2 to 6 s, wrong pairs of the same activity; `azure` real Azure Kinect
of 4 to 17 s, cut by hand, where no clock is known (data sets: `UNOCCLUDE_DATASETS`).

`match [utd|scenes] [--methods motion,..]`. `utd`: all trials of an action in UTD-MHAD at once
(four people who do the same, one IMU on each right wrist; needs UNOCCLUDE_DATASETS), whole trials and their
first 2 s, with four wrists and four upper arms to choose from. `scenes`: simulated scenes of two people with
four nameless IMUs, one of them on the table; half of the scenes random motion, half a clinical protocol; in
half of them everybody moves in time. Both print a table of methods and how often pairs of a stated
probability are right. `assigned` is the share that is right where each worn IMU has to be on a limb (in `utd`
on one of the four wrists), which is what the published method answers. Constants were set on trials 1 and 2
and seeds from 1000 on; measured are trials 3 and 4 and seeds from 0 on.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from smoother.errors import RecordingError
from smoother.evaluation.datasets import open_smartfallmm, open_utd, smartfallmm_trials, utd_files
from smoother.matching import METHODS, SURE_FROM, ImuMatch, decide, limbs_of, pair_evidence
from smoother.matching.match import assign
from smoother.recording import CameraFrame, Recording
from smoother.selfcal.agreement import agreement
from smoother.selfcal.pairing import decided
from smoother.simulation import ArmSimulation, PeopleSimulation, simulate_arm, simulate_people
from tools.accuracy.check import PRESETS, check, datasets, option, parts_option, seeds_option

#: A clock is treated as found where it is this near, s.
FOUND_S = 0.2


class PairTrial(NamedTuple):
    """A pair of streams, and what came of it."""

    is_right: bool
    proved: bool  # As files with unrelated clocks
    accepted: bool  # As streams of one recorder: no reason against it
    found: bool | None  # The clock of the unrelated files is right; None where it is not known
    evidence: float


def tried(recording: Recording, is_right: bool, true_s: float | None) -> PairTrial:
    """Pair a recording's streams, with unrelated clocks and with those of one recorder."""
    found_at = agreement(recording)
    apart, _ = decided(found_at, replace(recording, clocks_unrelated=True))
    together, _ = decided(found_at, replace(recording, clocks_unrelated=False))
    found = None
    if is_right and true_s is not None:
        found = apart is not None and abs(apart.offset_s - true_s) < FOUND_S
    return PairTrial(
        is_right,
        apart is not None and apart.proved,
        together is not None and not together.reason,
        found,
        np.nan if apart is None else apart.evidence,
    )


def rows_of(name: str, trials: Sequence[PairTrial]) -> Iterator[str]:
    """A line for the right pairs and one for the wrong ones."""
    for is_right in (True, False):
        rows = [each for each in trials if each.is_right is is_right]
        if not rows:
            continue
        known = [each.found for each in rows if each.found is not None]
        evidence = np.nanpercentile([each.evidence for each in rows], [0, 50, 100])
        clocks = f", clock found {sum(known)} of {len(known)}" if known else ""
        yield (
            f"{name:28} {'right' if is_right else 'wrong'} {len(rows):4}: proved"
            f" {sum(each.proved for each in rows):4}, accepted of one recorder"
            f" {sum(each.accepted for each in rows):4}; evidence {evidence[0]:.1f} .. {evidence[1]:.1f} .."
            f" {evidence[2]:.1f}{clocks}"
        )


def crossed(made: Sequence[tuple[Recording, float | None]]) -> Iterator[PairTrial]:
    """Each recording as it is, and with the IMU of the next one."""
    for number, (recording, true_s) in enumerate(made):
        yield tried(recording, True, true_s)
        yield tried(replace(recording, imu=made[(number + 1) % len(made)][0].imu), False, None)


def _made(seeds: int, **changes: object) -> list[tuple[Recording, float | None]]:
    """Recordings of one preset each, in turn, and their true offsets."""
    made = []
    for seed in range(seeds):
        config = ArmSimulation.preset(PRESETS[seed % len(PRESETS)], **changes)
        simulated = simulate_arm(config, 9000 + seed)
        offset_s = simulated.parameters["clock_offset_s"]
        made.append((replace(simulated.recording, truth=None), offset_s))
    return made


def simulated(seeds: int) -> Iterator[str]:
    """Random motion."""
    for duration_s in (8.0, 15.0, 30.0, 60.0):
        yield from rows_of(
            f"random, {duration_s:.0f} s", [*crossed(_made(seeds, protocol="random", duration_s=duration_s))]
        )


def exercise(seeds: int) -> Iterator[str]:
    """The same script in every recording."""
    for repetitions in (2, 5):
        made = _made(seeds, protocol="behind", repetitions=repetitions)
        yield from rows_of(f"exercise, {float(np.ptp(made[0][0].arm.t_s)):.0f} s", [*crossed(made)])


def utd(seeds: int) -> Iterator[str]:
    """Trials of UTD-MHAD, this many subjects; the wrong IMU is of another trial of the same activity."""
    files = utd_files(datasets("utd_mhad"))
    recordings = {key: open_utd(files[key]) for key in sorted(files, key=lambda key: files[key].name)}
    rng, trials = np.random.default_rng(0), []
    for (subject, action, trial), recording in recordings.items():
        if subject > seeds:
            continue
        trials.append(tried(recording, True, -0.04))  # both streams cover the same interval
        others = [key for key in recordings if key[1] == action and key != (subject, action, trial)]
        other = recordings[others[rng.integers(len(others))]]
        trials.append(tried(replace(recording, imu=other.imu), False, None))
    yield from rows_of("UTD-MHAD", trials)


def azure(seeds: int) -> Iterator[str]:
    """Trials of SmartFallMM; the wrong IMU of this many other trials, those of the same activity first."""
    recordings = {}
    for trial in smartfallmm_trials(datasets("smartfallmm")):
        with suppress(RecordingError):  # a file of it cannot be used
            recordings[trial.name] = open_smartfallmm(trial)
    trials = []
    for name, recording in recordings.items():
        trials.append(tried(recording, True, None))
        others = [each for each in recordings if each != name]
        for other in sorted(others, key=lambda each: each[3:6] != name[3:6])[:seeds]:
            trials.append(tried(replace(recording, imu=recordings[other].imu), False, None))
    yield from rows_of("SmartFallMM, Azure Kinect", trials)


PARTS = {"simulated": simulated, "exercise": exercise, "utd": utd, "azure": azure}


@check(
    parts_option(*PARTS),
    seeds_option("12"),
)
def pairing(options: argparse.Namespace) -> Iterator[str]:
    """How many right and wrong pairs of camera and IMU are proved, accepted, and given the right clock."""
    for part in options.parts or PARTS:
        yield from PARTS[part](len(options.seeds))


#: Weight of `none` where every IMU is on somebody.
NEVER = -1e5
PROBABILITIES = (0.6, 0.8, 0.95, 0.99, 1.0 + 1e-9)


class Answer(NamedTuple):
    """One IMU: what was said, whether it is so, and what an assignment without `none` would have said."""

    match: ImuMatch
    is_right: bool
    is_assigned_right: bool

    @property
    def is_pair(self) -> bool:
        """A limb was named."""
        return self.match.limb is not None


def match_utd(method: str, first_s: float) -> list[Answer]:
    """Every IMU of all groups: trials of one action and number, one per subject, until a time."""
    answers, groups = [], defaultdict(list)
    for (_, action, trial), files in utd_files(datasets("utd_mhad")).items():
        if trial in (3, 4):  # constants were set on the others
            made = open_utd(files)
            imu, arm = made.imu.select(made.imu.t_s <= first_s), made.arm.select(made.arm.t_s <= first_s)
            groups[action, trial].append(replace(made, imu=imu, arm=arm))
    for _, group in sorted(groups.items()):
        limbs = [limb for body, one in enumerate(group) for limb in limbs_of(one.arm, body, one.side)]
        imus = [one.imu for one in group]
        pairs = pair_evidence(imus, limbs, CameraFrame.KINECT.down, method)
        # the question of the published method: which of the four wrists, each IMU being on one
        wrists = [k for k, limb in enumerate(limbs) if limb.segment == "wrist"]
        assigned = assign(pairs.limb[:, wrists], np.full(len(imus), NEVER))
        for body, match in enumerate(decide(imus, limbs, pairs)):
            where = match.limb
            is_right = where is not None and (where.body, where.segment) == (body, "wrist")
            answers.append(Answer(match, is_right, limbs[wrists[assigned[body]]].body == body))
    return answers


def scene_settings(seed: int) -> ArmSimulation:
    """Even seeds move at random for 20 s, odd ones perform the clinical protocol once."""
    if seed % 2:
        return ArmSimulation.preset("realistic", protocol="behind", repetitions=1)
    return ArmSimulation.preset("realistic", protocol="random", duration_s=20.0)


def scenes(methods: list[str], seeds: range) -> dict[str, list[Answer]]:
    """Every IMU of all scenes, by method."""
    answers: dict[str, list[Answer]] = {method: [] for method in methods}
    for seed in seeds:
        scene = simulate_people(PeopleSimulation(), scene_settings(seed), seed)
        limbs = [limb for body, side, arm in scene.arms for limb in limbs_of(arm, body, side)]
        imus = [one.stream for one in scene.worn]
        places = [(limb.body, limb.joint) for limb in limbs]
        for method in methods:
            pairs = pair_evidence(imus, limbs, scene.camera_frame.down, method)
            on_someone = [k for k, one in enumerate(scene.worn) if one.body is not None]
            assigned = assign(pairs.limb[on_someone], np.full(len(on_someone), NEVER))
            limb_of = dict(zip(on_someone, assigned.tolist(), strict=True))
            for k, match in enumerate(decide(imus, limbs, pairs)):
                true = (scene.worn[k].body, scene.worn[k].joint)
                body = None if match.limb is None else match.limb.body
                place = (body, match.joint) if k not in limb_of else places[limb_of[k]]
                answers[method].append(Answer(match, (body, match.joint) == true, place == true))
    return answers


def answer_rows(title: str, answers: dict[str, list[Answer]]) -> Iterator[str]:
    """One row per method, then reliability of the pairs."""
    yield (f"\n{title}, {len(next(iter(answers.values())))} IMUs")
    yield (
        f"{'method':22}{'right':>8}{'unknown':>9}{'wrong':>7}{'sure':>8}{'sure, wrong':>13}{'assigned':>10}"
    )
    for method, rows in answers.items():
        right = np.mean([one.is_right for one in rows])
        unknown = np.mean([not one.match.is_known for one in rows])
        assigned = np.mean([one.is_assigned_right for one in rows])
        wrong = sum(one.match.is_known and not one.is_right for one in rows)
        sure = [one for one in rows if one.is_pair and one.match.probability > SURE_FROM]
        bad = sum(not one.is_right for one in sure)
        share = len(sure) / len(rows)
        cells = f"{right:8.1%}{unknown:9.1%}{wrong:7d}{share:8.1%}{bad:13d}{assigned:10.1%}"
        yield (f"{method:22}{cells}")
    yield ("reliability: pairs with a probability of .. are right in .. of .. cases")
    for method, rows in answers.items():
        reliability = []
        for low, high in pairwise(PROBABILITIES):
            inside = [one for one in rows if one.is_pair and low <= one.match.probability < high]
            if inside:
                mean = np.mean([one.match.probability for one in inside])
                fraction = np.mean([one.is_right for one in inside])
                reliability.append(f"{mean:.3f}: {fraction:.3f} of {len(inside)}")
        yield (f"{method:22}{'; '.join(reliability)}")


@check(
    parts_option("match_utd", "scenes"),
    option("--methods", default=",".join(METHODS), help="names, with commas"),
    seeds_option("200", "scenes"),
)
def match(options: argparse.Namespace) -> Iterator[str]:
    """How often IMUs are found on the right limb of the right person, and how often surely."""
    methods = options.methods.split(",")
    wanted = options.parts or ["match_utd", "scenes"]
    if "match_utd" in wanted:
        for first_s, about in ((np.inf, "whole"), (2.0, "first 2 s")):
            found = {method: match_utd(method, first_s) for method in methods}
            yield from answer_rows(f"UTD-MHAD, trials 3, 4, {about}", found)
    if "scenes" in wanted:
        seeds = options.seeds
        yield from answer_rows(f"Scenes, seeds {seeds[0]} to {seeds[-1]}", scenes(methods, seeds))
