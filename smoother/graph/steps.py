"""Whether something changed for good at some moment of a window: the camera's place, the mounting, the clock.

A step is a quantity that is zero before a moment and constant after it. It is no variable of the graph: it
enters the linearised equations as further columns, everything else eliminated, as if it had been solved for.
The test is one likelihood ratio for every kind and moment (Willsky and Jones, A generalized likelihood ratio
approach to the detection and estimation of jumps in linear systems, IEEE TAC 1976), with what sound cameras
and straps do allowed for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..array_types import FloatArray, IntArray
from ..body import FOREARM
from ..linalg import skew
from ..measurements.visibility import MISSING_S
from ..window.problem import States, Window
from ..window.solution import Step
from .build import FactorGroup
from .error_columns import camera_rows, offset_column
from .linear_system import Jacobian, LinearSystem, reduced_to_extras

#: Moments that are looked at: the middle of every gap, and so far apart elsewhere, s; so much of the window
#: lies before the first and after the last, s: in trials of 4 s a Kinect v1's slow errors look like a step.
APART_S, ENDS_S = 10.0, 3.0
#: Columns of a cell, in their order.
CAMERA, PLACE, MOUNTING, CLOCK = slice(0, 6), slice(3, 6), slice(6, 12), slice(12, 13)
KINDS = {"camera": CAMERA, "place": PLACE, "mounting": MOUNTING, "clock": CLOCK}
WIDTH = 13
#: What may change without anything being wrong, one sigma: a camera's slow errors turn with the posture, rad,
#: and move, m; a strap turns and slides a little; stamps of a frame's time, s.
ALLOWED = {
    "camera": np.repeat([0.02, 0.015], 3),
    "place": np.full(3, 0.015),
    "mounting": np.repeat([0.03, 0.01], 3),
    "clock": np.array([0.012]),
}


def moments(window: Window) -> FloatArray:
    """Moments (m,) s at which a step is looked for."""
    seen = [each.t_s for each in window.joint_measurements]
    if not seen:
        return np.zeros(0)
    t = np.unique(np.concatenate(seen))
    hidden = np.flatnonzero(np.diff(t) > MISSING_S)
    middles = 0.5 * (t[hidden] + t[hidden + 1])
    found: list[float] = middles.tolist()
    edges = [float(t[0]), *found, float(t[-1])]
    for a, b in pairwise(edges):
        count = int((b - a) / APART_S)
        found += (a + (b - a) * np.arange(1, count + 1) / (count + 1)).tolist()
    at = np.sort(np.array(found))
    return at[(at > t[0] + ENDS_S) & (at < t[-1] - ENDS_S)]


@dataclass(frozen=True)
class StepColumns:
    """The columns of steps in a window: a cell of them between each two moments."""

    window: Window
    groups: Sequence[FactorGroup]
    states: Mapping[str, States]
    levers: Mapping[str, FloatArray]
    shoulder: FloatArray | None  # (n, 3) m at the nodes
    at_s: FloatArray  # (m,)

    @property
    def count(self) -> int:
        """How many columns there are."""
        return WIDTH * len(self.at_s)

    def __call__(self, jacobian: Jacobian) -> FloatArray:
        """Columns (r, count) of the whitened Jacobian's first rows."""
        every = list(camera_rows(jacobian, self.window, self.groups))
        columns = np.zeros((max((each.rows.stop for each in every), default=0), self.count))
        if not self.count:
            return columns
        late = offset_column(jacobian, self.window, self.groups, self.states)
        centre = self.states[FOREARM.name].p.mean(axis=0)
        for factors in every:
            cell = np.searchsorted(self.at_s, self.window.t[factors.nodes], side="right") - 1
            shift = np.zeros((len(factors.nodes), 3, WIDTH))
            shift[:, :, :12] = self._shifts(factors.joint, factors.nodes, centre)
            own = factors.whitened(shift)
            if factors.rows.stop <= len(late) and factors.joint != "shoulder":
                own[:, CLOCK] = late[factors.rows]
            rows = np.arange(factors.rows.start, factors.rows.stop)
            of_row = np.repeat(cell, 3)
            for k in range(len(self.at_s)):
                mine = of_row == k
                columns[rows[mine], WIDTH * k : WIDTH * (k + 1)] = own[mine]
        return columns

    def _shifts(self, joint: str, nodes: IntArray, centre: FloatArray) -> FloatArray:
        """How a joint (m, 3) as the camera sees it follows camera and mounting, (m, 3, 12)."""
        shift = np.zeros((len(nodes), 3, 12))
        segment = self.window.priors.layout.segment_of(joint) if joint != "shoulder" else ""
        if joint == "shoulder":
            place = np.zeros((len(nodes), 3)) if self.shoulder is None else self.shoulder[nodes]
        else:
            own = self.states[segment]
            lever = self.levers.get(joint, np.zeros(3))
            place = own.p[nodes] + own.R[nodes] @ lever
            if segment == FOREARM.name and joint in self.levers:
                shift[:, :, 6:9] = -own.R[nodes] @ skew(lever)
                shift[:, :, 9:12] = own.R[nodes]
        shift[:, :, 0:3] = -skew(place - centre)
        shift[:, :, 3:6] = np.eye(3)
        return shift

    def steps(self, system: LinearSystem) -> Iterator[Step]:
        """The most significant step of each kind and moment, with its statistic."""
        if not self.count:
            return
        information, vector = reduced_to_extras(system, self.window.considered, self.count)
        kinds = dict(KINDS)
        if self.window.considered is not None and self.window.considered.stamp_sigma_s:
            del kinds["clock"]  # made-up stamps jump with every frame that was lost
        if len({each.camera for each in self.window.joint_measurements}) > 1:
            del kinds["camera"], kinds["place"]  # one of several that moved shows against the others
        m = len(self.at_s)
        by_cell = information.reshape(m, WIDTH, m, WIDTH)
        score = vector.reshape(m, WIDTH)
        for k in range(m):
            whole, pull = by_cell[k:, :, k:].sum(axis=(0, 2)), score[k:].sum(axis=0)
            for kind, rows in kinds.items():
                own = whole[rows, rows]
                own = own + np.diag(np.maximum(1e-6 * np.diag(own), 1e-4))
                covariance = np.linalg.inv(own)
                size = covariance @ pull[rows]
                allowed = covariance + np.diag(ALLOWED[kind] ** 2)
                squared = float(size @ np.linalg.solve(allowed, size))
                yield Step(kind, float(self.at_s[k]), size, squared)
