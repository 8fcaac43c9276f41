"""Every method on one recording, held against one truth: errors, consistency, and the lag that is left."""

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
from ..runtime.pool import Pool
from .align import lag_s, truth_at
from .gaps import Method, Progress
from .metrics import Figures
from .reference import ReferenceAlignment
from .truth import truth_notes
from .validate import Validation, validate

#: The point that is compared where the truth has it; joints where it has no IMU.
SENSOR = "sensor"
POINTS = (SENSOR, "wrist", "hand", "elbow")
PARTS = ("all", "occluded", "visible")


@dataclass(frozen=True)
class MethodResult:
    """What one method made of the recording.

    Attributes
    ----------
    method : str
        Its name.
    validation : Validation or None
        Its figures, or None where it failed.
    lag_s : float, s, or None
        Lag of its answer behind the truth over all samples; None where there is none.
    lag_occluded_s : float, s, or None
        The same over the samples in gaps.
    path : ndarray, shape (n, 3), m, or None
        The compared point at the IMU's times, in {K}; nan where there is no answer.
    failure : str
        Why there is no answer, "" where there is one.
    """

    method: str
    validation: Validation | None
    lag_s: float | None = None
    lag_occluded_s: float | None = None
    path: FloatArray | None = None
    failure: str = ""


@dataclass(frozen=True)
class Comparison:
    """All methods on one recording.

    Attributes
    ----------
    rows : tuple of MethodResult
        The methods, the best first (by the rms of the compared point in gaps, else over all samples); those
        without an answer last.
    point : str
        What is compared: "sensor" (the forearm IMU), or a joint where the truth has no IMU.
    clock_offset_s, clock_offset_sigma_s : float, s
        `t_imu = t_camera + offset`, estimated by the graph, given to all.
    camera_lag_s : dict[str, float], s
        By joint, lag of the camera's own samples behind the truth, stamps as they came.
    t_s : ndarray, shape (n,), s
        The IMU's times.
    gaps : tuple of Gap
        Of the recording, on the IMU's clock.
    truth : Truth
        What all were held against.
    alignment : ReferenceAlignment
        How it was brought there.
    notes : tuple of str
        What a reader must know, one sentence each.
    """

    rows: tuple[MethodResult, ...]
    point: str
    clock_offset_s: float
    clock_offset_sigma_s: float
    camera_lag_s: dict[str, float]
    t_s: FloatArray
    gaps: tuple[Gap, ...]
    truth: Truth
    alignment: ReferenceAlignment
    notes: tuple[str, ...] = ()

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

    def figures(self, row: MethodResult, part: str) -> Figures | None:
        """Figures of the compared point over a part ("all", "occluded" or "visible")."""
        return None if row.validation is None else figures_of(row.validation, self.point, part)

    def title(self, text: str) -> str:
        """The title of one of its results: says where the truth was aligned."""
        return f"{text} ({self.alignment.title})" if self.alignment.title else text

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
            "methods": {row.method: self._method(row) for row in self.rows},
            "camera": {
                "clock_offset_s": self.clock_offset_s,
                "clock_offset_sigma_s": self.clock_offset_sigma_s,
                "latency_s": -self.clock_offset_s,
                "lag_before_s": self.camera_lag_s,
            },
            **self.alignment.to_dict(),
            "notes": list(self.notes),
        }

    def _method(self, row: MethodResult) -> dict[str, Any]:
        plain: dict[str, Any] = {"failure": row.failure}
        if row.validation is not None:
            whole = row.validation.to_dict()
            plain |= {key: whole[key] for key in (*PARTS, "points", "gaps")}
            plain |= {"lag_s": row.lag_s, "lag_occluded_s": row.lag_occluded_s}
        return plain


def compare(
    recording: Recording,
    graph: Recovery,
    truth: Truth,
    methods: Mapping[str, Method],
    alignment: ReferenceAlignment | None = None,
    progress: Progress | None = None,
    processes: int = 1,
) -> Comparison:
    """Run every method on one recording and hold each answer against the same truth.

    Parameters
    ----------
    recording : Recording
        What the methods are given; it should hold no truth.
    graph : Recovery
        The graph's recovery of this very recording, which also gave the clock.
    truth : Truth
        In the camera frame and on the IMU's clock.
    methods : dict[str, Method]
        By name, a function from a recording to its recovery.
    alignment : ReferenceAlignment, optional
        How the truth was brought there; None where it came so.
    progress : Progress, optional
        Called with (part done, what is being done).
    processes : int
        Methods that run side by side, each in a process; 0 for one a core. With more than one they must be
        such as can be sent to another process (no local functions).

    Raises
    ------
    RecordingError
        Truth and recording do not overlap.
    """
    alignment = alignment or ReferenceAlignment()
    point = compared_point(validate(graph, truth, alignment), graph)
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
    """The first of `POINTS` that truth and answer share.

    Raises
    ------
    RecordingError
        They share none.
    """
    for point in POINTS:
        figures = figures_of(validation, point, "all")
        if figures is not None and figures.samples:
            return point
    raise RecordingError(
        f"{recovery.name}: the truth holds no position that the methods answer (the IMU's, wrist, hand or"
        " elbow), so there is nothing to compare"
    )


def figures_of(validation: Validation, point: str, part: str) -> Figures | None:
    """Figures of a point over a part, the IMU's orientation with the IMU; None where there are none."""
    if point == SENSOR:
        figures: Figures = getattr(validation, part)
        return figures
    return validation.points.get(point, {}).get(part)


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
        validation = validate(recovery, truth, alignment)
    except UnoccludeError as error:
        return MethodResult(name, None, failure=str(error))
    path = recovery.position if point == SENSOR else recovery.joints[point]
    reference = truth.position if point == SENSOR else truth.joints[point]
    reference = np.where(truth.score[:, None], reference, np.nan)
    hidden = np.where(recovery.occluded[:, None], path, np.nan)
    return MethodResult(
        name,
        validation,
        lag_s=lag_s(recovery.t_s, path, reference, truth.t_s),
        lag_occluded_s=lag_s(recovery.t_s, hidden, reference, truth.t_s),
        path=path,
    )


def _rank(row: MethodResult, point: str) -> tuple[bool, float]:
    """The error in gaps, else over all samples; without an answer last."""
    if row.validation is None:
        return True, 0.0
    for part in ("occluded", "all"):
        figures = figures_of(row.validation, point, part)
        if figures is not None and figures.position_rms_m is not None:
            return False, figures.position_rms_m
    return True, 0.0


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
            notes.append(f"{row.method} left {count} samples with truth unanswered; they are in no figure.")
    if not graph.occluded.any():
        notes.append("The recording has no gap: methods are compared where the camera sees the arm.")
    return list(dict.fromkeys(notes))
