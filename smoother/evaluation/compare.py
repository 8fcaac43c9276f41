"""Every method on one recording, each validated against one truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..errors import RecordingError, UnoccludeError
from ..recording import Recording, Truth
from ..result import Recovery
from ..runtime.pool import Pool, Progress
from ..table import Table, fixed, tabulated
from .gaps import Method
from .metrics import lag_s
from .reference import ReferenceAlignment, truth_notes
from .validate import PARTS, SENSOR, Validation, validate


@dataclass(frozen=True)
class Comparison:
    """All methods on one recording."""

    # By method, the best first (by the rms of the compared point in gaps, else over all samples), those
    # without an answer last: its figures, or why there are none
    methods: dict[str, Validation | str]
    graph: Recovery  # Its clock, its times and its gaps were given to all
    of_graph: Validation  # What it is worth; its point is what is compared of all
    camera_lag_s: dict[str, float]  # By joint: the camera's own samples behind the truth, stamps as they came
    truth: Truth  # What all were held against
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each

    @property
    def point(self) -> str:
        """What is compared: "sensor" (the forearm IMU), or a joint where the truth has no IMU."""
        return self.of_graph.point

    @property
    def table(self) -> Table:
        """The errors in gaps (else over the whole recording), and the lag left, by method."""
        part, where = "occluded", "in gaps"
        if not self.graph.gaps:
            part, where = "all", "over the whole recording, which has no gap"
        rows: list[dict[str, Any]] = []
        for name, each in self.methods.items():
            row: dict[str, Any] = {"method": name}
            if isinstance(each, Validation) and (found := each.figures_of(self.point, part)) is not None:
                seen = each.figures_of(self.point, "visible")
                row |= vars(found) | {"visible_m": seen and seen.position_rms_m, "lag_s": each.lag_s}
                row |= {f"{joint}_m": parts[part].position_rms_m for joint, parts in each.points.items()}
            rows.append(row)
        # the shoulder of all methods but the graph is the camera's
        joints = [joint for joint in self.of_graph.points if joint not in (self.point, "shoulder")]
        columns: dict[str, str | Callable[[Any], object]] = {"method": "method", "rms, cm": "position_rms_m"}
        columns |= {"95 %": "position_p95_m", "max": "position_max_m", "rms, deg": "orientation_rms_deg"}
        columns |= {"NEES": "nees", "inside 95 %": "coverage_95", "visible": "visible_m"}
        columns |= {joint: f"{joint}_m" for joint in joints}
        columns["lag, ms"] = lambda row: fixed(row.get("lag_s") and 1e3 * row["lag_s"], 1)
        what = "forearm IMU" if self.point == SENSOR else self.point
        title = f"Error of the {what} {where}, the best method first"
        return tabulated(self.of_graph.alignment.titled(title), rows, columns)

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
            whole, keys = each.to_dict(), (*PARTS, "points", "gaps", "lag_s", "lag_occluded_s")
            return {"failure": ""} | {key: whole[key] for key in keys}

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
            **self.of_graph.alignment.to_dict(),
            "notes": list(self.notes),
        }


def _rms_m(found: Validation | str, point: str) -> float:
    """By what methods are ranked: the rms in gaps, else over all samples; infinite without an answer."""
    for part in ("occluded", "all"):
        figures = found.figures_of(point, part) if isinstance(found, Validation) else None
        if figures is not None and figures.position_rms_m is not None:
            return figures.position_rms_m
    return math.inf


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
    of_graph = validate(graph, truth, alignment, with_measures=False)
    if not of_graph.point:
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

    ranked = dict(sorted(found.items(), key=lambda each: _rms_m(each[1], of_graph.point)))
    lags, notes = _camera_lag(recording, truth), _notes(found, alignment, graph, truth)
    of_graph = replace(of_graph, notes=tuple(dict.fromkeys([*of_graph.notes, *notes])))
    return Comparison(ranked, graph, of_graph, lags, truth, notes)


def _validated(
    name: str,
    methods: Mapping[str, Method],
    recording: Recording,
    truth: Truth,
    alignment: ReferenceAlignment,
) -> Validation | str:
    """What a method's answer is worth, or why it has none."""
    try:
        return validate(methods[name](recording), truth, alignment, with_measures=False)
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
