"""What an answer is worth against its truth."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.config import Config
from smoother.errors import UnoccludeError
from smoother.evaluation.metrics import squared_sigmas
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

#: True times (N,) to the truth by name (`wrist`, `imu`), each (N, 3), m.
TruthAt = Callable[[FloatArray], dict[str, FloatArray]]
Interval = tuple[float, float]


@dataclass(frozen=True)
class Trial:
    """A recording with what is needed to judge its answer."""

    recording: Recording  # As a user gives it
    truth_at: TruthAt  # See `TruthAt`
    intervals: tuple[Interval, ...]  # When the arm is hidden, on the true clock, s
    offset_s: float | None = None  # Where the IMU's time has nothing to do with the motion


def trial_of(scene: Scene) -> Trial:
    """The trial of a scene."""

    def truth_at(t_s: FloatArray) -> dict[str, FloatArray]:
        joints = scene.motion.joints(t_s)
        truth = {name: joints[name] for name in scene.judged_joints} | {"imu": scene.motion.imu_pose(t_s)[1]}
        return {name: scene.view(t_s, place) for name, place in truth.items()}

    return Trial(scene.recording(), truth_at, scene.gaps)


@dataclass(frozen=True, eq=False)
class Rated:
    """An interval of an answer."""

    length_s: float
    # Rms of the wrist's error or of the IMU's (or of another joint's), the larger one in sigmas, and what is
    # stated of it (3D); nan where there is no answer
    error_m: float
    sigma_m: float
    trusted: bool  # The answer calls more than half of the interval's samples trusted
    squared_sigmas: FloatArray  # (n,): of its samples, wrist and IMU

    def off(self, limit_m: float = ONE_GAP_M) -> bool:
        """Farther off than it may be."""
        return bool(self.error_m > limit_m and self.error_m > SIGMAS * self.sigma_m)


@dataclass(frozen=True)
class Outcome:
    """How a trial ended."""

    rated: tuple[Rated, ...] = ()  # By interval; empty without an answer
    sentence: str = ""  # The error that it ended with; "" for an answer
    trusted: bool | None = None  # The recording's verdict

    @property
    def wrong_and_trusted(self) -> tuple[Rated, ...]:
        """Intervals that are wrong and called trusted; all trusted gaps where they are wrong together."""
        single = tuple(each for each in self.rated if each.trusted and each.off())
        gaps = [each for each in self.rated if each.trusted and np.isfinite(each.error_m)]
        if single or not gaps:
            return single
        weight = [each.length_s for each in gaps]
        error_m, sigma_m = (
            np.sqrt(np.average(np.square([getattr(each, of) for each in gaps]), weights=weight))
            for of in ("error_m", "sigma_m")
        )
        wrong = error_m > GAPS_M and error_m > SIGMAS * sigma_m
        return (max(gaps, key=lambda each: each.error_m),) if wrong else ()


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
    try:
        with time_limit(trial.recording):
            recovery = smooth(trial.recording, None, config)
    except (UnoccludeError, TooSlow) as error:
        return Outcome(sentence=str(error))
    except Exception as error:  # a set-up that ends in a traceback is a finding
        return Outcome(sentence=f"traceback, {type(error).__name__}: {error}")
    return Outcome(rated(recovery, trial), trusted=recovery.estimates.trusted)


def rated(recovery: Recovery, trial: Trial) -> tuple[Rated, ...]:
    """Every interval of an answer."""
    t_s = recovery.t_s
    if trial.offset_s is not None:
        t_s = t_s - recovery.clock_offset_s + trial.offset_s
    truth, trusted = trial.truth_at(t_s), trusted_samples(recovery)
    answers = {name: (place, recovery.joint_covariance[name]) for name, place in recovery.joints.items()}
    answers["imu"] = (recovery.position, recovery.pose_covariance[:, :3, :3])
    found = []
    for start_s, end_s in trial.intervals:
        rows = (t_s > start_s) & (t_s < end_s)
        if not rows.any():
            continue
        errors, squares = [], []
        for name in (name for name in truth if name in answers):
            answer, covariance = answers[name]
            error = answer[rows] - truth[name][rows]
            known = np.isfinite(error).all(axis=1) & np.isfinite(covariance[rows]).all(axis=(1, 2))
            if known.any():
                variance = np.trace(covariance[rows][known], axis1=1, axis2=2)
                rms_m = float(np.sqrt((error[known] ** 2).sum(axis=1).mean()))
                errors.append((rms_m, float(np.sqrt(variance.mean()))))
                squares.append(squared_sigmas(error[known], covariance[rows][known]))
        error_m, sigma_m = max(errors, key=lambda pair: pair[0] / pair[1], default=(np.nan, np.nan))
        believed = bool(np.mean(trusted[rows]) > TRUSTED_SHARE) and bool(errors)
        whole = np.concatenate(squares) if squares else np.empty(0)
        found.append(Rated(end_s - start_s, error_m, sigma_m, believed, whole))
    return tuple(found)


def trusted_samples(recovery: Recovery) -> BoolArray:
    """(N,) what the answer calls trusted: sample by sample where it marks them, else all or nothing."""
    mask = getattr(recovery, "trusted", None)
    mask = np.ones(len(recovery), dtype=bool) if mask is None else np.asarray(mask, dtype=bool).copy()
    return mask & (recovery.estimates.trusted is not False)
