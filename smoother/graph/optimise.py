"""The optimum of a window's graph, also where a long gap has several.

In a gap of many seconds the camera shows where the arm disappears and reappears; in between the
upper arm keeps the elbow on a sphere about the shoulder, which is not convex: from a poor start the optimiser
ends in a minimum that is decimetres off. So windows with a long gap are solved in stages, the sphere loose
at first (graduated non-convexity; Blake and Zisserman, Visual Reconstruction, 1987), and the answer has to
pass a likelihood-ratio test against the solution with the loose sphere, which is unique in practice.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from ..array_types import FloatArray, IntArray
from ..linalg import runs
from ..window.problem import Window
from .build import (
    FactorGroup,
    bias_of_intervals,
    node_of_variables,
    upper_arm_factors,
    upper_arm_sigmas,
)
from .shared_prior import gravity_axes, have_turned, turned_with_axes
from .variables import keys_of

MAX_ITERATIONS = 12
#: The optimum is sought anew at most this many times because gravity's axes have turned.
MOST_TURNS = 3
#: Gaps from this length on are solved in stages, s.
LONG_S = 3.0
#: Sigma of the upper arm's length where it is to say next to nothing, m, and on the way from there.
LOOSE_M = 1.0
TIGHTER_M = (0.2, 0.05)
#: The upper arm is put in from the gap's ends inwards, in such steps, s.
STEP_S, FINE_STEP_S = 3.0, 1.0
#: Steps are even to this depth, s, and grow with this share of what lies beyond, or minutes would take long.
EVEN_S, GROWING = 15.0, 0.3
#: Other strategies are tried where the upper arm raises the error by more than this a knot (two thirds of
#: simulated windows stay below), unless the first two end within `SAME` of each other: they go different
#: ways, while the others may follow the first into the same wrong minimum.
USUAL, SAME = 0.25, 1.0
#: A sound window is refused so rarely: none of 1,257 simulated ones with gaps of 5 to 30 s, while 142 of 167
#: wrong minima were (those left are of 20 and 30 s, where only the search helps).
FALSE_ALARM = 1e-5
STAGE_ITERATIONS, STAGE_TOLERANCE = 10, 1e-2
LAST_ITERATIONS, LAST_TOLERANCE = 30, 1e-3


@dataclass(frozen=True)
class Optimum:
    """Where the optimiser ended."""

    graph: gtsam.NonlinearFactorGraph  # What the values are the optimum of
    values: gtsam.Values
    iterations: int  # Of all stages
    error: float  # Half the weighted squared sum
    accepted: bool = True  # The model explains long gaps; where False the graph's upper arm is loose in them


def optimise(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    groups: Sequence[FactorGroup],
    window: Window,
    tolerance: float,
    start: gtsam.Values | None = None,
) -> Optimum:
    """Optimise a window's graph (`LevenbergMarquardtOptimizer`), in stages where there is a long gap."""
    order = elimination_order(window, values)
    optimum = _in_stages(graph, start or values, groups, window, tolerance, order)
    return _in_axes_of_gravity(optimum, gravity_axes(values), tolerance, order)


def elimination_order(window: Window, values: gtsam.Values) -> gtsam.Ordering:
    """Variables in the order of their nodes' times, a bias after all nodes that use it; shared ones last."""
    biases = bias_of_intervals(window)
    turns = {key: (node, 0) for key, node in node_of_variables(window).items()}
    for number, last in enumerate(np.searchsorted(biases, np.arange(biases[-1] + 1), "right").tolist()):
        turns |= {keys_of(name).bias + number: (last, 1) for name in window.priors.layout.segments}
    border = (len(window.t), 0)
    order = gtsam.Ordering()
    for key in sorted(values.keys(), key=lambda key: (turns.get(key, border), key)):
        order.push_back(key)
    return order


def _in_axes_of_gravity(
    optimum: Optimum, before: FloatArray, tolerance: float, order: gtsam.Ordering
) -> Optimum:
    """The optimum where the prior on gravity is written in the axes that GTSAM uses there."""
    for _ in range(MOST_TURNS):
        now = gravity_axes(optimum.values)
        if not have_turned(before, now):
            break
        graph = gtsam.NonlinearFactorGraph(optimum.graph)
        for i in range(graph.size()):
            if isinstance(factor := graph.at(i), gtsam.LinearContainerFactor):
                graph.replace(i, turned_with_axes([factor], optimum.values, before)[0])
        again = _descend(graph, optimum.values, MAX_ITERATIONS, tolerance, order)
        iterations = optimum.iterations + again.iterations
        optimum, before = replace(again, iterations=iterations, accepted=optimum.accepted), now
    return optimum


