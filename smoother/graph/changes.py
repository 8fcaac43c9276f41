"""What does not go with the rest of a window: blocks of camera samples, and what changed for good.

A block is some neighbouring seconds of elbow, wrist and hand, shifted in {K}; a step is a quantity that is
zero before a moment and constant after it: of the camera's place, the mounting, the clock. Both are further
quantities of the linearised window, a few columns for each cell of time, everything else eliminated, as if a
block had been left out and compared (leave-a-block-out; Cook and Weisberg, Residuals and Influence in
Regression, 1982, with a group of rows in place of one), or a step solved for. The test is one likelihood
ratio (Willsky and Jones, A generalized likelihood ratio approach to the detection and estimation of jumps in
linear systems, IEEE TAC 1976), with what sound cameras and straps do allowed for.

Losses are robust, so the weights at the solution understate the shift of a block that the solution has
rejected: this finds what is suspicious, not how far it is off.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..array_types import FloatArray, IntArray
from ..body import FOREARM
from ..linalg import inverse, skew
from ..measurements.visibility import MISSING_S
from ..window.problem import Window
from ..window.shared import SIZE, Considered
from ..window.solution import BlockShift, Step
from .columns import CameraRows, camera_rows, constant_error_columns, velocity_at_nodes
from .linear_system import LinearSystem, eliminated
from .solved import SolvedWindow, levers_of

#: Blocks are built of cells of about this length, s, and are this many cells long.
CELL_S = 1.0
LENGTHS = (1, 2, 4)
#: Between two cells the forearm has jumped: farther than this in m, and faster than this in m/s.
JUMP_M, JUMP_M_PER_S = 0.12, 3.6
#: Moments that are looked at: one in every gap, and so far apart elsewhere, s; so much of the window
#: lies before the first and after the last, s: in trials of 4 s a Kinect v1's slow errors look like a step.
APART_S, ENDS_S = 10.0, 3.0
#: The shoulder jumped where it moved this many times as far as in the median of its steps: noise of 1 cm does
#: not, 25 cm do.
JUMPED = 4.0
#: What may change by itself, one sigma: a camera's slow errors shift a block, m; they turn with the posture,
#: rad, and move, m; a strap turns and slides a little; stamps of a frame's time, s.
SLOW_M = np.full(3, 0.015)
#: A step's columns in a cell, and what is allowed.
STEPS = {
    "camera": (slice(0, 6), np.repeat([0.02, 0.015], 3)),
    "place": (slice(3, 6), np.full(3, 0.015)),
    "mounting": (slice(6, 12), np.repeat([0.03, 0.01], 3)),
    "clock": (slice(12, 13), np.array([0.012])),
}
WIDTH = 13


@dataclass(frozen=True)
class Cells:
    """A window's camera samples in cells: no cell reaches over a gap or a jump."""

    start_s: FloatArray  # (k,) s: on the IMU's clock
    end_s: FloatArray  # (k,) s: on the IMU's clock
    segment: IntArray  # int (k,): cells of one segment follow each other without a gap or a jump
    camera: IntArray  # int (k,): the camera whose samples they hold; those of a camera follow each other

    def __len__(self) -> int:
        return len(self.start_s)

    @classmethod
    def of_window(cls, window: Window) -> Cells:
        """The cells of the cameras' samples in a window's core."""
        rows: list[tuple[float, float, int, int]] = []
        segment = -1
        for camera in sorted({each.camera for each in window.joint_measurements}):
            own = [each for each in window.joint_measurements if each.camera == camera]
            measured = [each for each in own if each.joint != "strap"] or own
            t = np.unique(np.concatenate([each.t_s for each in measured]))
            t = t[(t >= window.core_start_s) & (t <= window.core_end_s)]
            if len(t) < 2:
                continue
            breaks = np.diff(t) > MISSING_S
            for each in measured:
                far = np.linalg.norm(np.diff(each.position, axis=0), axis=1)
                jumped = (far > JUMP_M) & (far > JUMP_M_PER_S * np.diff(each.t_s))
                breaks |= np.isin(t[1:], each.t_s[1:][jumped])
            for run in np.split(t, np.flatnonzero(breaks) + 1):
                segment += 1
                count = max(round(float(run[-1] - run[0]) / CELL_S), 1)
                parts = np.array_split(run, min(count, len(run)))
                rows += [(float(part[0]), float(part[-1]), segment, camera) for part in parts]
        start_s, end_s, segments, cameras = np.array(rows, float).reshape(-1, 4).T
        return cls(start_s, end_s, segments.astype(int), cameras.astype(int))

    def of(self, t: FloatArray, camera: int = 0) -> IntArray:
        """The cell of each time (n,) of a camera; -1 where there is none."""
        own = np.flatnonzero(self.camera == camera)
        if not len(own):
            return np.full(len(t), -1)
        index = own[np.clip(np.searchsorted(self.start_s[own], t + 1e-9, side="right") - 1, 0, None)]
        inside = (t >= self.start_s[index] - 1e-9) & (t <= self.end_s[index] + 1e-9)
        return np.where(inside, index, -1)

    def blocks(self) -> list[slice]:
        """Runs of cells that are judged together."""
        blocks = {
            (first, first + length)
            for length in LENGTHS
            for first in range(len(self) - length + 1)
            if self.segment[first] == self.segment[first + length - 1]
        }
        edges = np.flatnonzero(np.diff(self.segment, prepend=-1, append=len(self) + 1))
        blocks |= set(pairwise(edges.tolist()))
        return [slice(*block) for block in sorted(blocks)]


