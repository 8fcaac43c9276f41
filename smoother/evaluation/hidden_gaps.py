"""Where visible frames can be hidden, and the errors of a recovery inside such a gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.sigma_factor import LEVELS, needed_factors

from ..array_types import BoolArray, FloatArray
from ..linalg import robust_sigma
from ..measurements.visibility import accepted_samples, seen_by_any, visible_frames
from ..recording import JOINTS, Recording
from ..result import Recovery
from .metrics import Figures, linear_at, position_at, squared_sigmas, summarise
from .validate import sample_errors

#: Frames without the forearm up to this long do not end a visible run, s.
FLICKER_S = 0.2
#: An IMU that is silent for longer than this is paused, s.
IMU_PAUSE_S = 0.1
#: How far camera and IMU clocks may disagree before the offset is known, s.
CLOCK_S = 0.25
#: What must remain visible on each side of the one gap of a short recording, s.
LEAST_SIDE_S = 0.4


@dataclass(frozen=True)
class HiddenGap:
    """A gap to make, on the camera's clock."""

    start_s: float  # The frames beside it, which stay visible
    end_s: float  # The frames beside it, which stay visible

    @property
    def length_s(self) -> float:
        """Duration, s."""
        return self.end_s - self.start_s

    def contains(self, t_s: FloatArray) -> BoolArray:
        """True strictly between the visible frames beside the gap."""
        return (t_s > self.start_s) & (t_s < self.end_s)


def visible_times(recording: Recording) -> FloatArray:
    """Times (F,) of the frames that see the forearm, on the camera's clock, s."""
    arm = recording.arm
    visible = seen_by_any(arm.t_s, visible_frames(arm, accepted_samples(arm)), arm.camera)
    return np.asarray(arm.t_s[visible])


def visible_runs(recording: Recording) -> list[tuple[float, float]]:
    """Runs (start, end) in which the forearm is seen and the IMU is not paused, camera's clock, s."""
    visible_s, imu = visible_times(recording), recording.imu.t_s
    if len(visible_s) < 2 or len(imu) < 2:
        return []
    cuts = np.flatnonzero(np.diff(visible_s) > FLICKER_S) + 1
    runs = [(float(times[0]), float(times[-1])) for times in np.split(visible_s, cuts)]
    pauses = np.flatnonzero(np.diff(imu) > max(IMU_PAUSE_S, 5.0 / recording.imu.rate_hz))
    barred = [(float(imu[i]) - CLOCK_S, float(imu[i + 1]) + CLOCK_S) for i in pauses]
    barred += [(-np.inf, float(imu[0])), (float(imu[-1]), np.inf)]
    for first, last in barred:
        parts = [part for start, end in runs for part in ((start, min(end, first)), (max(start, last), end))]
        runs = [(start, end) for start, end in parts if end > start]
    return runs


def place_gaps(
    recording: Recording,
    length_s: float,
    rng: np.random.Generator,
    *,
    count: int,
    margin_s: float = 1.5,
) -> list[HiddenGap]:
    """Draw gaps of one length at random."""
    runs, visible_s = visible_runs(recording), visible_times(recording)
    fits = np.zeros(len(visible_s), dtype=bool)
    for start, end in runs:
        fits |= (visible_s >= start + margin_s) & (visible_s + length_s + margin_s <= end)
    open_starts, chosen = visible_s[fits], list[HiddenGap]()
    while len(open_starts) and len(chosen) < count:
        start_s = float(rng.choice(open_starts))
        gap = _snapped(visible_s, start_s, length_s)
        if gap is None or not _worth_scoring(recording, gap):
            open_starts = open_starts[open_starts != start_s]
            continue
        chosen.append(gap)
        open_starts = open_starts[np.abs(open_starts - gap.start_s) > length_s + 2.0 * margin_s]
    if not chosen and runs:
        chosen = _middle(recording, visible_s, runs, length_s)
    return sorted(chosen, key=lambda gap: gap.start_s)


