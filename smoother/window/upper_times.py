"""The upper-arm IMU's motion at any times, from its nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..linalg import runs
from .problem import States
from .trajectory import Trajectory, at_times
from .upper_runs import PreparedRun


def upper_at(upper: Trajectory, prepared: Sequence[PreparedRun], at: FloatArray) -> States:
    """Pose and velocity of the upper-arm IMU at any times; orientation and all else nan without samples.

    Parameters
    ----------
    upper : Trajectory
        Its own (`Trajectory.upper`).
    prepared : sequence of PreparedRun
        Of the same segment.
    at : ndarray, shape (k,), s
        Increasing.

    Returns
    -------
    states : States
        At the k times.
    """
    states = States(
        np.full((len(at), 3, 3), np.nan), np.full((len(at), 3), np.nan), np.full((len(at), 3), np.nan)
    )
    known = np.isfinite(upper.states.p[:, 0])
    for run in prepared:
        mine = np.zeros_like(known)
        mine[run.first : run.first + len(run.start.p)] = True
        for nodes in runs(known & mine):
            inside = slice(
                *np.searchsorted(at, upper.t[[nodes.start, nodes.stop - 1]] + [0.0, 1e-9]).tolist()
            )
            if nodes.stop - nodes.start < 2 or inside.stop <= inside.start:
                continue
            own = States(*(getattr(upper.states, name)[nodes] for name in ("R", "p", "v")))
            motion = replace(
                upper, t=upper.t[nodes], states=own, bias=upper.bias[nodes], gravity=upper.gravity[nodes]
            )
            times = np.clip(at[inside], motion.t[0], motion.t[-1])
            answer = at_times(motion, run.signal, times)
            states.R[inside], states.p[inside], states.v[inside] = answer.R, answer.p, answer.v
    return states


def with_start(
    prepared: tuple[PreparedRun, ...], t: FloatArray, upper: Trajectory | None, before: Sequence[PreparedRun]
) -> tuple[PreparedRun, ...]:
    """The runs with an earlier solution's motion as start values, where it has any.

    Parameters
    ----------
    prepared : tuple of PreparedRun
    t : ndarray, shape (n,), s
        Their segment's nodes.
    upper : Trajectory or None
        The earlier solution.
    before : sequence of PreparedRun
        What that was solved with.
    """
    if upper is None:
        return prepared
    restarted = []
    for run in prepared:
        states = upper_at(upper, before, t[run.first : run.first + len(run.start.p)])
        good = np.isfinite(states.p[:, 0])
        start = States(
            np.where(good[:, None, None], states.R, run.start.R),
            np.where(good[:, None], states.p, run.start.p),
            np.where(good[:, None], states.v, run.start.v),
        )
        restarted.append(replace(run, start=start))
    return tuple(restarted)
