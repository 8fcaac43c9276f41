"""What is done with a section, twice: alone, for what all sections share; then told what the others found.

Both run in worker processes. What the second pass needs of the first is kept in between.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..calibration import ArmCalibration
from ..config import Config
from ..graph.solve import solve
from ..measurements.alignment import Alignment
from ..measurements.clock import Clock
from ..measurements.outliers import reject_by_camera, reject_by_residual
from ..measurements.segment import Segment
from ..recording import FloatArray
from ..selfcal.clock_fit import ClockScore, clock_score
from ..selfcal.rounds import SelfCalibration, reject_by_direction, with_initial_values
from ..units import GRAVITY
from ..window.cut import PreparedSegment, cut, cut_times, window_nodes
from ..window.prepare import prepare
from ..window.problem import FieldMeasurements, Message, NoiseModel, Priors, Window
from ..window.trajectory import Trajectory, merge_windows
from .magnetometer import FieldMean, FieldObservation, field_means, observe
from .samples import SectionAnswer, frame_residuals, sample_section
from .sections import SectionData

#: The first pass is a start for the second, which ends within 0.02 sigma (0.15 mm) of where it would with a
#: ten times smaller tolerance.
FIRST_TOLERANCE, SECOND_TOLERANCE = 1e-2, 1e-3


@dataclass(frozen=True)
class Task:
    """What holds for all sections.

    Attributes
    ----------
    known : from the self-calibration.
    config : settings.
    prior : what every window of the first pass is told.
    noise : densities and losses.
    sharing : how many windows share the attitude prior, about.
    joints : to answer for.
    magnetometer : there is a calibrated one.
    with_clock : the first pass asks every section for the clock.
    """

    known: SelfCalibration
    config: Config
    prior: Priors
    noise: NoiseModel
    sharing: int
    joints: tuple[str, ...]
    magnetometer: bool
    with_clock: bool


@dataclass(frozen=True)
class SectionState:
    """What the second pass needs of a section.

    Attributes
    ----------
    imu_t : the IMU's stamps, of which the first is the recording's sample `first_sample`.
    segment, prepared, alignment, borders, motion : samples, nodes, the inertial frame's alignment, where
        windows begin and end, and the motion found.
    clock : that the first pass had.
    seen : what the magnetometer read, a window each; empty without one.
    believed : samples that the first pass contradicts were set aside already.
    """

    imu_t: FloatArray
    first_sample: int
    segment: Segment
    prepared: PreparedSegment
    alignment: Alignment
    clock: Clock
    borders: list[float]
    motion: Trajectory
    seen: tuple[FieldObservation, ...]
    believed: bool = False


@dataclass(frozen=True)
class FirstAnswer:
    """What a section says to all.

    Attributes
    ----------
    kept : what its second pass needs.
    messages : on the shared quantities, a window each.
    strengths : of the magnetic field where it was read, a window each.
    score : on the clock, of one window.
    """

    kept: SectionState
    messages: list[Message]
    strengths: tuple[FloatArray, ...]
    score: ClockScore


@dataclass(frozen=True)
class SecondAnswer:
    """The section's answer, and its windows' messages."""

    answer: SectionAnswer
    messages: list[Message]


def first_pass(data: SectionData, task: Task) -> FirstAnswer | None:
    """Solve a section by itself; None where the camera saw too little of the forearm.

    Raises
    ------
    SolveError
        A window leaves something free; the text names the time.
    """
    segment = data.segment()
    if segment is None:
        return None
    known, config = task.known, task.config
    clock = known.clocks[0]
    (segment,) = known.bias.corrected([reject_by_camera(segment)])
    segment, alignment = reject_by_direction(segment, known.start, clock)
    ready = prepare(segment, known.start, clock, known.sigma_m, config.windows.margin_s, alignment)
    if ready is None:
        return None
    prepared, alignment = ready
    borders = cut_times(prepared, config.windows.length_s)
    windows = _windows(prepared, borders, [task.prior] * (len(borders) - 1), task)
    middle = len(windows) // 2
    solutions = [
        solve(
            window,
            with_covariance=task.magnetometer,
            with_offset=task.with_clock and k == middle,
            tolerance=FIRST_TOLERANCE,
        )
        for k, window in enumerate(windows)
    ]
    score = clock_score([windows[middle]], [solutions[middle]]).gathered()
    seen = tuple(
        observe(data.imu, window, solution)
        for window, solution in zip(windows, solutions, strict=True)
        if task.magnetometer  # it is judged by what the first pass knows of the attitude
    )
    motion = merge_windows(prepared.t, windows, solutions)
    kept = SectionState(
        data.imu.t_s, data.section.samples.start, segment, prepared, alignment, clock, borders, motion, seen
    )
    messages, strengths = [each.message for each in solutions], tuple(each.strength for each in seen)
    return FirstAnswer(kept, messages, strengths, score)


def second_pass(
    kept: SectionState,
    told: Sequence[Priors],
    found: ArmCalibration,
    fields: Mapping[int, FieldMeasurements],
    task: Task,
) -> SecondAnswer:
    """Solve a section again with what all others found.

    Parameters
    ----------
    told : the windows' priors.
    found : the arm's calibration as all sections together have it.
    fields : what the magnetometer adds, by the window's number in the section.
    """
    kept = reject_outliers(kept, found, task)
    windows = [
        replace(window, field=fields[number]) if number in fields else window
        for number, window in enumerate(_windows(kept.prepared, kept.borders, told, task))
    ]
    solutions = [
        solve(window, with_covariance=True, with_message=False, tolerance=SECOND_TOLERANCE)
        for window in windows
    ]
    motion = merge_windows(kept.prepared.t, windows, solutions)
    answer = sample_section(
        kept.imu_t, kept.first_sample, kept.segment, kept.prepared, motion, found, task.known, task.joints
    )
    return SecondAnswer(answer, [each.message for each in solutions])


def reject_outliers(kept: SectionState, found: ArmCalibration, task: Task) -> SectionState:
    """Without samples that the first pass contradicts, and with better start values."""
    if kept.believed:
        return kept
    segment, prepared, motion, known = kept.segment, kept.prepared, kept.motion, task.known
    clock = known.clocks[0]
    residual = frame_residuals(segment.position, segment.frame_t_imu(clock), prepared, motion, found)
    believed = reject_by_residual(segment, residual, known.noise)
    margin_s = task.config.windows.margin_s
    again = None
    if believed is not segment:
        again = prepare(believed, known.start, clock, known.sigma_m, margin_s, kept.alignment)
    if again is None:
        # frames may lie elsewhere, on a clock that was found anew; they are carried to the same nodes
        before = segment.frame_t_imu(kept.clock)
        inside = (before >= segment.start_s) & (before <= segment.end_s)
        frame_t = np.clip(segment.frame_t_imu(clock), prepared.signal.start_s, prepared.signal.end_s)[inside]
        prepared = replace(prepared, start=motion.states, frame_t_imu=frame_t)
        return replace(kept, prepared=prepared, believed=True)
    return replace(kept, segment=believed, prepared=with_initial_values(again[0], motion), believed=True)


def section_field_means(
    kept: SectionState, first_window: int, strength: float, found: ArmCalibration, task: Task
) -> tuple[SectionState, list[FieldMean]]:
    """Where the magnetometer could take part in the second pass; windows are numbered from `first_window`."""
    kept = reject_outliers(kept, found, task)
    prepared, margin_s = kept.prepared, task.config.windows.margin_s
    blocks: list[FieldMean] = []
    for number, seen in enumerate(kept.seen):
        rows = window_nodes(prepared.t, kept.borders, number, margin_s)
        blocks += field_means(first_window + number, seen, strength, prepared.t[rows], prepared.start.R[rows])
    return replace(kept, seen=()), blocks


def _windows(
    prepared: PreparedSegment, borders: list[float], priors: Sequence[Priors], task: Task
) -> list[Window]:
    return list(
        cut(prepared, priors, task.noise, borders, task.config.windows.margin_s, GRAVITY, task.sharing)
    )
