"""Every method on one recording, compared with one truth: errors, consistency and remaining lag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..errors import RecordingError, UnoccludeError
from ..measurements.visibility import Gap
from ..recording import Recording, Truth
from ..result import Recovery
from ..runtime.pool import Pool, Progress
from ..table import Table, tabulated
from .gaps import Method
from .metrics import lag_s, truth_at
from .reference import ReferenceAlignment
from .truth import truth_notes
from .validate import PARTS, Validation, validated

#: The point that is compared where the truth has it; joints where it has no IMU.
SENSOR = "sensor"
POINTS = (SENSOR, "wrist", "hand", "elbow")


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
    clock_offset_s: float  # `t_imu = t_camera + offset`, estimated by the graph, given to all
    clock_offset_sigma_s: float
    # By joint, lag of the camera's own samples behind the truth, stamps as they came
    camera_lag_s: dict[str, float]
    t_s: FloatArray  # (n,) s: the IMU's times
    gaps: tuple[Gap, ...]  # Of the recording, on the IMU's clock
    truth: Truth  # What all were held against
    alignment: ReferenceAlignment  # How it was brought there
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each

    @property
    def reference(self) -> FloatArray:
        """The truth of the compared point (N, 3) at the IMU's times; nan where there is none."""
        at = truth_at(self.truth, self.t_s)
        position = at.position if self.point == SENSOR else at.joints[self.point]
        return np.where(at.score[:, None], position, np.nan)

    @property
    def part(self) -> str:
        """What the methods are ranked by: "occluded", or "all" in a recording without gaps."""
        return "occluded" if self.gaps else "all"

    @property
    def where(self) -> str:
        """The same in words."""
        return "in gaps" if self.gaps else "over the whole recording, which has no gap"

    @property
    def rms_m(self) -> dict[str, float]:
        """By method the rms of the compared point there; of those that have one."""
        found = {row.method: _rms_m(row, self.point, self.part) for row in self.rows}
        return {name: value for name, value in found.items() if value is not None}

    @property
    def tables(self) -> tuple[Table, Table, Table]:
        """Errors, joints and lag by method."""
        errors, joints, lags = list[dict[str, Any]](), list[dict[str, Any]](), list[dict[str, Any]]()
        for row in self.rows:
            found: dict[str, Any] = {"method": row.method}
            own = row.validation
            shown, seen = (
                None if own is None else own.figures_of(self.point, part) for part in (self.part, "visible")
            )
            if own is not None and shown is not None and seen is not None:
                found |= {"visible_m": seen.position_rms_m, "visible_deg": seen.orientation_rms_deg}
                points = {
                    f"{joint}_m": parts[self.part].position_rms_m for joint, parts in own.points.items()
                }
                joints.append({"method": row.method, **points})
                errors.append(found | vars(shown))
            else:
                errors.append(found)
            lags.append({"method": row.method, "all": own and own.lag_s, "gaps": row.lag_occluded_s})
        names = dict.fromkeys(key for row in joints for key in row if key != "method")
        titled, what = self.alignment.titled, "forearm IMU" if self.point == SENSOR else self.point
        return (
            tabulated(
                titled(f"Error of the {what} {self.where}, the best method first"),
                errors,
                {
                    "method": "method",
                    "rms, cm": "position_rms_m",
                    "95 %": "position_p95_m",
                    "max": "position_max_m",
                    "rms, deg": "orientation_rms_deg",
                    "NEES": "nees",
                    "inside 95 %": "coverage_95",
                    "visible rms, cm": "visible_m",
                    "deg": "visible_deg",
                },
                _ERRORS,
            ),
            tabulated(
                titled(f"Joints {self.where}, rms, cm"),
                joints if names else (),
                {"method": "method", **{name.removesuffix("_m"): name for name in names}},
                _JOINTS,
            ),
            tabulated(
                titled("Lag left behind the truth, ms"),
                lags,
                {
                    "method": "method",
                    "all samples": lambda row: _ms(row["all"]),
                    "in gaps": lambda row: _ms(row["gaps"]),
                },
                _LAG,
            ),
        )

    @property
    def camera_words(self) -> str:
        """The camera's latency as the graph found it, and as the truth sees it, in a sentence."""
        words = (
            f"The camera's stamps are {-1e3 * self.clock_offset_s:+.1f} +-"
            f" {1e3 * self.clock_offset_sigma_s:.1f} ms late, as the graph found without the truth"
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
                "clock_offset_s": self.clock_offset_s,
                "clock_offset_sigma_s": self.clock_offset_sigma_s,
                "latency_s": -self.clock_offset_s,
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
    point = compared_point(validated(graph, truth, alignment)[0], graph)
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
    return Comparison(
        rows=tuple(sorted(rows, key=lambda row: _rank(row, point))),
        point=point,
        clock_offset_s=graph.clock_offset_s,
        clock_offset_sigma_s=graph.clock_offset_sigma_s,
        camera_lag_s=_camera_lag(recording, truth),
        t_s=graph.t_s,
        gaps=graph.gaps,
        truth=truth,
        alignment=alignment,
        notes=tuple(_notes(rows, alignment, graph, truth)),
    )


def compared_point(validation: Validation, recovery: Recovery) -> str:
    """The first of `POINTS` that truth and answer share."""
    for point in POINTS:
        figures = validation.figures_of(point, "all")
        if figures is not None and figures.samples:
            return point
    raise RecordingError(
        f"{recovery.name}: the truth has no position that the methods answer (the IMU's, wrist, hand or"
        " elbow), so there is nothing to compare"
    )


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
        validation, _ = validated(recovery, truth, alignment)
    except UnoccludeError as error:
        return MethodResult(name, None, failure=str(error))
    path = recovery.position if point == SENSOR else recovery.joints[point]
    reference = truth.position if point == SENSOR else truth.joints[point]
    hidden = np.where(recovery.occluded[:, None], path, np.nan)
    known = np.where(truth.score[:, None], reference, np.nan)
    return MethodResult(name, validation, lag_s(recovery.t_s, hidden, known, truth.t_s), path)


def _rms_m(row: MethodResult, point: str, part: str) -> float | None:
    figures = row.validation and row.validation.figures_of(point, part)
    return figures.position_rms_m if figures else None


def _rank(row: MethodResult, point: str) -> tuple[bool, float]:
    """The error in gaps, else over all samples; without an answer last."""
    known = [rms for part in ("occluded", "all") if (rms := _rms_m(row, point, part)) is not None]
    return not known, known[0] if known else 0.0


def _camera_lag(recording: Recording, truth: Truth) -> dict[str, float]:
    """Lag of what the camera tracked, before anything was done about it."""
    lags = {}
    references = {**truth.joints, "strap": truth.position}
    for joint in recording.arm.present:
        if joint not in references or joint == "shoulder":
            continue
        tracked = np.where(recording.arm.tracked(joint)[:, None], recording.arm.joint(joint), np.nan)
        lag = lag_s(recording.arm.t_s, tracked, references[joint], truth.t_s)
        if lag is not None:
            lags[joint] = lag
    return lags


def _notes(
    rows: list[MethodResult], alignment: ReferenceAlignment, graph: Recovery, truth: Truth
) -> list[str]:
    notes = [*alignment.notes, *truth_notes(graph, truth, aligned=alignment.kind != "none")]
    if alignment.kind != "none":
        notes.append("The truth was aligned by the graph's answer, once for all methods.")
        notes.append("A lag is against the truth's clock as it was aligned.")
    for row in rows:
        if row.validation is None:
            notes.append(f"{row.method} could not recover it: {row.failure}")
        elif row.validation.all.unanswered:
            count = row.validation.all.unanswered
            notes.append(f"{row.method} left {count} samples with truth without a result; they are excluded.")
    if not graph.occluded.any():
        notes.append("The recording has no gap: methods are compared where the camera sees the arm.")
    return list(dict.fromkeys(notes))
