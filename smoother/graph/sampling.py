"""Motions drawn from a window's posterior: `GaussianBayesNet.sample` for the chain with a border.

`LinearSystem` contains the factorisation that GTSAM's Bayes net is: each group of nodes given the next one
and the border. The border is drawn first, then the groups from the last to the first (back substitution). The
order of elimination is that of the nodes' times, and the random numbers are the nodes' own, so that
neighbouring windows draw the same motion where they overlap.
"""

from __future__ import annotations

from collections.abc import Callable

import gtsam
import numpy as np
from gtsam.symbol_shorthand import G, S, V, X

from ..array_types import FloatArray, IntArray
from ..body import FOREARM, SEGMENTS, UPPER_ARM
from ..window.draw_plan import DrawPlan, root_of
from ..window.problem import Window
from ..window.shared import STRAP_PLACE
from ..window.solution import WindowDraws
from .build import node_of_variables
from .error_columns import is_place
from .linear_system import LinearSystem
from .shared_prior import shared_jacobian, shared_keys
from .variables import DIMENSION, keys_of

#: Streams of random numbers: forearm and upper arm share one, any other segment has its own, so that its
#: being there changes nothing of theirs. By stream the letters of a node's variables in their order.
_SHARED_STREAM = (FOREARM.name, UPPER_ARM.name)
_LETTERS = {"node": "xvsywe"} | {
    f"node {name}": segment.letters[0] + segment.letters[1] + segment.letters[4]
    for name, segment in SEGMENTS.items()
    if name not in _SHARED_STREAM
}
_WIDTHS = {stream: sum(DIMENSION[each] for each in letters) for stream, letters in _LETTERS.items()}
#: Where a variable's numbers begin, one stream after the other.
_FIRST = dict(
    zip(
        "".join(_LETTERS.values()),
        np.cumsum([0, *(DIMENSION[each] for each in "".join(_LETTERS.values()))])[:-1].tolist(),
        strict=True,
    )
)
#: Random numbers of the biases belong to slices of time of this length, s, as windows cut them differently.
_SLICE_S = 0.5


def sample_window(
    system: LinearSystem,
    values: gtsam.Values,
    window: Window,
    biases: IntArray,
    plan: DrawPlan,
    shared_sensitivity: FloatArray | None,
    lost: FloatArray,
) -> WindowDraws:
    """Draw motions with the covariance that the window states (GTSAM: `GaussianBayesNet.sample`).

    Parameters
    ----------
    system : LinearSystem
        At the solution.
    values : gtsam.Values
        The solution.
    window : Window
    biases : ndarray of int, shape (n - 1,)
        From `bias_of_intervals`.
    plan : DrawPlan
    shared_sensitivity : ndarray, shape (b, e), or None
        How the border follows considered errors; None without any.
    lost : ndarray, shape (3, 3), rad^2
        Covariance of the attitude, in {K}, that the solver's priors lack.

    Returns
    -------
    draws : WindowDraws
    """
    nodes = node_of_variables(window)
    # 1. What all windows share, drawn once, and the biases given that.
    border = _border(system, values, window, biases, plan)
    # 2. The chain, node by node from the last.
    errors = _chain(system, nodes, window.t, border, plan)
    # 3. Errors that are considered: constant over the recording, and of made-up frame times.
    considered = plan.considered_errors(window.t)
    if shared_sensitivity is not None and considered is not None:
        _add_considered(errors, system, shared_sensitivity, considered)

    width = errors.shape[1]

    def of(keys: list[int]) -> FloatArray:
        columns = np.concatenate([np.arange(width)[system.columns(key)] for key in keys])
        return errors[:, columns].reshape(plan.count, len(keys), -1)

    # 4. From GTSAM's (rotation, translation) in the body's axes to the camera's.
    count = range(len(window.t))
    R = np.array([values.atPose3(X(i)).rotation().matrix() for i in count])
    body = of([X(i) for i in count])
    rotation = np.einsum("nij,knj->kni", R, body[:, :, :3])
    rotation += (plan.once("attitude", 3) @ root_of(lost))[:, None]
    shoulder = None
    if window.shoulder is not None:
        shoulder = of([S(k) for k in range(len(window.shoulder.node))])
    place = body[:, :, 3:]
    if considered is not None and any(is_place(each.joint, window) for each in window.joint_measurements):
        place = place + considered[:, None, STRAP_PLACE]  # the answer is to be at the tracked point
    return WindowDraws(
        position=np.einsum("nij,knj->kni", R, place),
        rotation=rotation,
        velocity=of([V(i) for i in count]),
        shoulder=shoulder,
        turns={name: _turns(values, window, name, plan, of) for name in window.priors.layout.further},
    )


def _turns(
    values: gtsam.Values, window: Window, segment: str, plan: DrawPlan, of: Callable[[list[int]], FloatArray]
) -> FloatArray:
    """Rotation errors of a further IMU at all nodes; nan where it has no samples."""
    rotation = np.full((plan.count, len(window.t), 3), np.nan)
    for run in window.runs(segment):
        rows, pose = range(run.first, run.nodes.stop), keys_of(run.segment).pose
        R = np.array([values.atPose3(pose + i).rotation().matrix() for i in rows])
        rotation[:, rows] = np.einsum("nij,knj->kni", R, of([pose + i for i in rows])[:, :, :3])
    return rotation


