"""The second pass: every section with priors from all others."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from ..graph.optimise import LONG_S
from ..graph.solve import WindowOptimum, optimise_window, solution_of
from ..measurements.visibility import Gap
from ..runtime.pool import Pool
from ..window.problem import Window
from ..window.solution import BlockShift, Message, Solution
from ..window.trajectory import merge_draws, merge_windows
from .drawn_samples import SectionDraws, sample_draws
from .first_pass import SecondJob
from .samples import SectionAnswer, sample_section
from .self_check import HiddenStretch, hide_and_recover
from .task import SectionState, Task

TOLERANCE = 1e-3


@dataclass(frozen=True)
class SecondAnswer:
    """A section's second pass."""

    answer: SectionAnswer  # At its samples
    messages: list[Message]  # One per window
    unexplained: tuple[Gap, ...]  # Long gaps whose motion the model does not explain
    check: SectionCheck  # Of the camera against the rest
    draws: SectionDraws | None = None  # Motions drawn from the posterior; None where not asked for


@dataclass(frozen=True)
class SectionCheck:
    """A section's evidence on the camera against the rest."""

    shifts: tuple[BlockShift, ...]
    stretches: tuple[HiddenStretch, ...]

    @classmethod
    def of(cls, solutions: Sequence[Solution], stretches: Sequence[HiddenStretch]) -> SectionCheck:
        """Of all windows together."""
        return cls(tuple(shift for solution in solutions for shift in solution.shifts), tuple(stretches))


def solve_again(job: SecondJob, task: Task) -> SecondAnswer:
    """Solve a section with the priors that all others give it."""
    state, optimised = job.state, None
    if state.trajectory is None:
        state, optimised = _optimised(job, task)
    if optimised is None:
        state = state.without_outliers(task)
        optimised = [optimise_window(window, TOLERANCE) for window in _windows(state, job, task)]
    windows = [each.window for each in optimised]
    solutions = [
        solution_of(each, with_covariance=True, with_message=False, plan=task.plan, with_blocks=True)
        for each in optimised
    ]
    trajectory = merge_windows(state.prepared.t, windows, solutions)
    answer = sample_section(
        state.imu_t,
        state.first_sample,
        state.segment,
        state.prepared,
        trajectory,
        task.model,
        task.joints,
    )
    refused = [window for window, solution in zip(windows, solutions, strict=True) if not solution.accepted]
    unexplained = tuple(
        gap
        for gap in answer.gaps
        if gap.length_s >= LONG_S
        and any(gap.start_s < window.t[-1] and gap.end_s > window.t[0] for window in refused)
    )
    rows = slice(answer.samples.start - state.first_sample, answer.samples.stop - state.first_sample)
    draws = None
    if task.plan is not None:
        drawn = merge_draws(state.prepared.t, windows, solutions)
        layout = task.prior.layout
        draws = sample_draws(answer, state.imu_t[rows], drawn, trajectory, task.model, layout, task.plan)
    check = SectionCheck.of(
        solutions,
        hide_and_recover(state.prepared.with_start(trajectory.forearm.states), windows, job.priors, task),
    )
    return SecondAnswer(answer, [solution.message for solution in solutions], unexplained, check, draws)


def _optimised(job: SecondJob, task: Task) -> tuple[SectionState, list[WindowOptimum] | None]:
    """A section that the first pass did not solve: its windows' optima, and the samples they contradict."""
    state = job.state.at_clock(task.model.clock)
    optimised = [optimise_window(window, TOLERANCE) for window in _windows(state, job, task)]
    solutions = [solution_of(each, with_covariance=False, with_message=False) for each in optimised]
    trajectory = merge_windows(state.prepared.t, [each.window for each in optimised], solutions)
    again = replace(state, trajectory=trajectory).without_outliers(task)
    return again, optimised if again.segment is state.segment else None


def _windows(state: SectionState, job: SecondJob, task: Task) -> list[Window]:
    """A section's windows, with what all others say and the errors that are considered."""
    return [
        replace(window, field=job.field.get(number), considered=task.model.errors.considered)
        for number, window in enumerate(task.windows(state.prepared, state.borders, job.priors))
    ]


def second_pass(jobs: Iterable[SecondJob], task: Task, workers: Pool) -> Iterator[SecondAnswer]:
    """The sections' answers in the order of time, solved side by side as they are asked for."""
    return workers.map(partial(solve_again, task=task), jobs)
