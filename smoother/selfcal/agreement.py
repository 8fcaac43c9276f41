"""At which clock offset camera and IMU agree best over a whole recording, and how well chance does.

How much of a forearm's turning, as the camera saw it, an IMU's attitude explains is known at every offset:
the relation of `measurements.rigid` holds for derivatives after any filter along time, x of the forearm's
direction and Y of the IMU's attitude. Where a is known, from other recordings with the same strap, Q alone is
free, and seconds of motion tell. What lies outside the overlap is treated as unexplained: an offset cannot
win by leaving most of the data out. A mirrored skeleton, or elbow and wrist exchanged, fits as well as the
true one if Q is free (a and Q turn).

The camera's stretches (the whole of a short recording, excerpts of a long one) are each compared with the IMU
at all offsets. Evidence adds: the clock is the line of offsets, with a drift, that all stretches together
support. A stretch has a heading and a forearm axis of its own, so neither a drifting heading nor a strap that
slips spoils the rest.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..filters import gaussian_smoothed
from ..linalg import parabola_vertex, runs, unit, upright
from ..measurements.clock import LARGEST_OFFSET_S
from ..measurements.inertial import InertialSignal, inertial_attitude
from ..measurements.rigid import GRID_HZ, SMOOTH_S, best_fits, correlation, fits_along, known_at
from ..measurements.segment import FEWEST_SAMPLES, Timeline, down_hint, without_spikes
from ..measurements.timestamps import dejitter, split_at_pauses
from ..recording import ImuStream, JointTracks, Recording
from ..runtime.pool import Pool
from .excerpts import EXCERPT_S, spread_excerpts

#: Beside a gap the filter's reach is left out, s.
BESIDE_GAP_S = 0.24
#: A forearm whose length in a frame is outside this range of its median is not a forearm there.
LENGTHS = (0.5, 1.6)
#: An offset is tried where this part of the shorter one is in common, but no more than this is asked for, s.
OVERLAP_SHARE, OVERLAP_S = 0.35, 8.0
#: Nothing shorter than this is looked at, s.
SHORTEST_S = 1.0
#: What is left unexplained grows with speed: a sample weighs 1 / (this + the power about it, over this long,
#: against the mean power), so that one burst does not dominate the whole recording.
WEIGHT_FLOOR, WEIGHT_S = 0.3, 0.25
#: Autocorrelation is summed up to this, s; no offset explains more than this part.
CORRELATED_S, MOST_EXPLAINED = 4.0, 0.999
#: Of the offsets every this many are tried first; then all where this part of the best is reached.
COARSE, LOOKED_AT = 3, 0.5


@dataclass(frozen=True)
class CameraTurning:
    """Derivative of the forearm's direction in {K} on an even grid."""

    first: int  # Number of the first grid point: its time is `first / GRID_HZ` after the grid's origin
    rate: FloatArray  # (n, 3) 1/s: zero where the camera saw no forearm
    known: BoolArray  # bool (n,): Where it did
    stretching: FloatArray  # (n,) 1/s: derivative of the logarithm of the forearm's length

    @cached_property
    def weight(self) -> FloatArray:
        """Of each grid point, (n,); see `WEIGHT_FLOOR`."""
        known = self.known.astype(float)
        power = (self.rate**2).sum(axis=1)
        about = gaussian_smoothed(np.stack([power, known], axis=1), WEIGHT_S * GRID_HZ)
        mean = max(float(power.sum() / max(known.sum(), 1.0)), 1e-12)
        return known / (WEIGHT_FLOOR + about[:, 0] / np.maximum(about[:, 1], 1e-3) / mean)

    @cached_property
    def power(self) -> float:
        """Weighted sum of squares of all that is known."""
        return float(self.weight @ (self.rate**2).sum(axis=1))

    @cached_property
    def noise_share(self) -> float:
        """Part of `power` that is the camera's error, 0 to 1: across the forearm as along it."""
        return min(2.0 * float(self.weight @ self.stretching**2) / max(self.power, 1e-12), 1.0)

    @cached_property
    def effective_samples(self) -> float:
        """How many independent samples it is worth, by its autocorrelation (Bartlett, 1946)."""
        known, weighted = self.known[:, None].astype(float), self.rate * np.sqrt(self.weight)[:, None]
        zero = len(known) - 1
        count = correlation(known, known)[zero:, 0, 0]
        product = np.sum(
            [correlation(axis[:, None], axis[:, None])[zero:, 0, 0] for axis in weighted.T], axis=0
        )
        lags = np.arange(min(len(known), int(CORRELATED_S * GRID_HZ)))
        rho = np.where(count[lags] > 0.1 * count[0], product[lags] / np.maximum(count[lags], 1.0), 0.0)
        rho /= max(float(rho[0]), 1e-300)
        return float(self.known.sum() / max(2.0 * (rho**2).sum() - 1.0, 1.0))

    def part(self, start: int, stop: int) -> CameraTurning:
        """Some consecutive grid points."""
        rows = slice(start, stop)
        return CameraTurning(self.first + start, self.rate[rows], self.known[rows], self.stretching[rows])


