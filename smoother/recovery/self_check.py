"""The self-check: visible stretches are hidden, recovered from the rest, and compared with what was seen.

The stretches are as long and as fast as the recording's own gaps. What is hidden is used in no window that
answers for it; the arm's measures and the clock, which all of the recording shares, are those of the whole.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..body import FOREARM
from ..calibration import SigmaFactors
from ..error_radius import pooled_radius
from ..errors import SolveError
from ..graph.solve import solve
from ..measurements.outliers import noise_key
from ..measurements.rays import across, directions, of_rays, origins_of
from ..measurements.visibility import MISSING_S, Gap, enough_joints, seen_by_any
from ..recording import FOREARM_JOINTS, JOINTS
from ..result import Draws, Recovery, SelfCheck
from ..runtime.store import batches
from ..units import GRAVITY
from ..window.cut import window_between
from ..window.prepare import PreparedSegment
from ..window.solution import FAILED_M, FAILED_NEES, HiddenStretch
from ..window.trajectory import joint_from_pose, share_after
from .samples import poses_at
from .task import Task

#: Length of a stretch, s: as the gaps, within these limits; of a recording without gaps the last.
SHORTEST_S, LONGEST_S = 0.4, 4.0
#: Visible time that is left on both sides of a stretch, s, and from its window's ends.
BESIDE_S, MARGIN_S = 0.5, 2.0
#: Candidates begin this far apart, s; motion is compared in steps of this length, s.
APART_S, STEP_S = 0.25, 0.1
#: Joints that are compared, the best first.
REFERENCES = ("wrist", "strap", "hand", "elbow")
#: Squared sigmas within which 95 % of three normal numbers lie.
INSIDE_95 = 7.815
#: This many stretches have to speak before sigma is widened; it is never widened more.
ENOUGH, LARGEST_FACTOR = 8, 3.0


def hide_and_recover(prepared: PreparedSegment, task: Task) -> list[HiddenStretch]:
    """Hide some stretches of a section, recover each, and compare."""
    stretches = choose_stretches(prepared, task.stretches, task.usual_gap_s)
    return [_recovered(prepared, gap, task) for gap in stretches]


def choose_stretches(prepared: PreparedSegment, count: int, usual_gap_s: float) -> list[Gap]:
    """Visible stretches that resemble the gaps of a section."""
    visible = _visible_runs(prepared)
    edges = np.arange(prepared.forearm.signal.start_s, prepared.forearm.signal.end_s, STEP_S)
    if not visible or len(edges) < 3 or count < 1:
        return []
    motion = _Motion.of(prepared, edges)
    inner = [gap for gap in prepared.gaps if gap.length_s >= SHORTEST_S]
    inner.sort(key=lambda gap: -float(motion.of_times(gap.start_s, gap.end_s).sum()))
    models = [inner[k * len(inner) // count] for k in range(count)] if inner else [None] * count
    chosen: list[Gap] = []
    for model in models:
        wanted_s = float(np.clip(usual_gap_s if model is None else model.length_s, SHORTEST_S, LONGEST_S))
        longest_s = max(b - a for a, b in visible) - 2.0 * BESIDE_S
        length_s = min(wanted_s, longest_s)
        if length_s < SHORTEST_S:
            continue
        starts: FloatArray = np.concatenate(
            [np.arange(a + BESIDE_S, b - BESIDE_S - length_s + 1e-9, APART_S) for a, b in visible]
        )
        for each in chosen:
            starts = starts[
                (starts + length_s + BESIDE_S <= each.start_s) | (starts >= each.end_s + BESIDE_S)
            ]
        if not len(starts):
            continue
        features = np.array([motion.of_times(s, s + length_s) for s in starts.tolist()])
        if model is None:
            best = int(np.argmax(features.sum(axis=1)))
        else:
            off = np.abs(features - motion.of_times(model.start_s, model.end_s)).sum(axis=1)
            best = int(np.argmin(off))
        chosen.append(Gap(float(starts[best]), float(starts[best]) + length_s))
    return sorted(chosen, key=lambda gap: gap.start_s)


def _visible_runs(prepared: PreparedSegment) -> list[tuple[float, float]]:
    """From when to when the camera sees the forearm within what the section answers for, s."""
    forearm = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
    needed = 2 if np.count_nonzero(np.asarray(prepared.accepted[:, forearm].any(axis=0))) > 1 else 1
    visible = enough_joints(prepared.accepted, needed)
    t = prepared.frame_t_imu[seen_by_any(prepared.frame_t_imu, visible, prepared.camera)]
    t = t[(t >= prepared.start_s) & (t <= prepared.end_s)]
    if len(t) < 2:
        return []
    ends = np.array([gap.start_s for gap in prepared.gaps])
    # a gap of a frame or two breaks a run as well
    inside = np.searchsorted(t, ends + 1e-9, side="right")
    breaks = np.union1d(np.flatnonzero(np.diff(t) > MISSING_S) + 1, inside[(inside > 0) & (inside < len(t))])
    runs = np.split(t, breaks)
    return [(float(run[0]), float(run[-1])) for run in runs if run[-1] - run[0] > SHORTEST_S + 2.0 * BESIDE_S]


@dataclass(frozen=True)
class _Motion:
    """Running sums of how a sensor moves, in steps of `STEP_S`."""

    edges: FloatArray
    turning: FloatArray
    force: FloatArray

    @classmethod
    def of(cls, prepared: PreparedSegment, edges: FloatArray) -> _Motion:
        means = prepared.forearm.signal.means(edges)
        turning = np.sum(means[:, 3:] ** 2, axis=1)
        force = (np.linalg.norm(means[:, :3], axis=1) - GRAVITY) ** 2

        def sums(values: FloatArray) -> FloatArray:
            return np.concatenate(([0.0], np.cumsum(values)))

        return cls(edges, sums(turning), sums(force))

    def of_times(self, start_s: float, end_s: float) -> FloatArray:
        """Logarithms of the rms of turning, rad/s, and of the specific force beyond gravity, m/s^2, (2,)."""
        first, last = np.searchsorted(self.edges, [start_s, end_s]).clip(0, len(self.turning) - 1).tolist()
        count = max(last - first, 1)
        rms = [np.sqrt(max(total[last] - total[first], 0.0) / count) for total in (self.turning, self.force)]
        return np.log(np.array(rms) + np.array([0.05, 0.05]))


def _recovered(prepared: PreparedSegment, gap: Gap, task: Task) -> HiddenStretch:
    """One stretch, hidden and recovered."""
    t = prepared.frame_t_imu
    hidden: BoolArray = (t >= gap.start_s) & (t <= gap.end_s)
    forearm = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
    accepted = prepared.accepted.copy()
    layout = task.prior.layout
    on_forearm = [joint for joint in REFERENCES if layout.segment_of(joint) == FOREARM.name]
    reference = next(
        (joint for joint in on_forearm if (accepted[hidden, JOINTS.index(joint)]).sum() > 2), None
    )
    if reference is None:
        return HiddenStretch(gap.start_s, gap.end_s)
    column = JOINTS.index(reference)
    rows = np.flatnonzero(hidden & accepted[:, column] & (t >= prepared.t[0]) & (t <= prepared.t[-1]))
    accepted[np.ix_(np.flatnonzero(hidden), np.array(forearm))] = False
    copy = replace(
        prepared, accepted=accepted, gaps=tuple(sorted((*prepared.gaps, gap), key=lambda each: each.start_s))
    )
    own = window_between(
        copy, task.prior, task.noise, task.sharing, gap.start_s - MARGIN_S, gap.end_s + MARGIN_S
    )
    own = replace(own, considered=task.model.errors.considered)
    try:
        solution = solve(own, with_covariance=True, tolerance=1e-2)
    except SolveError:
        return HiddenStretch(gap.start_s, gap.end_s)
    model = task.model
    states, pose = poses_at(solution, prepared.forearm.signal, model.clock, t[rows])
    lever = model.estimate.lever_arms.get(reference)
    place, covariance = joint_from_pose(
        states.R,
        states.p,
        pose,
        solution.lever(reference),
        None if lever is None else np.diag(lever.sigma_m**2),
    )
    cameras = np.zeros(len(rows), int) if prepared.camera is None else prepared.camera[rows].astype(int)
    keys = [noise_key(reference, camera) for camera in range(int(cameras.max(initial=0)) + 1)]
    samples = np.array(
        [model.joint_noise[key].sample_m if key in model.joint_noise else 0.01 for key in keys]
    )
    covariance = covariance + samples[cameras, None, None] ** 2 * np.eye(3)
    origin = origins_of(prepared.ray_origin_m, prepared.camera, len(t))
    position = prepared.position[rows, column]
    error, covariance = _across(
        position - place, covariance, position, None if origin is None else origin[rows]
    )
    squared = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    finite = np.isfinite(squared)
    if not finite.any():
        return HiddenStretch(gap.start_s, gap.end_s)
    lengths = np.linalg.norm(error[finite], axis=1)
    return HiddenStretch(
        gap.start_s,
        gap.end_s,
        samples=int(finite.sum()),
        rms_m=float(np.sqrt(np.mean(lengths**2))),
        stated_m=float(np.sqrt(np.mean(np.trace(covariance[finite], axis1=1, axis2=2)))),
        inside=int((squared[finite] < INSIDE_95).sum()),
        nees=float(squared[finite].mean()) / 3.0,
        error_m=tuple(lengths.tolist()),
        stated_95_m=pooled_radius(covariance[finite]) or float("nan"),
        contradicting=tuple(_contradicting(squared[finite], lengths, cameras[finite])),
    )


def _across(
    error: FloatArray, covariance: FloatArray, position: FloatArray, origin_m: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    """Errors (n, 3) and covariances as seen across rays, where a camera has no depth."""
    if origin_m is None:
        return error, covariance
    flat = of_rays(origin_m, len(error))
    ray = directions(position[flat], origin_m[flat])
    seen = across(error, position, origin_m)
    outer = ray[:, :, None] * ray[:, None, :]
    project = np.eye(3) - outer
    covariance = covariance.copy()
    own = project @ covariance[flat] @ project
    mean = 0.5 * np.trace(own, axis1=1, axis2=2)
    covariance[flat] = own + mean[:, None, None] * outer
    size = np.sqrt(0.5 * np.sum(seen[flat] ** 2, axis=1, keepdims=True))
    seen[flat] += size * ray
    return seen, covariance


def _contradicting(squared: FloatArray, lengths: FloatArray, cameras: IntArray) -> Iterator[int]:
    """Cameras whose samples fail by themselves, from each sample's squared sigmas and error, m."""
    for camera in np.unique(cameras).tolist():
        own = cameras == camera
        nees, rms_m = float(squared[own].mean()) / 3.0, float(np.sqrt(np.mean(lengths[own] ** 2)))
        if nees > FAILED_NEES and rms_m > FAILED_M:
            yield camera


