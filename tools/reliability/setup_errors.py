"""Answers on wrong set-ups: `python -m tools.reliability.setup_errors --count 200 --sound 40`.

Each case is a mistake that people make with sensors, axes, clocks, units or names, put into a simulated
recording; which case, recording, preset and length is drawn from the seed. `smooth` runs on it without a word
of warning. The table says how far the answer is off in the gaps, what sigma it states there, or the sentence
that it ends with, and whether the result is called trusted. `--sound` adds recordings without a mistake.
"""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from smoother.config import Config
from smoother.errors import UnoccludeError
from smoother.evaluation.validate import sample_errors
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth
from tools.reliability.setup_cases import CASES, Setup, sound

ONE_PROCESS = Config.model_validate({"windows": {"processes": 1}})
PRESETS = ("white", "realistic", "azure")
SHORTEST_S, LONGEST_S = 24.0, 60.0
#: An answer that is off by more than this in the gaps must not be called trusted, m.
LARGEST_ERROR_M = 0.10


@dataclass(frozen=True)
class Job:
    """One recording to draw.

    Attributes
    ----------
    case : function
        The mistake.
    seed : int
        Of the recording and of the mistake's draws.
    preset : str
    duration_s : float, s
    """

    case: Callable[[Setup], Setup]
    seed: int
    preset: str
    duration_s: float

    @property
    def name(self) -> str:
        """The case in words."""
        return self.case.__name__.replace("_", " ")

    def setup(self) -> Setup:
        """The recording with its mistake."""
        config = ArmSimulation.preset(self.preset, protocol="random", duration_s=self.duration_s)
        simulated, rng = simulate_arm(config, self.seed), np.random.default_rng(self.seed)
        return self.case(Setup(simulated, config, rng, simulated.recording))


def draw(count: int, seed: int, cases: tuple[Callable[[Setup], Setup], ...] = CASES) -> list[Job]:
    """As many jobs, the cases in turn; the first ones do not depend on how many follow."""
    rng = np.random.default_rng([seed, int(cases == (sound,))])
    return [
        Job(
            cases[number % len(cases)],
            int(rng.integers(2**31)),
            str(rng.choice(PRESETS)),
            round(float(rng.uniform(SHORTEST_S, LONGEST_S)), 1),
        )
        for number in range(count)
    ]


@dataclass(frozen=True)
class Outcome:
    """How a job ended.

    Attributes
    ----------
    error_m, sigma_m : float, m
        Rms of the IMU's position error in the gaps, and of what is stated; nan without an answer.
    sentence : str
        The error that it ended with; "" for an answer.
    trusted : bool or None
        The result's own verdict; None where it has none.
    reasons : tuple of str
        The verdict's reasons or cautions; the result's notes where it has no verdict.
    """

    error_m: float = float("nan")
    sigma_m: float = float("nan")
    sentence: str = ""
    trusted: bool | None = None
    reasons: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """In a word."""
        if self.sentence:
            return "refused"
        return {True: "trusted", False: "not trusted", None: "no verdict yet"}[self.trusted]

    @property
    def off(self) -> bool:
        """The answer is off by more than it may be in a result that is trusted."""
        return self.error_m > LARGEST_ERROR_M


def run(job: Job, config: Config = ONE_PROCESS) -> Outcome:
    """Smooth a job's recording and judge the answer."""
    setup = job.setup()
    truth = setup.recording.truth
    assert truth is not None
    try:
        recovery = smooth(replace(setup.recording, truth=None), setup.calibration, config)
    except UnoccludeError as error:
        return Outcome(sentence=str(error))
    except Exception as error:  # a mistake that ends in a traceback is what this program looks for
        return Outcome(sentence=f"traceback, {type(error).__name__}: {error}")
    errors, occluded = sample_errors(recovery, truth), setup.occluded(recovery.t_s)
    answered = occluded & np.isfinite(errors.distance_m)
    variance = np.trace(recovery.pose_covariance[answered, :3, :3], axis1=1, axis2=2)
    estimates = getattr(recovery, "estimates", None)
    trusted = getattr(estimates, "trusted", None)
    reasons = getattr(estimates, "reasons", ()) or getattr(estimates, "cautions", ())
    if trusted is None:
        reasons = recovery.notes
    return Outcome(
        float(np.sqrt(np.mean(errors.distance_m[answered] ** 2))) if answered.any() else float("nan"),
        float(np.sqrt(np.mean(variance))) if answered.any() else float("nan"),
        trusted=None if trusted is None else bool(trusted),
        reasons=tuple(reasons),
    )


def show(job: Job, outcome: Outcome) -> None:
    """Print a row of the table."""
    text = outcome.sentence or "; ".join(outcome.reasons)
    print(
        f"{job.name:32} {job.seed:10} {job.preset:9} {job.duration_s:4.1f} s {_cm(outcome.error_m)}"
        f" {_cm(outcome.sigma_m)}  {outcome.verdict:14} {textwrap.shorten(text, 150)}",
        flush=True,
    )


def summarise(jobs: list[Job], outcomes: list[Outcome]) -> None:
    """Print a line a case, and what is to be none."""
    print(f"\n{'case':32} {'jobs':>4} {'refused':>7} {'trusted':>7} {'not':>4}  errors in the gaps / stated")
    for name in dict.fromkeys(job.name for job in jobs):
        own = [outcome for job, outcome in zip(jobs, outcomes, strict=True) if job.name == name]
        answers = [f"{_cm(each.error_m)} /{_cm(each.sigma_m)}" for each in own if not each.sentence]
        refused, trusted, untrusted = (
            sum(each.verdict == verdict for each in own) for verdict in ("refused", "trusted", "not trusted")
        )
        print(f"{name:32} {len(own):4} {refused:7} {trusted:7} {untrusted:4}  {', '.join(answers)}")
    wrong, good = (
        [each for job, each in zip(jobs, outcomes, strict=True) if (job.case is sound) is is_sound]
        for is_sound in (False, True)
    )
    undecided = sum(each.off and each.verdict == "no verdict yet" for each in wrong)
    print(
        f"\nwrong, above {100 * LARGEST_ERROR_M:.0f} cm in the gaps and trusted:"
        f" {sum(each.off and each.trusted is True for each in wrong)} of {len(wrong)}"
        f" (without a verdict yet: {undecided})"
    )
    untrusted = sum(each.trusted is False or bool(each.sentence) for each in good)
    print(f"sound, not trusted or refused: {untrusted} of {len(good)}")


def _cm(metres: float) -> str:
    if not np.isfinite(metres):
        return f"{'-':>11}"
    return f"{100 * metres:8.2f} cm" if metres < 1000 else f"{100 * metres:8.1e} cm"


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=44, help="wrong set-ups, the cases in turn")
    parser.add_argument("--sound", type=int, default=0, help="recordings without a mistake besides")
    parser.add_argument("--seed", type=int, default=0, help="of all draws")
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--processes", type=int, default=1, help="recordings at a time")
    options = parser.parse_args()
    cases = tuple(case for case in CASES if options.only in case.__name__.replace("_", " "))
    if not cases:
        parser.error(f"no case is called '{options.only}'")
    jobs = [*draw(options.count, options.seed, cases), *draw(options.sound, options.seed, (sound,))]
    outcomes = []
    with ProcessPoolExecutor(options.processes) as pool:
        answers = pool.map(run, jobs) if options.processes > 1 else map(run, jobs)
        for job, outcome in zip(jobs, answers, strict=True):
            show(job, outcome)
            outcomes.append(outcome)
    summarise(jobs, outcomes)


if __name__ == "__main__":
    main()