@dataclass(frozen=True)
class ImuTurning:
    """Derivative of the IMU's attitude in {E} on an even grid, over a run of samples without a pause."""

    first: int  # Number of the first grid point, as `CameraTurning` has it, from the IMU's own origin
    rate: FloatArray  # (m, 3, 3) 1/s: of `R_E_A`


def camera_turning(arm: JointTracks, origin_s: float, tip: str) -> CameraTurning | None:
    """The derivative of the forearm's direction; None where there is less than `SHORTEST_S` of it."""
    visible = arm.tracked("elbow") & arm.tracked(tip)
    along = (arm.joint(tip) - arm.joint("elbow"))[visible]
    t = np.asarray(arm.t_s)[visible] - origin_s
    length = np.linalg.norm(along, axis=1)
    relative = length / max(float(np.median(length)), 1e-9) if len(t) else length
    keep = (relative > LENGTHS[0]) & (relative < LENGTHS[1])
    t = t[keep]
    grid, first = _grid(t)
    if len(grid) < SHORTEST_S * GRID_HZ:
        return None
    seen = np.hstack([unit(along[keep]), np.log(length[keep, None])])
    on_grid = np.stack([np.interp(grid, t, axis) for axis in seen.T], axis=1)
    rate = gaussian_smoothed(on_grid, SMOOTH_S * GRID_HZ, derivative=True) * GRID_HZ
    known = known_at(grid, t, BESIDE_GAP_S)
    if known.sum() < SHORTEST_S * GRID_HZ:
        return None
    rate = np.where(known[:, None], rate, 0.0)
    return CameraTurning(first, rate[:, :3], known, rate[:, 3])


def imu_turning(imu: ImuStream, origin_s: float) -> ImuTurning | None:
    """The derivative of an IMU's attitude; None where there is less than `SHORTEST_S` of it."""
    if len(imu) < FEWEST_SAMPLES or not imu.t_s[-1] - imu.t_s[0] > SHORTEST_S:
        return None
    t_s = dejitter(np.asarray(imu.t_s)) - origin_s
    signal = InertialSignal(without_spikes(replace(imu, t_s=t_s)))
    attitude = inertial_attitude(signal, imu.rate_hz)
    grid, first = _grid(attitude.t)
    if len(grid) < SHORTEST_S * GRID_HZ:
        return None
    matrix = attitude.at(grid).as_matrix().reshape(-1, 9)
    rate = gaussian_smoothed(matrix, SMOOTH_S * GRID_HZ, derivative=True) * GRID_HZ
    return ImuTurning(first, rate.reshape(-1, 3, 3))


def _grid(t: FloatArray) -> tuple[FloatArray, int]:
    """Points of the grid between the first and the last time, and the number of the first."""
    if len(t) < 3:
        return np.empty(0), 0
    numbers = np.arange(int(np.ceil(t[0] * GRID_HZ)), int(np.floor(t[-1] * GRID_HZ)) + 1)
    return numbers / GRID_HZ, int(numbers[0]) if len(numbers) else 0


@dataclass(frozen=True)
class EvidenceCurve:
    """What speaks for each clock offset."""

    first: int  # The first offset, in steps of the grid: IMU's number less camera's
    evidence: FloatArray  # (k,): by offset
    searched: int  # Offsets at which enough was in common; the evidence of the others is zero
    freedom: float  # Independent samples of the camera's turning beyond the unknowns