def _snapped(visible_s: FloatArray, start_s: float, length_s: float) -> HiddenGap | None:
    """The gap from one visible frame to the visible frame nearest to its length."""
    later = visible_s[visible_s > start_s]
    if not len(later):
        return None
    gap = HiddenGap(start_s, float(later[np.argmin(np.abs(later - start_s - length_s))]))
    hides_something = gap.contains(visible_s).any()
    return gap if hides_something and abs(gap.length_s - length_s) <= FLICKER_S else None


def _worth_scoring(recording: Recording, gap: HiddenGap) -> bool:
    """With a truth, at least half of the gap's samples must be finite and scored."""
    truth = recording.truth
    if truth is None or not len(truth):
        return True
    inside = gap.contains(truth.t_s)
    good = truth.score & np.isfinite(truth.position).all(axis=1)
    return bool(inside.any() and good[inside].mean() >= 0.5)


def _middle(
    recording: Recording, visible_s: FloatArray, runs: list[tuple[float, float]], length_s: float
) -> list[HiddenGap]:
    """One gap in the middle of the longest run, if enough stays visible beside it."""
    start, end = max(runs, key=lambda run: run[1] - run[0])
    inside = visible_s[(visible_s >= start) & (visible_s <= end)]
    if end - start < length_s + 2 * LEAST_SIDE_S or len(inside) < 3:
        return []
    at = float(inside[np.argmin(np.abs(inside - 0.5 * (start + end - length_s)))])
    gap = _snapped(visible_s, at, length_s)
    return [gap] if gap is not None and _worth_scoring(recording, gap) else []


#: Hidden joints to compare with where there is no truth, the best first.
REFERENCES = ("wrist", "strap", "hand", "elbow")


@dataclass(frozen=True)
class GapErrors:
    """Errors sample by sample inside a gap; nan where there is no answer."""

    reference: str  # What the answer was compared with: "truth" or a joint
    distance_m: FloatArray  # (n,)
    angle_deg: FloatArray  # (n,)
    squared_sigmas: FloatArray  # (n,)
    unanswered: int = 0  # Samples with a reference and without an answer
    sigma_max_m: float | None = None  # Largest stated standard deviation, on one axis
    path_m: float | None = None  # Length of the hidden path
    # (n, 2): By what sigma has to be multiplied to hold, see `sigma_factor.needed_factors`
    needed_factors: FloatArray = field(default_factory=lambda: np.zeros((0, len(LEVELS))))
    since_s: FloatArray = field(default_factory=lambda: np.zeros(0))  # (n,) s: time since the gap began

    def figures(self, chosen: BoolArray | slice = slice(None)) -> Figures:
        """The figures of these samples, or of some."""
        columns = (self.distance_m[chosen], self.angle_deg[chosen], self.squared_sigmas[chosen])
        return summarise(*columns, self.unanswered)

    @staticmethod
    def empty() -> GapErrors:
        """A gap in which nothing can be compared."""
        return GapErrors("", np.zeros(0), np.zeros(0), np.zeros(0))

    @staticmethod
    def pooled(parts: Sequence[GapErrors]) -> GapErrors:
        """The samples of several gaps together."""
        columns = ("distance_m", "angle_deg", "squared_sigmas", "needed_factors", "since_s")
        together: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in columns
        }
        return GapErrors(parts[0].reference, unanswered=sum(part.unanswered for part in parts), **together)


