"""Motions drawn from a window's posterior: `GaussianBayesNet.sample` for the chain with a border.

`LinearSystem` contains the factorisation that GTSAM's Bayes net is: each group of nodes given the next one
and the border. The border is drawn first, then the groups from the last to the first (back substitution). The
order of elimination is that of the nodes' times, and the random numbers are the nodes' own, so that
neighbouring windows draw the same motion where they overlap.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from gtsam.symbol_shorthand import S, V, X

from ..array_types import FloatArray
from ..body import FOREARM, SEGMENTS
from ..linalg import interpolate
from ..window.draw_plan import DrawPlan, root_of
from ..window.problem import Window
from ..window.shared import STRAP_PLACE
from ..window.solution import WindowDraws
from .build import node_of_variables
from .columns import is_place
from .linear_system import LinearSystem
from .solved import SolvedWindow
from .variables import DIMENSION, keys_of, letter_of

#: Every segment has its own stream of random numbers, so that a further IMU changes nothing of the others'.
#: By segment the letters of a node's variables that it is for.
_LETTERS = {
    segment.name: segment.letters[:2] + (segment.letters[4:] if segment.parent else "s")
    for segment in SEGMENTS.values()
}
#: Random numbers of the biases belong to slices of time of this length, s, as windows cut them differently.
_SLICE_S = 0.5


def sample_window(
    solved: SolvedWindow, system: LinearSystem, plan: DrawPlan, lost: FloatArray
) -> WindowDraws:
    """Draw motions with the covariance that the window states (GTSAM: `GaussianBayesNet.sample`)."""
    window, R = solved.window, solved.bodies[0].states.R
    # 1. What all windows share, drawn once, and the biases given that.
    jacobian = solved.shared_jacobian
    shared = jacobian @ system.shared_covariance(solved.shared_keys) @ jacobian.T
    border = _border(solved, system, shared, plan)
    # 2. Errors that are considered: constant over the recording, and of made-up frame times.
    considered, given = plan.considered_errors(window.t), border
    if system.considered is not None and considered is not None:
        given = np.concatenate([border + considered @ system.follows.T, considered], axis=1)
    # 3. The chain, node by node from the last.
    errors = system.sample(_normals_of_columns(system, window, plan), given)

    width = errors.shape[1]

    def of(keys: list[int]) -> FloatArray:
        columns = np.concatenate([np.arange(width)[system.columns(key)] for key in keys])
        return errors[:, columns].reshape(plan.count, len(keys), -1)

    # 4. From GTSAM's (rotation, translation) in the body's axes to the camera's.
    count = range(len(window.t))
    body = of([X(i) for i in count])
    rotation = np.einsum("nij,knj->kni", R, body[:, :, :3])
    rotation += (plan.once("attitude", 3) @ root_of(lost))[:, None]
    shoulder = None
    if window.shoulder is not None:
        knots = of([S(k) for k in range(len(window.shoulder.node))])
        at_nodes = interpolate(window.t[window.shoulder.node], np.moveaxis(knots, 1, 0), window.t)
        shoulder = np.moveaxis(at_nodes, 0, 1)
    place = body[:, :, 3:]
    if considered is not None and any(is_place(each.joint, window) for each in window.joint_measurements):
        place = place + considered[:, None, STRAP_PLACE]  # the answer is to be at the tracked point
    return WindowDraws(
        position=np.einsum("nij,knj->kni", R, place),
        rotation=rotation,
        velocity=of([V(i) for i in count]),
        shoulder=shoulder,
        shared_covariance=shared,
        levers={
            joint: given[:, system.border_rows([keys_of(FOREARM.name).lever_of(joint)])]
            for joint in window.priors.layout.joints
        },
        turns={name: _turns(solved, name, plan, of) for name in window.priors.layout.further},
    )


def _turns(
    solved: SolvedWindow, segment: str, plan: DrawPlan, of: Callable[[list[int]], FloatArray]
) -> FloatArray:
    """Rotation errors of a further IMU at all nodes; nan where it has no samples."""
    window, R, pose = solved.window, solved.states[segment].R, keys_of(segment).pose
    rotation = np.full((plan.count, len(window.t), 3), np.nan)
    for run in window.runs(segment):
        turns = of([pose + i for i in range(run.first, run.nodes.stop)])[:, :, :3]
        rotation[:, run.nodes] = np.einsum("nij,knj->kni", R[run.nodes], turns)
    return rotation


def _border(solved: SolvedWindow, system: LinearSystem, shared: FloatArray, plan: DrawPlan) -> FloatArray:
    """Errors (count, b) of the border's variables: the shared vector, then the other biases given it."""
    size = system.extras.start
    border = np.zeros((plan.count, size))
    known = system.border_rows(solved.shared_keys)
    border[:, known] = plan.shared_errors(shared) @ np.linalg.inv(solved.shared_jacobian).T
    others = np.setdiff1d(np.arange(size), known)  # biases, in the order of time
    if len(others):
        own = system.information[np.ix_(others, others)]
        scale = 1.0 / np.sqrt(np.diag(own))
        factor = np.linalg.cholesky(own * scale * scale[:, None])
        across = system.information[np.ix_(others, known)] @ border[:, known].T
        pull = np.linalg.solve(factor, scale[:, None] * across)
        normals = _bias_normals(solved, system, plan)[:, others].T
        border[:, others] = (scale[:, None] * np.linalg.solve(factor.T, normals - pull)).T
    return border


def _bias_normals(solved: SolvedWindow, system: LinearSystem, plan: DrawPlan) -> FloatArray:
    """Standard normals (count, b) of the border's rows that are biases; zero of the others."""
    window, normals = solved.window, np.zeros((plan.count, system.extras.start))
    edges = np.linspace(window.t[0], window.t[-1], int(solved.biases[-1]) + 2)
    first = np.ceil(edges / _SLICE_S - 0.5).astype(int)
    slices = (np.arange(first[0], first[-1] + 1) + 0.5) * _SLICE_S
    for segment in window.priors.layout.segments:
        numbers = plan.at_times(f"bias {segment}", slices, 6)
        for k, (start, end) in enumerate(pairwise((first - first[0]).tolist())):
            own = numbers[:, start : max(end, start + 1)]
            rows = system.border_rows([keys_of(segment).bias + k])
            normals[:, rows] = own.sum(axis=1) / np.sqrt(own.shape[1])
    return normals


def _normals_of_columns(system: LinearSystem, window: Window, plan: DrawPlan) -> FloatArray:
    """Standard normals (count, columns) of all variables in time, a node's its own; zero of the others."""
    normals = np.zeros((plan.count, system.jacobian.width))
    by_letter: dict[str, dict[int, int]] = {}
    for key, node in node_of_variables(window).items():
        by_letter.setdefault(letter_of(key), {})[key] = node
    for segment, letters in _LETTERS.items():
        if letters[0] not in by_letter:
            continue
        sizes = [DIMENSION[letter] for letter in letters]
        numbers = plan.at_times(f"node {segment}", window.t, sum(sizes))
        parts = np.split(numbers, np.cumsum(sizes)[:-1], axis=2)
        for letter, part in zip(letters, parts, strict=True):
            if nodes := by_letter.get(letter):  # keys of a letter follow each other, as columns do
                columns = slice(system.columns(min(nodes)).start, system.columns(max(nodes)).stop)
                normals[:, columns] = part[:, list(nodes.values())].reshape(plan.count, -1)
    return normals