class TurningSums:
    """The sums over time that tell how much an IMU explains, at every offset at which enough is in common."""

    def __init__(self, camera: CameraTurning, runs: Sequence[ImuTurning], up: FloatArray | None) -> None:
        """Of what the camera saw and the IMU's runs; `up` (3,) in {K}: {E}'s heading alone is free."""
        self.camera, self.has_up = camera, up is not None
        starts = [run.first - camera.first - (len(camera.rate) - 1) for run in runs]
        self.first = min(starts)  # The first offset, in steps of the grid: IMU's number less camera's
        ends = max(run.first + len(run.rate) for run in runs)
        self.known = np.zeros(ends - camera.first - self.first)  # grid points in common, by offset
        known_s = camera.known.sum() / GRID_HZ
        imu_s = sum(len(run.rate) for run in runs) / GRID_HZ
        self.needed = GRID_HZ * max(min(OVERLAP_SHARE * min(known_s, imu_s), OVERLAP_S), SHORTEST_S)
        # by run: rows of `known` (r,), T (r, 3, 3, 3), C (r, 3, 3), and the most there is to explain (r,)
        self.runs: list[tuple[IntArray, FloatArray, FloatArray, FloatArray]] = []
        weight = camera.weight[:, None]
        power = weight * (camera.rate**2).sum(axis=1, keepdims=True)
        for run, start in zip(runs, starts, strict=True):
            m, begin = len(run.rate), start - self.first
            count = correlation(camera.known[:, None].astype(float), np.ones((m, 1)))[:, 0, 0]
            self.known[begin : begin + len(count)] += count
            rows = np.flatnonzero(count > GRID_HZ * SHORTEST_S - 0.5)
            gram = np.einsum("tij,tik->tjk", run.rate, run.rate).reshape(m, 9)
            C = correlation(weight, gram)[rows, 0].reshape(-1, 3, 3)
            T = correlation(weight * camera.rate, run.rate.reshape(m, 9))[rows].reshape(-1, 3, 3, 3)
            if up is not None:  # x in axes whose third points up, as that of {E} does
                T = np.einsum("ai,najk->nijk", upright(up), T)
            self.runs.append((begin + rows, T, C, correlation(power, np.ones((m, 1)))[rows, 0, 0]))

    def curve(self, along: FloatArray | None = None) -> EvidenceCurve:
        """The evidence at every offset; `along` (3,) is the forearm's direction in the sensor, if known."""
        evidence = self._evidence(None if along is None else along[None])[0]
        searched = int((self.known > self.needed - 0.5).sum())
        return EvidenceCurve(self.first, evidence, searched, self._freedom(along is not None))

    def best_of(self, directions: FloatArray) -> FloatArray:  # (d, 3) -> (d,)
        """The evidence of the best offset for each of some directions of the forearm in the sensor."""
        return np.asarray(self._evidence(directions).max(axis=1))

    def _freedom(self, is_known: bool) -> float:
        unknown = (1 if self.has_up else 3) + (0 if is_known else 2)
        return max(self.camera.effective_samples - 0.5 * unknown, 0.0)

    def _evidence(self, directions: FloatArray | None) -> FloatArray:
        """(d, k) for directions (d, 3) at every offset, or (1, k) for the best one at each."""
        power = np.zeros((1 if directions is None else len(directions), len(self.known)))
        for rows, T, C, most in self.runs:
            if directions is not None:
                explained = fits_along(T, C, directions, self.has_up)
            else:
                explained = _searched(T, C, self.has_up)[None] if len(rows) else np.zeros((1, 0))
            power[:, rows] += np.clip(explained, 0.0, np.maximum(most, 0.0))
        power[:, self.known <= self.needed - 0.5] = 0.0
        share = np.clip(power / max(self.camera.power, 1e-12), 0.0, MOST_EXPLAINED)
        return np.asarray(-self._freedom(directions is not None) * np.log1p(-share))


def _searched(T: FloatArray, C: FloatArray, heading_only: bool) -> FloatArray:
    """The best fits (n,): some offsets first, then all where these are good."""
    coarse = np.unique(np.append(np.arange(0, len(T), COARSE), len(T) - 1))
    answer = np.interp(np.arange(len(T)), coarse, best_fits(T[coarse], C[coarse], heading_only)[0])
    fine = np.setdiff1d(np.flatnonzero(answer > LOOKED_AT * answer.max()), coarse)
    answer[fine] = best_fits(T[fine], C[fine], heading_only)[0]
    return answer


