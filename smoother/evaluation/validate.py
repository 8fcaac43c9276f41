"""A recovery compared with a reference: all samples, the occluded ones, the visible ones, each gap."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..angles.definitions import ANGLE_TITLES, ANGLES, arm_angles, defined, forearm_axes, recovery_angles
from ..array_types import BoolArray, FloatArray
from ..error_radius import pooled_radius
from ..errors import RecordingError
from ..linalg import unit
from ..measurements.visibility import Gap
from ..recording import Truth
from ..result import Recovery
from ..runtime.pool import Progress
from ..table import Table, fixed, tabulated
from .measure_agreement import MeasurePair, compare_measures
from .metrics import (
    BRIDGED_S,
    Errors,
    Figures,
    lag_s,
    position_at,
    rms,
    rotation_error,
    squared_sigmas,
    truth_at,
)
from .reference import ReferenceAlignment, truth_notes
from .statistics import Agreement, agreement
from .words import limits_words, said, with_interval

_said = partial(said, "reference")
PARTS = ("all", "occluded", "visible")
#: What may be compared, the forearm IMU first; joints where the truth has none.
SENSOR = "sensor"
POINTS = (SENSOR, "wrist", "hand", "elbow")
#: About this many samples are pooled to one stated distance.
_MOST_POOLED = 4000


@dataclass(frozen=True)
class SampleErrors(Errors):
    """Errors of the sensor, and of each joint, at the recovery's times."""

    reference: Truth  # The truth at the recovery's times
    joints: dict[str, Errors]  # Of those that the reference has

    def figures(self, chosen: BoolArray | slice = slice(None)) -> Figures:
        """The figures of the sensor, with the rms of the joints."""
        joints = {name: rms(each.distance_m[chosen]) for name, each in self.joints.items()}
        return replace(super().figures(chosen), joint_rms_m=joints)


def sample_errors(recovery: Recovery, truth: Truth) -> SampleErrors:
    """Errors of a recovery at each of its samples; the truth is read at the recovery's times."""
    reference = truth_at(truth, recovery.t_s)
    unknown = np.full((len(recovery), 3, 3), np.nan)

    def scored(values: FloatArray) -> FloatArray:
        return np.where(reference.score[:, None] if values.ndim > 1 else reference.score, values, np.nan)

    joints = {}
    for name, position in reference.joints.items():
        if name in recovery.joints:
            off, spread = (
                scored(recovery.joints[name] - position),
                recovery.joint_covariance.get(name, unknown),
            )
            joints[name] = Errors.of_positions(off, squared_sigmas(off, spread))
    difference = scored(recovery.position - reference.position)
    turn = scored(rotation_error(recovery.quaternion, reference.quaternion))
    return SampleErrors(
        difference,
        squared_sigmas(difference, recovery.pose_covariance[:, :3, :3]),
        reference.score & np.isfinite(reference.position).all(axis=1),
        turn,
        squared_sigmas(turn, recovery.pose_covariance[:, 3:, 3:]),
        reference,
        joints,
    )


