"""The drawn motions of a section's windows joined, as the answer is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from ..array_types import FloatArray
from .drawn_window import WindowDraws
from .problem import Window
from .solution import Solution
from .trajectory import mix, window_share


def merge_draws(t: FloatArray, windows: Sequence[Window], solutions: Sequence[Solution]) -> WindowDraws:
    """The windows' draws blended as `merge_windows` blends the answer.

    Parameters
    ----------
    t : ndarray, shape (n,), s
        The section's nodes; each window covers a run of them.
    windows : sequence of Window
        In order of time.
    solutions : sequence of Solution
        Of each, with draws.

    Returns
    -------
    draws : WindowDraws
        At the nodes; both windows drew nearly the same motion where they overlap, so that the blend keeps
        its variance.
    """
    merged: dict[str, FloatArray] = {}
    filled = np.zeros(len(t), dtype=bool)
    for window, solution in zip(windows, solutions, strict=True):
        assert solution.draws is not None
        knots = window.t if window.shoulder is None else window.t[window.shoulder.node]
        own, rows, share = window_share(t, window, filled)
        for name, values in solution.draws.at_nodes(knots, window.t).columns().items():
            column = merged.setdefault(name, np.zeros((values.shape[0], len(t), 3)))
            mix(np.moveaxis(column, 1, 0), rows, np.moveaxis(values[:, own], 1, 0), share)
        filled[rows] = True
    return WindowDraws(**{each.name: merged.get(each.name) for each in fields(WindowDraws)})  # type: ignore[arg-type]
