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
half of them everybody moves in time. Both print by method what was right, and how often pairs of a stated
probability are. `assigned` is the share that is right where each worn IMU has to be on a limb (in `utd`
on one of the four wrists), which is what the published method answers. Constants were set on trials 1 and 2
and seeds from 1000 on; measured are trials 3 and 4 and seeds from 0 on.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from smoother.errors import RecordingError
from smoother.evaluation.datasets import open_smartfallmm, open_utd, smartfallmm_trials, utd_files
from smoother.matching import METHODS, SURE_FROM, ImuMatch, decide, limbs_of, pair_evidence
from smoother.matching.match import assign
from smoother.recording import CameraFrame, Recording
from smoother.selfcal.agreement import agreement
from smoother.selfcal.pairing import decided
from smoother.simulation import ArmSimulation, PeopleSimulation, simulate_arm, simulate_people
from tools.accuracy.check import PRESETS, check, datasets, option, parts_option, seeds_option, table

#: A clock is treated as found where it is this near, s.
FOUND_S = 0.2
#: Pairs of streams: of what kind, the recording, the true offset where it is known (s), and whether right.
Pairs = Iterator[tuple[str, Recording, float | None, bool]]


def tried(kind: str, recording: Recording, true_s: float | None, right: bool) -> dict[str, Any]:
    """Pair a recording's streams, with unrelated clocks and with those of one recorder."""
    found_at = agreement(recording)
    apart, _ = decided(found_at, replace(recording, clocks_unrelated=True))
    together, _ = decided(found_at, replace(recording, clocks_unrelated=False))
    found = apart is not None and true_s is not None and abs(apart.offset_s - true_s) < FOUND_S
    return {
        "kind": kind,
        "pairs": "right" if right else "wrong",
        "proved": apart is not None and apart.proved,
        "accepted": together is not None and not together.reason,
        "known": right and true_s is not None,
        "clock found": right and found,
        "evidence": None if apart is None else apart.evidence,
    }


def simulated(seeds: int) -> Pairs:
    """Random motion, and the same script in every recording; the wrong IMU is of the next recording."""
    kinds = [
        (f"random, {length_s} s", {"protocol": "random", "duration_s": length_s})
        for length_s in (8, 15, 30, 60)
    ]
    yield from _crossed(seeds, kinds)


def exercise(seeds: int) -> Pairs:
    """The same script in every recording."""
    yield from _crossed(seeds, [(f"exercise, {count} times", {"repetitions": count}) for count in (2, 5)])


def _crossed(seeds: int, kinds: list[tuple[str, dict[str, Any]]]) -> Pairs:
    """Recordings of each preset in turn: each as it is, and with the IMU of the next one."""
    for kind, changes in kinds:
        made = []
        for seed in range(seeds):
            arm = simulate_arm(ArmSimulation.preset(PRESETS[seed % len(PRESETS)], **changes), 9000 + seed)
            made.append((replace(arm.recording, truth=None), arm.parameters["clock_offset_s"]))
        for number, (recording, true_s) in enumerate(made):
            yield kind, recording, true_s, True
            yield kind, replace(recording, imu=made[(number + 1) % len(made)][0].imu), None, False


def utd(seeds: int) -> Pairs:
    """Trials of UTD-MHAD, this many subjects; the wrong IMU is of another trial of the same activity."""
    files = utd_files(datasets("utd_mhad"))
    recordings = {key: open_utd(files[key]) for key in sorted(files, key=lambda key: files[key].name)}
    rng = np.random.default_rng(0)
    for key, recording in recordings.items():
        if key[0] > seeds:
            continue
        yield "UTD-MHAD", recording, -0.04, True  # both streams cover the same interval
        others = [each for each in recordings if each[1] == key[1] and each != key]
        other = recordings[others[rng.integers(len(others))]]
        yield "UTD-MHAD", replace(recording, imu=other.imu), None, False


def azure(seeds: int) -> Pairs:
    """Trials of SmartFallMM; the wrong IMU of this many other trials, those of the same activity first."""
    recordings = {}
    for trial in smartfallmm_trials(datasets("smartfallmm")):
        with suppress(RecordingError):  # a file of it cannot be used
            recordings[trial.name] = open_smartfallmm(trial)
    for name, recording in recordings.items():
        yield "SmartFallMM, Azure Kinect", recording, None, True
        others = sorted(
            (each for each in recordings if each != name), key=lambda each: each[3:6] != name[3:6]
        )
        for other in others[:seeds]:
            yield "SmartFallMM, Azure Kinect", replace(recording, imu=recordings[other].imu), None, False


PARTS = {"simulated": simulated, "exercise": exercise, "utd": utd, "azure": azure}


@check(parts_option(*PARTS), seeds_option("12"))
def pairing(options: argparse.Namespace) -> Iterator[str]:
    """How many right and wrong pairs of camera and IMU are proved, accepted, and given the right clock."""
    found = (tried(*pair) for part in options.parts or PARTS for pair in PARTS[part](len(options.seeds)))
    yield from table(
        """select kind, pairs, count(*) as n, sum(proved::int) as proved, sum(accepted::int) as accepted,
        sum(known::int) as known, sum("clock found"::int) as "clock found", min(evidence) as least,
        median(evidence) as median, max(evidence) as most from found group by kind, pairs order by all""",
        found,
    )


