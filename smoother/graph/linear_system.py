"""A window's linearised graph as a chain in time with a border: covariances and reduced systems, exactly.

Poses, velocities and shoulder knots follow each other in time, so their normal equations are block
tridiagonal; what the whole window shares (biases, gravity, lengths, lever arms, and quantities that are
considered but not solved) borders them. One sweep forwards and one back give every covariance that is
asked for (Takahashi et al., 1973; block form as in the Rauch-Tung-Striebel smoother).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs
from scipy.sparse import coo_matrix, csr_matrix

from ..recording import FloatArray, IntArray

#: Dimension of a variable by the letter of its key (see `build`).
DIMENSION = {"x": 6, "v": 3, "b": 6, "g": 2, "u": 1, "l": 3, "s": 3}
DIMENSION |= {"y": 6, "w": 3, "c": 6, "e": 3, "m": 3}


def dimension(key: int) -> int:
    """How many coordinates a variable has."""
    return DIMENSION[chr(gtsam.Symbol(key).chr())]


@dataclass(frozen=True)
class Conditional:
    """A group of the chain given the next group and the border: a block row of the Cholesky factor.

    It is what GTSAM's `GaussianBayesNet` holds, a `GaussianConditional` a group.

    Attributes
    ----------
    columns : ndarray of int, shape (k,)
        Of the group in `LinearSystem.jacobian`.
    factor : ndarray, shape (k, k)
        Lower Cholesky factor of the group's information, scaled.
    gain : ndarray, shape (k, m), or None
        The group falls by this times the next one, both scaled; None of the last one.
    scale : ndarray, shape (k,)
        A coordinate is its scaled one times this.
    follows : ndarray, shape (k, b + e)
        The group falls by this times the border and the extra quantities, not scaled.
    """

    columns: IntArray
    factor: FloatArray
    gain: FloatArray | None
    scale: FloatArray
    follows: FloatArray


class LinearSystem:
    """The normal equations of a linearised graph, reduced to its border.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Every variable of the graph, where it is linearised.
    node_of : mapping of int to int
        The node whose time a variable has, by key; what is not in it belongs to the border.
    extra : callable, optional
        Gives columns (r, e) of the whitened Jacobian for quantities that are not variables of the graph, from
        the Jacobian and each variable's columns in it; rows beyond the r-th have none.

    Raises
    ------
    numpy.linalg.LinAlgError
        A direction is left free.
    """

    def __init__(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        node_of: Mapping[int, int],
        extra: Callable[[csr_matrix, Mapping[int, slice]], FloatArray] | None = None,
    ) -> None:
        keys = sorted(values.keys())  # the order in which GTSAM hands out columns
        sizes = np.array([dimension(key) for key in keys])
        starts = np.concatenate(([0], np.cumsum(sizes)))
        self._columns = {key: slice(a, b) for key, a, b in zip(keys, starts[:-1], starts[1:], strict=True)}
        row, column, value = graph.linearize(values).sparseJacobian_()
        row, column = row.astype(np.int64) - 1, column.astype(np.int64) - 1
        count, width = int(row.max(initial=-1)) + 1, int(starts[-1])
        jacobian = csr_matrix((value, (row, column)), shape=(count, width + 1))  # the last: right-hand side
        self.jacobian, self.rhs = jacobian[:, :width], jacobian[:, width].toarray().ravel()
        self._extra = np.zeros((0, 0)) if extra is None else extra(self.jacobian, self._columns)
        node = np.array([node_of.get(key, -1) for key in keys])
        node_of_column = np.repeat(node, sizes)
        self._border = np.flatnonzero(node_of_column < 0)
        self._border_row = np.full(width, -1)
        self._border_row[self._border] = np.arange(len(self._border))
        self._group(node_of_column)
        self._reduce()

    def columns(self, key: int) -> slice:
        """Columns of a variable in `jacobian`."""
        return self._columns[key]

    def _group(self, node_of_column: IntArray) -> None:
        """Nodes to groups so that no factor reaches beyond the neighbouring group."""
        chain = np.flatnonzero(node_of_column >= 0)
        pattern = self.jacobian[:, chain]
        entry_node = node_of_column[chain][pattern.indices]
        filled = np.flatnonzero(np.diff(pattern.indptr))
        first = np.minimum.reduceat(entry_node, pattern.indptr[filled])
        last = np.maximum.reduceat(entry_node, pattern.indptr[filled])
        reach = max(int((last - first).max(initial=1)), 3)
        group = node_of_column[chain] // reach
        order = np.argsort(group, kind="stable")
        self._groups = np.split(chain[order], np.flatnonzero(np.diff(group[order])) + 1)
        #: group and row in it of every column
        self._place = np.full((len(node_of_column), 2), -1)
        for g, columns in enumerate(self._groups):
            self._place[columns] = np.stack([np.full(len(columns), g), np.arange(len(columns))], axis=1)

    def _reduce(self) -> None:
        """Eliminate the chain: what is left of the information on the border and the extra columns."""
        A, E, b = self.jacobian, self._extra, self.rhs
        full = np.zeros((A.shape[0], E.shape[1]))
        full[: len(E)] = E
        chain = np.concatenate(self._groups)
        ends = np.cumsum([len(columns) for columns in self._groups])
        C, B = A[:, chain], A[:, self._border].toarray()
        side = np.column_stack([B, full, b])  # border, extra, right-hand side
        information = (C.T @ C).tocoo()
        scale = 1.0 / np.sqrt(
            np.bincount(information.row, information.data * (information.row == information.col))
        )
        self._scale = np.split(scale, ends[:-1])
        coupling = np.split(scale[:, None] * (C.T @ side), ends[:-1])
        own, following = self._blocks(information, scale, ends)
        self._factors: list[FloatArray] = []
        self._gains: list[FloatArray] = []
        forward: list[FloatArray] = []
        for g, D in enumerate(own):
            r = coupling[g]
            if g > 0:  # what the groups before say of this one
                across = following[g - 1]
                gain = _solve(self._factors[-1], across)
                self._gains.append(gain)
                D, r = D - across.T @ gain, r - across.T @ forward[-1]
            self._factors.append(_cholesky(D))
            forward.append(_solve(self._factors[-1], r))
        solved = [forward[-1]]
        for g in range(len(own) - 2, -1, -1):
            solved.append(forward[g] - self._gains[g] @ solved[-1])
        solved.reverse()
        borders = len(self._border)
        total = side.T @ side - sum(c.T @ z for c, z in zip(coupling, solved, strict=True))
        total = 0.5 * (total + total.T)
        self._solved = [z * s[:, None] for z, s in zip(solved, self._scale, strict=True)]
        #: information (b + e, b + e) and vector (b + e,) on the border's variables and the extra columns
        self.information, self.vector = total[:-1, :-1], total[:-1, -1]
        self._shared_covariance = _inverse(self.information[:borders, :borders])

    def _blocks(
        self, information: coo_matrix, scale: FloatArray, ends: IntArray
    ) -> tuple[list[FloatArray], list[FloatArray]]:
        """Scaled information within each group, and of each with the next."""
        sizes = np.diff(ends, prepend=0)
        group = np.repeat(np.arange(len(sizes)), sizes)
        within = np.arange(len(group)) - np.repeat(ends - sizes, sizes)
        row, column = information.row, information.col
        value = information.data * scale[row] * scale[column]
        blocks = []
        for step in (0, 1):  # a group's columns, then the next one's
            width = sizes[step:]
            height = sizes[: len(width)]
            start = np.concatenate(([0], np.cumsum(height * width)))
            mine = group[column] == group[row] + step
            i, j = row[mine], column[mine]
            flat = np.zeros(start[-1])
            flat[start[group[i]] + within[i] * width[group[i]] + within[j]] = value[mine]
            blocks.append(
                [
                    flat[a:b].reshape(h, w)
                    for a, b, h, w in zip(start[:-1], start[1:], height, width, strict=True)
                ]
            )
        return blocks[0], blocks[1]

    @property
    def extras(self) -> slice:
        """The extra columns in `information` and `vector`."""
        return slice(len(self._border), len(self.information))

    def border_rows(self, keys: Sequence[int]) -> IntArray:
        """Rows of border variables in `information` and `vector`, one after the other."""
        return np.concatenate([self._border_row[self._columns[key]] for key in keys])

    def shared_covariance(self, keys: Sequence[int]) -> FloatArray:
        """Joint covariance of border variables, in the order of the keys; extra quantities held fixed."""
        rows = self.border_rows(keys)
        return np.asarray(self._shared_covariance[np.ix_(rows, rows)])

    @cached_property
    def _diagonal(self) -> list[FloatArray]:
        """Covariance within each group, the border held fixed, in scaled coordinates."""
        blocks = [_inverse_of(self._factors[-1])]
        for g in range(len(self._groups) - 2, -1, -1):
            gain = self._gains[g]
            blocks.append(_inverse_of(self._factors[g]) + gain @ blocks[-1] @ gain.T)
        return blocks[::-1]

    def covariance(self, key: int) -> FloatArray:
        """Covariance of a variable in time; extra quantities held fixed."""
        group, rows = self._rows(key)
        scale = self._scale[group][rows]
        own = self._diagonal[group][np.ix_(rows, rows)] * scale[:, None] * scale
        follows = self._solved[group][rows, : len(self._border)]
        return np.asarray(own + follows @ self._shared_covariance @ follows.T)

    def sensitivity(self, key: int, shared: FloatArray) -> FloatArray:
        """How a variable in time follows the extra quantities, (dimension, e).

        Parameters
        ----------
        key : int
        shared : ndarray, shape (b, e)
            How the border follows them (`shared_sensitivity`).
        """
        group, rows = self._rows(key)
        solved = self._solved[group][rows]
        borders = len(self._border)
        return np.asarray(-solved[:, self.extras] - solved[:, :borders] @ shared)

    def shared_sensitivity(self, pull: FloatArray | None = None) -> FloatArray:
        """How the border's variables follow the extra quantities, (b, e).

        Parameters
        ----------
        pull : ndarray, shape (b, e), optional
            Information of the border's prior times how its mean follows them; it does not where None.
        """
        borders = len(self._border)
        across = self.information[:borders, self.extras]
        return np.asarray(self._shared_covariance @ ((0.0 if pull is None else pull) - across))

    def conditionals(self) -> Iterator[Conditional]:
        """The groups of the chain, each given what comes after it, from the last to the first."""
        gains = [*self._gains, None]
        for g in range(len(self._groups) - 1, -1, -1):
            follows = self._solved[g][:, : len(self.information)]
            yield Conditional(self._groups[g], self._factors[g], gains[g], self._scale[g], follows)

    def _rows(self, key: int) -> tuple[int, IntArray]:
        columns = self._columns[key]
        place = self._place[columns]
        return int(place[0, 0]), place[:, 1]


def _inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a positive definite matrix, scaled to unit diagonal first."""
    if not len(matrix):
        return matrix
    diagonal = np.diag(matrix)
    if not (diagonal > 0).all():
        raise np.linalg.LinAlgError("a shared quantity is left free")
    scale = 1.0 / np.sqrt(diagonal)
    inverse = _inverse_of(_cholesky(matrix * scale[:, None] * scale))
    return np.asarray(inverse * scale[:, None] * scale)


def _inverse_of(factor: FloatArray) -> FloatArray:
    return _solve(factor, np.eye(len(factor)))


def _cholesky(matrix: FloatArray) -> FloatArray:
    """Lower factor; LAPACK itself, since checks and conversions cost more than blocks of some thirty rows."""
    factor, info = dpotrf(matrix, lower=1)
    if info:
        raise np.linalg.LinAlgError("a direction is left free")
    return np.asarray(factor)


def _solve(factor: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(dpotrs(factor, right, lower=1)[0])
