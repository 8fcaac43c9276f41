"""A recovery compared with a reference: all samples, the occluded ones, the visible ones, each gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..errors import RecordingError
from ..measurements.visibility import Gap
from ..recording import JOINTS, Truth
from ..result import Recovery
from ..runtime.pool import Progress
from .agreement import Agreement, AngleComparison, compare_angles
from .measure_agreement import MeasureComparison, MeasurePair, compare_measures
from .metrics import (
    Figures,
    coverage_95,
    lag_s,
    maximum,
    mean_vector,
    nees,
    orientation_error_deg,
    position_at,
    rms,
    rotation_error,
    squared_sigmas,
    summarise,
    truth_at,
)
from .reference import ReferenceAlignment
from .truth import truth_notes


@dataclass(frozen=True)
class TableRow:
    """One line of the table."""

    errors: str  # "Orientation errors (degree)"
    figure: str  # "RMS" or "Maximum"
    camera: float | None  # The errors, in the unit of the line; None where there is none
    answer: float | None  # The errors, in the unit of the line; None where there is none

    @property
    def reduction(self) -> float | None:
        """By which part of the camera's error the answer is better, 0 to 1; negative where it is worse."""
        if self.camera is None or self.answer is None or self.camera <= 0:
            return None
        return 1.0 - self.answer / self.camera

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {
            "errors": self.errors,
            "figure": self.figure,
            "camera": self.camera,
            "answer": self.answer,
            "reduction": self.reduction,
        }


@dataclass(frozen=True)
class TableOne:
    """Table I of Jatesiktat and Ang (2017): the camera's skeleton, the answer, what it gains."""

    rows: tuple[TableRow, ...]  # Its lines
    camera_share: float  # Part of the scored samples for which the camera states a position at all
    note: str  # A note for the reader, in a sentence

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {
            "rows": [row.to_dict() for row in self.rows],
            "camera_share": self.camera_share,
            "note": self.note,
        }


def table_one(
    recovery: Recovery, reference: Truth, scored: BoolArray, distance_m: FloatArray, angle_deg: FloatArray
) -> TableOne:
    """The table of a recovery, its figures over all scored samples.

    The camera's estimate of the IMU's position is their eq 16, D = L + d_se / (d_sw + d_se) (T - L), between
    the camera's elbow L and wrist T, inferred samples included, read at the IMU's times between samples
    0.1 s apart at most. A skeleton states no orientation; the direction elbow to wrist stands below instead.
    """
    position, direction = camera_estimate(recovery)
    own = np.where(scored, np.linalg.norm(position - reference.position, axis=1), np.nan)
    rows = [
        TableRow("Orientation errors (degree)", "RMS", None, rms(angle_deg)),
        TableRow("Orientation errors (degree)", "Maximum", None, maximum(angle_deg)),
    ]
    both = ("elbow", "wrist")
    if all(name in reference.joints and name in recovery.joints for name in both):
        true = reference.joints["wrist"] - reference.joints["elbow"]
        answer = _between_deg(recovery.joints["wrist"] - recovery.joints["elbow"], true)
        camera = _between_deg(direction, true)
        keep = reference.score
        errors = "Forearm direction errors (degree)"
        for name, figure in (("RMS", rms), ("Maximum", maximum)):
            rows.append(
                TableRow(
                    errors,
                    name,
                    figure(np.where(keep, camera, np.nan)),
                    figure(np.where(keep, answer, np.nan)),
                )
            )
    rows.append(TableRow("Position errors (meter)", "RMS", rms(own), rms(distance_m)))
    rows.append(TableRow("Position errors (meter)", "Maximum", maximum(own), maximum(distance_m)))
    known = np.isfinite(reference.position).all(axis=1) & scored
    share = float(np.isfinite(own[known]).mean()) if known.any() else 0.0
    return TableOne(
        tuple(rows),
        share,
        f"The camera states a position, guesses included, for {100 * share:.0f} % of the samples; its errors"
        " are over those, the answer's over all. A skeleton has no orientation.",
    )