#: A recording up to this long is read whole, in stretches of about the second length, s: within one a drift
#: of 3000 ppm blurs less than the filter does. Of a longer one this many excerpts are read.
WHOLE_S, STRETCH_S, EXCERPTS = 120.0, 45.0, 12
#: Time of the IMU read around an excerpt, s; the second where the first is not enough. Around a recording
#: that is read whole, the third.
AROUND_S, FAR_S, WHOLE_AROUND_S = 60.0, 600.0, 3600.0
#: Clocks drift by at most this against each other, s/s; lines are tried whose ends differ by this, s.
LARGEST_SKEW, LINE_STEP_S = 3.5e-3, 0.06
#: Offsets up to this need no search: the fine search's reach, and what this one is off by, s.
NEAR_S = LARGEST_OFFSET_S + 0.05
#: Another offset is one at least this far away, s.
APART_S = 0.5
#: A stretch is used in the line's fit where its own best offset is this near to it, s.
ON_LINE_S = 0.14
#: The offset and drift of fewer stretches, or over a shorter time, s, are not told apart.
FEWEST_FOR_SKEW, SKEW_SPAN_S = 3, 60.0
#: How the evidence of streams that do not belong together is distributed: see `chance`.
CHANCE_SCALE, CHANCE_START, CHANCE_STRETCH, CHANCE_FREE = 1.6, 0.0, 1.5, 1.5
#: And the part of the camera's turning that it explains where both are of the same exercise; the camera's own
#: error, by the forearm's length, accounts for this part at most.
SAME_EXERCISE, MOST_NOISE = 0.08, 0.4
#: The same where the forearm's direction in the sensor is known. Of 844 wrong pairs of two activities
#: (SmartFallMM) 10 % reach an evidence of 1.8, 1 % reach 3.7 and 0.1 % reach 5.6; of 720 simulated ones none
#: exceeds 3.2. A search over this many offsets counts as one try. Of 86 wrong pairs of one activity 10 %
#: explain 0.18 of the turning and 1 % explain 0.41, which `SAME_EXERCISE` allows for.
KNOWN_SCALE, KNOWN_TRIED = 0.83, 50.0
#: Good enough not to look further; a freer fit has to be this much less likely to be chance to count.
CERTAIN, SWITCH = 1e-3, 0.1
#: Distinct offsets in a second of search.
OFFSETS_PER_S = 3.0


@dataclass(frozen=True)
class OffsetLine:
    """Clock offsets that are explained best, among some."""

    offset_s: float  # t_imu - t_camera in the middle of the recording
    skew: float  # Drift per second
    evidence: float  # Over all stretches
    chance: float  # Probability that streams which do not belong together reach as much
    explained: float  # Part of the camera's turning (its power, its own error aside) that the IMU explains


@dataclass(frozen=True)
class MotionAgreement:
    """How camera and IMU agree, at all offsets and at those near zero."""

    middle_s: float  # On the camera's clock: where the lines' offsets hold
    best: OffsetLine  # Over all offsets
    near: OffsetLine  # Over those within `NEAR_S`
    rival: float  # Evidence of the best offset at least `APART_S` from `best`
    freedom: float  # Independent samples of the camera's turning beyond the unknowns, over all stretches
    noise_share: float  # Part of the camera's turning that is its own error
    heading_only: bool  # Down was known and used
    is_mounted: bool  # The forearm's direction in the sensor was known and used


#: A part of what the camera saw, and the IMU's runs about it.
_Stretch = tuple[CameraTurning, tuple[ImuTurning, ...]]


def agreement(
    recording: Recording,
    timeline: Timeline | None = None,
    workers: Pool | None = None,
    along: FloatArray | None = None,  # (3,)
) -> MotionAgreement | None:
    """How camera and IMU agree over a recording; None where there is no forearm direction, or too little.

    `along` is the forearm's direction in the sensor where other recordings have shown it.
    """
    arm, imu, up, workers = recording.arm, recording.imu, _up(recording), workers or Pool(1, 0)
    found = None
    for around_s in (AROUND_S, FAR_S):
        stretches = list(_stretches(recording, timeline, around_s, workers))
        if not stretches:
            return None
        kinds: list[tuple[FloatArray | None, FloatArray | None]] = [] if along is None else [(up, along)]
        kinds += [(up, None), (None, None)] if up is not None else [(None, None)]
        for direction, mounted in kinds:
            curves = list(workers.map(partial(_curve, up=direction, along=mounted), stretches))
            ahead_s, camera_s = float(imu.t_s[0] - arm.t_s[0]), float(arm.t_s[0])
            answer = _over(stretches, curves, direction, mounted is not None, ahead_s, camera_s)
            if found is None or answer.best.chance < SWITCH * found.best.chance:
                found = answer
            if min(found.best.chance, found.near.chance) < CERTAIN:
                return found
        if arm.t_s[-1] - arm.t_s[0] <= WHOLE_S:
            break
    return found


