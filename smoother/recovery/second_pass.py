"""The second pass: every section again, with priors from all others."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

from ..graph.optimise import LONG_S
from ..graph.solve import solve
from ..measurements.visibility import Gap
from ..runtime.pool import Pool
from ..window.drawn_trajectory import merge_draws
from ..window.solution import Message
from ..window.trajectory import merge_windows
from .drawn_samples import SectionDraws, sample_draws
from .first_pass import SecondJob
from .samples import SectionAnswer, sample_section
from .task import Task
from .upper_samples import UpperAnswer, sample_upper

TOLERANCE = 1e-3


@dataclass(frozen=True)
class SecondAnswer:
    """A section's second pass.

    Attributes
    ----------
    answer : SectionAnswer
        At its samples.
    messages : list of Message
        One a window.
    upper : UpperAnswer or None
        Of an upper-arm IMU at the same samples.
    unexplained : tuple of Gap
        Long gaps whose motion the model does not explain.
    draws : SectionDraws or None
        Motions drawn from the posterior; None where not asked for.
    """

    answer: SectionAnswer
    messages: list[Message]
    unexplained: tuple[Gap, ...]
    upper: UpperAnswer | None = None
    draws: SectionDraws | None = None


def solve_again(job: SecondJob, task: Task) -> SecondAnswer:
    """Solve a section with the priors that all others give it.

    Parameters
    ----------
    job : SecondJob
    task : Task
        Refined by the first pass.

    Raises
    ------
    SolveError
        A window leaves something free; the text names the time.
    """
    state = job.state.without_outliers(task)
    windows = [
        replace(window, field=job.field.get(number), considered=task.model.errors.considered)
        for number, window in enumerate(task.windows(state.prepared, state.borders, job.priors))
    ]
    solutions = [
        solve(window, with_covariance=True, with_message=False, tolerance=TOLERANCE, plan=task.plan)
        for window in windows
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
    upper = sample_upper(answer, state.imu_t[rows], trajectory, state.prepared.upper, task.model)
    draws = None
    if task.plan is not None:
        drawn = merge_draws(state.prepared.t, windows, solutions)
        layout = task.prior.layout
        draws = sample_draws(answer, state.imu_t[rows], drawn, trajectory, task.model, layout, task.plan)
    return SecondAnswer(answer, [solution.message for solution in solutions], unexplained, upper, draws)


def second_pass(jobs: Iterable[SecondJob], task: Task, workers: Pool) -> Iterator[SecondAnswer]:
    """The sections' answers in the order of time, solved side by side as they are asked for."""
    return workers.map(partial(solve_again, task=task), jobs)