def _border(
    system: LinearSystem, values: gtsam.Values, window: Window, biases: IntArray, plan: DrawPlan
) -> FloatArray:
    """Errors (count, b) of the border's variables: the shared vector, then the other biases given it."""
    keys = shared_keys(window, biases)
    jacobian = shared_jacobian(window.priors.layout, values.atUnit3(G(0)))
    covariance = jacobian @ system.shared_covariance(keys) @ jacobian.T
    size = system.extras.start
    border = np.zeros((plan.count, size))
    known = system.border_rows(keys)
    border[:, known] = plan.shared_errors(covariance) @ np.linalg.inv(jacobian).T
    others = np.setdiff1d(np.arange(size), known)  # biases, in the order of time
    if len(others):
        own = system.information[np.ix_(others, others)]
        scale = 1.0 / np.sqrt(np.diag(own))
        factor = np.linalg.cholesky(own * scale * scale[:, None])
        # small systems: NumPy's general solver, as SciPy's triangular one would have to be imported
        pull = np.linalg.solve(
            factor, scale[:, None] * system.information[np.ix_(others, known)] @ border[:, known].T
        )
        normals = _bias_normals(system, window, biases, plan)[:, others].T
        border[:, others] = (scale[:, None] * np.linalg.solve(factor.T, normals - pull)).T
    return border


def _bias_normals(system: LinearSystem, window: Window, biases: IntArray, plan: DrawPlan) -> FloatArray:
    """Standard normals (count, b) of the border's rows that are biases; zero of the others.

    A bias covers some seconds; its numbers are sums over slices of that time.
    """
    normals = np.zeros((plan.count, system.extras.start))
    start, end, count = window.t[0], window.t[-1], int(biases[-1]) + 1
    edges = np.linspace(start, end, count + 1)
    first = np.ceil(edges / _SLICE_S - 0.5).astype(int)
    for number, segment in enumerate(window.priors.layout.segments):
        bias, shares = keys_of(segment).bias, segment in _SHARED_STREAM
        stream, at = ("bias", 6 * number) if shares else (f"bias {segment}", 0)
        for k in range(count):
            slices = (np.arange(first[k], max(first[k + 1], first[k] + 1)) + 0.5) * _SLICE_S
            width = 6 * len(_SHARED_STREAM) if shares else 6
            of_slices = plan.at_times(stream, slices, width)[:, :, at : at + 6]
            rows = system.border_rows([bias + k])
            normals[:, rows] = of_slices.sum(axis=1) / np.sqrt(len(slices))
    return normals


def _chain(
    system: LinearSystem, nodes: dict[int, int], t: FloatArray, border: FloatArray, plan: DrawPlan
) -> FloatArray:
    """Errors (count, columns) of all variables in time, given the border's; zero of the border."""
    width = system.jacobian.width
    letters = {chr(gtsam.Symbol(key).chr()) for key in nodes}
    normals = plan.at_times("node", t, _WIDTHS["node"])
    for name, own_width in list(_WIDTHS.items())[1:]:
        met = not letters.isdisjoint(_LETTERS[name])
        more = plan.at_times(name, t, own_width) if met else np.zeros((plan.count, len(t), own_width))
        normals = np.concatenate([normals, more], axis=2)
    # the node of each column, and which of the node's random numbers it has
    place = np.full((width, 2), -1)
    for key, node in nodes.items():
        letter = chr(gtsam.Symbol(key).chr())
        place[system.columns(key), 0] = node
        place[system.columns(key), 1] = _FIRST[letter] + np.arange(DIMENSION[letter])
    errors = np.zeros((plan.count, width))
    after = np.zeros((0, plan.count))
    for group in system.conditionals():
        node, number = place[group.columns].T
        order = np.lexsort((number, node))  # by time, however nodes are grouped
        own = normals[:, node[order], number[order]].T
        drawn = np.empty_like(own)
        drawn[order] = np.linalg.solve(_reordered(group.factor, order).T, own)
        if group.gain is not None:
            drawn -= group.gain @ after
        after = drawn
        follows = group.follows[:, : border.shape[1]] @ border.T
        errors[:, group.columns] = (group.scale[:, None] * drawn - follows).T
    return errors


def _reordered(factor: FloatArray, order: IntArray) -> FloatArray:
    """Lower Cholesky factor of the same information with its rows in another order.

    By QR, which never fails: drawing must not decide whether a window is treated as determined.
    """
    upper = np.linalg.qr(np.tril(factor)[order].T, mode="r")
    return np.asarray((upper * np.sign(np.diag(upper))[:, None]).T)


def _add_considered(
    errors: FloatArray, system: LinearSystem, shared: FloatArray, considered: FloatArray
) -> None:
    """What considered errors (count, e) add, in place."""
    borders = len(shared)
    for group in system.conditionals():
        own = group.follows[:, borders : borders + considered.shape[1]]
        sensitivity = -own - group.follows[:, :borders] @ shared
        errors[:, group.columns] += considered @ sensitivity.T