def turning_sums(recording: Recording, workers: Pool | None = None) -> Iterator[TurningSums]:
    """The sums of a recording's stretches, one after the other; none where there is no forearm direction."""
    for camera, imus in _stretches(recording, None, AROUND_S, workers or Pool(1, 0)):
        yield TurningSums(camera, imus, _up(recording))


def _curve(stretch: _Stretch, up: FloatArray | None, along: FloatArray | None) -> EvidenceCurve:
    """Of a stretch, where up in {K} and the forearm's direction in the sensor are known or free."""
    return TurningSums(*stretch, up).curve(along)


def _up(recording: Recording) -> FloatArray | None:
    down = down_hint(recording)
    return -down if down.any() else None


def chance(
    evidence: float,
    explained: float,
    searched_s: float,
    stretches: int,
    heading_only: bool,
    is_mounted: bool = False,
) -> float:
    """Probability that streams which do not belong together reach this evidence or more, at most 1."""
    start = CHANCE_START + CHANCE_STRETCH * (stretches - 1)
    start += 0.0 if heading_only else CHANCE_FREE * stretches
    tried = max(searched_s * OFFSETS_PER_S / (KNOWN_TRIED if is_mounted else 1.0), 1.0)
    by_search = tried * np.exp(-max(evidence - start, 0.0) / (KNOWN_SCALE if is_mounted else CHANCE_SCALE))
    return float(min(1.0, max(by_search, np.exp(-max(explained, 0.0) / SAME_EXERCISE))))


def _stretches(
    recording: Recording, timeline: Timeline | None, around_s: float, workers: Pool
) -> Iterator[_Stretch]:
    """The whole recording in pieces, or the excerpts of a long one; none without a forearm direction."""
    arm, imu = recording.arm, recording.imu
    tip = next((joint for joint in ("wrist", "hand") if joint in arm.present), None)
    if tip is None or "elbow" not in arm.present or len(arm) < 3 or len(imu) < 3:
        return
    camera_s, imu_s = float(arm.t_s[0]), float(imu.t_s[0])
    if arm.t_s[-1] - camera_s <= WHOLE_S:
        yield from _whole(recording, tip, camera_s, imu_s)
        return
    timeline = timeline or Timeline.of(recording)
    context_s = 0.5 * (STRETCH_S - EXCERPT_S)
    count = min(EXCERPTS, int((arm.t_s[-1] - camera_s) / STRETCH_S))
    excerpts = spread_excerpts(recording, timeline, count, context_s, around_s)
    parts = ((arm.select(excerpt.frames), imu.select(excerpt.samples)) for excerpt in excerpts)
    found = workers.map(partial(_of_excerpt, origins_s=(camera_s, imu_s), tip=tip), parts)
    yield from (stretch for stretch in found if stretch is not None)


def _of_excerpt(
    part: tuple[JointTracks, ImuStream], origins_s: tuple[float, float], tip: str
) -> _Stretch | None:
    camera, run = camera_turning(part[0], origins_s[0], tip), imu_turning(part[1], origins_s[1])
    return None if camera is None or run is None else (camera, (run,))


def _whole(recording: Recording, tip: str, camera_s: float, imu_s: float) -> Iterator[_Stretch]:
    arm, imu = recording.arm, recording.imu
    camera = camera_turning(arm, camera_s, tip)
    rows = slice(
        *np.searchsorted(imu.t_s, [camera_s - WHOLE_AROUND_S, arm.t_s[-1] + WHOLE_AROUND_S]).tolist()
    )
    if rows.start == rows.stop:
        rows = slice(0, len(imu))
    about = imu.select(rows)
    found = [imu_turning(about.select(run), imu_s) for run in split_at_pauses(about)]
    imus = tuple(run for run in found if run is not None)
    if camera is None or not imus:
        return
    known = runs(camera.known)
    first, last = known[0].start, known[-1].stop
    count = max(int(np.ceil((last - first) / (STRETCH_S * GRID_HZ))), 1)
    edges = np.linspace(first, last, count + 1).astype(int)
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        part = camera.part(start, stop)
        if part.known.sum() > GRID_HZ:
            yield part, imus