def in_cells(factors: CameraRows, shift: FloatArray, cell: IntArray, count: int) -> FloatArray:
    """Whitened columns (3 m, count w) of a joint that each cell's w quantities shift by (m, 3, w)."""
    spread, known = np.zeros((len(shift), 3, count, shift.shape[2])), np.flatnonzero(cell >= 0)
    spread[known, :, cell[known]] = shift[known]
    return factors.whitened(spread.reshape(len(shift), 3, -1))


@dataclass(frozen=True)
class CellEvidence:
    """What a window says of m cells' w quantities, all its variables eliminated."""

    information: FloatArray  # (m, w, m, w)
    vector: FloatArray  # (m, w)

    @classmethod
    def of(cls, system: LinearSystem, considered: Considered | None, count: int, width: int) -> CellEvidence:
        """Of the last extra columns; of those before, the first may be errors that are considered."""
        information, extras = np.array(system.information), system.extras
        own, others = np.arange(extras.stop - count * width, extras.stop), np.arange(extras.start)
        if considered is not None:
            errors = slice(extras.start, extras.start + SIZE)
            information[errors, errors] += np.linalg.inv(considered.covariance + 1e-12 * np.eye(SIZE))
            others = np.arange(errors.stop)
        information[others, others] += 1e-9 * np.maximum(information[others, others], 1.0)
        information, vector = eliminated(information, system.vector, own, others)
        return cls(information.reshape(count, width, count, width), vector.reshape(count, width))

    def change(self, cells: slice, rows: slice, allowed: FloatArray) -> tuple[FloatArray, float]:
        """Estimate of quantities that cells have in common, and its square in sigmas with what is allowed."""
        own = self.information[cells, rows, cells, rows].sum(axis=(0, 2))
        # a direction that nothing is known of has a large variance
        covariance = inverse(own + np.diag(np.maximum(1e-6 * np.diag(own), 1e-4)))
        size = covariance @ self.vector[cells, rows].sum(axis=0)
        return size, float(size @ np.linalg.solve(covariance + np.diag(allowed**2), size))


def block_columns(solved: SolvedWindow, cells: Cells) -> FloatArray:
    """Columns (r, 3 k) of the whitened Jacobian for a shift of each cell."""
    columns = np.zeros((len(solved.jacobian.rhs), 3 * len(cells)))
    for factors in camera_rows(solved):
        if factors.measured is not None:
            cell = cells.of(solved.window.t[factors.nodes], factors.camera)
            shift = np.tile(np.eye(3), (len(cell), 1, 1))
            columns[factors.rows] = in_cells(factors, shift, cell, len(cells))
    return columns


def block_shifts(system: LinearSystem, considered: Considered | None, cells: Cells) -> list[BlockShift]:
    """The shift of every block; the last extra columns are those of `block_columns`."""
    found, shifts = CellEvidence.of(system, considered, len(cells), 3), []
    for block in cells.blocks():
        shift_m, squared = found.change(block, slice(0, 3), SLOW_M)
        ends = float(cells.start_s[block.start]), float(cells.end_s[block.stop - 1])
        shifts.append(BlockShift(*ends, shift_m, squared / 3.0, int(cells.camera[block.start])))
    return shifts


