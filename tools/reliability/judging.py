"""What an answer is worth against its truth, and the tables of it."""

from __future__ import annotations

import signal
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.errors import UnoccludeError
from smoother.linalg import interpolate
from smoother.recording import Recording
from smoother.result import Recovery
from smoother.smoothing import smooth
from tools.reliability.scene import Scene

ONE_PROCESS = Config.model_validate({"windows": {"processes": 1}})
#: Wrong: farther off than this over all gaps or over a single one (rms), and than this many stated sigmas, m.
GAPS_M, ONE_GAP_M, SIGMAS = 0.10, 0.15, 3.0
#: Chi-squared with three degrees of freedom is below this in 95 of 100.
CHI2_95 = 7.815
#: An interval is treated as trusted where more of its samples than this are.
TRUSTED_SHARE = 0.5

#: True times (N,) to the truth by name (`wrist`, `imu`), each (V, N, 3), m: of V views the nearest counts.
TruthAt = Callable[[FloatArray], dict[str, FloatArray]]


@dataclass(frozen=True)
class Interval:
    """A time to judge, on the true clock, s: an occlusion, or a visible time when the camera is wrong."""

    start_s: float
    end_s: float
    faulty: bool = False


@dataclass(frozen=True)
class Trial:
    """A recording with what is needed to judge its answer."""

    recording: Recording  # As a user gives it
    truth_at: TruthAt  # See `TruthAt`
    intervals: tuple[Interval, ...]  # What to judge
    offset_s: float | None = None  # Where the IMU's time has nothing to do with the motion
    calibration: ArmCalibration | None = None
    # (N,) s: When the IMU's samples were taken, where their stamps are wrong
    true_t_s: FloatArray | None = None


def trial_of(scene: Scene) -> Trial:
    """The trial of a scene."""

    def truth_at(t_s: FloatArray) -> dict[str, FloatArray]:
        joints = scene.motion.joints(t_s)
        truth = {name: joints[name] for name in scene.judged_joints}
        if scene.sensor_is_worn:
            truth["imu"] = scene.motion.imu_pose(t_s)[1]
        return {name: np.stack([view(t_s, place) for view in scene.views]) for name, place in truth.items()}

    gaps = [Interval(start_s, end_s) for start_s, end_s in scene.gaps]
    gaps += [Interval(start_s, end_s, faulty=True) for start_s, end_s in scene.faulty]
    offset_s = scene.offset_s if scene.unpaired else None
    return Trial(scene.recording(), truth_at, tuple(gaps), offset_s, scene.calibration, scene.true_t_s)


@dataclass(frozen=True, eq=False)
class Rated:
    """An interval of an answer."""

    interval: Interval
    # Rms of the wrist's error or of the IMU's (or of another joint's), the larger one in sigmas, and what is
    # stated of it (3D); nan where there is no answer
    error_m: float
    # Rms of the wrist's error or of the IMU's (or of another joint's), the larger one in sigmas, and what is
    # stated of it (3D); nan where there is no answer
    sigma_m: float
    trusted: bool  # The answer calls more than half of the interval's samples trusted
    squared_sigmas: FloatArray  # (n,): of its samples, wrist and IMU
    line_m: float = float("nan")  # Rms error of a straight line between the visible wrists beside it
    reasons: tuple[str, ...] = ()  # The gap's own

    def off(self, limit_m: float = ONE_GAP_M) -> bool:
        """Farther off than it may be."""
        return bool(self.error_m > limit_m and self.error_m > SIGMAS * self.sigma_m)


@dataclass(frozen=True)
class Outcome:
    """How a trial ended."""

    rated: tuple[Rated, ...] = ()  # By interval; empty without an answer
    sentence: str = ""  # The error that it ended with; "" for an answer
    trusted: bool | None = None  # The recording's verdict
    reasons: tuple[str, ...] = ()  # The verdict's reasons, or its cautions
    pairing: str = ""  # What the answer states of its pairing
    seconds: float = float("nan")  # s: what `smooth` took, and how long the recording is
    duration_s: float = float("nan")  # What `smooth` took, and how long the recording is
    contradiction: str = ""  # Where the verdicts of the answer contradict each other

    @property
    def verdict(self) -> str:
        """In a word."""
        if self.sentence:
            return "refused"
        if not self.trusted:
            return "not trusted"
        return "trusted" if all(each.trusted for each in self.rated) else "with care"

    @property
    def wrong_and_trusted(self) -> tuple[Rated, ...]:
        """Intervals that are wrong and called trusted; all trusted gaps where they are wrong together."""
        single = tuple(each for each in self.rated if each.trusted and each.off())
        gaps = [each for each in self.rated if each.trusted and np.isfinite(each.error_m)]
        if single or not gaps:
            return single
        weight = np.array([each.interval.end_s - each.interval.start_s for each in gaps])
        error_m, sigma_m = (
            np.sqrt(np.average(np.square([getattr(each, of) for each in gaps]), weights=weight))
            for of in ("error_m", "sigma_m")
        )
        wrong = error_m > GAPS_M and error_m > SIGMAS * sigma_m
        return (max(gaps, key=lambda each: each.error_m),) if wrong else ()

    @property
    def worst(self) -> Rated | None:
        """The interval to show: one that is wrong and trusted, else the one that is farthest off."""
        answered = [each for each in self.rated if np.isfinite(each.error_m)]
        return max(self.wrong_and_trusted or answered, key=lambda each: each.error_m, default=None)


