"""Hidden gaps: visible frames are hidden, recovered, and the answer is compared with what was hidden.

The one kernel of `gaps`, `check`, `benchmark` and the checks of accuracy.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from calib.sigma_factor import LEVELS, LengthFactor, length_factors, needed_factors

from ..array_types import BoolArray, FloatArray
from ..cameras import join_cameras
from ..errors import RecordingError, UnoccludeError
from ..linalg import robust_sigma
from ..measurements.visibility import Gap, seen_by_any, visible_frames
from ..recording import JOINTS, Recording
from ..result import Recovery
from ..runtime.pool import Pool, Progress
from ..table import Table, tabulated
from .metrics import Errors, Figures, linear_at, percentile, position_at, rms, squared_sigmas
from .validate import sample_errors
from .words import said

#: A method: recording in, recovery out.
Method = Callable[[Recording], Recovery]

# --- where visible frames can be hidden

#: Frames without the forearm up to this long do not end a visible run, s.
FLICKER_S = 0.2
#: An IMU that is silent for longer than this is paused, s.
IMU_PAUSE_S = 0.1
#: How far camera and IMU clocks may disagree before the offset is known, s.
CLOCK_S = 0.25
#: What must remain visible on each side of the one gap of a short recording, s.
LEAST_SIDE_S = 0.4


class HiddenGap(Gap):
    """A gap to make, on the camera's clock, from one visible frame to another."""

    def contains(self, t_s: FloatArray) -> BoolArray:
        """True strictly between the visible frames beside the gap."""
        return (t_s > self.start_s) & (t_s < self.end_s)


def visible_times(recording: Recording) -> FloatArray:
    """Times (F,) of the frames that see the forearm, on the camera's clock, s."""
    arm = recording.arm
    return np.asarray(arm.t_s[seen_by_any(arm.t_s, visible_frames(arm), arm.camera)])


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
    recording: Recording, length_s: float, rng: np.random.Generator, *, count: int, margin_s: float = 1.5
) -> list[HiddenGap]:
    """Draw gaps of one length at random; where none fits, one in the middle of the longest visible run."""
    runs, visible_s, truth = visible_runs(recording), visible_times(recording), recording.truth

    def gap_from(start_s: float) -> HiddenGap | None:
        """From one visible frame to the one nearest to its length, if it is worth scoring."""
        later = visible_s[visible_s > start_s]
        if not len(later):
            return None
        gap = HiddenGap(start_s, float(later[np.argmin(np.abs(later - start_s - length_s))]))
        good = gap.contains(visible_s).any() and abs(gap.length_s - length_s) <= FLICKER_S
        if truth is None or not len(truth) or not good:
            return gap if good else None
        inside = gap.contains(truth.t_s)  # at least half of it must be finite and scored
        known = truth.score & np.isfinite(truth.position).all(axis=1)
        return gap if inside.any() and known[inside].mean() >= 0.5 else None

    fits = np.zeros(len(visible_s), dtype=bool)
    for start, end in runs:
        fits |= (visible_s >= start + margin_s) & (visible_s + length_s + margin_s <= end)
    open_starts, chosen = visible_s[fits], list[HiddenGap]()
    while len(open_starts) and len(chosen) < count:
        start_s = float(rng.choice(open_starts))
        if (gap := gap_from(start_s)) is None:
            open_starts = open_starts[open_starts != start_s]
            continue
        chosen.append(gap)
        open_starts = open_starts[np.abs(open_starts - gap.start_s) > length_s + 2.0 * margin_s]
    if not chosen and runs:
        start, end = max(runs, key=lambda run: run[1] - run[0])
        inside = visible_s[(visible_s >= start) & (visible_s <= end)]
        if end - start >= length_s + 2 * LEAST_SIDE_S and len(inside) >= 3:
            gap = gap_from(float(inside[np.argmin(np.abs(inside - 0.5 * (start + end - length_s)))]))
            chosen = [] if gap is None else [gap]
    return sorted(chosen, key=lambda gap: gap.start_s)


def hide(recording: Recording, gaps: Sequence[HiddenGap]) -> Recording:
    """A copy whose forearm is not seen inside the gaps, and which has no truth."""
    hidden = np.zeros(len(recording.arm), dtype=bool)
    for gap in gaps:
        hidden |= gap.contains(recording.arm.t_s)
    return replace(recording, arm=recording.arm.hide(hidden), truth=None)


# --- the errors inside

#: Hidden joints to compare with where there is no truth, the best first.
REFERENCES = ("wrist", "strap", "hand", "elbow")


