"""A window's linearised graph as a chain in time with a border: covariances and reduced systems, exactly.

Poses, velocities and shoulder knots follow each other in time, so their normal equations are block
tridiagonal; what the whole window shares (biases, gravity, lengths, lever arms, and quantities that are
considered but not solved) borders them. One sweep forwards and one back give every covariance that is
asked for (Takahashi et al., 1973; block form as in the Rauch-Tung-Striebel smoother).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import gtsam
import numpy as np

from ..array_types import FloatArray, IntArray
from ..linalg import scaled_inverse
from .variables import sizes_of


@dataclass(frozen=True)
class Jacobian:
    """The entries that are not zero, factor by factor."""

    row: IntArray  # int (m,): rows in the order of the graph's factors
    column: IntArray  # int (m,): columns of the variables, in the order of `columns`
    value: FloatArray  # (m,)
    rhs: FloatArray  # (r,): the right-hand side: minus the whitened errors
    columns: Mapping[int, slice]  # Columns of each variable, by key
    width: int  # Columns of all variables

    @classmethod
    def of(cls, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> Jacobian:
        """Of a graph, linearised at values of all its variables."""
        keys = np.sort(np.array(values.keys(), dtype=np.uint64))  # the order in which GTSAM hands out columns
        starts = np.concatenate(([0], np.cumsum(sizes_of(keys))))
        ends = zip(keys.tolist(), starts[:-1].tolist(), starts[1:].tolist(), strict=True)
        width = int(starts[-1])
        entries = graph.linearize(values).sparseJacobian_()
        row, column = entries[0].astype(np.int64) - 1, entries[1].astype(np.int64) - 1
        inside = column < width  # the last column is the right-hand side
        rhs = np.zeros(int(row.max(initial=-1)) + 1)
        rhs[row[~inside]] = entries[2][~inside]
        columns = {key: slice(first, end) for key, first, end in ends}
        return cls(row[inside], column[inside], entries[2][inside], rhs, columns, width)

    def scaled(self, scale: FloatArray) -> Jacobian:  # (r,)
        """With each row times a number."""
        return replace(self, value=self.value * scale[self.row], rhs=self.rhs * scale)

    def entries(self, rows: slice) -> tuple[IntArray, IntArray, FloatArray]:
        """Rows, counted from the first of these, columns and values of the entries in them."""
        mine = (self.row >= rows.start) & (self.row < rows.stop)
        return self.row[mine] - rows.start, self.column[mine], self.value[mine]

    def block(self, rows: slice, columns: slice) -> FloatArray:
        """These rows and columns, dense."""
        row, column, value = self.entries(rows)
        mine = (column >= columns.start) & (column < columns.stop)
        dense = np.zeros((rows.stop - rows.start, columns.stop - columns.start))
        dense[row[mine], column[mine] - columns.start] = value[mine]
        return dense

    def toarray(self) -> FloatArray:
        """All of it, dense, without the right-hand side."""
        return self.block(slice(0, len(self.rhs)), slice(0, self.width))


class LinearSystem:
    """The normal equations of a linearised graph, reduced to its border."""

    def __init__(
        self,
        jacobian: Jacobian,
        node_of: Mapping[int, int],
        extra: Sequence[FloatArray] = (),  # (r, ..): columns of quantities that are no variables of it
    ) -> None:
        self.jacobian = jacobian
        node = np.full(jacobian.width, -1)
        for key, number in node_of.items():
            node[jacobian.columns[key]] = number
        self._border = np.flatnonzero(node < 0)
        self._border_row = np.full(len(node), -1)
        self._border_row[self._border] = np.arange(len(self._border))
        self._group(node)
        self._reduce(np.concatenate([*extra, jacobian.rhs[:, None]], axis=1))
        #: Covariance (e, e) of errors of the first extra quantities that count in `covariances`, and how the
        #: border's variables follow them (b, e).
        self.considered: FloatArray | None = None
        self.follows = np.zeros((len(self._border), 0))

    def columns(self, key: int) -> slice:
        """Columns of a variable in `jacobian`."""
        return self.jacobian.columns[key]

    def _group(self, node: IntArray) -> None:
        """Nodes to groups, as small as they can be so that no row reaches beyond the neighbouring group."""
        rows, of_entry = self.jacobian.row, node[self.jacobian.column]
        count, nodes = len(self.jacobian.rhs), int(node.max(initial=0)) + 1
        chained = of_entry >= 0
        first, last = np.full(count, nodes), np.full(count, -1)
        np.minimum.at(first, rows[chained], of_entry[chained])
        np.maximum.at(last, rows[chained], of_entry[chained])
        reach = np.full(nodes + 1, -1)  # of the rows that begin at a node or before it
        np.maximum.at(reach, first, last)
        np.maximum.accumulate(reach, out=reach)
        starts = [0]
        while (start := starts[-1]) < nodes:
            starts.append(max(start, int(reach[start - 1]) if start else 0) + 1)
        group_of_node = np.searchsorted(starts, np.arange(nodes + 1), side="right") - 1
        # in the order of time, in a group too: what is drawn is the same however nodes are grouped
        self._chain = np.argsort(node, kind="stable")[np.count_nonzero(node < 0) :]
        group = group_of_node[node[self._chain]]
        #: where each group begins in the chain, and the last one ends
        self._bounds = np.concatenate([[0], np.cumsum(np.bincount(group, minlength=len(starts) - 1))])
        #: place in the chain of every column, and its group; -1 of the border
        self._place, self._group_of_column = np.full((2, len(node)), -1)
        self._place[self._chain] = np.arange(len(group))
        self._group_of_column[self._chain] = group
        #: the group of every row of the Jacobian, one more than there are of those about the border alone
        self._group_of_row = np.where(last >= 0, group_of_node[first], len(starts) - 1)

    def _table(self, given: FloatArray) -> tuple[FloatArray, IntArray, IntArray]:
        """The Jacobian by groups, dense; the given columns (r, ..) are the last."""
        jacobian, groups = self.jacobian, len(self._bounds) - 1
        wide, borders = int(np.diff(self._bounds).max()), len(self._border)
        row, column, group = jacobian.row, jacobian.column, self._group_of_row
        is_next = self._group_of_column[column] > group[row]
        reaches = np.zeros(len(group), dtype=bool)
        reaches[row[is_next]] = True
        place = np.empty(len(group), int)
        place[np.lexsort((~reaches, group))] = np.arange(len(group))
        in_group = self._place - self._bounds[self._group_of_column]
        of_column = np.where(self._place >= 0, in_group, 2 * wide + self._border_row)
        table = np.zeros((len(group), 2 * wide + borders + given.shape[1]))
        scale = np.ones(jacobian.width)
        scale[self._chain] = self._scale
        table[place[row], of_column[column] + wide * is_next] = jacobian.value * scale[column]
        table[place, 2 * wide + borders :] = given
        starts = np.concatenate([[0], np.cumsum(np.bincount(group, minlength=groups))[:groups]])
        return table, starts, np.bincount(group[reaches], minlength=groups)

    def _reduce(self, given: FloatArray) -> None:
        """Eliminate the chain: what is left of the information on the border and the extra columns."""
        squares = np.bincount(self.jacobian.column, self.jacobian.value**2, self.jacobian.width)[self._chain]
        self._scale = 1.0 / np.sqrt(np.where(squares > 0.0, squares, 1.0))
        table, starts, reaching = self._table(given)
        sizes = [*np.diff(self._bounds).tolist(), 0]
        wide = max(sizes)
        own: list[FloatArray] = []
        self._inverses: list[FloatArray] = []
        self._gains: list[FloatArray] = []
        others = np.empty((len(self._chain), table.shape[1] - 2 * wide))
        solved = np.empty_like(others)
        said = np.zeros((sizes[0], table.shape[1] - wide))  # what groups before say
        for g, (size, after) in enumerate(pairwise(sizes)):
            rows, here = table[starts[g] : starts[g + 1]], slice(self._bounds[g], self._bounds[g + 1])
            normal = rows[:, :size].T @ rows
            own.append(normal[:, :size] + said[:, :size])
            right = normal[:, wide:]
            right[:, wide:] += said[:, wide:]
            # half the time of `solve` with as many columns
            self._inverses.append(np.asarray(np.linalg.inv(own[-1])))
            forward = self._inverses[-1] @ right
            reach = rows[: reaching[g], wide:]
            said = reach[:, :after].T @ reach - right[:, :after].T @ forward
            self._gains.append(forward[:, :after])
            others[here], solved[here] = right[:, wide:], forward[:, wide:]
        self._factors = _cholesky(own)  # raises where a direction is left free
        total = table[:, 2 * wide :].T @ table[:, 2 * wide :]
        eliminated = others.T @ solved
        total -= 0.5 * (eliminated + eliminated.T)
        for g in range(len(self._gains) - 2, -1, -1):
            a, b, c = self._bounds[g : g + 3]
            solved[a:b] -= self._gains[g] @ solved[b:c]
        self._solved = solved * self._scale[:, None]
        #: information (b + e, b + e) and vector (b + e,) on the border's variables and the extra columns
        self.information, self.vector = total[:-1, :-1], total[:-1, -1]
        borders = len(self._border)
        self._shared_covariance = scaled_inverse(self.information[:borders, :borders])

    @property
    def extras(self) -> slice:
        """The extra columns in `information` and `vector`."""
        return slice(len(self._border), len(self.information))

    def border_rows(self, keys: Sequence[int]) -> IntArray:
        """Rows of border variables in `information` and `vector`, one after the other."""
        return np.concatenate([self._border_row[self.columns(key)] for key in keys])

    def shared_covariance(self, keys: Sequence[int]) -> FloatArray:
        """Joint covariance of border variables, in the order of the keys; extra quantities held fixed."""
        rows = self.border_rows(keys)
        return np.asarray(self._shared_covariance[np.ix_(rows, rows)])

    @cached_property
    def _diagonal(self) -> FloatArray:
        """Covariance (g, w, w) within each group, the border held fixed, in scaled coordinates."""
        sizes = [*np.diff(self._bounds).tolist(), 0]
        blocks = np.zeros((len(self._gains) + 1, max(sizes), max(sizes)))
        for g in range(len(self._gains) - 1, -1, -1):
            gain, after = self._gains[g], blocks[g + 1, : sizes[g + 1], : sizes[g + 1]]
            blocks[g, : sizes[g], : sizes[g]] = self._inverses[g] + gain @ after @ gain.T
        return blocks

    def consider(self, covariance: FloatArray, pull: FloatArray) -> None:
        """Count errors with a covariance (e, e) of the first e extra quantities in `covariances`.

        The prior of the border's variables follows them by `pull` (b, e), as information times mean.
        """
        self.considered, self.follows = covariance, self.shared_sensitivity(pull)

    def covariances(
        self, keys: Sequence[int], held: Sequence[int] = (), own_follow: FloatArray | None = None
    ) -> FloatArray:
        """Covariances (k, d, d) of variables in time, all of one dimension; other extra quantities held.

        `own_follow` (d, e) is how they follow the considered errors beyond what the equations say.
        """
        follows = self._solved[self._places(keys), : len(self._border)]
        shared = self._shared_covariance
        if held:
            free = np.setdiff1d(np.arange(len(self._border)), self.border_rows(held))
            follows, shared = follows[:, :, free], scaled_inverse(self.information[np.ix_(free, free)])
        covariance = self._given_border(keys) + follows @ shared @ np.swapaxes(follows, 1, 2)
        if self.considered is not None:
            errors = self.sensitivities(keys, self.follows) + (0.0 if own_follow is None else own_follow)
            covariance = covariance + errors @ self.considered @ np.swapaxes(errors, 1, 2)
        return np.asarray(covariance)

    def end_covariances(self, keys: Sequence[int], slope: FloatArray, lever: int) -> FloatArray:
        """Covariances (k, 3, 3) of a slope (3, d) times variables in time plus a lever of the border.

        As `covariances`, with what variables in time and the border's variable have in common.
        """
        rows = self.border_rows([lever])
        covariance = slope @ self._given_border(keys) @ slope.T
        follows = -slope @ self._solved[self._places(keys), : len(self._border)]
        follows[:, :, rows] += np.eye(3)
        covariance += follows @ self._shared_covariance @ np.swapaxes(follows, 1, 2)
        if self.considered is not None:
            errors = slope @ self.sensitivities(keys, self.follows) + self.follows[rows]
            covariance += errors @ self.considered @ np.swapaxes(errors, 1, 2)
        return np.asarray(covariance)

    def _given_border(self, keys: Sequence[int]) -> FloatArray:
        """Covariances (k, d, d) of variables in time, the border held."""
        place = self._places(keys)
        group = np.searchsorted(self._bounds, place[:, 0], side="right") - 1
        scale, rows = self._scale[place], place - self._bounds[group, None]
        own = self._diagonal[group[:, None, None], rows[:, :, None], rows[:, None, :]]
        return np.asarray(own * scale[:, :, None] * scale[:, None, :])

    def sensitivities(self, keys: Sequence[int], shared: FloatArray) -> FloatArray:  # shared (b, e)
        """How variables in time, all of one dimension, follow the first e extra quantities, (k, d, e)."""
        follows, borders = self._solved[self._places(keys)], len(self._border)
        errors = follows[:, :, borders : borders + shared.shape[1]]
        return np.asarray(-errors - follows[:, :, :borders] @ shared)

    def shared_sensitivity(self, pull: FloatArray) -> FloatArray:  # pull (b, e)
        """How the border's variables follow the first e extra quantities, (b, e)."""
        borders = len(self._border)
        across = self.information[:borders, borders : borders + pull.shape[1]]
        return np.asarray(self._shared_covariance @ (pull - across))

    def extra_information(self, column: int) -> float:
        """Information on one extra quantity, the graph's variables eliminated and the other extras held."""
        borders, row = len(self._border), self.extras.start + column
        across = self.information[:borders, row]
        return float(max(self.information[row, row] - across @ self._shared_covariance @ across, 0.0))

    def sample(self, normals: FloatArray, given: FloatArray) -> FloatArray:
        """Draw all variables in time (k, c) from normals (k, c), given the border and extras (k, b + e)."""
        numbers, drawn = normals[:, self._chain].T, np.empty((len(self._chain), len(normals)))
        after = np.empty((0, len(normals)))
        for g in range(len(self._gains) - 1, -1, -1):
            here = slice(self._bounds[g], self._bounds[g + 1])
            after = np.linalg.solve(self._factors[g].T, numbers[here]) - self._gains[g] @ after
            drawn[here] = after
        drawn *= self._scale[:, None]
        drawn -= self._solved[:, : given.shape[1]] @ given.T
        errors = np.zeros(normals.shape)
        errors[:, self._chain] = drawn.T
        return errors

    def _places(self, keys: Sequence[int]) -> IntArray:
        """Places in the chain (k, d) of each variable's columns."""
        first = np.array([self.columns(key).start for key in keys])
        own = self.columns(keys[0])
        return np.asarray(self._place[first[:, None] + np.arange(own.stop - own.start)])


def _cholesky(matrices: Sequence[FloatArray]) -> list[FloatArray]:
    """Lower Cholesky factors; matrices of one size at once, in half the time."""
    factors = list(matrices)
    sizes = np.array([len(matrix) for matrix in matrices])
    for size in np.unique(sizes):
        alike = np.flatnonzero(sizes == size).tolist()
        for number, factor in zip(alike, np.linalg.cholesky([matrices[g] for g in alike]), strict=True):
            factors[number] = factor
    return factors


def eliminated(
    information: FloatArray, vector: FloatArray, kept: IntArray, others: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Information and vector of some rows when others are eliminated; all the rest is held."""
    own, across = information[np.ix_(kept, kept)], information[np.ix_(kept, others)]
    sides = np.column_stack([information[np.ix_(others, kept)], vector[others]])
    solved = np.linalg.solve(information[np.ix_(others, others)], sides)
    return own - across @ solved[:, :-1], vector[kept] - across @ solved[:, -1]
