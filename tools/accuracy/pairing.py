"""Which camera and IMU belong together, `pairing` and `sessions`, and which IMU is on whom, `match`.

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

`sessions`: simulated arms cut into trials of 8 s, each with a clock of its own. For each seed: the trials
whose clock the session finds, rightly (within 0.15 s) and wrongly, and those that are proved; a trial with
another session's IMU, which no strap may fit; and half of one session with half of another one, which are
two straps. With `--smooth` the trials are recovered by what the session shows, and scored in their gaps that
the camera saw the arm on both sides of; beside it the same gaps' error where all of it is one recording.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from calib.motion import calibrate_motion
from smoother.errors import RecordingError
from smoother.evaluation.benchmark import open_smartfallmm, open_utd, smartfallmm_trials, utd_files
from smoother.matching import METHODS, SURE_FROM, ImuMatch, decide, limbs_of, pair_evidence
from smoother.matching.match import assign
from smoother.measurements.visibility import occluded_at
from smoother.recording import CameraFrame, Recording
from smoother.selfcal.agreement import agreement
from smoother.selfcal.pairing import decided
from smoother.selfcal.session import find_straps
from smoother.simulation import ArmSimulation, PeopleSimulation, SimulatedArm, simulate_arm, simulate_people
from smoother.smoothing import smooth
from tools.accuracy.check import (
    ONE_PROCESS,
    PRESETS,
    check,
    datasets,
    option,
    parts_option,
    rms,
    seeds_option,
    table,
)

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


LENGTH_S, APART_S, MOST_OFF_S, RIGHT_S = 8.0, 12.0, 10.0, 0.15
#: The seed of the session that is foreign to another one's.
FOREIGN = 500


def made_session(seed: int, count: int) -> SimulatedArm:
    """An arm that moves for as long as that many trials, a second hidden every five."""
    settings = {"occlusion_lengths_s": (1.0,), "occlusion_every_s": 5.0, "duration_s": count * APART_S + 5.0}
    return simulate_arm(ArmSimulation.preset("realistic", protocol="random", **settings), seed)


def trials_of(made: SimulatedArm, count: int, seed: int) -> list[tuple[Recording, float, float]]:
    """Trials, each with t_imu - t_camera and with where its IMU's clock is zero on the recording's, s."""
    recording, rng, trials = made.recording, np.random.default_rng(seed), []
    offset_s = float(made.parameters["clock_offset_s"])
    imu_t, frame_t = np.asarray(recording.imu.t_s), np.asarray(recording.arm.t_s) + offset_s
    for number in range(count):
        start_s, off_s = 2.0 + APART_S * number, float(rng.uniform(-MOST_OFF_S, MOST_OFF_S))
        before_s, after_s = rng.uniform(0.0, 1.5, 2)
        inside = (imu_t > start_s - before_s) & (imu_t < start_s + LENGTH_S + after_s)
        imu = recording.imu.select(inside)
        arm = recording.arm.select((frame_t > start_s) & (frame_t < start_s + LENGTH_S))
        zero_s = float(imu.t_s[0])
        trial = replace(
            recording,
            imu=replace(imu, t_s=imu.t_s - zero_s),
            arm=replace(arm, t_s=arm.t_s - zero_s + off_s),
            truth=None,
            clocks_unrelated=True,
            name=f"trial {number + 1}",
        )
        trials.append((trial, offset_s - off_s, zero_s))
    return trials


@check(
    seeds_option("0:20"),
    option("--count", type=int, default=20, help="trials of a session [20]"),
    option("--smooth", action="store_true", help="recover them, too"),
)
def sessions(options: argparse.Namespace) -> Iterator[str]:
    """How many trials of a session are proved, rightly; foreign trials, and two straps in one session."""
    total = np.zeros(8)
    counted = "right | wrong | proved | foreign named | two straps apart | trusted"
    yield f"| seed | {counted} | rms in gaps, cm | as one recording |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for seed in options.seeds:
        made = made_session(seed, options.count)
        trials = trials_of(made, options.count, seed)
        others = [
            trial for trial, *_ in trials_of(made_session(seed + FOREIGN, options.count), options.count, seed)
        ]
        own, counts = [trial for trial, *_ in trials], np.zeros(8)
        strap = next(iter(find_straps(own)), None)
        for number, (trial, offset_s, _) in enumerate(trials):
            found = None if strap is None else agreement(trial, along=strap.along)
            if strap is None or found is None:
                continue
            right, (pairing, _) = abs(found.best.offset_s - offset_s) < RIGHT_S, decided(found, trial)
            proved = pairing is not None and pairing.proved
            counts[0] += right and number in strap.members
            counts[1] += not right and (proved or number in strap.members)
            counts[2] += proved
        foreign = seed % options.count
        mixed = [*own[:foreign], replace(own[foreign], imu=others[foreign].imu), *own[foreign + 1 :]]
        counts[3] = all(foreign not in each.members for each in find_straps(mixed))
        half = options.count // 2
        apart = find_straps([*own[:half], *others[half:]])
        counts[4] = len(apart) == 2 and all(len({m < half for m in each.members}) == 1 for each in apart)
        errors = np.zeros(0)
        if options.smooth:
            calibration = calibrate_motion(own, None, ONE_PROCESS).calibration
            for trial, _, zero_s in trials:
                recovery = smooth(trial, calibration, ONE_PROCESS)
                counts[5] += recovery.estimates.trusted is True
                _, true = made.motion.imu_pose(recovery.t_s + zero_s)
                two_sided = tuple(gap for gap in recovery.gaps if not (gap.open_start or gap.open_end))
                rows = occluded_at(recovery.t_s, two_sided) & recovery.trusted
                rows &= np.isfinite(recovery.position[:, 0])
                errors = np.append(errors, np.linalg.norm(recovery.position - true, axis=1)[rows])
            counts[6] = 100.0 * rms(errors)
            whole = smooth(replace(made.recording, truth=None), None, ONE_PROCESS)
            _, true = made.motion.imu_pose(whole.t_s)
            rows = whole.occluded & np.isfinite(whole.position[:, 0])
            counts[7] = 100.0 * rms(np.linalg.norm(whole.position - true, axis=1)[rows])
        total += counts
        yield f"| {seed} | {' | '.join(f'{count:.3g}' for count in counts)} |"
    sums = [f"{count:.4g}" for count in total[:6]]
    means = [f"{mean:.2f}" for mean in total[6:] / len(options.seeds)]
    yield f"| all | {' | '.join([*sums, *means])} |"