@dataclass(frozen=True)
class GapErrors(Errors):
    """Errors inside a hidden gap."""

    # (n, 2): by what sigma has to be multiplied to hold, see `sigma_factor.needed_factors`
    needed_factors: FloatArray = field(default_factory=lambda: np.zeros((0, len(LEVELS))))
    reference: str = ""  # What the answer was compared with: "truth" or a joint
    sigma_max_m: float | None = None  # Largest stated standard deviation, on one axis
    path_m: float | None = None  # Length of the hidden path


#: Of a gap without an answer.
NOTHING = GapErrors.of_positions(np.zeros((0, 3)), np.zeros(0))


def score_gap(
    recording: Recording, recovery: Recovery, gap: HiddenGap, noise_of: Recovery | None = None
) -> GapErrors:
    """Errors of a recovery inside a gap of the recording, which still holds what was hidden."""
    arm, truth = recording.arm, recording.truth
    own_t_s = frame_times(recording, recovery)
    turns: dict[str, FloatArray] = {}
    if truth is not None and len(truth):
        t_s = recovery.t_s  # on the camera's clock, on which gaps are hidden
        if len(own_t_s):
            t_s = t_s - np.interp(t_s, own_t_s, own_t_s - arm.t_s)
        rows = np.flatnonzero(gap.contains(t_s))
        samples = sample_errors(recovery.rows(rows), truth)
        name, scored = "truth", samples.scored
        reference, difference = samples.reference.position, samples.difference_m
        turns = {key: getattr(samples, key) for key in ("turn_rad", "turn_squared_sigmas")}
        stated, noise = recovery.pose_covariance[rows, :3, :3], np.zeros((3, 3))
    else:
        inside = gap.contains(arm.t_s)
        known = [joint for joint in REFERENCES if joint == "strap" or joint in recovery.joints]
        shown = [joint for joint in known if (inside & arm.tracked(joint)).any()]
        if not shown:
            return NOTHING
        name = shown[0]
        frames = inside & arm.tracked(name)
        if name == "strap":
            path, covariance = strap_position(recovery), recovery.pose_covariance[:, :3, :3]
        else:
            path = recovery.joints[name]
            covariance = recovery.joint_covariance.get(name, np.full((len(recovery), 3, 3), np.nan))
        reference, t_s = arm.joint(name)[frames], own_t_s[frames]
        difference, scored = position_at(recovery.t_s, path, t_s) - reference, np.ones(len(t_s), dtype=bool)
        stated = linear_at(recovery.t_s, covariance.reshape(-1, 9), t_s).reshape(-1, 3, 3)
        # a hidden sample has the camera's own noise, which the answer's covariance does not include
        noise = camera_noise(noise_of or recovery, name)
    variance = np.einsum("nii->ni", stated)
    finite = variance[np.isfinite(variance).all(axis=1)]
    way = reference[np.isfinite(reference).all(axis=1)]
    return GapErrors.of_positions(
        difference,
        squared_sigmas(difference, stated + noise),
        scored=scored,
        **turns,
        needed_factors=needed_factors(difference, stated, noise),
        reference=name,
        sigma_max_m=float(np.sqrt(finite.max())) if len(finite) else None,
        path_m=float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum()) if len(way) > 1 else None,
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


# --- their table


@dataclass(frozen=True)
class GapRow:
    """One hidden gap and what a method made of it."""

    length_s: float  # Length asked for
    method: str  # Name of the method
    run: int  # Which copy of the recording the gap was hidden in
    gap: HiddenGap  # Where it was hidden, on the camera's clock
    errors: GapErrors  # Sample by sample inside the gap
    failure: str = ""  # Why there is no answer, "" where there is one
    recording: str = ""  # Name of the recording

    @cached_property
    def figures(self) -> Figures:
        """Errors inside the gap."""
        return self.errors.figures()

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        figures, errors = self.figures, self.errors
        return {
            **{name: getattr(self, name) for name in ("length_s", "method", "run", "failure", "recording")},
            **{name: getattr(self.gap, name) for name in ("start_s", "end_s")},
            **{name: getattr(errors, name) for name in ("reference", "sigma_max_m", "path_m")},
            "rms_m": figures.position_rms_m,
            "max_m": figures.position_max_m,
            **{name: getattr(figures, name) for name in ("orientation_rms_deg", "nees", "samples")},
        }


