"""Every method on one recording, held against one truth: errors, consistency, and the lag that is left.

The live smoother as methods: a recording played into it on a simulated clock, the answers a recovery.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..config import Config
from ..errors import RecordingError, UnoccludeError
from ..linalg import interpolate
from ..live.answers import LiveEstimate
from ..live.buffers import ImuBatch, SkeletonFrame
from ..measurements.visibility import Gap
from ..measures.motion import one_sign
from ..recording import Recording, Truth
from ..result import Recovery
from ..runtime.pool import Pool, Progress
from ..table import Table, centimetres, percent
from .gaps import Method
from .metrics import Figures, lag_s, truth_at
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
    validation: Validation | None  # Its figures, or None where it failed
    lag_s: float | None = None  # Lag of its answer behind the truth over all samples
    lag_occluded_s: float | None = None  # The same over the samples in gaps
    path: FloatArray | None = None  # (n, 3) m: the compared point at the IMU's times, in {K}
    failure: str = ""  # Why there is no answer, "" where there is one


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

    def figures(self, row: MethodResult, part: str) -> Figures | None:
        """Figures of the compared point over a part ("all", "occluded" or "visible")."""
        return None if row.validation is None else row.validation.figures_of(self.point, part)

    def title(self, text: str) -> str:
        """The title of one of its results: states where the truth was aligned."""
        return self.alignment.titled(text)

    @property
    def tables(self) -> tuple[Table, Table, Table]:
        """Errors, joints and lag by method."""
        errors: list[tuple[object, ...]] = []
        joints: list[tuple[object, ...]] = []
        answered = [row.validation.points for row in self.rows if row.validation is not None]
        names = list(dict.fromkeys(joint for points in answered for joint in points))
        for row in self.rows:
            hidden, visible = self.figures(row, self.part), self.figures(row, "visible")
            if row.validation is None or hidden is None or visible is None:
                errors.append((row.method, *[None] * 8))
                continue
            lengths = (hidden.position_rms_m, hidden.position_p95_m, hidden.position_max_m)
            consistency = (hidden.orientation_rms_deg, hidden.nees, percent(hidden.coverage_95))
            seen = (centimetres(visible.position_rms_m), visible.orientation_rms_deg)
            errors.append((row.method, *map(centimetres, lengths), *consistency, *seen))
            found = [row.validation.points.get(joint, {}).get(self.part) for joint in names]
            joints.append((row.method, *(each and centimetres(each.position_rms_m) for each in found)))
        lags = [(row.method, _ms(row.lag_s), _ms(row.lag_occluded_s)) for row in self.rows]
        columns = ("method", "rms, cm", "95 %", "max", "rms, deg", "NEES", "inside 95 %", "visible rms, cm")
        what = "forearm IMU" if self.point == SENSOR else self.point
        best = self.title(f"Error of the {what} {self.where}, the best method first")
        rms, lag = f"Joints {self.where}, rms, cm", "Lag left behind the truth, ms"
        return (
            Table(best, (*columns, "deg"), errors, _ERRORS),
            Table(self.title(rms), ("method", *names), joints if names else (), _JOINTS),
            Table(self.title(lag), ("method", "all samples", "in gaps"), lags, _LAG),
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
        if row.validation is None:
            return {"failure": row.failure}
        whole = row.validation.to_dict()
        own = {"failure": row.failure, "lag_s": row.lag_s, "lag_occluded_s": row.lag_occluded_s}
        return own | {key: whole[key] for key in (*PARTS, "points", "gaps")}


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
    reference = np.where(truth.score[:, None], reference, np.nan)
    lag, lag_occluded = (
        lag_s(recovery.t_s, samples, reference, truth.t_s)
        for samples in (path, np.where(recovery.occluded[:, None], path, np.nan))
    )
    return MethodResult(name, validation, lag, lag_occluded, path)


def _rank(row: MethodResult, point: str) -> tuple[bool, float]:
    """The error in gaps, else over all samples; without an answer last."""
    for part in ("occluded", "all"):
        figures = row.validation and row.validation.figures_of(point, part)
        if figures and figures.position_rms_m is not None:
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
            notes.append(f"{row.method} left {count} samples with truth without a result; they are excluded.")
    if not graph.occluded.any():
        notes.append("The recording has no gap: methods are compared where the camera sees the arm.")
    return list(dict.fromkeys(notes))


#: Answers are asked for at this rate, Hz, and interpolated to the IMU's times.
RATE_HZ = 30.0
#: A self-calibration in the background takes this many steps until its answer is there.
STEPS_OF_CALIBRATION = 15
#: Between answers farther apart than this there is none, s.
APART_S = 0.2


#: By kind ("now" or "settled"), every answer of the live smoother.
LiveAnswers = dict[str, list[LiveEstimate]]


def play(
    recording: Recording,
    graph: Method,
    calibration: ArmCalibration | None,
    config: Config,
    latency_s: float = 0.1,
    lag_s: float = 0.2,
) -> LiveAnswers:
    """What the live smoother answers to a recording that arrives step by step."""
    from ..live.calibrations import InlineCalibrator
    from ..live.smoother import LiveSmoother

    answers: LiveAnswers = {"now": [], "settled": []}
    calibrator = InlineCalibrator(STEPS_OF_CALIBRATION)
    given = (recording.gravity_hint, recording.camera_frame, calibrator)
    with LiveSmoother(recording.side, calibration, config, lag_s, *given) as live:
        for now_s, imu, frames in arrivals(recording, graph(recording).clock_offset_s, latency_s):
            for batch in imu:
                live.add_imu(batch)
            for frame in frames:
                live.add_frame(frame)
            output = live.step(now_s)
            for kind, own in answers.items():
                if (estimate := getattr(output, kind)) is not None:
                    own.append(estimate)
    return answers


def arrivals(
    recording: Recording, offset_s: float, latency_s: float
) -> Iterator[tuple[float, list[ImuBatch], list[SkeletonFrame]]]:
    """Step by step what has arrived since the last one: the time, IMU batches, frames."""
    imu, arm = recording.imu, recording.arm
    arrival_s = np.asarray(arm.t_s) + offset_s + latency_s
    first = frame = 0
    for now_s in np.arange(float(imu.t_s[0]), float(imu.t_s[-1]), 1.0 / RATE_HZ).tolist():
        last = int(np.searchsorted(imu.t_s, now_s, side="right"))
        rows = slice(first, last)
        batch = ImuBatch(np.array(imu.t_s[rows]), np.array(imu.acc[rows]), np.array(imu.gyro[rows]))
        until = int(np.searchsorted(arrival_s, now_s, side="right"))
        frames = [
            SkeletonFrame(float(arm.t_s[k]), float(arrival_s[k]), np.array(arm.position[k]), arm.state[k])
            for k in range(frame, until)
        ]
        yield now_s, [batch] if last > first else [], frames
        first, frame = last, until


def by_live(
    kind: str, played: Callable[[Recording], LiveAnswers], graph: Method, recording: Recording
) -> Recovery:
    """The live answers at the times of the graph's recovery; nan before the first."""
    solved, answers = graph(recording), played(recording)[kind]
    if len(answers) < 2:
        raise UnoccludeError(
            f"{solved.name}: too short for live-{kind}, which calibrates itself on the first seconds"
        )
    by_time = {answer.t_s: answer for answer in answers}
    t = np.array(sorted(by_time))
    answers = [by_time[t_s] for t_s in t.tolist()]
    right = np.clip(np.searchsorted(t, solved.t_s), 1, len(t) - 1)
    unknown = (solved.t_s < t[0]) | (solved.t_s > t[-1]) | (t[right] - t[right - 1] > APART_S)

    def column(values: list[FloatArray]) -> FloatArray:
        at = interpolate(t, np.array(values), solved.t_s)
        at[unknown] = np.nan
        return at

    quaternion = column(list(one_sign(np.array([answer.quaternion for answer in answers]))))
    no_place, no_spread = np.full(3, np.nan), np.full((3, 3), np.nan)
    return replace(
        solved,
        method=f"live-{kind}",
        position=column([answer.position for answer in answers]),
        quaternion=quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        velocity=column([answer.velocity for answer in answers]),
        pose_covariance=column([answer.pose_covariance for answer in answers]),
        velocity_covariance=np.full((len(solved), 3, 3), np.nan),
        joints={
            joint: column([answer.joints.get(joint, no_place) for answer in answers])
            for joint in solved.joints
        },
        joint_covariance={
            joint: column([answer.joint_covariance.get(joint, no_spread) for answer in answers])
            for joint in solved.joints
        },
    )
