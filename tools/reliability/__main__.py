"""Run the second simulator: `python -m tools.reliability --seed S --count N --sound N [--only CASE]`.

Each case is a set-up, drawn from the seed: an exercise, a person, a tracker, a sensor, and what went wrong.
`smooth` runs on it without a word of warning. A row shows how far the worst gap is off, what the answer
states of it, and whether it calls it trusted; the summary counts what must not be. `--pairs presets|own|real`
runs wrong pairs instead. `--held-out` draws from seeds that no run without it ever sees: for the very end.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from smoother.array_types import FloatArray
from smoother.linalg import runs
from smoother.simulation import ArmSimulation, simulate_arm
from tools.reliability.judging import Row, head, summarise

from .cases import CASES, SOUND, UNUSUAL, WRONG, Case
from .judging import Interval, Trial, run, trial_of
from .scene import draw_scene

#: Pairs of our own are as long as a session's exercise, s.
PAIR_S = (40.0, 72.0)


@dataclass(frozen=True)
class Job:
    """A set-up to draw: which case (its number in `CASES`), who does what for how long, and the seeds."""

    case: int
    exercise: str
    duration_s: float
    rate_hz: float  # Of the camera
    seed: int  # As printed
    family: int  # 1 for the seeds that are held out
    kind: str  # See `Row.kind`

    def row(self) -> Row:
        """Smooth and judge it."""
        case = CASES[self.case]
        scene = draw_scene(
            self.exercise,
            self.duration_s,
            [self.seed, self.family],
            rate_hz=self.rate_hz,
            every_s=case.every_s,
        )
        scene = case.apply(scene)
        return Row(
            case.name, f"{scene.exercise}, {scene.tracker_name}", self.kind, self.seed, run(trial_of(scene))
        )


@dataclass(frozen=True)
class PresetJob:
    """A wrong pair of the project's own presets: preset, protocol, both seeds."""

    draw: tuple[str, str, int, int]

    def row(self) -> Row:
        """Smooth and judge it."""
        preset, protocol, seed, _ = self.draw
        return Row(
            "imu of another preset recording",
            f"{protocol}, {preset}",
            "pair",
            seed,
            run(preset_pair(*self.draw)),
        )


def draw_jobs(
    cases: Sequence[Case],
    count: int,
    rng: np.random.Generator,
    family: int,
    pairs_s: tuple[float, float] | None = None,
) -> list[Job]:
    """As many jobs, the cases in turn; the first ones do not depend on how many follow."""
    jobs = []
    for number in range(count):
        case = cases[number % len(cases)]
        shortest_s, longest_s = pairs_s or case.duration_s
        jobs.append(
            Job(
                CASES.index(case),
                str(rng.choice(case.exercises)),
                round(float(rng.uniform(shortest_s, longest_s)), 1),
                float(rng.choice(case.rate_hz)),
                int(rng.integers(2**31)),
                family,
                "pair" if pairs_s else case.kind,
            )
        )
    return jobs


def row_of(job: Job | PresetJob) -> Row:
    """A job's row; a function, so that processes can be given it."""
    return job.row()


def run_jobs(jobs: Sequence[Job | PresetJob], processes: int) -> list[Row]:
    """Run them, a row printed as soon as it is there."""
    rows: list[Row] = []
    head()
    with ProcessPoolExecutor(processes) as pool:
        for row in pool.map(row_of, jobs) if processes > 1 else map(row_of, jobs):
            row.show()
            rows.append(row)
    return rows


def own_pairs(count: int, rng: np.random.Generator, family: int) -> list[Job]:
    """Pairs of the second simulator, the same exercise in both."""
    cases = [case for case in WRONG if case.name in ("imu of another session", "imu of another person")]
    return draw_jobs(cases, count, rng, family, PAIR_S)


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.reliability",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    usual = len(WRONG) + len(UNUSUAL)
    parser.add_argument("--seed", type=int, default=0, help="of all draws")
    parser.add_argument(
        "--count", type=int, help=f"wrong and unusual set-ups, the cases in turn [{usual}]; or pairs"
    )
    parser.add_argument("--sound", type=int, help=f"sound recordings besides [{len(SOUND)}]")
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--pairs", choices=["presets", "own", "real"], help="wrong pairs instead")
    parser.add_argument("--held-out", action="store_true", help="the seeds that are kept for the end")
    parser.add_argument("--processes", type=int, default=1, help="recordings at a time")
    options = parser.parse_args()
    family = int(options.held_out)

    def rng(part: int) -> np.random.Generator:
        return np.random.default_rng([options.seed, part, family])

    if options.pairs == "real":
        from .real import show_pairs

        show_pairs(options.count or 12, rng(4))
        return
    jobs: list[Job | PresetJob]
    if options.pairs == "presets":
        jobs = [PresetJob(draw) for draw in preset_jobs(options.count or 20, rng(3))]
    elif options.pairs == "own":
        jobs = [*own_pairs(options.count or 12, rng(2), family)]
    else:
        faults, sound = (
            [case for case in cases if options.only in case.name] for cases in ((*WRONG, *UNUSUAL), SOUND)
        )
        if not faults and not sound:
            parser.error(
                f"no case is called '{options.only}'; choose one of: {', '.join(case.name for case in CASES)}"
            )
        count = len(faults) if options.count is None else options.count
        number = len(sound) if options.sound is None else options.sound
        jobs = [
            *draw_jobs(faults, count if faults else 0, rng(0), family),
            *draw_jobs(sound, number if sound else 0, rng(1), family),
        ]
    summarise(run_jobs(jobs, options.processes))


PRESETS = ("white", "realistic", "azure")
#: What the presets' people do: the protocol, and how long.
PROTOCOLS = ("behind", "random")
PRESET_S = 70.0


def preset_pair(preset: str, protocol: str, skeleton_seed: int, imu_seed: int) -> Trial:
    """The skeleton of one simulated arm with the IMU of another one that does the same."""
    config = ArmSimulation.preset(preset, protocol=protocol, repetitions=3, duration_s=PRESET_S)
    one, other = simulate_arm(config, skeleton_seed), simulate_arm(config, imu_seed)
    offset_s = float(one.parameters["clock_offset_s"])
    true_t = one.recording.arm.t_s + offset_s

    def truth_at(t_s: FloatArray) -> dict[str, FloatArray]:
        inside = np.clip(t_s, true_t[0], true_t[-1])
        wrist = np.where((t_s == inside)[:, None], one.motion.joints(inside)["wrist"], np.nan)
        return {"wrist": wrist[None]}

    hidden = tuple(
        Interval(float(true_t[run.start]), float(true_t[run.stop - 1]))
        for run in runs(one.occluded)
        if run.stop - run.start > 3
    )
    recording = replace(one.recording, imu=other.recording.imu, truth=None)
    return Trial(recording, truth_at, hidden, offset_s)


def preset_jobs(count: int, rng: np.random.Generator) -> list[tuple[str, str, int, int]]:
    """As many pairs: preset, protocol, seed of the skeleton, seed of the IMU."""
    return [
        (
            PRESETS[number % len(PRESETS)],
            PROTOCOLS[number % len(PROTOCOLS)],
            int(rng.integers(2**30)),
            int(rng.integers(2**30, 2**31)),
        )
        for number in range(count)
    ]


if __name__ == "__main__":
    main()
