"""What a calibrated magnetometer adds to the second pass, from what it read in the first."""

from __future__ import annotations

from functools import partial

from ..runtime.pool import Pool
from ..window.cut import window_nodes
from .first_pass import FirstPass
from .magnetometer import NO_MAGNETOMETER, FieldMean, Magnetometer, field_means, judge, usual_strength
from .task import SectionState, Task


def magnetic_field(first: FirstPass, task: Task, workers: Pool) -> Magnetometer:
    """The field's measurements by window, where they agree with the rest of the recording.

    Parameters
    ----------
    first : FirstPass
        Its states come back with outliers rejected.
    task : Task
        Refined by the first pass.
    workers : Pool
    """
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
    """Where the magnetometer could take part in the second pass of a section."""
    state, windows = section[0].without_outliers(task), section[1]
    prepared, margin_s = state.prepared, task.config.windows.margin_s
    means: list[FieldMean] = []
    for number, observation in enumerate(state.observations):
        rows = window_nodes(prepared.t, state.borders, number, margin_s)
        means += field_means(
            windows.start + number, observation, strength, prepared.t[rows], prepared.start.R[rows]
        )
    return state, windows, means