def summary(stretches: Sequence[HiddenStretch]) -> SelfCheck:
    """What the stretches say together, before sigma is widened."""
    if not stretches:
        return SelfCheck(0, note="the camera never saw the arm long enough between gaps to hide a part of it")
    answered = [each for each in stretches if each.samples]
    samples = sum(each.samples for each in answered)
    length_s = float(np.median([each.end_s - each.start_s for each in stretches]))
    if not samples:
        return SelfCheck(len(stretches), len(stretches), length_s, failed=len(stretches))

    def rms(values: list[float]) -> float:
        total = sum(each.samples * value**2 for each, value in zip(answered, values, strict=True))
        return float(np.sqrt(total / samples))

    return SelfCheck(
        stretches=len(stretches),
        unanswered=len(stretches) - len(answered),
        length_s=length_s,
        rms_m=rms([each.rms_m for each in answered]),
        stated_sigma_m=rms([each.stated_m for each in answered]),
        inside_95=sum(each.inside for each in answered) / samples,
        worst_nees=max(each.nees for each in answered),
        sigma_factor=_sigma_factor([each.nees for each in answered]),
        failed=sum(each.failed for each in stretches),
        error_95_m=float(np.percentile([error for each in answered for error in each.error_m], 95.0)),
        stated_95_m=rms([each.stated_95_m for each in answered]),
    )