def camera_estimate(recovery: Recovery) -> tuple[FloatArray, FloatArray]:
    """The camera's own IMU position (N, 3) m and way from elbow to wrist (N, 3) m, at the IMU's times."""
    arm = recovery.arm
    elbow, wrist, strap = (arm.position[:, JOINTS.index(name)] for name in ("elbow", "wrist", "strap"))
    calibration = recovery.calibration
    along = None if calibration is None else calibration.forearm_direction
    if calibration is None or along is None:
        place = strap if np.isfinite(strap).any() else np.full_like(wrist, np.nan)
    else:
        levers = calibration.lever_arms
        from_elbow = -(levers["elbow"].position_m @ along)
        length = (levers["wrist"].position_m - levers["elbow"].position_m) @ along
        place = elbow + from_elbow / length * (wrist - elbow)
    return position_at(arm.t_s, place, recovery.t_s), position_at(arm.t_s, wrist - elbow, recovery.t_s)


def _between_deg(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1)))


@dataclass(frozen=True)
class SampleErrors:
    """Errors sample by sample, at the recovery's times; nan where there is nothing to compare."""

    reference: Truth  # The truth at the recovery's times
    scored: BoolArray  # bool (n,): the reference has a position there that is to be scored
    distance_m: FloatArray  # (n,) m: position error
    angle_deg: FloatArray  # (n,) degrees: orientation error, as an angle of rotation
    squared_sigmas: FloatArray  # (n,): squared position error in sigmas
    # dict of (n,) m: Position error of the joints that the reference has, by joint
    joint_distance_m: dict[str, FloatArray]
    difference_m: FloatArray  # (n, 3) m: answer minus reference, in {K}
    turn_rad: FloatArray  # (n, 3) rad: rotation vector from reference to answer, in {K}
    turn_squared_sigmas: FloatArray  # (n,): squared orientation error in sigmas
    joint_difference_m: dict[str, FloatArray]  # dict of (n, 3) and (n,): likewise by joint
    joint_squared_sigmas: dict[str, FloatArray]  # dict of (n, 3) and (n,): likewise by joint

    def figures(self, chosen: BoolArray) -> Figures:
        """The figures of the chosen samples (N,)."""
        unanswered = int((chosen & self.scored & ~np.isfinite(self.distance_m)).sum())
        figures = summarise(
            self.distance_m[chosen], self.angle_deg[chosen], self.squared_sigmas[chosen], unanswered
        )
        turn = mean_vector(np.degrees(self.turn_rad[chosen]))
        return replace(
            figures,
            joint_rms_m={name: rms(distance[chosen]) for name, distance in self.joint_distance_m.items()},
            position_bias_m=mean_vector(self.difference_m[chosen]),
            orientation_bias_deg=turn,
            orientation_nees=nees(self.turn_squared_sigmas[chosen]),
            orientation_coverage_95=coverage_95(self.turn_squared_sigmas[chosen]),
        )

    def joint_figures(self, joint: str, chosen: BoolArray) -> Figures:
        """The figures of a joint's position over the chosen samples (N,)."""
        nothing = np.full(int(chosen.sum()), np.nan)
        figures = summarise(
            self.joint_distance_m[joint][chosen], nothing, self.joint_squared_sigmas[joint][chosen]
        )
        return replace(figures, position_bias_m=mean_vector(self.joint_difference_m[joint][chosen]))


