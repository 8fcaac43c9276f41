"""Which IMU is on whom: `match [utd|scenes] [--methods motion,..] [--develop]`.

`utd`: all trials of an action in UTD-MHAD at once (four people who do the same, one IMU on each right
wrist; needs UNOCCLUDE_DATASETS), whole trials and their first 2 s, with four wrists and four upper arms to
choose from. `scenes`: simulated scenes of two people with four nameless IMUs, one of them on the table;
half of the scenes random motion, half a clinical protocol; in half of them everybody moves in time. Both
print a table of methods and how often pairs of a stated probability are right. `assigned` is the share that
is right where each worn IMU has to be on a limb (in `utd` on one of the four wrists), which is what the
published methods answer. Reported are trials 3 and 4 and seeds from 0 on; `--develop` takes those that the
constants were set on: trials 1 and 2, seeds from 1000 on.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from smoother.io import import_utd_mhad
from smoother.matching import METHODS, SURE_FROM, ImuMatch, decide, limbs_of, pair_evidence
from smoother.matching.match import assign
from smoother.recording import CameraFrame, Recording
from smoother.simulation import ArmSimulation, PeopleSimulation, simulate_people
from tools.accuracy.check import Check, datasets, option, parts_option, seeds_option

#: Weight of `none` where every IMU is on somebody.
NEVER = -1e5
ACTIONS, SUBJECTS = range(1, 22), range(1, 5)
PROBABILITIES = (0.6, 0.8, 0.95, 0.99, 1.0 + 1e-9)


@dataclass(frozen=True)
class Answer:
    """One IMU: what was said, whether it is so, and what an assignment without `none` would have said."""

    match: ImuMatch
    is_right: bool
    is_assigned_right: bool

    @property
    def is_pair(self) -> bool:
        """A limb was named."""
        return self.match.limb is not None


def utd_groups(trials: tuple[int, ...], first_s: float | None) -> Iterator[list[Recording]]:
    """Trials of one action and number, one a subject."""
    folder = datasets("utd_mhad")
    for action in ACTIONS:
        for trial in trials:
            group = []
            for subject in SUBJECTS:
                name = f"a{action}_s{subject}_t{trial}"
                inertial = folder / "Inertial" / f"{name}_inertial.mat"
                if inertial.exists():
                    made = import_utd_mhad(inertial, folder / "Skeleton" / f"{name}_skeleton.mat")
                    if first_s is not None:
                        imu = made.imu.select(made.imu.t_s <= first_s)
                        made = replace(made, imu=imu, arm=made.arm.select(made.arm.t_s <= first_s))
                    group.append(made)
            yield group


def utd(method: str, trials: tuple[int, ...], first_s: float | None) -> list[Answer]:
    """Every IMU of all groups."""
    answers = []
    for group in utd_groups(trials, first_s):
        limbs = [limb for body, one in enumerate(group) for limb in limbs_of(one.arm, body, one.side)]
        imus = [one.imu for one in group]
        pairs = pair_evidence(imus, limbs, CameraFrame.KINECT.down, method)
        # the question of the published methods: which of the four wrists, each IMU being on one
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
    """A row a method, then reliability of the pairs."""
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


def match(options: argparse.Namespace) -> Iterator[str]:
    """How often IMUs are found on the right limb of the right person, and how often surely."""
    methods = options.methods.split(",")
    wanted = options.parts or ["utd", "scenes"]
    trials = (1, 2, 3, 4) if options.all_trials else (1, 2) if options.develop else (3, 4)
    if "utd" in wanted:
        for first_s, about in ((None, "whole"), (2.0, "first 2 s")):
            title = f"UTD-MHAD, trials {', '.join(map(str, trials))}, {about}"
            yield from answer_rows(title, {method: utd(method, trials, first_s) for method in methods})
    if "scenes" in wanted:
        start = 1000 if options.develop else 0
        seeds = range(start + options.seeds.start, start + options.seeds.stop)
        yield from answer_rows(f"Scenes, seeds {seeds[0]} to {seeds[-1]}", scenes(methods, seeds))


CHECKS = (
    Check(
        "match",
        match,
        (
            parts_option("utd", "scenes"),
            option("--methods", default=",".join(METHODS), help="names, with commas"),
            seeds_option("200", "scenes"),
            option("--develop", action="store_true", help="what the constants were set on"),
            option("--all-trials", action="store_true", help="of utd, developed and others together"),
        ),
    ),
)
