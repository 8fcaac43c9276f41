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
from ..measurements.alignment import GRAVITY, Alignment
from ..measurements.clock import Clock
from ..measurements.outliers import by_camera, by_residual
from ..measurements.segment import Piece
from ..recording import FloatArray
from ..selfcal.clock_fit import Pulls, pulls_of
from ..selfcal.rounds import Knowledge, screen_attitude, started
from ..window.cut import Stretch, cut, cut_times, window_nodes
from ..window.prepare import prepare
from ..window.problem import FieldSight, Message, Noise, Priors, Window
from ..window.trajectory import Motion, join
from .magnetometer import Block, Observed, blocks_of, observe
from .samples import SectionAnswer, answer_of, frame_residuals
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

    known: Knowledge
    config: Config
    prior: Priors
    noise: Noise
    sharing: int
    joints: tuple[str, ...]
    magnetometer: bool
    with_clock: bool


@dataclass(frozen=True)
class Kept:
    """What the second pass needs of a section.

    Attributes
    ----------
    imu_t : the IMU's stamps, of which the first is the recording's sample `first_sample`.
    piece, stretch, alignment, borders, motion : samples, nodes, the inertial frame's alignment, where windows
        begin and end, and the motion found.
    clock : that the first pass had.
    seen : what the magnetometer read, a window each; empty without one.
    believed : samples that the first pass contradicts were set aside already.
    """

    imu_t: FloatArray
    first_sample: int
    piece: Piece
    stretch: Stretch
    alignment: Alignment
    clock: Clock
    borders: list[float]
    motion: Motion
    seen: tuple[Observed, ...]
    believed: bool = False


@dataclass(frozen=True)
class FirstAnswer:
    """What a section says to all.

    Attributes
    ----------
    kept : what its second pass needs.
    messages : on the shared quantities, a window each.
    strengths : of the magnetic field where it was read, a window each.
    pulls : on the clock, of one window.
    """

    kept: Kept
    messages: list[Message]
    strengths: tuple[FloatArray, ...]
    pulls: Pulls


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
    piece = data.piece()
    if piece is None:
        return None
    known, config = task.known, task.config
    clock = known.clocks[0]
    (piece,) = known.bias.corrected([by_camera(piece)])
    piece, alignment = screen_attitude(piece, known.start, clock)
    ready = prepare(piece, known.start, clock, known.sigma_m, config.windows.margin_s, alignment)
    if ready is None:
        return None
    stretch, alignment = ready
    borders = cut_times(stretch, config.windows.length_s)
    windows = _windows(stretch, borders, [task.prior] * (len(borders) - 1), task)
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
    pulls = pulls_of([windows[middle]], [solutions[middle]]).gathered()
    seen = tuple(
        observe(data.imu, window, solution)
        for window, solution in zip(windows, solutions, strict=True)
        if task.magnetometer  # it is judged by what the first pass knows of the attitude
    )
    motion = join(stretch.t, windows, solutions)
    kept = Kept(
        data.imu.t_s, data.section.samples.start, piece, stretch, alignment, clock, borders, motion, seen
    )
    messages, strengths = [each.message for each in solutions], tuple(each.strength for each in seen)
    return FirstAnswer(kept, messages, strengths, pulls)


def second_pass(
    kept: Kept,
    told: Sequence[Priors],
    found: ArmCalibration,
    fields: Mapping[int, FieldSight],
    task: Task,
) -> SecondAnswer:
    """Solve a section again with what all others found.

    Parameters
    ----------
    told : the windows' priors.
    found : the arm's calibration as all sections together have it.
    fields : what the magnetometer adds, by the window's number in the section.
    """
    kept = believe(kept, found, task)
    windows = [
        replace(window, field=fields[number]) if number in fields else window
        for number, window in enumerate(_windows(kept.stretch, kept.borders, told, task))
    ]
    solutions = [
        solve(window, with_covariance=True, with_message=False, tolerance=SECOND_TOLERANCE)
        for window in windows
    ]
    motion = join(kept.stretch.t, windows, solutions)
    answer = answer_of(
        kept.imu_t, kept.first_sample, kept.piece, kept.stretch, motion, found, task.known, task.joints
    )
    return SecondAnswer(answer, [each.message for each in solutions])


def believe(kept: Kept, found: ArmCalibration, task: Task) -> Kept:
    """Without samples that the first pass contradicts, and with better start values."""
    if kept.believed:
        return kept
    piece, stretch, motion, known = kept.piece, kept.stretch, kept.motion, task.known
    clock = known.clocks[0]
    residual = frame_residuals(
        piece.position, piece.frame_t + clock.at(piece.frame_t), stretch, motion, found
    )
    believed = by_residual(piece, residual, known.noise)
    margin_s = task.config.windows.margin_s
    again = None
    if believed is not piece:
        again = prepare(believed, known.start, clock, known.sigma_m, margin_s, kept.alignment)
    if again is None:
        # frames may lie elsewhere, on a clock that was found anew; they are carried to the same nodes
        before = piece.frame_t + kept.clock.at(piece.frame_t)
        inside = (before >= piece.start_s) & (before <= piece.end_s)
        frame_t = np.clip(
            piece.frame_t + clock.at(piece.frame_t), stretch.signal.start_s, stretch.signal.end_s
        )[inside]
        return replace(kept, stretch=replace(stretch, start=motion.states, frame_t=frame_t), believed=True)
    return replace(kept, piece=believed, stretch=started(again[0], motion), believed=True)


def field_blocks(
    kept: Kept, first_window: int, strength: float, found: ArmCalibration, task: Task
) -> tuple[Kept, list[Block]]:
    """Where the magnetometer could take part in the second pass; windows are numbered from `first_window`."""
    kept = believe(kept, found, task)
    stretch, margin_s = kept.stretch, task.config.windows.margin_s
    blocks: list[Block] = []
    for number, seen in enumerate(kept.seen):
        rows = window_nodes(stretch.t, kept.borders, number, margin_s)
        blocks += blocks_of(first_window + number, seen, strength, stretch.t[rows], stretch.start.R[rows])
    return replace(kept, seen=()), blocks


def _windows(stretch: Stretch, borders: list[float], priors: Sequence[Priors], task: Task) -> list[Window]:
    return list(
        cut(stretch, priors, task.noise, borders, task.config.windows.margin_s, GRAVITY, task.sharing)
    )