def _sigma_factor(nees: Sequence[float]) -> float:
    """What sigma in gaps has to be multiplied by: what the stretches ask for beyond chance, 1 otherwise."""
    if len(nees) < ENOUGH:
        return 1.0
    values = np.minimum(np.array(nees), LARGEST_FACTOR**2)
    least = float(values.mean() - values.std(ddof=1) / np.sqrt(len(values)))
    return float(np.sqrt(np.clip(least, 1.0, LARGEST_FACTOR**2)))


#: Gaps longer than the longest hidden one by this factor deserve a word.
BEYOND = 1.5
#: Drawn motions take their factor on and off over this time before and after a gap, s.
RAMP_S = 0.3


def with_sigma_factors(recovery: Recovery, factors: SigmaFactors | None) -> Recovery:
    """The recovery with the covariance of positions in every gap multiplied by the factor's square."""
    if factors is None or not recovery.gaps:
        return recovery
    applied = tuple(round(factors.at(gap.length_s), 4) for gap in recovery.gaps)
    _widen(recovery, applied)
    notes = (*recovery.notes, _note(applied, factors, max(gap.length_s for gap in recovery.gaps)))
    return replace(recovery, notes=notes, estimates=replace(recovery.estimates, sigma_factors=applied))


def with_self_check(recovery: Recovery, stretches: Sequence[HiddenStretch]) -> Recovery:
    """The recovery with its self-check, and sigma in gaps as wide as the hidden stretches ask for."""
    check = summary(stretches)
    if recovery.estimates.sigma_factors:
        check = replace(check, sigma_factor=1.0)
    if check.sigma_factor > 1.0 and recovery.gaps:
        _widen(recovery, [check.sigma_factor] * len(recovery.gaps))
    return replace(recovery, estimates=replace(recovery.estimates, self_check=check))


