"""Every method on one recording, compared with one truth: errors, consistency and remaining lag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..errors import RecordingError, UnoccludeError
from ..recording import Recording, Truth
from ..result import Recovery
from ..runtime.pool import Pool, Progress
from ..table import Table, tabulated
from .gaps import Method
from .metrics import lag_s, truth_at
from .reference import ReferenceAlignment
from .truth import truth_notes
from .validate import PARTS, SENSOR, Validation, point_lag_s, validate

_ERRORS = (
    "All methods are given the same calibration, clock and camera samples; only the gap itself is"
    " recovered differently. rms: root mean square. NEES: mean squared error in stated standard"
    " deviations; 1 is consistent, above 1 over-confident, below 1 under-confident; a dash where a method"
    " states none. Inside 95 %: 0.95 is consistent."
)
_JOINTS = (
    "Methods that estimate only the sensor's motion place the joints by the lever arms; the shoulder is"
    " the camera's, interpolated where it was lost."
)
_LAG = (
    "Delay of each result: the shift with the highest cross-correlation with the truth. Below about 5 ms"
    " the camera's latency is corrected. A lag in gaps only is the method's own; a dash: the result does"
    " not follow the truth."
)


@dataclass(frozen=True)
class MethodResult:
    """What one method made of the recording."""

    method: str
    validation: Validation | None  # Its figures, with its lag over all samples; None where it failed
    lag_occluded_s: float | None = None  # Lag of its answer behind the truth over the samples in gaps
    path: FloatArray | None = None  # (n, 3) m: the compared point at the IMU's times, in {K}
    failure: str = ""  # Why there is no answer, "" where there is one

    def rms_m(self, point: str, part: str) -> float | None:
        """Rms of a point's errors over a part; None where there is none."""
        figures = self.validation and self.validation.figures_of(point, part)
        return figures.position_rms_m if figures else None

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name."""
        if self.validation is None:
            return {"failure": self.failure}
        whole = self.validation.to_dict()
        own = {"failure": "", "lag_s": whole["lag_s"], "lag_occluded_s": self.lag_occluded_s}
        return own | {key: whole[key] for key in (*PARTS, "points", "gaps")}


@dataclass(frozen=True)
class Comparison:
    """All methods on one recording."""

    # The methods, the best first (by the rms of the compared point in gaps, else over all samples)
    rows: tuple[MethodResult, ...]
    point: str  # What is compared: "sensor" (the forearm IMU), or a joint where the truth has no IMU
    graph: Recovery  # Its clock, its times and its gaps were given to all
    camera_lag_s: dict[
        str, float
    ]  # By joint, of the camera's own samples behind the truth, stamps as they came
    truth: Truth  # What all were held against
    alignment: ReferenceAlignment  # How it was brought there
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each

    @property
    def reference(self) -> FloatArray:
        """The truth of the compared point (N, 3) at the IMU's times; nan where there is none."""
        at = truth_at(self.truth, self.graph.t_s)
        position = at.position if self.point == SENSOR else at.joints[self.point]
        return np.where(at.score[:, None], position, np.nan)

    @property
    def part(self) -> str:
        """What the methods are ranked by: "occluded", or "all" in a recording without gaps."""
        return "occluded" if self.graph.gaps else "all"

    @property
    def where(self) -> str:
        """The same in words."""
        return "in gaps" if self.graph.gaps else "over the whole recording, which has no gap"

    @property
    def rms_m(self) -> dict[str, float]:
        """By method the rms of the compared point there; of those that have one."""
        found = {row.method: row.rms_m(self.point, self.part) for row in self.rows}
        return {name: value for name, value in found.items() if value is not None}

    @property
    def tables(self) -> tuple[Table, Table, Table]:
        """Errors, joints and lag by method."""
        errors, joints, lags = list[dict[str, Any]](), list[dict[str, Any]](), list[dict[str, Any]]()
        for row in self.rows:
            about: dict[str, Any] = {"method": row.method}
            lags.append(about | {"gaps": row.lag_occluded_s, "all": row.validation and row.validation.lag_s})
            found = row.validation and row.validation.figures_of(self.point, self.part)
            if row.validation is None or found is None:
                errors.append(about)
                continue
            seen = row.validation.figures_of(self.point, "visible")
            visible = {"visible_m": seen and seen.position_rms_m}
            errors.append(about | vars(found) | visible | {"deg": seen and seen.orientation_rms_deg})
            points = row.validation.points.items()
            joints.append(about | {f"{name}_m": parts[self.part].position_rms_m for name, parts in points})
        names = dict.fromkeys(key for row in joints for key in row if key != "method")
        columns = {"method": "method", "rms, cm": "position_rms_m", "95 %": "position_p95_m"}
        columns |= {"max": "position_max_m", "rms, deg": "orientation_rms_deg", "NEES": "nees"}
        columns |= {"inside 95 %": "coverage_95", "visible rms, cm": "visible_m", "deg": "deg"}
        titled, what = self.alignment.titled, "forearm IMU" if self.point == SENSOR else self.point
        by_joint = {"method": "method", **{name.removesuffix("_m"): name for name in names}}
        of_lag = {"all samples": lambda row: _ms(row["all"]), "in gaps": lambda row: _ms(row["gaps"])}
        title = titled(f"Error of the {what} {self.where}, the best method first")
        return (
            tabulated(title, errors, columns, _ERRORS),
            tabulated(titled(f"Joints {self.where}, rms, cm"), joints if names else (), by_joint, _JOINTS),
            tabulated(titled("Lag left behind the truth, ms"), lags, {"method": "method", **of_lag}, _LAG),
        )

    @property
    def camera_words(self) -> str:
        """The camera's latency as the graph found it, and as the truth sees it, in a sentence."""
        words = (
            f"The camera's stamps are {-1e3 * self.graph.clock_offset_s:+.1f} +-"
            f" {1e3 * self.graph.clock_offset_sigma_s:.1f} ms late, as the graph found without the truth"
        )
        lags = ", ".join(f"{joint} {1e3 * lag:+.1f}" for joint, lag in self.camera_lag_s.items())
        return f"{words}; its samples lag behind the truth, ms: {lags}" if lags else words

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them."""
        return {
            "point": self.point,
            "order": [row.method for row in self.rows],
            "methods": {row.method: row.to_dict() for row in self.rows},
            "camera": {
                "clock_offset_s": self.graph.clock_offset_s,
                "clock_offset_sigma_s": self.graph.clock_offset_sigma_s,
                "latency_s": -self.graph.clock_offset_s,
                "lag_before_s": self.camera_lag_s,
            },
            **self.alignment.to_dict(),
            "notes": list(self.notes),
        }


def _ms(value_s: float | None) -> str | None:
    return None if value_s is None else f"{1e3 * value_s:+.1f}"


def compare(
    recording: Recording,
    graph: Recovery,
    truth: Truth,
    methods: Mapping[str, Method],
    alignment: ReferenceAlignment | None = None,
    progress: Progress | None = None,
    processes: int = 1,
) -> Comparison:
    """Run every method on one recording and hold each answer against the same truth."""
    alignment = alignment or ReferenceAlignment()
    point = validate(graph, truth, alignment, pooled=None).point
    if not point:
        raise RecordingError(
            f"{graph.name}: the truth has no position that the methods answer (the IMU's, wrist, hand or"
            " elbow), so there is nothing to compare"
        )
    report = progress or (lambda part, text: None)
    job = partial(
        _result, methods=methods, recording=recording, truth=truth, alignment=alignment, point=point
    )
    rows: list[MethodResult] = []
    with Pool(min(processes, len(methods)), len(methods) * len(recording.arm)) as workers:
        answers = workers.map(job, methods)
        for place, name in enumerate(methods):
            report(place / len(methods), name)
            rows.append(next(answers))
    report(1.0, "done")

    def rank(row: MethodResult) -> tuple[bool, float]:
        """The error in gaps, else over all samples; without an answer last."""
        known = [rms for part in ("occluded", "all") if (rms := row.rms_m(point, part)) is not None]
        return not known, known[0] if known else 0.0

    lags, notes = _camera_lag(recording, truth), _notes(rows, alignment, graph, truth)
    return Comparison(tuple(sorted(rows, key=rank)), point, graph, lags, truth, alignment, notes)


def _result(
    name: str,
    methods: Mapping[str, Method],
    recording: Recording,
    truth: Truth,
    alignment: ReferenceAlignment,
    point: str,
) -> MethodResult:
    try:
        recovery = methods[name](recording)
        validation = validate(recovery, truth, alignment, pooled=None)
    except UnoccludeError as error:
        return MethodResult(name, None, failure=str(error))
    path = recovery.position if point == SENSOR else recovery.joints[point]
    return MethodResult(name, validation, point_lag_s(recovery, truth, point, recovery.occluded), path)


def _camera_lag(recording: Recording, truth: Truth) -> dict[str, float]:
    """Lag of what the camera tracked, before anything was done about it."""
    arm, references = recording.arm, {**truth.joints, "strap": truth.position}
    lags = {
        joint: lag_s(
            arm.t_s,
            np.where(arm.tracked(joint)[:, None], arm.joint(joint), np.nan),
            references[joint],
            truth.t_s,
        )
        for joint in arm.present
        if joint in references and joint != "shoulder"
    }
    return {joint: lag for joint, lag in lags.items() if lag is not None}


def _notes(
    rows: list[MethodResult], alignment: ReferenceAlignment, graph: Recovery, truth: Truth
) -> tuple[str, ...]:
    notes = [*alignment.notes, *truth_notes(graph, truth, aligned=alignment.kind != "none")]
    if alignment.kind != "none":
        notes.append("The truth was aligned by the graph's answer, once for all methods.")
        notes.append("A lag is against the truth's clock as it was aligned.")
    for row in rows:
        if row.validation is None:
            notes.append(f"{row.method} could not recover it: {row.failure}")
        elif count := row.validation.all.unanswered:
            notes.append(f"{row.method} left {count} samples with truth without a result; they are excluded.")
    if not graph.occluded.any():
        notes.append("The recording has no gap: methods are compared where the camera sees the arm.")
    return tuple(dict.fromkeys(notes))
