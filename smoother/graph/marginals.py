"""Marginal covariances of a window, also where GTSAM's Cholesky takes a weak direction for a free one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import gtsam
import numpy as np

from ..recording import FloatArray

#: Dimension of a variable by the letter of its key (see `build`).
_DIMENSION = {"x": 6, "v": 3, "b": 6, "g": 2, "u": 1, "l": 3, "s": 3, "y": 6, "w": 3, "c": 6, "e": 3, "m": 3}


class Marginals(Protocol):
    """What `solve` needs of marginals."""

    def marginalCovariance(self, key: int) -> FloatArray:
        """Covariance of one variable."""

    def jointMarginalCovariance(self, keys: Sequence[int]) -> Any:
        """Covariance of several, block by block through `at(a, b)`."""


def marginals_of(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Marginals:
    """GTSAM's `Marginals`, or the dense inverse of the information matrix where that gives up.

    Its elimination calls a variable indeterminate when one pivot is 4096 times smaller than the one
    before, which stiff short intervals reach on a system that is well determined.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Where the graph is linearised.

    Returns
    -------
    marginals : Marginals

    Raises
    ------
    numpy.linalg.LinAlgError
        The information matrix is singular indeed.
    """
    return _WithFallback(graph, values)


class _WithFallback:
    """GTSAM's marginals; it may give up when they are made, or at a single variable later."""

    def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        self._problem = graph, values
        self._marginals: Marginals
        try:
            self._marginals = gtsam.Marginals(graph, values)
        except RuntimeError as error:
            self._give_up(error)

    def marginalCovariance(self, key: int) -> FloatArray:
        return self._or_dense(lambda: self._marginals.marginalCovariance(key))

    def jointMarginalCovariance(self, keys: Sequence[int]) -> Any:
        return self._or_dense(lambda: self._marginals.jointMarginalCovariance(keys))

    def _or_dense(self, covariance: Callable[[], Any]) -> Any:
        try:
            return covariance()
        except RuntimeError as error:
            self._give_up(error)
            return covariance()

    def _give_up(self, error: RuntimeError) -> None:
        if "ndetermin" not in str(error):
            raise error
        self._marginals = _Dense(*self._problem)


class _Dense:
    """Marginals by inverting the whole information matrix: slow, for the rare window that needs it."""

    def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        information = np.asarray(graph.linearize(values).hessian()[0])
        keys = sorted(values.keys())
        sizes = [_DIMENSION[chr(gtsam.Symbol(key).chr())] for key in keys]
        ends = np.cumsum(sizes)
        self._rows = {key: slice(end - size, end) for key, size, end in zip(keys, sizes, ends, strict=True)}
        scale = 1.0 / np.sqrt(np.diag(information))
        factor = np.linalg.cholesky(information * scale[:, None] * scale)
        root = np.linalg.solve(factor, np.diag(scale))
        self._covariance = root.T @ root

    def marginalCovariance(self, key: int) -> FloatArray:
        return self.at(key, key)

    def jointMarginalCovariance(self, keys: Sequence[int]) -> _Dense:
        return self

    def at(self, a: int, b: int) -> FloatArray:
        return np.asarray(self._covariance[self._rows[a], self._rows[b]])
