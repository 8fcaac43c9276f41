"""A recovery compared with a reference: all samples, the occluded ones, the visible ones, each gap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..error_radius import pooled_radius
from ..errors import RecordingError
from ..measurements.visibility import Gap
from ..recording import Truth
from ..result import Recovery
from ..runtime.pool import Progress
from ..table import Table, fixed, tabulated
from .agreement import WORDS, Agreement, AngleComparison, compare_angles, interval, with_interval
from .measure_agreement import MeasureComparison, MeasurePair, compare_measures
from .metrics import (
    Figures,
    coverage_95,
    lag_s,
    mean_vector,
    nees,
    orientation_error_deg,
    rms,
    rotation_error,
    squared_sigmas,
    summarise,
    truth_at,
)
from .reference import ReferenceAlignment
from .truth import truth_notes

PARTS = ("all", "occluded", "visible")
#: About this many samples are pooled to one stated distance.
_MOST_POOLED = 4000


@dataclass(frozen=True)
class SampleErrors:
    """Errors sample by sample, at the recovery's times; nan where there is nothing to compare."""

    reference: Truth  # The truth at the recovery's times
    scored: BoolArray  # bool (n,): the reference has a position there that is to be scored
    difference_m: FloatArray  # (n, 3) m: answer minus reference, in {K}
    squared_sigmas: FloatArray  # (n,): squared position error in sigmas
    turn_rad: FloatArray  # (n, 3) rad: rotation vector from reference to answer, in {K}
    angle_deg: FloatArray  # (n,) degrees: orientation error, as an angle of rotation
    turn_squared_sigmas: FloatArray  # (n,): squared orientation error in sigmas
    joint_difference_m: dict[str, FloatArray]  # dict of (n, 3) and (n,): of joints that the reference has
    joint_squared_sigmas: dict[str, FloatArray]

    @property
    def distance_m(self) -> FloatArray:
        """(n,) m: position error."""
        return np.asarray(np.linalg.norm(self.difference_m, axis=1))

    @property
    def joint_distance_m(self) -> dict[str, FloatArray]:
        """(n,) m: position error by joint."""
        return {name: np.linalg.norm(each, axis=1) for name, each in self.joint_difference_m.items()}

    def figures(self, chosen: BoolArray) -> Figures:
        """The figures of the chosen samples (N,)."""
        distance = self.distance_m[chosen]
        unanswered = int((self.scored[chosen] & ~np.isfinite(distance)).sum())
        squared = self.turn_squared_sigmas[chosen]
        return replace(
            summarise(distance, self.angle_deg[chosen], self.squared_sigmas[chosen], unanswered),
            joint_rms_m={name: rms(each[chosen]) for name, each in self.joint_distance_m.items()},
            position_bias_m=mean_vector(self.difference_m[chosen]),
            orientation_bias_deg=mean_vector(np.degrees(self.turn_rad[chosen])),
            orientation_nees=nees(squared),
            orientation_coverage_95=coverage_95(squared),
        )

    def joint_figures(self, joint: str, chosen: BoolArray) -> Figures:
        """The figures of a joint's position over the chosen samples (N,)."""
        difference, squared = self.joint_difference_m[joint][chosen], self.joint_squared_sigmas[joint][chosen]
        figures = summarise(np.linalg.norm(difference, axis=1), np.full(len(squared), np.nan), squared)
        return replace(figures, position_bias_m=mean_vector(difference))