#: How the sentence of a solve that was given up begins.
TOO_SLOW = "smooth took longer than"


class TooSlow(BaseException):
    """`smooth` took longer than anybody waits; no handler of ordinary errors is to swallow it."""


@contextmanager
def time_limit(recording: Recording) -> Iterator[None]:
    """Raise `TooSlow` after 40 s and three times the shorter stream's length of processor time."""
    shortest_s = min(float(t_s[-1] - t_s[0]) for t_s in (recording.imu.t_s, recording.arm.t_s))
    limit_s = 40.0 + 3.0 * shortest_s

    def stop(number: int, frame: object) -> None:
        raise TooSlow(f"{TOO_SLOW} {limit_s:.0f} s of processor time")

    before = signal.signal(signal.SIGVTALRM, stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def run(trial: Trial, config: Config = ONE_PROCESS) -> Outcome:
    """Smooth a trial as a user would, and judge the answer."""
    t_s = trial.recording.imu.t_s
    duration_s, began = float(t_s[-1] - t_s[0]), time.process_time()
    try:
        with time_limit(trial.recording):
            recovery = smooth(trial.recording, trial.calibration, config)
    except (UnoccludeError, TooSlow) as error:
        return Outcome(sentence=str(error), seconds=time.process_time() - began, duration_s=duration_s)
    except Exception as error:  # a set-up that ends in a traceback is a finding
        return Outcome(sentence=f"traceback, {type(error).__name__}: {error}", duration_s=duration_s)
    seconds = time.process_time() - began
    estimates = recovery.estimates
    return Outcome(
        rated=rated(recovery, trial),
        trusted=estimates.trusted,
        reasons=estimates.reasons or estimates.cautions,
        pairing=_pairing(recovery),
        seconds=seconds,
        duration_s=duration_s,
        contradiction=_contradiction(recovery),
    )


def rated(recovery: Recovery, trial: Trial) -> tuple[Rated, ...]:
    """Every interval of an answer."""
    t_s = recovery.t_s
    if trial.offset_s is not None:
        t_s = t_s - recovery.clock_offset_s + trial.offset_s
    if trial.true_t_s is not None:
        t_s = np.interp(t_s, trial.recording.imu.t_s, trial.true_t_s)
    truth, trusted = trial.truth_at(t_s), trusted_samples(recovery)
    answers = {name: (place, recovery.joint_covariance[name]) for name, place in recovery.joints.items()}
    answers["imu"] = (recovery.position, recovery.pose_covariance[:, :3, :3])
    found = []
    for interval in trial.intervals:
        rows = (t_s > interval.start_s) & (t_s < interval.end_s)
        if not rows.any():
            continue
        errors, squares = [], []
        for name, places in truth.items():
            if name not in answers:
                continue
            answer, covariance = answers[name]
            error = _nearest(answer[rows] - places[:, rows])
            known = np.isfinite(error).all(axis=1) & np.isfinite(covariance[rows]).all(axis=(1, 2))
            if known.any():
                errors.append(_error_and_sigma(error[known], covariance[rows][known]))
                squares.append(_squared_sigmas(error[known], covariance[rows][known]))
        error_m, sigma_m = max(errors, key=lambda pair: pair[0] / pair[1], default=(np.nan, np.nan))
        found.append(
            Rated(
                interval,
                error_m,
                sigma_m,
                bool(np.mean(trusted[rows]) > TRUSTED_SHARE) and bool(errors),
                np.concatenate(squares) if squares else np.empty(0),
                np.nan if interval.faulty else _line_m(recovery, truth["wrist"], rows),
                _reasons_at(recovery, recovery.t_s[rows]),
            )
        )
    return tuple(found)


def _nearest(errors: FloatArray) -> FloatArray:
    """Of (V, n, 3) errors those of the view that is nearest over the whole interval."""
    size = np.nansum(errors**2, axis=(1, 2))
    return np.asarray(errors[int(size.argmin())])


def _error_and_sigma(error: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    variance = np.trace(covariance, axis1=1, axis2=2)
    return float(np.sqrt((error**2).sum(axis=1).mean())), float(np.sqrt(variance.mean()))


def _squared_sigmas(error: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0]))


