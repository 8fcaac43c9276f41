"""Sessions of short trials, `sessions`: simulated arms cut into trials of 8 s, each with a clock of its own.

For each seed: the trials whose clock the session finds, rightly (within 0.15 s) and wrongly, and those that
are proved; a trial with another session's IMU, which no strap may fit; and half of one session with half of
another one, which are two straps. With `--smooth` the trials are recovered by what the session shows, and
scored in their gaps that the camera saw the arm on both sides of; beside it the same gaps' error where
all of it is one recording.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib.motion import calibrate_motion
from smoother.measurements.visibility import occluded_at
from smoother.recording import Recording
from smoother.selfcal.agreement import agreement
from smoother.selfcal.pairing import decided
from smoother.selfcal.session import find_straps
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.smoothing import smooth
from tools.accuracy.check import ONE_PROCESS, check, option, rms, seeds_option

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