@dataclass(frozen=True)
class Validation:
    """A recovery held against a reference."""

    all: Figures  # Figures of all samples, of those in gaps, and of the others
    occluded: Figures
    visible: Figures
    notes: tuple[str, ...] = ()  # Notes on the comparison for the reader, one sentence each
    # Figures of each joint that truth and answer share, by joint and part
    points: dict[str, dict[str, Figures]] = field(default_factory=dict)
    gaps: tuple[tuple[Gap, Figures], ...] = ()  # Figures of each gap that contains a sample with truth
    angles: AngleComparison | None = None  # Joint angles of both
    # Agreement of the angles by part and angle
    angle_figures: dict[str, dict[str, Agreement]] = field(default_factory=dict)
    lag_s: float | None = None  # How late the answer's position is against the truth's
    # How the truth was brought to the result
    alignment: ReferenceAlignment = field(default_factory=ReferenceAlignment)
    measures: MeasureComparison | None = None  # What clinicians read, of both

    def figures_of(self, point: str, part: str) -> Figures | None:
        """Figures of a joint, or of the "sensor", over a part; None where there are none."""
        if point == "sensor":
            figures: Figures = getattr(self, part)
            return figures
        return self.points.get(point, {}).get(part)

    def to_dict(self) -> dict[str, Any]:
        """The figures by name, as `--json` writes them."""
        return {
            **{part: asdict(getattr(self, part)) for part in PARTS},
            "points": {
                name: {part: asdict(figures) for part, figures in parts.items()}
                for name, parts in self.points.items()
            },
            **self.alignment.to_dict(),
            "gaps": [
                {"start_s": gap.start_s, "end_s": gap.end_s, **asdict(figures)} for gap, figures in self.gaps
            ],
            "angles_deg": self.angle_figures,
            "carrying_truth_deg": None if self.angles is None else self.angles.carrying_truth_deg,
            "lag_s": self.lag_s,
            "measures": None if self.measures is None else self.measures.to_dict(),
            "notes": list(self.notes),
        }

    def errors(self, recovery: Recovery) -> Table:
        """The errors of the sensor by part, with what was stated of them."""
        rows: list[dict[str, Any]] = []
        for part, inside in _parts(recovery).items():
            figures: Figures = getattr(self, part)
            chosen = np.flatnonzero(inside)
            some = recovery.pose_covariance[chosen[:: max(1, len(chosen) // _MOST_POOLED)]]
            stated_m = pooled_radius(some[:, :3, :3]) if figures.position_p95_m is not None else None
            rows.append({"part": part, "stated_m": stated_m, **vars(figures)})
        title = self.alignment.titled("Error against the truth, with the measured and the stated 95 % bound")
        columns = {"95 % within, cm": "position_p95_m", "stated, cm": "stated_m", "rms, cm": "position_rms_m"}
        turns = {"rms, deg": "orientation_rms_deg", "95 %, deg": "orientation_p95_deg"}
        more = {"max, deg": "orientation_max_deg", "NEES": "nees", "inside 95 %": "coverage_95"}
        columns |= {"max, cm": "position_max_m"} | turns | more
        return tabulated(title, rows, {"part": "part", **columns, "samples": "samples"})

    @property
    def joint_errors(self) -> Table:
        """The errors of the joints by part."""
        rows = [
            {"joint": name, **vars(parts["all"])}
            | {f"{part}_m": parts[part].position_rms_m for part in PARTS}
            for name, parts in self.points.items()
        ]
        columns = {"joint": "joint", **{part: f"{part}_m" for part in PARTS}}
        columns |= {"95 %": "position_p95_m", "max": "position_max_m", "NEES": "nees"}
        return tabulated(self.alignment.titled("Joints, position rms, cm"), rows, columns)

    @property
    def gap_errors(self) -> Table:
        """The errors of the sensor gap by gap."""
        rows = [
            {"start": f"{gap.start_s:.2f}", "length": f"{gap.length_s:.2f}", **vars(figures)}
            for gap, figures in self.gaps
            if figures.position_rms_m is not None or figures.orientation_rms_deg is not None
        ]
        columns = {"gap at, s": "start", "length, s": "length", "rms, cm": "position_rms_m"}
        columns |= {"95 % within, cm": "position_p95_m", "max, cm": "position_max_m"}
        columns |= {"rms, deg": "orientation_rms_deg", "max, deg": "orientation_max_deg", "NEES": "nees"}
        return tabulated(self.alignment.titled("Error gap by gap"), rows, columns)

    @property
    def angle_errors(self) -> Table:
        """The agreement of the joint angles by part."""
        rows = [
            {"angle": WORDS[name], "part": part, **found}
            for name in (self.angles.compared if self.angles else ())
            for part in PARTS
            if (found := self.angle_figures[part][name])["samples"]
        ]
        columns: dict[str, str | Callable[[Any], object]] = {
            "angle": "angle",
            "part": "part",
            "RMSE": lambda row: fixed(row["rmse"]),
            "bias": lambda row: fixed(row["bias"]),
            "limits of agreement": lambda row: interval(row["limits_low"], row["limits_high"], 1),
            "ICC(A,1), 95 % interval": with_interval,
            "samples": "samples",
        }
        return tabulated(self.alignment.titled("Joint angles, degrees (answer minus truth)"), rows, columns)


def _parts(recovery: Recovery) -> dict[str, BoolArray]:
    """Which samples (N,) are in each of `PARTS`."""
    hidden = recovery.occluded
    return {"all": np.ones_like(hidden), "occluded": hidden, "visible": ~hidden}


def sample_errors(recovery: Recovery, truth: Truth) -> SampleErrors:
    """Errors of a recovery at each of its samples; the truth is read at the recovery's times."""
    reference = truth_at(truth, recovery.t_s)
    score = reference.score[:, None]
    difference = np.where(score, recovery.position - reference.position, np.nan)
    angle = orientation_error_deg(recovery.quaternion, reference.quaternion)
    turn = np.where(score, rotation_error(recovery.quaternion, reference.quaternion), np.nan)
    joints = {
        name: np.where(score, recovery.joints[name] - position, np.nan)
        for name, position in reference.joints.items()
        if name in recovery.joints
    }
    unknown = np.full((len(recovery), 3, 3), np.nan)
    return SampleErrors(
        reference=reference,
        scored=reference.score & np.isfinite(reference.position).all(axis=1),
        angle_deg=np.where(reference.score, angle, np.nan),
        squared_sigmas=squared_sigmas(difference, recovery.pose_covariance[:, :3, :3]),
        difference_m=difference,
        turn_rad=turn,
        turn_squared_sigmas=squared_sigmas(turn, recovery.pose_covariance[:, 3:, 3:]),
        joint_difference_m=joints,
        joint_squared_sigmas={
            name: squared_sigmas(each, recovery.joint_covariance.get(name, unknown))
            for name, each in joints.items()
        },
    )


def validate(
    recovery: Recovery,
    truth: Truth,
    alignment: ReferenceAlignment | None = None,
    pooled: Sequence[MeasurePair] = (),
    processes: int = 1,
    progress: Progress | None = None,
) -> Validation:
    """Compare a recovery with a reference on the same clock and in the same frame.

    Parameters
    ----------
    recovery : Recovery
        The result to judge.
    truth : Truth
        Pose of the forearm IMU in the camera frame, on the IMU's clock; times count from the recovery's
        origin. Samples outside `truth.score` are not scored.
    alignment : ReferenceAlignment, optional
        How the truth was brought there; None where it came so.
    pooled : sequence of MeasurePair
        Measures of earlier validations, whose agreement is stated together with this one's.
    processes : int
        Worker processes that measure the drawn motions, 0 = one per core.
    progress : callable, optional
        Called with the number of them measured so far.

    Returns
    -------
    Validation

    Raises
    ------
    RecordingError
        The truth contains nothing during the recovery.
    """
    validation, errors = validated(recovery, truth, alignment)
    measures = compare_measures(recovery, errors.reference, pooled, processes, progress)
    return replace(validation, measures=measures)


def validated(
    recovery: Recovery, truth: Truth, alignment: ReferenceAlignment | None = None
) -> tuple[Validation, SampleErrors]:
    """The same without the measures, and the errors sample by sample."""
    alignment = alignment or ReferenceAlignment()
    errors = sample_errors(recovery, truth)
    _refuse_without_overlap(recovery, truth, errors)
    parts = _parts(recovery)
    figures = {name: errors.figures(chosen) for name, chosen in parts.items()}
    angles = compare_angles(recovery, errors.reference, alignment.landmarks, truth.t_s)
    points = {
        joint: {name: errors.joint_figures(joint, chosen) for name, chosen in parts.items()}
        for joint in errors.joint_difference_m
    }
    notes = (
        *_same(figures["all"], points),
        *alignment.notes,
        *truth_notes(recovery, truth, aligned=alignment.kind != "none"),
        *_notes(errors, figures["all"]),
        *(angles.notes if angles else ()),
    )
    # of the IMU's position, or of the wrist where the truth has no IMU
    shared = [joint for joint in ("wrist", "hand", "elbow") if joint in errors.joint_difference_m]
    answer, position = recovery.position, truth.position
    if not errors.scored.any() and shared:
        answer, position = recovery.joints[shared[0]], truth.joints[shared[0]]
    known = np.where(truth.score[:, None], position, np.nan)
    lag = lag_s(recovery.t_s, answer, known, truth.t_s) if errors.scored.any() or shared else None
    validation = Validation(
        figures["all"],
        figures["occluded"],
        figures["visible"],
        notes=notes,
        points=points,
        gaps=tuple(_gaps(recovery, errors)),
        angles=angles,
        angle_figures={name: angles.figures(chosen) for name, chosen in parts.items()} if angles else {},
        lag_s=lag,
        alignment=alignment,
    )
    return validation, errors


#: Two measurements of a motion never agree this well, m; an export rounds its values less.
_SAME_M = 1e-4


def _same(figures: Figures, points: dict[str, dict[str, Figures]]) -> list[str]:
    """Says so where the reference is the result itself."""
    errors = [one.position_rms_m for one in (figures, *(each["all"] for each in points.values()))]
    known = [error for error in errors if error is not None]
    if known and max(known) < _SAME_M:
        return ["The reference is this result itself, or an export of it: the comparison shows nothing."]
    return []


def _notes(errors: SampleErrors, figures: Figures) -> list[str]:
    notes = []
    if not errors.scored.any():
        notes.append("The truth has no position of the IMU (no plate); joints are compared.")
    if not np.isfinite(errors.angle_deg).any():
        notes.append("The truth and the result share no orientation; only positions are compared.")
    if figures.unanswered:
        notes.append(
            f"{figures.unanswered} of {figures.unanswered + figures.samples} samples with truth have no"
            " result and are excluded."
        )
    return notes


def _gaps(recovery: Recovery, errors: SampleErrors) -> list[tuple[Gap, Figures]]:
    rows = []
    for gap in recovery.gaps:
        inside = (recovery.t_s > gap.start_s) & (recovery.t_s < gap.end_s) & recovery.occluded
        figures = errors.figures(inside)
        if figures.samples or any(value is not None for value in figures.joint_rms_m.values()):
            rows.append((gap, figures))
    return rows


def _refuse_without_overlap(recovery: Recovery, truth: Truth, errors: SampleErrors) -> None:
    joints = errors.joint_difference_m.values()
    if errors.scored.any() or np.isfinite(errors.angle_deg).any():
        return
    if any(np.isfinite(each).any() for each in joints):
        return
    known = truth.t_s[np.isfinite(truth.position).all(axis=1)]
    if not len(known):
        raise RecordingError("the truth has no finite position, so there is nothing to compare with")
    if not len(recovery):
        raise RecordingError("the result has no sample, so there is nothing to compare")
    first, last = recovery.t_s[0], recovery.t_s[-1]
    if known[-1] < first or known[0] > last:
        raise RecordingError(
            f"the truth covers {known[0]:.3f} to {known[-1]:.3f} s and the result {first:.3f} to"
            f" {last:.3f} s: they do not overlap in time, so check that both use the same clock"
        )
    if len(known) > 1 and np.median(np.diff(known)) > 0.1:
        raise RecordingError(
            "the truth's samples lie more than 0.1 s apart, and gaps that long are not bridged:"
            " give a truth with at least 10 samples per second"
        )
    raise RecordingError("no sample of the truth that is to be scored falls on a sample of the result")