def _line_m(recovery: Recovery, truth: FloatArray, rows: BoolArray) -> float:
    """Rms error, m, of a straight line between the camera's wrists beside an interval; truth is (V, N, 3)."""
    arm, seen = recovery.arm, recovery.arm.tracked("wrist")
    t_s = recovery.t_s[rows]
    seen &= (arm.t_s < t_s[0]) | (arm.t_s > t_s[-1])
    if not (seen & (arm.t_s < t_s[0])).any() or not (seen & (arm.t_s > t_s[-1])).any():
        return float("nan")
    line = interpolate(arm.t_s[seen], arm.joint("wrist")[seen], t_s)
    return float(np.sqrt((_nearest(line - truth[:, rows]) ** 2).sum(axis=1).mean()))


def trusted_samples(recovery: Recovery) -> BoolArray:
    """(N,) what the answer calls trusted: sample by sample where it marks them, else all or nothing."""
    mask = getattr(recovery, "trusted", None)
    mask = np.ones(len(recovery), dtype=bool) if mask is None else np.asarray(mask, dtype=bool).copy()
    return mask & (recovery.estimates.trusted is not False)


def _reasons_at(recovery: Recovery, t_s: FloatArray) -> tuple[str, ...]:
    """Of the gaps' verdicts that overlap some times."""
    verdicts = getattr(recovery, "gap_verdicts", ())
    overlapping = [each for each in verdicts if each.start_s < t_s[-1] and each.end_s > t_s[0]]
    return tuple(dict.fromkeys(reason for each in overlapping for reason in each.reasons))


def _contradiction(recovery: Recovery) -> str:
    """Verdicts of one answer that do not go together; "" where they do."""
    verdicts, mask = getattr(recovery, "gap_verdicts", None), getattr(recovery, "trusted", None)
    if verdicts is None or mask is None:
        return ""
    if recovery.estimates.trusted is False and np.any(mask):
        return "not to be trusted, and samples that are"
    for each in verdicts:
        rows = (recovery.t_s > each.start_s) & (recovery.t_s < each.end_s)
        if not each.trusted and np.any(np.asarray(mask)[rows]):
            return f"the gap at {each.start_s:.1f} s is not trusted, and samples in it are"
    return ""


def _pairing(recovery: Recovery) -> str:
    pairing = getattr(recovery.estimates, "pairing", None)
    if pairing is None:
        return ""
    return (
        "proved" if getattr(pairing, "proved", False) else f"not proved ({getattr(pairing, 'chance', None)})"
    )


@dataclass(frozen=True)
class Row:
    """A trial's name and its end."""

    case: str  # The case, and what the person did before which tracker
    about: str  # The case, and what the person did before which tracker
    kind: str  # "sound", "unusual", "wrong" or "pair"
    seed: int
    outcome: Outcome

    @property
    def fails(self) -> str:
        """What is not as it must be; "" where all is well."""
        outcome = self.outcome
        if wrong := outcome.wrong_and_trusted:
            return f"WRONG AND TRUSTED x{len(wrong)}"
        if outcome.sentence.startswith("traceback"):
            return "TRACEBACK"
        if outcome.sentence.startswith(TOO_SLOW):
            return "TOO SLOW"
        if self.kind == "pair" and outcome.trusted:
            return "PAIR TRUSTED"
        if self.kind == "sound" and not outcome.trusted:
            return "SOUND, NOT TRUSTED"
        return "CONTRADICTION" if outcome.contradiction else ""

    def show(self) -> None:
        """Print the row."""
        outcome, worst = self.outcome, self.outcome.worst
        error, sigma = (worst.error_m, worst.sigma_m) if worst else (np.nan, np.nan)
        gap = "-" if worst is None else ("trusted" if worst.trusted else "not")
        said = outcome.sentence or "; ".join((*(worst.reasons if worst else ()), *outcome.reasons))
        text = " ".join(filter(None, [self.fails, outcome.contradiction, outcome.pairing, said]))
        print(
            f"{self.case:38} {self.about:32} {self.seed:10} {outcome.duration_s:5.1f} s"
            f" {_cm(error)} {_cm(sigma)}  {gap:8} {outcome.verdict:12} {textwrap.shorten(text, 170)}",
            flush=True,
        )


