"""How far each block of the camera's samples is shifted against all the rest of a window.

A block is some neighbouring seconds of elbow, wrist and hand. Its shift in {K} is one more quantity of the
linearised window: three columns a block, everything else eliminated, give the shift's estimate and its
covariance, as if the block had been left out and compared (leave-a-block-out; Cook and Weisberg, Residuals
and Influence in Regression, 1982, with a group of rows in place of one).

Losses are robust, so the weights at the solution understate the shift of a block that the solution has
rejected: this finds what is suspicious, not how far it is off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray, IntArray
from ..linalg import inverse
from ..measurements.visibility import MISSING_S
from ..window.problem import Window
from ..window.solution import BlockShift
from .build import FactorGroup
from .error_columns import camera_rows
from .linear_system import Jacobian, LinearSystem, reduced_to_extras

#: Blocks are built of cells of about this length, s, and are this many cells long.
CELL_S = 1.0
LENGTHS = (1, 2, 4)
#: Between two cells the forearm has jumped: farther than this in m, and faster than this in m/s.
JUMP_M, JUMP_M_PER_S = 0.12, 3.6
#: What the camera's slow errors may shift a block by, m per axis.
SLOW_M = 0.015


@dataclass(frozen=True)
class Cells:
    """A window's camera samples in cells: no cell reaches over a gap or a jump."""

    start_s: FloatArray  # (k,) s: on the IMU's clock
    end_s: FloatArray  # (k,) s: on the IMU's clock
    segment: IntArray  # int (k,): cells of one segment follow each other without a gap or a jump
    camera: IntArray  # int (k,): the camera whose samples they hold; those of a camera follow each other

    def __len__(self) -> int:
        return len(self.start_s)

    def of(self, t: FloatArray, camera: int = 0) -> IntArray:
        """The cell of each time (n,) of a camera; -1 where there is none."""
        own = np.flatnonzero(self.camera == camera)
        if not len(own):
            return np.full(len(t), -1)
        index = own[np.clip(np.searchsorted(self.start_s[own], t + 1e-9, side="right") - 1, 0, None)]
        inside = (t >= self.start_s[index] - 1e-9) & (t <= self.end_s[index] + 1e-9)
        return np.where(inside, index, -1)


def cells_of(window: Window) -> Cells:
    """The cells of the cameras' samples in a window's core."""
    of_cameras, segments = [], 0
    for camera in sorted({each.camera for each in window.joint_measurements}):
        cells = _cells_of_camera(window, camera)
        of_cameras.append((cells, segments))
        segments += int(cells.segment.max(initial=-1)) + 1
    if not of_cameras:
        return Cells(np.zeros(0), np.zeros(0), np.zeros(0, int), np.zeros(0, int))
    return Cells(
        np.concatenate([cells.start_s for cells, _ in of_cameras]),
        np.concatenate([cells.end_s for cells, _ in of_cameras]),
        np.concatenate([cells.segment + first for cells, first in of_cameras]),
        np.concatenate([cells.camera for cells, _ in of_cameras]),
    )


def _cells_of_camera(window: Window, camera: int) -> Cells:
    own = [each for each in window.joint_measurements if each.camera == camera]
    measured = [each for each in own if each.joint != "strap"] or own
    t = np.unique(np.concatenate([each.t_s for each in measured]))
    t = t[(t >= window.core_start_s) & (t <= window.core_end_s)]
    if len(t) < 2:
        return Cells(np.zeros(0), np.zeros(0), np.zeros(0, int), np.zeros(0, int))
    breaks = np.diff(t) > MISSING_S
    for each in measured:
        breaks |= np.isin(t[1:], _jumps(each.t_s, each.position))
    starts, ends, segments = [], [], []
    edges = np.concatenate(([0], np.flatnonzero(breaks) + 1, [len(t)]))
    for number, (a, b) in enumerate(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)):
        run = t[a:b]
        count = max(round(float(run[-1] - run[0]) / CELL_S), 1)
        for part in np.array_split(run, min(count, len(run))):
            starts.append(float(part[0]))
            ends.append(float(part[-1]))
            segments.append(number)
    return Cells(np.array(starts), np.array(ends), np.array(segments), np.full(len(starts), camera))


def _jumps(t: FloatArray, position: FloatArray) -> FloatArray:
    """Times at which a joint has just jumped."""
    far = np.linalg.norm(np.diff(position, axis=0), axis=1)
    return t[1:][(far > JUMP_M) & (far > JUMP_M_PER_S * np.diff(t))]


@dataclass(frozen=True)
class CameraBlocks:
    """A window, the groups of its graph's factors, and the cells that its blocks are built of."""

    window: Window
    groups: Sequence[FactorGroup]
    cells: Cells

    @classmethod
    def of(cls, window: Window, groups: Sequence[FactorGroup]) -> CameraBlocks:
        """The blocks of a window's core; the groups are its graph's."""
        return cls(window, groups, cells_of(window))

    @property
    def count(self) -> int:
        """Quantities: a shift of each cell."""
        return 3 * len(self.cells)

    def columns(self, jacobian: Jacobian) -> FloatArray:
        """Columns (r, `count`) of the whitened Jacobian's first r rows; the blocks are in no others."""
        window = self.window
        all_rows = list(camera_rows(jacobian, window, self.groups))
        columns = np.zeros((max((each.rows.stop for each in all_rows), default=0), self.count))
        for factors in all_rows:
            if factors.joint == "shoulder":
                continue
            whitened = factors.whitened(np.tile(np.eye(3), (len(factors.nodes), 1, 1))).reshape(-1, 3, 3)
            rows = np.arange(factors.rows.start, factors.rows.stop).reshape(-1, 3)
            cell = self.cells.of(window.t[factors.nodes], factors.camera)
            mine = np.flatnonzero(cell >= 0)
            for axis in range(3):
                for of_shift in range(3):
                    columns[rows[mine, axis], 3 * cell[mine] + of_shift] = whitened[mine, axis, of_shift]
        return columns

    def shifts(self, system: LinearSystem) -> tuple[BlockShift, ...]:
        """The shift of every block."""
        information, vector = reduced_to_extras(system, self.window.considered, self.count)
        cells, shifts = self.cells, []
        for rows in _blocks(cells):
            own, count = slice(3 * rows.start, 3 * rows.stop), rows.stop - rows.start
            block = information[own, own].reshape(count, 3, count, 3).sum(axis=(0, 2))
            shift, covariance = _estimated(block, vector[own].reshape(count, 3).sum(axis=0))
            allowed = covariance + SLOW_M**2 * np.eye(3)
            score = float(shift @ np.linalg.solve(allowed, shift)) / 3.0
            start_s, end_s = float(cells.start_s[rows.start]), float(cells.end_s[rows.stop - 1])
            shifts.append(BlockShift(start_s, end_s, shift, score, int(cells.camera[rows.start])))
        return tuple(shifts)


def _blocks(cells: Cells) -> list[slice]:
    """Runs of cells that are judged together."""
    blocks = {
        (first, first + length)
        for length in LENGTHS
        for first in range(len(cells) - length + 1)
        if cells.segment[first] == cells.segment[first + length - 1]
    }
    edges = np.flatnonzero(np.diff(cells.segment, prepend=-1, append=len(cells) + 1))
    blocks |= set(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    return [slice(*block) for block in sorted(blocks)]


def _estimated(information: FloatArray, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Estimate and covariance; a direction that nothing is known of has a large variance."""
    known = information + np.diag(np.maximum(1e-6 * np.diag(information), 1e-4))
    covariance = inverse(known)
    return np.asarray(covariance @ vector), covariance
