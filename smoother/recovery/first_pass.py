"""The first pass: every section alone, for what all sections share.

Of a long recording it asks some windows of each section only, those that are most informative: what all share
is known long before every window has been selected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import islice

import numpy as np

from ..array_types import FloatArray, IntArray
from ..errors import SolveError
from ..graph.solve import solve
from ..measurements.outliers import reject_by_camera, reject_by_direction
from ..runtime.pool import Pool
from ..runtime.store import Store
from ..selfcal.clock_fit import ClockScore, clock_score
from ..window.cut import cut_times, window_middles, window_nodes
from ..window.pooling import leave_one_out_priors
from ..window.prepare import prepare
from ..window.problem import FieldMeasurements, Priors
from ..window.solution import Message
from ..window.trajectory import merge_windows
from .magnetometer import (
    NO_MAGNETOMETER,
    FieldMean,
    Magnetometer,
    field_means,
    judge,
    observe,
    usual_strength,
)
from .sections import SectionData, Sections
from .task import SectionState, Task

#: The first pass is a start for the second, which ends within 0.02 sigma (0.15 mm) of where it would with a
#: ten times smaller tolerance.
TOLERANCE = 1e-2


@dataclass(frozen=True)
class FirstAnswer:
    """What a section says to all."""

    state: SectionState  # What its second pass needs
    t_s: FloatArray  # (k,) s: middles of its windows
    selected: IntArray  # int (m,): which of its windows were selected
    messages: list[Message]  # On the shared quantities, one of each of these
    strengths: tuple[FloatArray, ...]  # Of the magnetic field where it was read, one per window
    clock_score: ClockScore  # On the clock, of one window


def solve_alone(data: SectionData, task: Task) -> FirstAnswer | None:
    """Solve a section by itself; None where the camera saw too little of the forearm."""
    segment = data.segment()
    if segment is None:
        return None
    model, config = task.model, task.config
    segment = model.errors.corrected(reject_by_camera(segment))
    segment, alignment = reject_by_direction(segment, model.prior, model.clock)
    ready = prepare(
        segment, model.prior, model.clock, model.joint_sigma_m, config.windows.margin_s, alignment
    )
    if ready is None:
        return None
    prepared, alignment = ready
    borders = cut_times(prepared, config.windows.length_s)
    selected = task.selected(segment, borders)
    windows = task.windows(prepared, borders, [task.prior] * (len(borders) - 1), selected)
    middle = len(windows) // 2
    solutions = [
        solve(
            window,
            with_covariance=task.magnetometer,  # it is judged by this pass's attitude
            with_offset=task.with_clock and k == middle,
            tolerance=TOLERANCE,
        )
        for k, window in enumerate(windows)
    ]
    observations = tuple(
        observe(data.imu, window, solution)
        for window, solution in zip(windows, solutions, strict=True)
        if task.magnetometer
    )
    whole = len(windows) == len(borders) - 1
    state = SectionState(
        imu_t=data.imu.t_s,
        first_sample=data.section.samples.start,
        segment=segment,
        prepared=prepared,
        alignment=alignment,
        clock=model.clock,
        borders=borders,
        trajectory=merge_windows(prepared.t, windows, solutions) if whole else None,
        observations=observations,
    )
    return FirstAnswer(
        state,
        window_middles(prepared.t, borders, config.windows.margin_s),
        selected,
        [solution.message for solution in solutions],
        tuple(observation.strength for observation in observations),
        clock_score([windows[middle]], [solutions[middle]]).condensed(),
    )


@dataclass(frozen=True)
class SecondJob:
    """A section of the second pass: its state, and of each of its windows the priors and the field."""

    state: SectionState
    priors: list[Priors]  # One per window
    field: dict[int, FieldMeasurements]  # What the magnetometer adds, by the window's number in the section


@dataclass
class FirstPass:
    """The answers of all sections, in the order of time; their states are in a store."""

    store: Store
    messages: list[Message] = field(default_factory=list)  # Of the windows that were selected
    selected: list[int] = field(default_factory=list)  # Numbers of these windows in the recording
    t_s: list[float] = field(default_factory=list)  # Middles of all windows
    clock_scores: list[ClockScore] = field(default_factory=list)  # One a section
    strengths: list[FloatArray] = field(default_factory=list)  # Of the magnetic field, one per window
    _states: list[tuple[object, range]] = field(default_factory=list)

    @classmethod
    def over(
        cls, sections: Sections, task: Task, workers: Pool, store: Store, progress: Callable[[float], None]
    ) -> FirstPass:
        """Solve all sections, side by side."""
        first = cls(store)
        for count, answer in enumerate(workers.map(partial(solve_alone, task=task), sections), start=1):
            if answer is not None:
                first._add(answer)
            progress(count / len(sections))
        if not first.messages:
            raise SolveError(f"{sections.name}: too few of the camera's samples are plausible")
        return first

    def _add(self, answer: FirstAnswer) -> None:
        windows = range(len(self.t_s), len(self.t_s) + len(answer.t_s))
        self._states.append((self.store.put(answer.state), windows))
        self.selected += (windows.start + answer.selected).tolist()
        self.t_s += answer.t_s.tolist()
        self.messages += answer.messages
        self.strengths += answer.strengths
        self.clock_scores.append(answer.clock_score)

    def __len__(self) -> int:
        return len(self._states)

    def priors(self, prior: Priors) -> Iterator[Priors]:
        """The second pass's priors of all windows, in the order of time (`leave_one_out_priors`)."""
        return leave_one_out_priors(self.messages, prior, np.array(self.t_s), np.array(self.selected))

    def states(self) -> Iterator[tuple[SectionState, range]]:
        """Each section's state, taken out of the store, and the numbers of its windows."""
        states, self._states = self._states, []
        for handle, windows in states:
            state = self.store.pop(handle)
            assert isinstance(state, SectionState)
            yield state, windows

    def put_back(self, state: SectionState, windows: range) -> None:
        """A section's state that was taken out, in the order of time."""
        self._states.append((self.store.put(state), windows))

    def jobs(
        self, priors: Iterator[Priors], field_by_window: Mapping[int, FieldMeasurements]
    ) -> Iterator[SecondJob]:
        """The second pass's jobs, a section each."""
        for state, windows in self.states():
            own = {k - windows.start: field_by_window[k] for k in windows if k in field_by_window}
            yield SecondJob(state, list(islice(priors, len(windows))), own)


def magnetic_field(first: FirstPass, task: Task, workers: Pool) -> Magnetometer:
    """The field's measurements by window, where they agree with the rest of the recording."""
    if not task.magnetometer:
        return NO_MAGNETOMETER
    strength, reason = usual_strength(first.strengths)
    if not strength > 0:
        return reason
    means: list[FieldMean] = []
    job = partial(_section_means, strength=strength, task=task)
    for state, windows, section_means in workers.map(job, first.states()):
        first.put_back(state, windows)
        means += section_means
    return judge(means)


def _section_means(
    section: tuple[SectionState, range], strength: float, task: Task
) -> tuple[SectionState, range, list[FieldMean]]:
    """Where the magnetometer could be used in the second pass of a section."""
    state, windows = section[0].without_outliers(task), section[1]
    prepared, margin_s = state.prepared, task.config.windows.margin_s
    means: list[FieldMean] = []
    for number, observation in enumerate(state.observations):
        rows = window_nodes(prepared.t, state.borders, number, margin_s)
        means += field_means(
            windows.start + number, observation, strength, prepared.t[rows], prepared.forearm.start.R[rows]
        )
    return state, windows, means