def head() -> None:
    """Print the heads of the columns."""
    print(
        f"{'case':38} {'exercise, tracker':32} {'seed':>10} {'length':>7} {'worst gap':>9} {'stated':>9}"
        f"  {'gap':8} {'recording':12} verdict"
    )


def summarise(rows: Sequence[Row]) -> None:
    """Print a line per case, then the figures that count."""
    print(f"\n{'case':38} runs refused not care trusted  intervals wrong and trusted")
    for case in dict.fromkeys(row.case for row in rows):
        own = [row.outcome for row in rows if row.case == case]
        ends = [
            sum(each.verdict == verdict for each in own)
            for verdict in ("refused", "not trusted", "with care", "trusted")
        ]
        wrong = [each for outcome in own for each in outcome.wrong_and_trusted]
        sizes = ", ".join(f"{_cm(each.error_m).strip()} at {_cm(each.sigma_m).strip()}" for each in wrong)
        print(
            f"{case:38} {len(own):4} {ends[0]:7} {ends[1]:3} {ends[2]:4} {ends[3]:7}"
            f"  {len(wrong) or '-'} {sizes}"
        )
    faults = [row for row in rows if row.kind in ("wrong", "unusual")]
    pairs, sound = ([row for row in rows if row.kind == kind] for kind in ("pair", "sound"))
    print()
    if faults:
        wrong_runs = sum(bool(row.outcome.wrong_and_trusted) for row in faults)
        print(f"wrong or unusual set-ups, an interval wrong and trusted: {wrong_runs} of {len(faults)}")
    if pairs:
        trusted, wrong_pairs = (
            sum(bool(of(row.outcome)) for row in pairs)
            for of in (lambda outcome: outcome.trusted, lambda outcome: outcome.wrong_and_trusted)
        )
        print(
            f"wrong pairs called trusted: {trusted} of {len(pairs)}; wrong in the gaps besides: {wrong_pairs}"
        )
    if sound:
        _show_sound([row.outcome for row in sound])
    _show_time([row.outcome for row in rows])


def _show_sound(outcomes: list[Outcome]) -> None:
    lost = [outcome for outcome in outcomes if not outcome.trusted]
    print(f"sound recordings not trusted or refused: {len(lost)} of {len(outcomes)}")
    wrong = sum(bool(outcome.wrong_and_trusted) for outcome in outcomes)
    print(f"sound recordings with an interval wrong and trusted: {wrong} of {len(outcomes)}")
    gaps: list[Rated] = [each for outcome in outcomes for each in outcome.rated if not each.interval.faulty]
    kept = [each for each in gaps if each.trusted]
    print(f"their gaps not trusted: {len(gaps) - len(kept)} of {len(gaps)}")
    if not kept:
        return
    squares = np.concatenate([each.squared_sigmas for each in kept])
    print(
        f"trusted gaps: rms {_cm(float(np.sqrt(np.mean([each.error_m**2 for each in kept])))).strip()},"
        f" {100 * np.mean(squares <= CHI2_95):.0f} % of the samples in the 95 % region,"
        f" squared error / variance {np.mean(squares) / 3:.2f} (median {np.median(squares) / 2.37:.2f})"
    )
    ratios = [each.error_m / each.line_m for each in kept if np.isfinite(each.line_m)]
    if ratios:
        print(
            f"error against a straight line's: median {np.median(ratios):.2f}, more than 1.1 times in"
            f" {sum(ratio > 1.1 for ratio in ratios)} of {len(ratios)} gaps"
        )


def _show_time(outcomes: list[Outcome]) -> None:
    share = [outcome.seconds / outcome.duration_s for outcome in outcomes if np.isfinite(outcome.seconds)]
    if share:
        print(f"time of smooth / time recorded: median {np.median(share):.2f}, most {max(share):.2f}")
    contradictions = sum(bool(outcome.contradiction) for outcome in outcomes)
    if contradictions:
        print(f"answers whose verdicts contradict each other: {contradictions}")


def _cm(metres: float) -> str:
    if not np.isfinite(metres):
        return f"{'-':>9}"
    return f"{100 * metres:6.1f} cm" if metres < 100 else f"{100 * metres:6.0e} cm"