def moments(window: Window) -> FloatArray:
    """Moments (m,) s at which a step is looked for."""
    seen = [each.t_s for each in window.joint_measurements]
    if not seen:
        return np.zeros(0)
    t = np.unique(np.concatenate(seen))
    hidden = np.flatnonzero(np.diff(t) > MISSING_S)
    found = [_moment_between(window, t[row], t[row + 1]) for row in hidden.tolist()]
    for a, b in pairwise([float(t[0]), *found, float(t[-1])]):
        count = int((b - a) / APART_S)
        found += (a + (b - a) * np.arange(1, count + 1) / (count + 1)).tolist()
    at = np.sort(np.array(found))
    return at[(at > t[0] + ENDS_S) & (at < t[-1] - ENDS_S)]


def _moment_between(window: Window, start_s: float, end_s: float) -> float:
    """The middle of a gap, or where the shoulder, if it is seen in it, clearly jumped."""
    if window.shoulder is not None:
        t, position = window.t[window.shoulder.node], window.shoulder.position
        rows = np.flatnonzero(np.isfinite(position[:, 0]) & (t >= start_s) & (t <= end_s))
        moved_m = np.linalg.norm(np.diff(position[rows], axis=0), axis=1)
        if len(moved_m) > 2 and moved_m.max() > JUMPED * np.median(moved_m):
            first = int(np.argmax(moved_m))
            return 0.5 * float(t[rows[first]] + t[rows[first + 1]])
    return 0.5 * float(start_s + end_s)


def step_columns(solved: SolvedWindow, at_s: FloatArray) -> FloatArray:  # (r, WIDTH m)
    """Columns of the whitened Jacobian for changes at moments (m,) s: a cell of them between each two."""
    window, states = solved.window, solved.states
    levers, shoulder = levers_of(solved.shared, window.priors.layout), solved.shoulder
    centre = states[FOREARM.name].p.mean(axis=0)
    columns = np.zeros((len(solved.jacobian.rhs), WIDTH * len(at_s)))
    for factors in camera_rows(solved):
        nodes, shift = factors.nodes, np.zeros((len(factors.nodes), 3, WIDTH))
        if factors.measured is None:
            place = np.zeros((len(nodes), 3)) if shoulder is None else shoulder[nodes]
        else:
            segment = window.priors.layout.segment_of(factors.joint)
            R, lever = states[segment].R[nodes], levers.get(factors.joint, np.zeros(3))
            place = states[segment].p[nodes] + R @ lever
            if segment == FOREARM.name and factors.joint in levers:
                shift[:, :, 6:9] = -R @ skew(lever)
                shift[:, :, 9:12] = R
            shift[:, :, 12] = velocity_at_nodes(factors.measured, states[factors.measured.segment])[0]
        shift[:, :, 0:3] = -skew(place - centre)
        shift[:, :, 3:6] = np.eye(3)
        cell = np.searchsorted(at_s, window.t[nodes], side="right") - 1
        columns[factors.rows] = in_cells(factors, shift, cell, len(at_s))
    return columns


def steps(solved: SolvedWindow) -> Iterator[Step]:
    """What may have changed for good: each kind at each moment, with its statistic."""
    window, considered = solved.window, solved.window.considered
    at_s = moments(window)
    if not len(at_s):
        return
    columns = step_columns(solved, at_s)
    try:
        system = solved.system([columns] if considered is None else [constant_error_columns(solved), columns])
    except np.linalg.LinAlgError:
        return
    kinds = dict(STEPS)
    if considered is not None and considered.stamp_sigma_s:
        del kinds["clock"]  # made-up stamps jump with every frame that was lost
    if len({each.camera for each in window.joint_measurements}) > 1:
        del kinds["camera"], kinds["place"]  # one of several that moved shows against the others
    found = CellEvidence.of(system, considered, len(at_s), WIDTH)
    for k, moment_s in enumerate(at_s.tolist()):
        for kind, (rows, allowed) in kinds.items():
            yield Step(kind, moment_s, *found.change(slice(k, None), rows, allowed))
