"""A section solved as one window: its motion with covariance, drawn motions, and the camera checked."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial

from ..errors import SolveError
from ..graph.changes import steps
from ..graph.optimise import LONG_S
from ..graph.solve import optimise_window, solution_of, solve
from ..measurements.alignment import Alignment
from ..measurements.outliers import reject_by_camera, reject_by_direction, reject_by_residual
from ..measurements.segment import Segment
from ..runtime.pool import Pool
from ..selfcal.clock_fit import ClockScore, clock_score, joined_scores, refined_clock
from ..selfcal.excerpts import most_telling
from ..window.cut import window_between
from ..window.prepare import PreparedSegment, prepare
from ..window.problem import Window
from ..window.trajectory import started_from
from .drawn_samples import sample_draws
from .magnetometer import FieldObservation, observe
from .samples import SectionAnswer, frame_residuals, sample_section
from .sections import SectionData, Sections
from .self_check import hide_and_recover
from .task import Task

#: An iteration that lowers the error by less than this share of it is the last.
TOLERANCE = 1e-3
#: With this many sections the clock is found anew from a part of each, s: it wanders over a long recording.
CLOCK_SECTIONS, CLOCK_PART_S, CLOCK_TOLERANCE = 5, 20.0, 1e-2


def solve_sections(sections: Sections, task: Task, workers: Pool) -> Iterator[SectionAnswer]:
    """The sections' answers in the order of time, solved side by side as they are asked for."""
    solved = workers.map(partial(solve_section, task=task), sections)
    return (each for each in solved if each is not None)


def solve_section(data: SectionData, task: Task) -> SectionAnswer | None:
    """Solve a section; None where the camera saw too little of the forearm."""
    ready = _prepared(data, task)
    if ready is None:
        return None
    segment, prepared, alignment = ready
    model = task.model
    # 1. Solved once; camera samples that the motion contradicts are left out, and it is solved again.
    optimised = optimise_window(_window(prepared, task), TOLERANCE)
    first, changes = solution_of(optimised, with_covariance=False), tuple(steps(optimised))
    residual = frame_residuals(
        segment.position, segment.frame_t_imu(model.clock), prepared, first, model.estimate
    )
    inliers = reject_by_residual(segment, residual, model.joint_noise)
    if inliers is not segment and (again := _made_ready(inliers, task, alignment)) is not None:
        segment, prepared = inliers, started_from(again[0], first, prepared)
        optimised = optimise_window(_window(prepared, task), TOLERANCE)
    # 2. The answer with its covariance, blocks of the camera against the rest, and drawn motions.
    solution = solution_of(optimised, with_covariance=True, plan=task.plan, with_blocks=True)
    imu_t, first_sample = data.imu.t_s, data.section.samples.start
    answer = sample_section(imu_t, first_sample, segment, prepared, solution, model, task.joints)
    if task.plan is not None and solution.draws is not None:
        rows = slice(answer.samples.start - first_sample, answer.samples.stop - first_sample)
        layout = task.prior.layout
        answer = sample_draws(answer, imu_t[rows], solution.draws, solution, model, layout, task.plan)
    unexplained = () if solution.accepted else tuple(gap for gap in answer.gaps if gap.length_s >= LONG_S)
    # 3. Visible stretches hidden, recovered from the rest, and compared.
    stretches = hide_and_recover(prepared.with_start(solution.forearm.states), task)
    return replace(
        answer, unexplained=unexplained, shifts=solution.shifts, stretches=tuple(stretches), steps=changes
    )


def _prepared(data: SectionData, task: Task) -> tuple[Segment, PreparedSegment, Alignment] | None:
    """The section's samples without known errors and without what the camera alone shows to be wrong."""
    segment = data.segment()
    if segment is None:
        return None
    segment = task.model.errors.corrected(reject_by_camera(segment))
    segment, alignment = reject_by_direction(segment, task.model.prior, task.model.clock)
    ready = _made_ready(segment, task, alignment)
    return None if ready is None else (segment, *ready)


def _made_ready(
    segment: Segment, task: Task, alignment: Alignment | None
) -> tuple[PreparedSegment, Alignment] | None:
    model, margin_s = task.model, task.config.windows.margin_s
    return prepare(segment, model.prior, model.clock, model.joint_sigma_m, margin_s, alignment)


def _window(prepared: PreparedSegment, task: Task) -> Window:
    """The section's window, with the magnetic field and the errors that are considered."""
    window = window_between(prepared, task.prior, task.noise, task.sharing)
    field = None if task.field is None else task.field.at_nodes(window.t)
    return replace(window, field=field, considered=task.model.errors.considered)


def clock_over(sections: Sections, task: Task, workers: Pool, synthetic_stamps: bool) -> Task:
    """The task with the clock that parts of all sections show, where there are enough of them."""
    if len(sections) < CLOCK_SECTIONS:
        return task
    scores = [each for each in workers.map(partial(_clock_score, task=task), sections) if each is not None]
    clock = refined_clock(task.model.clock, joined_scores(scores), synthetic_stamps)
    return replace(task, model=replace(task.model, clocks=(clock,)))


def _clock_score(data: SectionData, task: Task) -> ClockScore | None:
    """What the most informative part of a section says of the clock."""
    segment = data.segment()
    if segment is None:
        return None
    part = segment.between(*most_telling(segment, CLOCK_PART_S))
    segment = task.model.errors.corrected(reject_by_camera(part))
    segment, alignment = reject_by_direction(segment, task.model.prior, task.model.clock)
    ready = _made_ready(segment, task, alignment)
    if ready is None:
        return None
    window = replace(window_between(ready[0], task.prior, task.noise, task.sharing), loose_gaps=True)
    try:
        solution = solve(window, with_covariance=False, with_offset=True, tolerance=CLOCK_TOLERANCE)
    except SolveError:
        return None
    return clock_score([(window, solution)]).condensed()


def observed_field(sections: Sections, task: Task, workers: Pool) -> Iterable[FieldObservation]:
    """What the magnetometer read in each section, by a solution without it."""
    found = workers.map(partial(_observation, task=task), sections)
    return (each for each in found if each is not None)


def _observation(data: SectionData, task: Task) -> FieldObservation | None:
    ready = _prepared(data, task)
    if ready is None:
        return None
    solution = solve(_window(ready[1], task), with_covariance=True, tolerance=CLOCK_TOLERANCE)
    return observe(data.imu, solution, ready[1].start_s, ready[1].end_s)
