"""A linearised graph's whitened Jacobian, as GTSAM hands it out: its entries, and dense blocks of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np

from ..array_types import FloatArray, IntArray
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