def _over(
    stretches: list[_Stretch],
    curves: list[EvidenceCurve],
    up: FloatArray | None,
    is_mounted: bool,
    ahead_s: float,
    camera_s: float,
) -> MotionAgreement:
    """The evidence of all stretches, added along lines of offsets."""
    cameras = [camera for camera, _ in stretches]
    weights = np.maximum([camera.effective_samples for camera in cameras], 1e-9)
    times = np.array([(camera.first + 0.5 * len(camera.rate)) / GRID_HZ for camera in cameras])
    middle_s = float(np.average(times, weights=weights))
    first = min(curve.first for curve in curves)
    length = max(curve.first + len(curve.evidence) for curve in curves) - first
    span_s = float(np.ptp(times))
    half = int(np.ceil(0.5 * LARGEST_SKEW * span_s / LINE_STEP_S))
    skews = np.linspace(-LARGEST_SKEW, LARGEST_SKEW, 2 * half + 1) if half else np.zeros(1)
    total, of_skew = np.zeros(length), np.zeros(length)
    for skew in skews:
        one = np.zeros(length)
        for curve, t_s in zip(curves, times, strict=True):
            _add_shifted(one, curve, round(skew * (t_s - middle_s) * GRID_HZ) + first)
        of_skew = np.where(one > total, skew, of_skew)
        total = np.maximum(total, one)
    offset_s = (first + np.arange(length)) / GRID_HZ + ahead_s
    near = np.abs(offset_s) <= NEAR_S
    noise_share = float(np.average([camera.noise_share for camera in cameras], weights=weights))
    freedom = sum(curve.freedom for curve in curves)
    searched_s = max(curve.searched for curve in curves) / GRID_HZ * len(skews) ** 0.5

    def line(allowed: BoolArray, tried_s: float) -> OffsetLine:
        row = int(np.argmax(np.where(allowed, total, -1.0)))
        evidence = float(total[row]) if allowed.any() else 0.0
        at = _refined(curves, times - middle_s, offset_s[row], of_skew[row], ahead_s)
        explained = float(-np.expm1(-evidence / freedom)) if freedom > 0.0 else 0.0
        explained = min(explained / (1.0 - min(noise_share, MOST_NOISE)), 1.0)
        by_chance = chance(evidence, explained, tried_s, len(curves), up is not None, is_mounted)
        return OffsetLine(*at, evidence, by_chance, explained)

    best = line(np.ones(length, bool), searched_s)
    apart = np.abs(offset_s - best.offset_s) > APART_S
    return MotionAgreement(
        camera_s + middle_s,
        best,
        line(near, min(2.0 * NEAR_S, searched_s)),
        float(total[apart].max(initial=0.0)),
        freedom,
        noise_share,
        up is not None,
        is_mounted,
    )


def _add_shifted(total: FloatArray, curve: EvidenceCurve, first: int) -> None:
    """Add a curve whose offsets are counted from `first` on; what lies beyond the ends is left out."""
    start = curve.first - first
    a, b = max(start, 0), min(start + len(curve.evidence), len(total))
    if b > a:
        total[a:b] += curve.evidence[a - start : b - start]


def _refined(
    curves: list[EvidenceCurve], t_s: FloatArray, offset_s: float, skew: float, ahead_s: float
) -> tuple[float, float]:
    """The line through the stretches' own peaks beside it: offset at t_s = 0, and skew."""
    at, lag, weight = [], [], []
    for curve, t in zip(curves, t_s.tolist(), strict=True):
        own_s = (curve.first + np.arange(len(curve.evidence))) / GRID_HZ + ahead_s
        near = np.abs(own_s - (offset_s + skew * t)) < ON_LINE_S
        if (best := curve.evidence[near].max(initial=0.0)) > 0.0:
            at.append(t)
            lag.append(parabola_vertex(own_s[near], -curve.evidence[near]))
            weight.append(float(best))
    if not at:
        return float(offset_s), float(skew)
    t, y, w = np.array(at), np.array(lag), np.array(weight)
    if len(t) < FEWEST_FOR_SKEW or np.ptp(t) < SKEW_SPAN_S:
        return float(np.average(y, weights=w)), 0.0
    slope, level = np.polyfit(t, y, 1, w=np.sqrt(w))
    return float(level), float(slope)