@dataclass(frozen=True)
class Validation:
    """A recovery held against a reference."""

    all: Figures  # Figures of all samples, of those in gaps, and of the others
    occluded: Figures  # Figures of all samples, of those in gaps, and of the others
    visible: Figures  # Figures of all samples, of those in gaps, and of the others
    notes: tuple[str, ...] = ()  # Notes on the comparison for the reader, one sentence each
    # Figures of each joint that truth and answer share, by joint and part
    points: dict[str, dict[str, Figures]] = field(default_factory=dict)
    gaps: tuple[tuple[Gap, Figures], ...] = ()  # Figures of each gap that contains a sample with truth
    angles: AngleComparison | None = None  # Joint angles of both
    # Agreement of the angles by part and angle
    angle_figures: dict[str, dict[str, Agreement]] = field(default_factory=dict)
    lag_s: float | None = None  # How late the answer's position is against the truth's
    table: TableOne | None = None  # The layout of Jatesiktat and Ang's table I
    # How the truth was brought to the result
    alignment: ReferenceAlignment = field(default_factory=ReferenceAlignment)
    measures: MeasureComparison | None = None  # What clinicians read, of both

    def to_dict(self) -> dict[str, Any]:
        """The figures by name, as `--json` writes them."""
        points = {
            name: {part: figures.to_dict() for part, figures in parts.items()}
            for name, parts in self.points.items()
        }
        angles = {
            part: {name: found.to_dict() for name, found in each.items()}
            for part, each in self.angle_figures.items()
        }
        gaps = [
            {"start_s": gap.start_s, "end_s": gap.end_s, **figures.to_dict()} for gap, figures in self.gaps
        ]
        return {
            "all": self.all.to_dict(),
            "occluded": self.occluded.to_dict(),
            "visible": self.visible.to_dict(),
            "points": points,
            **self.alignment.to_dict(),
            "gaps": gaps,
            "angles_deg": angles,
            "carrying_truth_deg": None if self.angles is None else self.angles.carrying_truth_deg,
            "lag_s": self.lag_s,
            "measures": None if self.measures is None else self.measures.to_dict(),
            "table_1": None if self.table is None else self.table.to_dict(),
            "notes": list(self.notes),
        }

    def title(self, text: str) -> str:
        """The title of one of its results: states where the truth was aligned."""
        return f"{text} ({self.alignment.title})" if self.alignment.title else text


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
        distance_m=np.linalg.norm(difference, axis=1),
        angle_deg=np.where(reference.score, angle, np.nan),
        squared_sigmas=squared_sigmas(difference, recovery.pose_covariance[:, :3, :3]),
        joint_distance_m={name: np.linalg.norm(each, axis=1) for name, each in joints.items()},
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
    alignment = alignment or ReferenceAlignment()
    errors = sample_errors(recovery, truth)
    _refuse_without_overlap(recovery, truth, errors)
    parts = {
        "all": np.ones(len(recovery), dtype=bool),
        "occluded": recovery.occluded,
        "visible": ~recovery.occluded,
    }
    figures = {name: errors.figures(chosen) for name, chosen in parts.items()}
    angles = compare_angles(recovery, errors.reference, alignment.landmarks, truth.t_s)
    points = {
        joint: {name: errors.joint_figures(joint, chosen) for name, chosen in parts.items()}
        for joint in errors.joint_distance_m
    }
    return Validation(
        **figures,
        notes=(
            *_same(figures["all"], points),
            *alignment.notes,
            *truth_notes(recovery, truth, aligned=alignment.kind != "none"),
            *_notes(errors, figures["all"]),
            *(angles.notes if angles else ()),
        ),
        points=points,
        gaps=tuple(_gaps(recovery, errors)),
        angles=angles,
        angle_figures={name: angles.figures(chosen) for name, chosen in parts.items()} if angles else {},
        lag_s=_lag(recovery, truth, errors),
        table=table_one(recovery, errors.reference, errors.scored, errors.distance_m, errors.angle_deg),
        alignment=alignment,
        measures=compare_measures(recovery, errors.reference, pooled, processes, progress),
    )


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


def _lag(recovery: Recovery, truth: Truth, errors: SampleErrors) -> float | None:
    """Lag of the IMU's position, or of the wrist where the truth has no IMU."""
    answer, position = recovery.position, truth.position
    if not errors.scored.any():
        shared = [joint for joint in ("wrist", "hand", "elbow") if joint in errors.joint_distance_m]
        if not shared:
            return None
        answer, position = recovery.joints[shared[0]], truth.joints[shared[0]]
    return lag_s(recovery.t_s, answer, np.where(truth.score[:, None], position, np.nan), truth.t_s)


def _refuse_without_overlap(recovery: Recovery, truth: Truth, errors: SampleErrors) -> None:
    joints = errors.joint_distance_m.values()
    if errors.scored.any() or np.isfinite(errors.angle_deg).any():
        return
    if any(np.isfinite(distance).any() for distance in joints):
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