def _widen(recovery: Recovery, applied: Sequence[float]) -> None:
    """The covariance of positions in every gap times its factor's square, in place; drawn motions too."""
    starts = np.searchsorted(recovery.t_s, [gap.start_s for gap in recovery.gaps], "left")
    stops = np.searchsorted(recovery.t_s, [gap.end_s for gap in recovery.gaps], "right")
    for start, stop, factor in zip(starts.tolist(), stops.tolist(), applied, strict=True):
        for batch in recovery.rows(slice(start, stop)).batches():  # slices: they share the columns' memory
            hidden = np.where(batch.occluded, factor, 1.0)
            batch.pose_covariance[:, :3] *= hidden[:, None, None]
            batch.pose_covariance[:, :, :3] *= hidden[:, None, None]
            for joint, covariance in batch.joint_covariance.items():
                if joint in FOREARM_JOINTS:
                    covariance *= hidden[:, None, None] ** 2
    if recovery.draws is not None:
        _widen_draws(recovery.draws, recovery.gaps, applied)


def _widen_draws(draws: Draws, gaps: Sequence[Gap], factors: Sequence[float]) -> None:
    """Drawn positions (in place) as much further from the answer as their sigma is larger."""
    moved = [draws.position, *(values for joint, values in draws.joints.items() if joint in FOREARM_JOINTS)]
    ends = np.array([(gap.start_s, gap.end_s) for gap in gaps])
    for rows in batches(len(draws.t_s)):
        t = draws.t_s[rows]
        factor = np.ones(len(t))
        for (start_s, end_s), of_gap in zip(ends, factors, strict=True):
            away_s = np.maximum(np.maximum(start_s - t, t - end_s), 0.0)
            near = np.flatnonzero(away_s < RAMP_S)
            fade = 1.0 - share_after(away_s[near], 0.5 * RAMP_S, 0.5 * RAMP_S)
            # of two gaps side by side the stronger one counts
            own = 1.0 + (of_gap - 1.0) * fade
            factor[near] = np.where(np.abs(own - 1.0) > np.abs(factor[near] - 1.0), own, factor[near])
        for column in moved:
            column[:, rows] *= factor[:, None].astype(column.dtype)


def _note(applied: tuple[float, ...], factors: SigmaFactors, longest_s: float) -> str:
    least, most = min(applied), max(applied)
    by = f"{most:.2f}" if most - least < 0.005 else f"{least:.2f} to {most:.2f}"
    count = min(entry.gaps for entry in factors.by_length)
    note = (
        f"sigma of positions in gaps was multiplied by {by}, following the calibration's hidden gaps of up to"
        f" {factors.longest_s:g} s ({count} or more behind each factor)"
    )
    if longest_s > BEYOND * factors.longest_s:
        note += f"; no gap as long as {longest_s:.1f} s was hidden"
    return note
