"""The prior on what all windows share: bias, gravity, upper-arm length, lever arms."""

from __future__ import annotations

from collections.abc import Iterator

import gtsam
import numpy as np
from gtsam import Unit3, noiseModel
from gtsam.symbol_shorthand import G, U

from ..array_types import FloatArray, IntArray
from ..window.problem import Priors, Window
from ..window.shared import SharedLayout
from .factors import bias_walk
from .variables import DIMENSION, keys_of, letter_of, values_of


def shared_factors(
    values: gtsam.Values,
    window: Window,
    biases: IntArray,  # int (n - 1,)
) -> Iterator[tuple[str, str, list[gtsam.NonlinearFactor], int]]:
    """A random walk of the biases (`BetweenFactor..`), one joint Gaussian prior (`HessianFactor`)."""
    priors, layout, count = window.priors, window.priors.layout, int(biases[-1]) + 1
    walk = noiseModel.Diagonal.Sigmas(priors.bias_walk * np.sqrt((window.t[-1] - window.t[0]) / count))
    insert_shared(values, layout, priors.shared.mean, range(count))
    for segment in layout.segments:
        first = keys_of(segment).bias
        yield "bias walk", segment, [bias_walk(k, k + 1, walk) for k in range(first, first + count - 1)], 6
    yield "prior", "", [prior_factor(priors, count // 2)], layout.size


def prior_factor(priors: Priors, bias: int) -> gtsam.LinearContainerFactor:
    """The joint Gaussian prior on what windows share, with this number of the biases."""
    layout, mean = priors.layout, priors.shared.mean
    # the prior's mean is the initial value, so only its information matrix is needed
    jacobian = shared_jacobian(layout, Unit3(layout.down(mean)))
    information = jacobian.T @ np.linalg.inv(priors.shared.covariance) @ jacobian
    upper_arm = [layout.upper_arm] if layout.has_upper_arm else []
    levers = [rows for segment in layout.segments for rows in layout.levers(segment).values()]
    first, *further = (layout.bias_of(segment) for segment in layout.segments)
    blocks = [first, layout.gravity, *upper_arm, *levers, *further]
    factor = gaussian_factor(shared_keys(layout, bias), blocks, 0.5 * (information + information.T))
    at = gtsam.Values()
    insert_shared(at, layout, mean, range(bias, bias + 1))
    return gtsam.LinearContainerFactor(factor, at)


def insert_shared(values: gtsam.Values, layout: SharedLayout, mean: FloatArray, biases: range) -> None:
    """Insert the initial values of what is shared, and of these numbers of the biases."""
    values.insert(G(0), Unit3(layout.down(mean)))
    if layout.has_upper_arm:
        values.insert(U(0), 0.0)
    for segment in layout.segments:
        keys, bias = keys_of(segment), gtsam.imuBias.ConstantBias(*np.split(mean[layout.bias_of(segment)], 2))
        for joint, rows in layout.levers(segment).items():
            values.insert(keys.lever_of(joint), mean[rows])
        for number in biases:
            values.insert(keys.bias + number, bias)


def shared_keys(layout: SharedLayout, bias: int) -> list[int]:
    """Keys of the shared variables in the order of the shared vector, with this number of the biases."""
    first, *further = (keys_of(segment).bias + bias for segment in layout.segments)
    return [first, G(0), *([U(0)] if layout.has_upper_arm else []), *lever_keys(layout), *further]


def lever_keys(layout: SharedLayout) -> list[int]:
    """Keys of all lever arms in the order of the shared vector."""
    return [
        keys_of(segment).lever_of(joint) for segment in layout.segments for joint in layout.levers(segment)
    ]


def shared_jacobian(layout: SharedLayout, down: Unit3) -> FloatArray:  # -> (s, s)
    """Shared vector's change for a change of GTSAM's own coordinates."""
    jacobian = np.eye(layout.size)
    jacobian[layout.upper_arm, layout.upper_arm] *= -1.0
    jacobian[layout.gravity, layout.gravity] = layout.gravity_axes @ down.basis()
    return jacobian


def gaussian_factor(
    keys: list[int],
    blocks: list[slice],
    information: FloatArray,  # (s, s)
    vector: FloatArray | None = None,  # (s,)
    error: float = 0.0,
) -> gtsam.HessianFactor:
    """A Gaussian over any number of variables, put together from its pairs."""
    vector = np.zeros(len(information)) if vector is None else vector
    pairs = gtsam.GaussianFactorGraph()
    for i, (key, rows) in enumerate(zip(keys, blocks, strict=True)):
        size = rows.stop - rows.start
        constant = 0.0 if i else 2.0 * error
        pairs.add(gtsam.HessianFactor(key, information[rows, rows], vector[rows], constant))
        for other, columns in zip(keys[i + 1 :], blocks[i + 1 :], strict=True):
            mine, its = np.zeros(size), np.zeros(columns.stop - columns.start)
            squares, across = (np.outer(mine, mine), np.outer(its, its)), information[rows, columns]
            pairs.add(gtsam.HessianFactor(key, other, squares[0], across, mine, squares[1], its, 0.0))
    return gtsam.HessianFactor(pairs)


#: Axes whose directions differ by more than this (a component) have turned; else gravity moved a little.
TURNED = 0.5


def gravity_axes(values: gtsam.Values) -> FloatArray:
    """The axes across gravity (3, 2) in {K} that GTSAM uses at some values."""
    return np.asarray(values.atUnit3(G(0)).basis())


def have_turned(before: FloatArray, now: FloatArray) -> bool:
    """Whether axes across gravity, (3, 2) each, are others than before."""
    return bool(np.abs(before.T @ now - np.eye(2)).max() > TURNED)


def turned_with_axes(
    factors: list[gtsam.NonlinearFactor],
    values: gtsam.Values,
    before: FloatArray,  # (3, 2)
) -> list[gtsam.NonlinearFactor]:
    """Gaussians written in the axes across gravity that are in use now."""
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
        blocks.append(slice(start, start + DIMENSION[letter_of(key)]))
        start = blocks[-1].stop
    linear = gtsam.GaussianFactorGraph()
    linear.push_back(factor.linearize(values))
    information, vector = linear.hessian(ordering)
    whole, rows = np.eye(start), blocks[keys.index(G(0))]
    whole[rows, rows] = turn
    information = whole.T @ information @ whole
    information = 0.5 * (information + information.T)
    turned = gaussian_factor(keys, blocks, information, whole.T @ np.ravel(vector), factor.error(values))
    return gtsam.LinearContainerFactor(turned, values_of(values, keys))