def _in_stages(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    groups: Sequence[FactorGroup],
    window: Window,
    tolerance: float,
    order: gtsam.Ordering,
) -> Optimum:
    """The optimum, whatever the axes of gravity."""
    gap = _long_gap(window)
    if gap is None:
        return _descend(graph, values, MAX_ITERATIONS, tolerance, order)
    if (
        window.reaches_shoulder
    ):  # its start values are in the right minimum: the upper arm's direction is measured
        return _descend(graph, values, LAST_ITERATIONS, min(tolerance, LAST_TOLERANCE), order)
    (lengths,) = (group.factors for group in groups if group.kind == "length")

    def with_sigma(sigma_m: FloatArray) -> gtsam.NonlinearFactorGraph:
        changed = gtsam.NonlinearFactorGraph(graph)
        factors = upper_arm_factors(window, sigma_m, gap.knots)
        for knot, factor in zip(gap.knots.tolist(), factors, strict=True):
            changed.replace(lengths[knot], factor)
        return changed

    last_tolerance = min(tolerance, LAST_TOLERANCE)
    all_loose = with_sigma(np.full(len(gap.knots), LOOSE_M))
    loose = _descend(all_loose, values, LAST_ITERATIONS, last_tolerance, order)
    if window.loose_gaps:
        return loose
    tries, iterations = [], loose.iterations
    for number, stages in enumerate(gap.strategies(upper_arm_sigmas(window)[gap.knots], window.is_started)):
        values = values if window.is_started and not number else loose.values
        for sigma_m in stages:
            stage = _descend(with_sigma(sigma_m), values, STAGE_ITERATIONS, STAGE_TOLERANCE, order)
            values, iterations = stage.values, iterations + stage.iterations
        tries.append(_descend(graph, values, LAST_ITERATIONS, last_tolerance, order))
        tries.sort(key=lambda each: each.error)
        iterations += tries[0].iterations
        excess = tries[0].error - loose.error
        agree = len(tries) == 2 and tries[1].error - tries[0].error < SAME
        if excess < USUAL * len(gap.knots) or agree:
            break
    accepted = explained(excess, len(gap.knots))
    return replace(tries[0] if accepted else loose, iterations=iterations, accepted=accepted)


def explained(excess: float, knots: int) -> bool:
    """Whether the model explains a long gap: a likelihood-ratio test of the upper arm's length in it."""
    return chi_square_tail(excess, knots) > FALSE_ALARM


def chi_square_tail(half: float, freedom: int) -> float:
    """Probability that chi-square of this many degrees of freedom, 1 or more, exceeds 2 half."""
    if half <= 0.0:
        return 1.0
    first, tail = (0.5, math.erfc(math.sqrt(half))) if freedom % 2 else (1.0, math.exp(-half))
    steps = range((freedom - 1) // 2)
    return tail + sum(
        math.exp((first + k) * math.log(half) - half - math.lgamma(first + k + 1.0)) for k in steps
    )


def _descend(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    iterations: int,
    tolerance: float,
    order: gtsam.Ordering,
) -> Optimum:
    found = _gauss_newton(graph, values, iterations, tolerance, order)
    if found is not None:
        return found
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(iterations)
    params.setRelativeErrorTol(tolerance)
    params.setOrdering(order)
    params.setlambdaInitial(1e-9)  # close to Gauss-Newton as long as that lowers the error
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, params)
    values = optimizer.optimize()
    return Optimum(graph, values, optimizer.iterations(), optimizer.error())


def _gauss_newton(
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    iterations: int,
    tolerance: float,
    order: gtsam.Ordering,
) -> Optimum | None:
    """The optimum without damping, in seven eighths of the time; None where a step raises the error."""
    params = gtsam.GaussNewtonParams()
    params.setOrdering(order)
    optimizer = gtsam.GaussNewtonOptimizer(graph, values, params)
    error, least = optimizer.error(), params.getAbsoluteErrorTol()
    try:
        for _ in range(iterations):
            optimizer.iterate()
            before, error = error, optimizer.error()
            if not error <= before:
                return None
            if before - error <= max(tolerance * before, least):
                break
    except RuntimeError:  # a direction is free
        return None
    return Optimum(graph, optimizer.values(), optimizer.iterations(), error)


@dataclass(frozen=True)
class _LongGap:
    """Shoulder knots in long gaps, and how far each is from where its gap begins and ends, s."""

    knots: IntArray
    since_s: FloatArray
    until_s: FloatArray

    def strategies(self, sigma_m: FloatArray, is_started: bool) -> Iterator[Sequence[FloatArray]]:
        """Sigmas of the upper arm at the knots, stage by stage, of one strategy after the other."""
        if is_started:
            yield []
        nearest = np.minimum(self.since_s, self.until_s)

        def inwards(depth: FloatArray, step_s: float) -> list[FloatArray]:
            deepest = float(np.max(depth, where=np.isfinite(depth), initial=0.0))
            return [np.where(depth <= reach_s, sigma_m, LOOSE_M) for reach_s in _reaches(step_s, deepest)]

        yield inwards(nearest, STEP_S)
        yield [np.maximum(tighter, sigma_m) for tighter in TIGHTER_M]
        yield inwards(self.since_s, STEP_S)
        yield inwards(self.until_s, STEP_S)
        yield inwards(nearest, FINE_STEP_S)


def _reaches(step_s: float, deepest_s: float) -> Iterator[float]:
    """How far the upper arm is put in, stage by stage, s."""
    reach_s = step_s
    while reach_s < deepest_s:
        yield reach_s
        reach_s += max(step_s, GROWING * (reach_s - EVEN_S))


def _long_gap(window: Window) -> _LongGap | None:
    """The knots in gaps that are solved in stages; None where there are none."""
    if window.shoulder is None or not window.priors.layout.has_upper_arm:
        return None
    in_gap, knot_t = np.isfinite(window.velocity_change), window.t[window.shoulder.node]
    since, until = np.full(len(knot_t), np.nan), np.full(len(knot_t), np.nan)
    for rows in runs(in_gap):
        start_s, end_s = window.t[[rows.start, rows.stop]]
        if end_s - start_s >= LONG_S:
            inside = (knot_t >= start_s) & (knot_t <= end_s)
            since[inside] = knot_t[inside] - start_s if rows.start > 0 else np.inf
            until[inside] = end_s - knot_t[inside] if rows.stop < len(in_gap) else np.inf
    knots = np.flatnonzero(np.isfinite(since) | np.isfinite(until))
    return _LongGap(knots, since[knots], until[knots]) if len(knots) else None