@dataclass(frozen=True)
class Validation:
    """A recovery held against a reference."""

    all: Figures  # Figures of the sensor: of all samples, of those in gaps, and of the others
    occluded: Figures
    visible: Figures
    stated_m: Mapping[str, float | None]  # By part, within which 95 of 100 errors lie as stated
    notes: tuple[str, ...]  # Notes on the comparison for the reader, one sentence each
    points: dict[str, dict[str, Figures]]  # Of each joint that truth and answer share, by part
    gaps: tuple[tuple[Gap, Figures], ...]  # Figures of each gap that contains a sample with truth
    angles: dict[str, dict[str, Agreement]]  # Agreement of the joint angles that both have, by part
    carrying_truth_deg: float | None  # Median of the truth's; None without markers on the epicondyles
    point: str  # The first of `POINTS` that truth and answer share; "" without one
    lag_s: float | None  # How late it is against the truth's, over all samples
    lag_occluded_s: float | None  # The same over those in gaps
    alignment: ReferenceAlignment  # How the truth was brought to the result
    measures: list[MeasurePair] | None = None  # What clinicians read, of both

    def figures_of(self, point: str, part: str) -> Figures | None:
        """Figures of a joint, or of the "sensor", over a part; None where there are none."""
        found: Figures | None
        found = getattr(self, part) if point == SENSOR else self.points.get(point, {}).get(part)
        return found

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
            "angles_deg": self.angles,
            "carrying_truth_deg": self.carrying_truth_deg,
            "lag_s": self.lag_s,
            "lag_occluded_s": self.lag_occluded_s,
            "measures": None
            if self.measures is None
            else {"pairs": [pair.to_dict() for pair in self.measures]},
            "notes": list(self.notes),
        }

    @property
    def errors(self) -> Table:
        """The errors of the sensor and of the joints by part, with what was stated of the sensor's."""
        sensor = {part: getattr(self, part) for part in PARTS}
        rows = [
            {"point": point, "part": part, "stated_m": self.stated_m[part] if point == SENSOR else None}
            | vars(figures)
            for point, parts in ({SENSOR: sensor} | self.points).items()
            for part, figures in parts.items()
            if figures.samples or figures.orientation_rms_deg is not None
        ]
        title = "Error against the truth, with the measured and the stated 95 % bound"
        columns = {"95 % within, cm": "position_p95_m", "stated, cm": "stated_m", "rms, cm": "position_rms_m"}
        columns |= {"max, cm": "position_max_m", "rms, deg": "orientation_rms_deg"}
        columns |= {"95 %, deg": "orientation_p95_deg", "max, deg": "orientation_max_deg"}
        columns |= {"NEES": "nees", "inside 95 %": "coverage_95", "samples": "samples"}
        return tabulated(self.alignment.titled(title), rows, {"of": "point", "part": "part", **columns})

    @property
    def angle_errors(self) -> Table:
        """The agreement of the joint angles by part."""
        rows = [
            {"angle": ANGLE_TITLES[name], "part": part, "unit": "deg", **found}
            for name in self.angles.get("all", ())
            for part in PARTS
            if (found := self.angles[part][name])["samples"]
        ]
        title = self.alignment.titled("Joint angles, degrees (answer minus truth)")
        return tabulated(
            title,
            rows,
            {
                "angle": "angle",
                "part": "part",
                "RMSE": lambda row: fixed(row["rmse"]),
                "bias": lambda row: fixed(row["bias"]),
                "limits of agreement": limits_words,
                "ICC(A,1), 95 % interval": with_interval,
                "samples": "samples",
            },
        )


