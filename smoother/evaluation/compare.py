"""Every method on one recording, each validated against one truth."""

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
from .reference import ReferenceAlignment, truth_notes
from .validate import PARTS, SENSOR, Validation, validate


@dataclass(frozen=True)
class Comparison:
    """All methods on one recording."""

    # By method, the best first (by the rms of the compared point in gaps, else over all samples), those
    # without an answer last: its figures, or why there are none
    methods: dict[str, Validation | str]
    point: str  # What is compared: "sensor" (the forearm IMU), or a joint where the truth has no IMU
    graph: Recovery  # Its clock, its times and its gaps were given to all
    camera_lag_s: dict[str, float]  # By joint: the camera's own samples behind the truth, stamps as they came
    truth: Truth  # What all were held against
    alignment: ReferenceAlignment  # How it was brought there
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each

    @property
    def validated(self) -> dict[str, Validation]:
        """The methods that have an answer."""
        return {name: each for name, each in self.methods.items() if isinstance(each, Validation)}

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
        found = {name: _rms_m(each, self.point, self.part) for name, each in self.validated.items()}
        return {name: value for name, value in found.items() if value is not None}

    @property
    def tables(self) -> tuple[Table, Table, Table]:
        """Errors, joints and lag by method."""
        rows: list[dict[str, Any]] = []
        for name, each in self.methods.items():
            row: dict[str, Any] = {"method": name}
            if isinstance(each, Validation) and (found := each.figures_of(self.point, self.part)) is not None:
                seen = each.figures_of(self.point, "visible")
                row |= {"visible_m": seen and seen.position_rms_m, "deg": seen and seen.orientation_rms_deg}
                row |= {"lag_s": each.lag_s, "gap_lag_s": each.lag_occluded_s, **vars(found)}
                row |= {f"{joint}_m": parts[self.part].position_rms_m for joint, parts in each.points.items()}
            rows.append(row)
        joints = dict.fromkeys(joint for each in self.validated.values() for joint in each.points)
        answered = [row for row in rows if len(row) > 1 and joints]
        columns = {"method": "method", "rms, cm": "position_rms_m", "95 %": "position_p95_m"}
        columns |= {"max": "position_max_m", "rms, deg": "orientation_rms_deg", "NEES": "nees"}
        columns |= {"inside 95 %": "coverage_95", "visible rms, cm": "visible_m", "deg": "deg"}
        by_joint = {"method": "method", **{joint: f"{joint}_m" for joint in joints}}
        of_lag = {"all samples": lambda row: _ms(row, "lag_s"), "in gaps": lambda row: _ms(row, "gap_lag_s")}
        titled, what = self.alignment.titled, "forearm IMU" if self.point == SENSOR else self.point
        title = titled(f"Error of the {what} {self.where}, the best method first")
        return (
            tabulated(title, rows, columns),
            tabulated(titled(f"Joints {self.where}, rms, cm"), answered, by_joint),
            tabulated(titled("Lag left behind the truth, ms"), rows, {"method": "method", **of_lag}),
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

        def plain(each: Validation | str) -> dict[str, Any]:
            if isinstance(each, str):
                return {"failure": each}
            whole = each.to_dict()
            own = {"failure": "", "lag_s": each.lag_s, "lag_occluded_s": each.lag_occluded_s}
            return own | {key: whole[key] for key in (*PARTS, "points", "gaps")}

        return {
            "point": self.point,
            "order": list(self.methods),
            "methods": {name: plain(each) for name, each in self.methods.items()},
            "camera": {
                "clock_offset_s": self.graph.clock_offset_s,
                "clock_offset_sigma_s": self.graph.clock_offset_sigma_s,
                "latency_s": -self.graph.clock_offset_s,
                "lag_before_s": self.camera_lag_s,
            },
            **self.alignment.to_dict(),
            "notes": list(self.notes),
        }


def _ms(row: Mapping[str, Any], key: str) -> str | None:
    return None if row.get(key) is None else f"{1e3 * row[key]:+.1f}"


def _rms_m(found: Validation | str, point: str, part: str) -> float | None:
    """Rms of a point's errors over a part; None where there is none."""
    figures = found.figures_of(point, part) if isinstance(found, Validation) else None
    return None if figures is None else figures.position_rms_m


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
    job = partial(_validated, methods=methods, recording=recording, truth=truth, alignment=alignment)
    found: dict[str, Validation | str] = {}
    with Pool(min(processes, len(methods)), len(methods) * len(recording.arm)) as workers:
        answers = workers.map(job, methods)
        for place, name in enumerate(methods):
            report(place / len(methods), name)
            found[name] = next(answers)
    report(1.0, "done")

    def rank(name: str) -> tuple[bool, float]:
        """The error in gaps, else over all samples; without an answer last."""
        both = (_rms_m(found[name], point, part) for part in ("occluded", "all"))
        known = [rms_m for rms_m in both if rms_m is not None]
        return not known, known[0] if known else 0.0

    lags, notes = _camera_lag(recording, truth), _notes(found, alignment, graph, truth)
    ranked = {name: found[name] for name in sorted(found, key=rank)}
    return Comparison(ranked, point, graph, lags, truth, alignment, notes)


def _validated(
    name: str,
    methods: Mapping[str, Method],
    recording: Recording,
    truth: Truth,
    alignment: ReferenceAlignment,
) -> Validation | str:
    """What a method's answer is worth, or why it has none."""
    try:
        return validate(methods[name](recording), truth, alignment, pooled=None)
    except UnoccludeError as error:
        return str(error)


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
    found: Mapping[str, Validation | str], alignment: ReferenceAlignment, graph: Recovery, truth: Truth
) -> tuple[str, ...]:
    notes = [*alignment.notes, *truth_notes(graph, truth, aligned=alignment.kind != "none")]
    if alignment.kind != "none":
        notes.append("The truth was aligned by the graph's answer, once for all methods.")
        notes.append("A lag is against the truth's clock as it was aligned.")
    for name, each in found.items():
        if isinstance(each, str):
            notes.append(f"{name} could not recover it: {each}")
        elif count := each.all.unanswered:
            notes.append(f"{name} left {count} samples with truth without a result; they are excluded.")
    if not graph.occluded.any():
        notes.append("The recording has no gap: methods are compared where the camera sees the arm.")
    return tuple(dict.fromkeys(notes))