#: Weight of `none` where every IMU is on somebody.
NEVER = -1e5


def answer(title: str, method: str, match: ImuMatch, right: bool, assigned: bool) -> dict[str, Any]:
    """What was said of an IMU, whether it is so, and whether an assignment without `none` would have been."""
    sure = match.limb is not None and match.probability > SURE_FROM
    return {
        "of": title,
        "method": method,
        "right": right,
        "unknown": not match.is_known,
        "wrong": match.is_known and not right,
        "sure": sure,
        "sure, wrong": sure and not right,
        "assigned": assigned,
        "probability": match.probability if match.limb is not None else None,
    }


def match_utd(methods: list[str]) -> Iterator[dict[str, Any]]:
    """Every IMU of all groups: trials of one action and number, one per subject; whole, and the first 2 s."""
    for first_s, about in ((np.inf, "whole"), (2.0, "first 2 s")):
        groups = defaultdict(list)
        for (_, action, trial), files in utd_files(datasets("utd_mhad")).items():
            if trial in (3, 4):  # constants were set on the others
                made = open_utd(files)
                imu, arm = made.imu.select(made.imu.t_s <= first_s), made.arm.select(made.arm.t_s <= first_s)
                groups[action, trial].append(replace(made, imu=imu, arm=arm))
        for _, group in sorted(groups.items()):
            limbs = [limb for body, one in enumerate(group) for limb in limbs_of(one.arm, body, one.side)]
            imus = [one.imu for one in group]
            # the question of the published method: which of the four wrists, each IMU being on one
            wrists = [k for k, limb in enumerate(limbs) if limb.segment == "wrist"]
            for method in methods:
                pairs = pair_evidence(imus, limbs, CameraFrame.KINECT.down, method)
                assigned = assign(pairs.limb[:, wrists], np.full(len(imus), NEVER))
                for body, match in enumerate(decide(imus, limbs, pairs)):
                    where = match.limb
                    right = where is not None and (where.body, where.segment) == (body, "wrist")
                    by_force = limbs[wrists[assigned[body]]].body == body
                    yield answer(f"UTD-MHAD, trials 3, 4, {about}", method, match, right, by_force)


def scenes(methods: list[str], seeds: range) -> Iterator[dict[str, Any]]:
    """Every IMU of all scenes: even seeds move at random for 20 s, odd ones do the clinical protocol once."""
    title = f"scenes, seeds {seeds[0]} to {seeds[-1]}"
    for seed in seeds:
        settings = {"repetitions": 1} if seed % 2 else {"protocol": "random", "duration_s": 20.0}
        scene = simulate_people(PeopleSimulation(), ArmSimulation.preset("realistic", **settings), seed)
        limbs = [limb for body, side, arm in scene.arms for limb in limbs_of(arm, body, side)]
        imus = [one.stream for one in scene.worn]
        places = [(limb.body, limb.joint) for limb in limbs]
        on_someone = [k for k, one in enumerate(scene.worn) if one.body is not None]
        for method in methods:
            pairs = pair_evidence(imus, limbs, scene.camera_frame.down, method)
            assigned = assign(pairs.limb[on_someone], np.full(len(on_someone), NEVER))
            limb_of = dict(zip(on_someone, assigned.tolist(), strict=True))
            for k, match in enumerate(decide(imus, limbs, pairs)):
                true = (scene.worn[k].body, scene.worn[k].joint)
                said = (None if match.limb is None else match.limb.body, match.joint)
                by_force = places[limb_of[k]] if k in limb_of else said
                yield answer(title, method, match, said == true, by_force == true)


@check(
    parts_option("match_utd", "scenes"),
    option("--methods", default=",".join(METHODS), help="names, with commas"),
    seeds_option("200", "scenes"),
)
def match(options: argparse.Namespace) -> Iterator[str]:
    """How often IMUs are found on the right limb of the right person, and how often surely."""
    parts, methods = options.parts or ("match_utd", "scenes"), options.methods.split(",")
    found = [*match_utd(methods)] if "match_utd" in parts else []
    found += scenes(methods, options.seeds) if "scenes" in parts else []
    shares = [f'100 * avg("{name}"::int) as "{name}, %"' for name in ("right", "unknown", "sure", "assigned")]
    counts = [f'sum("{name}"::int) as "{name}"' for name in ("wrong", "sure, wrong")]
    yield from table(
        f"""select "of", method, count(*) as IMUs, {", ".join(shares + counts)} from found
        group by "of", method order by all""",
        found,
    )
    yield "\nreliability of the pairs: the stated probability, and how often it is right"
    yield from table(
        """select "of", method, case when probability < 0.8 then 0.6 when probability < 0.95 then 0.8
        when probability < 0.99 then 0.95 else 0.99 end as "from", avg(probability) as stated,
        avg("right"::int) as "right", count(*) as n from found where probability >= 0.6
        group by all order by all""",
        found,
    )
