"""Small functions that stand in for a library's, against the library's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.signal import find_peaks

from smoother.linalg import largest_trace, nearest_rotation, nonnegative_pair, peaks


@pytest.mark.parametrize("seed", range(20))
def test_peaks_are_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    y = np.convolve(rng.normal(size=400), np.ones(5), "valid")
    rows, _ = find_peaks(y, height=1.0, distance=12)
    highest = rows[np.argsort(-y[rows], kind="stable")]
    np.testing.assert_array_equal(peaks(y, 1.0, 12, 8), highest[:8])


def test_no_peaks() -> None:
    assert len(peaks(np.arange(9.0), 0.0, 1, 5)) == 0
    assert len(peaks(np.zeros(9), 0.0, 1, 5)) == 0
    assert peaks(np.array([0.0, 1, 1, 0]), 0.0, 1, 5).tolist() == [1]


@pytest.mark.parametrize("seed", range(40))
def test_nonnegative_pair_is_scipys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, y = rng.normal(size=(12, 2)), rng.normal(size=12)
    x, misfit = nonnegative_pair(A, y)
    theirs, their_misfit = nnls(A, y)
    np.testing.assert_allclose(x, theirs, atol=1e-10)
    assert misfit == pytest.approx(their_misfit)


def test_the_largest_trace_is_that_of_the_nearest_rotation() -> None:
    rng = np.random.default_rng(8)
    general = rng.normal(size=(300, 3, 3))
    lines = rng.normal(size=(100, 3, 1)) @ rng.normal(size=(100, 1, 3))  # one direction only: a double root
    planes = general[:100] @ np.diag([1.0, 1.0, 0.0])
    for matrices, tolerance in ((general, 1e-11), (100.0 * planes, 1e-11), (lines, 1e-7)):
        expected = np.einsum("nij,nij->n", nearest_rotation(matrices), matrices)
        np.testing.assert_allclose(
            largest_trace(matrices), expected, atol=tolerance * np.abs(matrices).max(), rtol=0
        )
    assert largest_trace(np.zeros((3, 3))) == 0.0
    # no reflection, half a turn about any axis: a triple root, which keeps a third of the digits
    np.testing.assert_allclose(largest_trace(-np.eye(3)), 1.0, atol=1e-4)