@dataclass(frozen=True)
class GapGroup:
    """A method's hidden gaps: `figures` of all samples together, `spread` over the gaps."""

    rows: Sequence[GapRow]

    @property
    def counts(self) -> dict[str, int]:
        """How many gaps, and how many of them have no answer."""
        return {"gaps": len(self.rows), "failed": sum(bool(row.failure) for row in self.rows)}

    @cached_property
    def figures(self) -> Figures:
        """Errors of all samples."""
        return Errors.pooled([row.errors for row in self.rows]).figures()

    @cached_property
    def spread(self) -> dict[str, float | int | None]:
        """Quartiles over the gaps of the rms inside each, m, their root mean square, and the worst."""
        each = [None if row.failure else row.figures.position_rms_m for row in self.rows]
        known = np.array([value for value in each if value is not None])
        found = {
            name: percentile(known, at)
            for name, at in (("low_m", 25), ("median_m", 50), ("high_m", 75), ("worst_m", 100))
        }
        return found | {"rms_m": rms(known), "gaps": len(each), "failed": len(each) - len(known)}

    def to_dict(self) -> dict[str, float | int | None]:
        """Plain values by name, distances in m and in cm."""
        figures = vars(self.figures)
        distances = {name: figures[f"position_{name}_m"] for name in ("rms", "median", "p95", "max")}
        names = ("orientation_rms_deg", "orientation_max_deg", "nees", "coverage_95", "samples", "unanswered")
        return {
            **{f"{name}_m": value for name, value in distances.items()},
            **{f"{name}_cm": value and 100.0 * value for name, value in distances.items()},
            **{name: figures[name] for name in names},
            **self.counts,
        }


#: By gap length (s) and method, all gaps of that length.
Lengths = Mapping[float, Mapping[str, GapGroup]]


def by_length(lengths: Lengths, what: Callable[[GapGroup], object]) -> list[dict[str, object]]:
    """Something of every group, as files hold it."""
    return [
        {"length_s": at, "methods": {name: what(each) for name, each in methods.items()}}
        for at, methods in lengths.items()
    ]


