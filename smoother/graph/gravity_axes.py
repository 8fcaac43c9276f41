"""The two axes in which GTSAM counts changes of gravity, and Gaussians that were written in other ones.

`Unit3` measures a change of a direction along two axes across it, which it makes from the coordinate axis
that the direction is farthest from. Where two are about as far (a level camera: gravity is near its y), a
hair's breadth turns the axes by 90 degrees. Factors that are linearised anew do not mind; a Gaussian that
stays (`LinearContainerFactor`) is of the axes that there were, and has to be turned with them.
"""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import G

from ..array_types import FloatArray
from .shared_prior import gaussian_factor
from .variables import DIMENSION, values_of

#: Axes whose directions differ by more than this (a component) have turned; else gravity moved a little.
TURNED = 0.5


def gravity_axes(values: gtsam.Values) -> FloatArray:
    """The axes across gravity (3, 2) in {K} that GTSAM uses at some values."""
    return np.asarray(values.atUnit3(G(0)).basis())


def have_turned(before: FloatArray, now: FloatArray) -> bool:
    """Whether axes across gravity, (3, 2) each, are others than before."""
    return bool(np.abs(before.T @ now - np.eye(2)).max() > TURNED)


def turned_with_axes(
    factors: list[gtsam.NonlinearFactor], values: gtsam.Values, before: FloatArray
) -> list[gtsam.NonlinearFactor]:
    """Gaussians written in the axes across gravity that are in use now.

    Parameters
    ----------
    factors : list of gtsam.NonlinearFactor
        Those on gravity are `LinearContainerFactor`s; others stay as they are.
    values : gtsam.Values
        The present ones; the Gaussians are then linear about them.
    before : ndarray, shape (3, 2)
        The axes in {K} that the Gaussians were written in.

    Returns
    -------
    factors : list of gtsam.NonlinearFactor
        In the same order.
    """
    left, _, right = np.linalg.svd(before.T @ gravity_axes(values))
    turn = left @ right
    return [_turned(factor, values, turn) if G(0) in set(factor.keys()) else factor for factor in factors]


def _turned(
    factor: gtsam.NonlinearFactor, values: gtsam.Values, turn: FloatArray
) -> gtsam.LinearContainerFactor:
    """One Gaussian, its changes of gravity turned (2, 2)."""
    keys, ordering, blocks, start = list(factor.keys()), gtsam.Ordering(), [], 0
    for key in keys:
        ordering.push_back(key)
        blocks.append(slice(start, start + DIMENSION[chr(gtsam.Symbol(key).chr())]))
        start = blocks[-1].stop
    linear = gtsam.GaussianFactorGraph()
    linear.push_back(factor.linearize(values))
    information, vector = linear.hessian(ordering)
    whole = np.eye(start)
    rows = blocks[keys.index(G(0))]
    whole[rows, rows] = turn
    information = whole.T @ information @ whole
    information = 0.5 * (information + information.T)
    turned = gaussian_factor(keys, blocks, information, whole.T @ np.ravel(vector), factor.error(values))
    return gtsam.LinearContainerFactor(turned, values_of(values, keys))
