"""What leaves a lag window stays as a Gaussian on what it was connected to (GTSAM).

All factors that touch a variable are linearised and it is eliminated (a fixed-lag smoother; Dong-Si and
Mourikis, ICRA 2011).
"""

from __future__ import annotations

from collections.abc import Sequence

import gtsam

from .variables import values_of


def marginalise(
    factors: Sequence[gtsam.NonlinearFactor], values: gtsam.Values, leaving: Sequence[int]
) -> list[gtsam.NonlinearFactor]:
    """Eliminate variables.

    Parameters
    ----------
    factors : sequence of gtsam.NonlinearFactor
        All that touch them, and any others.
    values : gtsam.Values
        Where to linearise; the variables are erased from it.
    leaving : sequence of int
        Keys of the variables, in the order of elimination.

    Returns
    -------
    factors : list of gtsam.NonlinearFactor
        The others as they were, then Gaussians (`LinearContainerFactor`) on what stays.
    """
    touching, rest = split(factors, set(leaving))
    graph, order = gtsam.NonlinearFactorGraph(), gtsam.Ordering()
    for factor in touching:
        graph.add(factor)
    for key in leaving:
        order.push_back(key)
    _, gaussians = graph.linearize(values).eliminatePartialSequential(order)
    for i in range(gaussians.size()):
        gaussian = gaussians.at(i)
        if gaussian is not None:
            rest.append(gtsam.LinearContainerFactor(gaussian, values_of(values, gaussian.keys())))
    for key in leaving:
        values.erase(key)
    return rest


def split(
    factors: Sequence[gtsam.NonlinearFactor], keys: set[int]
) -> tuple[list[gtsam.NonlinearFactor], list[gtsam.NonlinearFactor]]:
    """The factors that touch some variables, and those that do not."""
    touching = [factor for factor in factors if keys & set(factor.keys())]
    return touching, [factor for factor in factors if not keys & set(factor.keys())]