def score_gap(
    recording: Recording, recovery: Recovery, gap: HiddenGap, noise_of: Recovery | None = None
) -> GapErrors:
    """Errors of a recovery inside a gap of the recording, which still holds what was hidden."""
    arm, truth = recording.arm, recording.truth
    own_t_s = frame_times(recording, recovery)
    if truth is not None and len(truth):
        t_s = recovery.t_s  # on the camera's clock, on which gaps are hidden
        if len(own_t_s):
            t_s = t_s - np.interp(t_s, own_t_s, own_t_s - arm.t_s)
        rows = np.flatnonzero(gap.contains(t_s))
        samples = sample_errors(recovery.rows(rows), truth)
        return _errors(
            "truth",
            samples.difference_m,
            samples.reference.position,
            recovery.pose_covariance[rows, :3, :3],
            np.zeros((3, 3)),
            samples.angle_deg,
            samples.scored,
            t_s[rows] - gap.start_s,
        )
    inside = gap.contains(arm.t_s)
    for joint in REFERENCES:
        answered = joint == "strap" or joint in recovery.joints
        frames = inside & arm.tracked(joint)
        if answered and frames.any():
            break
    else:
        return GapErrors.empty()
    if joint == "strap":
        known, covariance = strap_position(recovery), recovery.pose_covariance[:, :3, :3]
    else:
        known = recovery.joints[joint]
        covariance = recovery.joint_covariance.get(joint, np.full((len(recovery), 3, 3), np.nan))
    reference, t_s = arm.joint(joint)[frames], own_t_s[frames]
    stated = linear_at(recovery.t_s, covariance.reshape(-1, 9), t_s).reshape(-1, 3, 3)
    return _errors(
        joint,
        position_at(recovery.t_s, known, t_s) - reference,
        reference,
        stated,
        # a hidden sample has the camera's own noise, which the answer's covariance does not include
        camera_noise(noise_of or recovery, joint),
        np.full(len(t_s), np.nan),
        np.ones(len(t_s), dtype=bool),
        arm.t_s[frames] - gap.start_s,
    )


def frame_times(recording: Recording, recovery: Recovery) -> FloatArray:
    """The frames' own times (F,) on the IMU's clock, s: with its drift, not its mean offset alone."""
    if len(recovery.arm) == len(recording.arm):
        return np.asarray(recovery.arm.t_s)
    offset = recovery.clock_offset_s if np.isfinite(recovery.clock_offset_s) else 0.0
    return np.asarray(recording.arm.t_s + offset)


def strap_position(recovery: Recovery) -> FloatArray:
    """The strap (N, 3), m in {K}: the IMU itself, or where its lever arm puts it if one was solved."""
    levers = {} if recovery.calibration is None else recovery.calibration.lever_arms
    known = np.isfinite(recovery.quaternion).all(axis=1)
    if "strap" not in levers or not known.any():
        return recovery.position
    strap = np.full_like(recovery.position, np.nan)
    turned = Rotation.from_quat(recovery.quaternion[known], scalar_first=True)
    strap[known] = recovery.position[known] + turned.apply(levers["strap"].position_m)
    return strap


def camera_noise(recovery: Recovery, joint: str) -> FloatArray:
    """Covariance (3, 3) of a joint's camera samples, m^2, from the residuals where it was used."""
    if recovery.residuals is None:
        return np.zeros((3, 3))
    index = JOINTS.index(joint)
    residual = recovery.residuals.residual[recovery.residuals.used[:, index], index]
    residual = residual[np.isfinite(residual).all(axis=1)]
    if len(residual) < 10:
        return np.zeros((3, 3))
    return np.diag(robust_sigma(residual - np.median(residual, axis=0), axis=0) ** 2)


def _errors(
    name: str,
    difference: FloatArray,
    reference: FloatArray,
    stated: FloatArray,
    noise: FloatArray,
    angle: FloatArray,
    scored: BoolArray,
    since_s: FloatArray,
) -> GapErrors:
    """Errors against a reference with noise of its own (3, 3) m^2."""
    distance = np.linalg.norm(difference, axis=1)
    variance = np.einsum("nii->ni", stated)
    finite = variance[np.isfinite(variance).all(axis=1)]
    path = reference[np.isfinite(reference).all(axis=1)]
    return GapErrors(
        reference=name,
        distance_m=distance,
        angle_deg=angle,
        squared_sigmas=squared_sigmas(difference, stated + noise),
        unanswered=int((scored & ~np.isfinite(distance)).sum()),
        sigma_max_m=float(np.sqrt(finite.max())) if len(finite) else None,
        path_m=float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) if len(path) > 1 else None,
        needed_factors=needed_factors(difference, stated, noise),
        since_s=since_s,
    )