def validate(
    recovery: Recovery,
    truth: Truth,
    alignment: ReferenceAlignment | None = None,
    with_measures: bool = True,
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
    with_measures : bool
        Whether the measures of both are compared too.
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
    angles = errors.angle_deg[:, None]
    compared = (errors.difference_m, angles, *(each.difference_m for each in errors.joints.values()))
    if not errors.scored.any() and not any(np.isfinite(each).any() for each in compared):
        raise RecordingError(_nothing_shared(recovery, truth))
    everything = np.ones(len(recovery), bool)
    parts = dict(zip(PARTS, (everything, recovery.occluded, ~recovery.occluded), strict=True))

    def by_part(of: Errors) -> dict[str, Figures]:
        return {name: of.figures(chosen) for name, chosen in parts.items()}

    figures, points = by_part(errors), {joint: by_part(each) for joint, each in errors.joints.items()}
    shared = {SENSOR: figures} | points
    point = next((each for each in POINTS if each in shared and shared[each]["all"].samples), "")
    path = recovery.joints.get(point, recovery.position)
    known = truth.joints[point] if point in points else truth.position
    lags = [
        lag_s(
            recovery.t_s,
            np.where(parts[part][:, None], path, np.nan),
            np.where(truth.score[:, None], known, np.nan),
            truth.t_s,
        )
        if point
        else None
        for part in ("all", "occluded")
    ]
    measures = None
    if with_measures:
        measures = compare_measures(recovery, errors.reference, processes, progress)
    without = measures is not None and recovery.draws is None
    answer, true, carrying, said = compare_angles(recovery, errors.reference, alignment.landmarks, truth.t_s)
    return Validation(
        **figures,
        stated_m={name: _stated_m(recovery, chosen, figures[name]) for name, chosen in parts.items()},
        notes=(
            *_notes(errors, shared),
            *alignment.notes,
            *truth_notes(recovery, truth, aligned=alignment.kind != "none"),
            *said,
            *([_said("no_draws")] if without else ()),
        ),
        points=points,
        gaps=tuple(_gaps(recovery, errors)),
        angles={
            name: {key: agreement(answer[key][chosen], true[key][chosen], degrees=True) for key in answer}
            for name, chosen in (parts if answer else {}).items()
        },
        carrying_truth_deg=carrying,
        point=point,
        lag_s=lags[0],
        lag_occluded_s=lags[1],
        alignment=alignment,
        measures=measures,
    )


def _stated_m(recovery: Recovery, chosen: BoolArray, figures: Figures) -> float | None:
    """Within which 95 of 100 errors of some samples lie as stated; None where they have none."""
    if figures.position_p95_m is None:
        return None
    rows = np.flatnonzero(chosen)
    return pooled_radius(recovery.pose_covariance[rows[:: max(1, len(rows) // _MOST_POOLED)], :3, :3])


#: Two measurements of a motion never agree this well, m; an export rounds its values less.
_SAME_M = 1e-4


def _notes(errors: SampleErrors, shared: Mapping[str, Mapping[str, Figures]]) -> Iterator[str]:
    """What a reader must know of the comparison; `shared` has the figures of each point by part."""
    rms_m = [parts["all"].position_rms_m for parts in shared.values()]
    if (known := [each for each in rms_m if each is not None]) and max(known) < _SAME_M:
        yield _said("same")
    if not errors.scored.any():
        yield _said("joints_only")
    if not np.isfinite(errors.angle_deg).any():
        yield _said("no_orientation")
    found = shared[SENSOR]["all"]
    if found.unanswered:
        yield _said("unanswered", count=found.unanswered, total=found.unanswered + found.samples)


def _gaps(recovery: Recovery, errors: SampleErrors) -> Iterator[tuple[Gap, Figures]]:
    for gap in recovery.gaps:
        inside = (recovery.t_s > gap.start_s) & (recovery.t_s < gap.end_s) & recovery.occluded
        figures = errors.figures(inside)
        if figures.samples or any(value is not None for value in figures.joint_rms_m.values()):
            yield gap, figures


def _nothing_shared(recovery: Recovery, truth: Truth) -> str:
    """Why there is nothing to compare."""
    known = truth.t_s[np.isfinite(truth.position).all(axis=1) & truth.score]
    covers = (
        f"{each[0]:.3f} to {each[-1]:.3f} s" if len(each) else "no time" for each in (known, recovery.t_s)
    )
    return (
        "no sample of the truth falls on one of the result: the truth has {} positions to score in {}, the"
        " result covers {}; check that both use the same clock, and that the truth has a sample every {:g} s"
        " or more often"
    ).format(len(known), *covers, BRIDGED_S)


# --- joint angles

#: Angles by name, (n,) degrees.
Angles = dict[str, FloatArray]


def compare_angles(
    recovery: Recovery,
    reference: Truth,
    landmarks: Mapping[str, FloatArray] | None,  # dict of (m, 3) m
    landmark_t_s: FloatArray,  # (m,) s
) -> tuple[Angles, Angles, float | None, list[str]]:
    """Angles that answer and truth both have, nan where not defined; the carrying angle; notes."""
    score = reference.score[:, None]
    joints = {name: np.where(score, place, np.nan) for name, place in reference.joints.items()}
    if not {"shoulder", "elbow"} <= joints.keys() & recovery.joints.keys():
        return {}, {}, None, []
    at = {name: position_at(landmark_t_s, each, recovery.t_s) for name, each in (landmarks or {}).items()}
    R_K_F, note = _true_forearm(recovery, reference, joints, at)
    about = (recovery.side, recovery.gravity_direction)
    answer, truth = recovery_angles(recovery), arm_angles(joints, len(recovery), R_K_F, *about)
    good_answer, good_truth = defined(answer), defined(truth)
    both = {name: good_answer[name] & good_truth[name] for name in ANGLES}
    mine, other = (
        {name: np.where(both[name], angles[name], np.nan) for name in ANGLES} for angles in (answer, truth)
    )
    shared = [name for name in ANGLES if (np.isfinite(mine[name]) & np.isfinite(other[name])).any()]
    if not shared:
        return {}, {}, None, []
    carrying = None
    if {"medial_epicondyle", "lateral_epicondyle"} <= at.keys():
        axis = at["lateral_epicondyle"] - at["medial_epicondyle"]
        own = arm_angles(joints, len(recovery), None, *about, flexion_axis=axis)["carrying"]
        carrying = float(np.nanmedian(own)) if np.isfinite(own).any() else None
    notes = [_said("angles"), _said("carrying"), note]
    return {k: mine[k] for k in shared}, {k: other[k] for k in shared}, carrying, notes


def _true_forearm(
    recovery: Recovery, reference: Truth, joints: dict[str, FloatArray], at: dict[str, FloatArray]
) -> tuple[FloatArray | None, str]:
    """The truth's `R_K_F` (N, 3, 3), and a note on it."""
    if {"radial_styloid", "ulnar_styloid", "elbow", "wrist"} <= at.keys() | joints.keys():
        y = unit(joints["wrist"] - joints["elbow"])
        thumb = (at["radial_styloid"] - at["ulnar_styloid"]) * (-1.0 if recovery.side == "left" else 1.0)
        x = unit(np.cross(y, thumb))
        axes = np.stack([x, y, np.cross(x, y)], axis=2)
        return axes, _said("styloids")
    mounting = None if recovery.calibration is None else recovery.calibration.R_F_A
    if mounting is None:
        return None, _said("no_mounting")
    return forearm_axes(reference.quaternion, mounting), _said("shared_mounting")