@dataclass(frozen=True)
class GapTable:
    """Error against gap length."""

    rows: tuple[GapRow, ...]  # Each gap by itself
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each

    @cached_property
    def lengths(self) -> Lengths:
        """The gaps by length and method, in order of appearance."""
        found: dict[float, dict[str, list[GapRow]]] = {}
        for row in self.rows:
            found.setdefault(float(row.length_s), {}).setdefault(row.method, []).append(row)
        return {
            length: {name: GapGroup(own) for name, own in by_method.items()}
            for length, by_method in found.items()
        }

    @property
    def reference(self) -> str:
        """What the answers were compared with: "truth", "wrist", "strap" .."""
        return next((row.errors.reference for row in self.rows if row.errors.reference), "truth")

    def sigma_factors(self, method: str = "graph") -> tuple[LengthFactor, ...]:
        """By what a method's sigma has to be multiplied to hold; empty without its answers."""
        own = [row for row in self.rows if row.method == method]
        return length_factors([(row.length_s, row.errors.needed_factors) for row in own])

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as `--json` writes them; `spread` has the quartiles over the gaps of a length."""
        return {
            "lengths": by_length(self.lengths, GapGroup.to_dict),
            "rows": [row.to_dict() for row in self.rows],
            "notes": list(self.notes),
            "sigma_factors": [row.to_dict() for row in self.sigma_factors()],
            "spread": by_length(dict(sorted(self.lengths.items())), lambda group: group.spread),
        }

    def table(self, whose: str = "") -> Table:
        """Error against gap length; `whose` goes into the title."""
        against = self.reference
        against = "truth" if against == "truth" else f"camera's hidden samples of the {against}"
        rows = [
            {"length_s": length, "method": name} | group.counts | vars(group.figures)
            for length, methods in self.lengths.items()
            for name, group in methods.items()
        ]
        columns: dict[str, str | Callable[[Any], object]] = {"gap, s": "length_s", "method": "method"}
        columns |= {"rms, cm": "position_rms_m", "median": "position_median_m", "95 %": "position_p95_m"}
        columns |= {"max": "position_max_m", "NEES": "nees", "inside 95 %": "coverage_95", "gaps": counted}
        return tabulated(f"Error in hidden gaps against the {against}{whose}", rows, columns)


def counted(row: Mapping[str, Any]) -> str:
    """How many gaps, and how many of them failed, in a cell."""
    return f"{row['gaps']} ({row['failed']} failed)" if row["failed"] else f"{row['gaps']}"


def pooled(tables: Sequence[GapTable]) -> GapTable:
    """The gaps of several recordings as one table."""
    notes = dict.fromkeys(note for table in tables for note in table.notes)
    return GapTable(tuple(row for table in tables for row in table.rows), tuple(notes))


# --- hide, recover, score


class GapCopy(NamedTuple):
    """A copy of the recording with these gaps; `run` counts the copies of one length."""

    length_s: float
    run: int
    gaps: list[HiddenGap]


def evaluate_gaps(
    recording: Recording,
    lengths_s: Sequence[float],
    methods: Mapping[str, Method],
    *,
    seed: int = 0,
    repetitions: int = 1,
    gaps_per_run: int = 6,
    margin_s: float = 1.5,
    progress: Progress | None = None,
    processes: int = 1,
) -> GapTable:
    """Hide visible frames at random, recover them, and measure the error there."""
    recording, _ = join_cameras(recording)  # what is hidden is hidden from all cameras
    report = progress or (lambda part, text: None)
    copies, notes = [], []
    for length in lengths_s:
        for run in range(repetitions):
            # a generator a length and run: adding a length to the list moves no other gap
            rng = np.random.default_rng([seed, round(1000 * length), run])
            gaps = place_gaps(recording, length, rng, count=gaps_per_run, margin_s=margin_s)
            if gaps:
                copies.append(GapCopy(length, run, gaps))
        if not any(copy.length_s == length for copy in copies):
            notes.append(f"The camera never sees the forearm for long enough to hide a gap of {length:g} s.")
    if not copies:
        raise RecordingError(
            f"{recording.name}: the camera never sees the forearm for long enough to hide a gap of"
            f" {min(lengths_s, default=0.0):g} s with 0.4 s visible on both sides"
        )
    tables = [GapTable((), tuple(notes))]
    job = partial(try_methods, recording=recording, methods=methods)
    with Pool(min(processes, len(copies)), len(copies) * len(recording.arm)) as workers:
        answers = workers.map(job, copies)
        for number, copy in enumerate(copies):
            report(number / len(copies), f"gaps of {copy.length_s:g} s")
            tables.append(next(answers))
    report(1.0, "done")
    return pooled(tables)


def try_methods(
    trial: GapCopy, recording: Recording, methods: Mapping[str, Method], one_noise: bool = False
) -> GapTable:
    """All methods on one copy; what one of them cannot do becomes rows without figures."""
    rows, notes = [], []
    copy = hide(recording, trial.gaps)
    noise_of: Recovery | None = None
    for name, method in methods.items():
        row = partial(GapRow, trial.length_s, name, trial.run, recording=recording.name)
        try:
            recovery = method(copy)
        except UnoccludeError as error:
            notes.append(f"{name} could not recover gaps of {trial.length_s:g} s: {error}")
            rows += [row(gap, NOTHING, str(error)) for gap in trial.gaps]
            continue
        noise_of = (noise_of or recovery) if one_noise else None
        for gap in trial.gaps:
            errors = score_gap(recording, recovery, gap, noise_of)
            answered = np.isfinite(errors.distance_m).any()
            rows.append(row(gap, errors, "" if answered else "no answer inside the gap"))
    return GapTable(tuple(rows), tuple(notes))


#: `check` hides gaps of these lengths, s; values between are read off the line through them.
LENGTHS_S = (1.0, 3.0, 10.0)
GAPS = 3
#: What a gap is to stay within, m.
WITHIN_M = 0.02


def allowed_gaps(
    recording: Recording,
    recover: Method,
    not_determined: Sequence[str] = (),
    progress: Progress | None = None,
    processes: int = 1,
) -> dict[str, Any]:
    """How uncertain hidden gaps are: what a recording allows, as plain values with their sentences."""
    try:
        table = evaluate_gaps(
            *(recording, LENGTHS_S, {"graph": recover}),
            gaps_per_run=GAPS,
            progress=progress,
            processes=processes,
        )
    except RecordingError:  # never visible for long enough
        table = GapTable(())
    sigmas = {}
    for length_s, methods in table.lengths.items():
        own = methods["graph"]
        stated = [sigma_m for row in own.rows if (sigma_m := row.errors.sigma_max_m) is not None]
        if stated:  # widened where errors exceed what is stated
            sigmas[length_s] = float(np.median(stated) * np.sqrt(np.fmax(own.figures.nees or 1.0, 1.0)))
    lengths_s, largest_m = list(sigmas), np.maximum.accumulate(list(sigmas.values()))
    longest_s: float | None = None
    if not sigmas:
        allows = said("gaps", "never")
    elif largest_m[0] > WITHIN_M:
        longest_s, known_cm = 0.0, 100 * sigmas[lengths_s[0]]
        allows = said("gaps", "none", within_cm=100 * WITHIN_M, length_s=lengths_s[0], known_cm=known_cm)
    else:
        longest_s, up_to = lengths_s[-1], "at least"
        if largest_m[-1] > WITHIN_M:
            longest_s = float(np.exp(np.interp(np.log(WITHIN_M), np.log(largest_m), np.log(lengths_s))))
            up_to = "about"
        allows = said("gaps", "allowed", within_cm=100 * WITHIN_M, up_to=up_to, length_s=longest_s)
    return {
        "sentence": "; ".join((allows, *not_determined)),
        "sentences": [allows, *not_determined],
        "longest_gap_s": longest_s,
        "within_m": WITHIN_M,
        "gaps": [{"length_s": length_s, "sigma_m": sigma_m} for length_s, sigma_m in sigmas.items()],
        "not_determined": list(not_determined),
    }
