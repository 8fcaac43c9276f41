"""A window's linearised graph as a chain in time with a border: covariances and reduced systems, exactly.

Poses, velocities and shoulder knots follow each other in time, so their normal equations are block
tridiagonal; what the whole window shares (biases, gravity, lengths, lever arms, and quantities that are
considered but not solved) borders them. One sweep forwards and one back give every covariance that is
asked for (Takahashi et al., 1973; block form as in the Rauch-Tung-Striebel smoother).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np

from ..array_types import FloatArray, IntArray
from ..linalg import scaled_inverse
from .variables import sizes_of


@dataclass(frozen=True)
class Jacobian:
    """The entries that are not zero, factor by factor.

    Attributes
    ----------
    row, column : ndarray of int, shape (m,)
        Rows in the order of the graph's factors.
    value : ndarray, shape (m,)
    rhs : ndarray, shape (r,)
        The right-hand side: minus the whitened errors.
    columns : mapping of int to slice
        Columns of each variable, by key.
    width : int
        Columns of all variables.
    """

    row: IntArray
    column: IntArray
    value: FloatArray
    rhs: FloatArray
    columns: Mapping[int, slice]
    width: int

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


#: Columns of the whitened Jacobian, of its first rows, for quantities that are not variables of the graph.
ExtraColumns = Callable[[Jacobian], FloatArray]


class LinearSystem:
    """The normal equations of a linearised graph, reduced to its border.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
    values : gtsam.Values
        Every variable of the graph, where it is linearised.
    node_of : mapping of int to int
        The node whose time a variable has, by key; what is not in it belongs to the border.
    extra : sequence of callable
        Each gives columns (r, e) of the whitened Jacobian for quantities that are not variables of the graph,
        from the Jacobian; rows beyond the r-th have none.

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
        extra: Sequence[ExtraColumns] = (),
    ) -> None:
        self.jacobian = Jacobian.of(graph, values)
        node = np.full(self.jacobian.width, -1)
        for key, number in node_of.items():
            node[self.jacobian.columns[key]] = number
        self._border = np.flatnonzero(node < 0)
        self._border_row = np.full(len(node), -1)
        self._border_row[self._border] = np.arange(len(self._border))
        given = [columns(self.jacobian) for columns in extra]
        self._extra_count = sum(columns.shape[1] for columns in given)
        self._group(node)
        self._reduce(*self._normal_equations(given))

    def columns(self, key: int) -> slice:
        """Columns of a variable in `jacobian`."""
        return self.jacobian.columns[key]

    def _group(self, node: IntArray) -> None:
        """Nodes to groups so that no factor reaches beyond the neighbouring group."""
        rows, of_entry = self.jacobian.row, node[self.jacobian.column]
        count = len(self.jacobian.rhs)
        chained = of_entry >= 0
        first, last = np.full(count, len(node)), np.full(count, -1)
        np.minimum.at(first, rows[chained], of_entry[chained])
        np.maximum.at(last, rows[chained], of_entry[chained])
        reach = max(int((last - first)[last >= 0].max(initial=1)), 3)
        # in the order of time, in a group too: what is drawn is the same however nodes are grouped
        chain = np.argsort(node, kind="stable")[np.count_nonzero(node < 0) :]
        group = node[chain] // reach
        sizes = np.bincount(group)
        self._groups = np.split(chain, np.cumsum(sizes)[:-1])
        #: group and row in it of every column
        self._place = np.full((len(node), 2), -1)
        self._place[chain, 0] = group
        self._place[chain, 1] = np.arange(len(chain)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        #: the group of every row of the Jacobian; -1 of those that are about the border alone
        self._group_of_row = np.where(last >= 0, first // reach, -1)

    def _normal_equations(self, given: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Normal equations group by group, in columns of the group, of the next, of the border and the rest.

        Returns
        -------
        normal : ndarray, shape (g, w + w, w + w + s)
            What the rows of each group say of its columns and the next one's; a group's are padded to the
            widest one's w, and the s others are the border, the extra columns and the right-hand side.
        others : ndarray, shape (s, s)
            What all rows say of these others.
        """
        jacobian, count = self.jacobian, len(self._groups)
        wide, borders = max(len(columns) for columns in self._groups), len(self._border)
        width = 2 * wide + borders + self._extra_count + 1
        # rows, sorted by group, into panels of one height; those of the border alone into one more
        group = np.where(self._group_of_row < 0, count, self._group_of_row)
        heights = np.bincount(group, minlength=count + 1)
        rank = np.empty(len(group), int)
        rank[np.argsort(group, kind="stable")] = np.arange(len(group)) - np.repeat(
            np.cumsum(heights) - heights, heights
        )
        panel = np.zeros((count + 1, int(heights.max()), width))
        of_column = np.where(self._place[:, 0] >= 0, self._place[:, 1], 2 * wide + self._border_row)
        row, column = jacobian.row, jacobian.column
        is_next = self._place[column, 0] > group[row]
        panel[group[row], rank[row], of_column[column] + wide * is_next] = jacobian.value
        first = 2 * wide + borders
        for own in given:
            rows = slice(0, len(own))
            panel[group[rows], rank[rows], first : first + own.shape[1]] = own
            first += own.shape[1]
        panel[group, rank, -1] = jacobian.rhs
        chained, others = panel[:-1, :, : 2 * wide], panel[:, :, 2 * wide :].reshape(-1, width - 2 * wide)
        return np.swapaxes(chained, 1, 2) @ panel[:-1], others.T @ others

    def _reduce(self, normal: FloatArray, others: FloatArray) -> None:
        """Eliminate the chain: what is left of the information on the border and the extra columns."""
        count, wide = len(normal), normal.shape[1] // 2
        own, right = normal[:, :wide, :wide], normal[:, :wide, wide:]
        own[1:] += normal[:-1, wide:, wide : 2 * wide]
        right[1:, :, wide:] += normal[:-1, wide:, 2 * wide :]
        diagonal = np.einsum("gii->gi", own)
        diagonal[diagonal == 0.0] = 1.0  # columns that pad a group
        self._scale = 1.0 / np.sqrt(diagonal)
        own *= self._scale[:, :, None] * self._scale[:, None, :]
        right *= self._scale[:, :, None]
        right[:-1, :, :wide] *= self._scale[1:, None, :]
        coupling = right[:, :, wide:].reshape(count * wide, -1).copy()
        forward, inverses = np.empty_like(right), np.empty_like(own)
        for g in range(count):
            if g > 0:  # information from the groups before about this one
                said = right[g - 1, :, :wide].T @ forward[g - 1]
                own[g] -= said[:, :wide]
                right[g, :, wide:] -= said[:, wide:]
            inverses[g] = np.linalg.inv(own[g])  # half the time of `solve` with this many right-hand sides
            forward[g] = inverses[g] @ right[g]
        self._inverses, self._gains = inverses, forward[:, :, :wide]
        self._factors = np.asarray(np.linalg.cholesky(own), float)  # raises where a direction is left free
        solved = forward[:, :, wide:]
        for g in range(count - 2, -1, -1):
            solved[g] -= self._gains[g] @ solved[g + 1]
        said = coupling.T @ solved.reshape(count * wide, -1)
        total = others - 0.5 * (said + said.T)
        self._solved = solved * self._scale[:, :, None]
        #: information (b + e, b + e) and vector (b + e,) on the border's variables and the extra columns
        self.information, self.vector = total[:-1, :-1], total[:-1, -1]
        borders = len(self._border)
        self._shared_covariance = scaled_inverse(self.information[:borders, :borders])

    @property
    def extra_count(self) -> int:
        """How many extra columns there are."""
        return self._extra_count

    @property
    def extras(self) -> slice:
        """The extra columns in `information` and `vector`."""
        return slice(len(self._border), len(self.information))

    def _first_extras(self, count: int) -> slice:
        return slice(self.extras.start, self.extras.start + count)

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
        blocks = self._inverses.copy()
        for g in range(len(blocks) - 2, -1, -1):
            gain = self._gains[g]
            blocks[g] += gain @ blocks[g + 1] @ gain.T
        return np.asarray(blocks)

    def covariances(self, keys: Sequence[int], held: Sequence[int] = ()) -> FloatArray:
        """Covariances (k, d, d) of variables in time, all of one dimension; extra quantities held fixed.

        So are the border's variables `held`.
        """
        group, rows = self._rows(keys)
        scale = self._scale[group, rows]
        own = self._diagonal[group[:, :, None], rows[:, :, None], rows[:, None, :]]
        follows, shared = self._solved[group, rows, : len(self._border)], self._shared_covariance
        if held:
            free = np.setdiff1d(np.arange(len(self._border)), self.border_rows(held))
            follows, shared = follows[:, :, free], scaled_inverse(self.information[np.ix_(free, free)])
        across = follows @ shared @ np.swapaxes(follows, 1, 2)
        return np.asarray(own * scale[:, :, None] * scale[:, None, :] + across)

    def sensitivities(self, keys: Sequence[int], shared: FloatArray) -> FloatArray:
        """How variables in time, all of one dimension, follow the first e extra quantities, (k, d, e).

        Parameters
        ----------
        keys : sequence of int
        shared : ndarray, shape (b, e)
            How the border follows them (`shared_sensitivity`).
        """
        follows = self._solved[self._rows(keys)]
        borders, extras = len(self._border), self._first_extras(shared.shape[1])
        return np.asarray(-follows[:, :, extras] - follows[:, :, :borders] @ shared)

    def shared_sensitivity(self, pull: FloatArray | None = None) -> FloatArray:
        """How the border's variables follow the first e extra quantities, (b, e).

        Parameters
        ----------
        pull : ndarray, shape (b, e), optional
            Information of the border's prior times how its mean follows them; it does not where None, and
            the answer is for all of them.
        """
        count = self.extra_count if pull is None else pull.shape[1]
        across = self.information[: len(self._border), self._first_extras(count)]
        return np.asarray(self._shared_covariance @ ((0.0 if pull is None else pull) - across))

    def extra_information(self, column: int) -> float:
        """Information on one extra quantity, the graph's variables eliminated and the other extras held."""
        borders, row = len(self._border), self.extras.start + column
        across = self.information[:borders, row]
        return float(max(self.information[row, row] - across @ self._shared_covariance @ across, 0.0))

    def sample(self, normals: FloatArray, given: FloatArray) -> FloatArray:
        """Draw all variables in time, given the border's and the extra quantities (back substitution).

        It is what `GaussianBayesNet.sample` does, which knows no extra quantities.

        Parameters
        ----------
        normals : ndarray, shape (k, c)
            Standard normals of k draws, by column of the Jacobian; those of the border are not used.
        given : ndarray, shape (k, b + e)
            Errors of the border's variables and of the first e extra quantities.

        Returns
        -------
        errors : ndarray, shape (k, c)
            Zero of the border.
        """
        chain = np.flatnonzero(self._place[:, 0] >= 0)
        group, row = self._place[chain].T
        drawn = np.zeros((*self._scale.shape, len(normals)))
        drawn[group, row] = normals[:, chain].T
        drawn = np.linalg.solve(np.swapaxes(self._factors, 1, 2), drawn)
        for g in range(len(drawn) - 2, -1, -1):
            drawn[g] -= self._gains[g] @ drawn[g + 1]
        drawn *= self._scale[:, :, None]
        drawn -= self._solved[:, :, : given.shape[1]] @ given.T
        errors = np.zeros(normals.shape)
        errors[:, chain] = drawn[group, row].T
        return errors

    def _rows(self, keys: Sequence[int]) -> tuple[IntArray, IntArray]:
        """The group of each variable's columns, and their rows in it, (k, d) each."""
        first = np.array([self.columns(key).start for key in keys])
        own = self.columns(keys[0])
        place = self._place[first[:, None] + np.arange(own.stop - own.start)]
        return place[:, :, 0], place[:, :, 1]
