"""One assignment, and the probabilities of its pairs."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from smoother.array_types import FloatArray
from smoother.matching.match import assign, probabilities


def best_by_force(weight: FloatArray, none: FloatArray) -> float:
    """Total weight of the best assignment, all of them tried."""
    k, m = weight.shape
    totals = []
    for chosen in product(range(-1, m), repeat=k):
        used = [j for j in chosen if j >= 0]
        if len(used) == len(set(used)):
            totals.append(sum(weight[i, j] if j >= 0 else none[i] for i, j in enumerate(chosen)))
    return max(totals)


@pytest.mark.parametrize("seed", range(10))
def test_the_assignment_is_the_best_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    weight, none = rng.normal(0, 3, (3, 4)), rng.normal(0, 1, 3)
    limb = assign(weight, none)
    total = sum(weight[i, j] if j >= 0 else none[i] for i, j in enumerate(limb))
    assert total == pytest.approx(best_by_force(weight, none))
    probability = probabilities(weight, none)
    np.testing.assert_allclose(probability.sum(axis=1), 1.0)
    # what is assigned is the most probable of its row: no other assignment has more weight
    assert (probability[np.arange(3), limb] == probability.max(axis=1)).all()


def test_ratios_are_those_of_the_best_assignments() -> None:
    weight, none = np.array([[2.0, 1.0], [1.5, -1.0]]), np.array([0.0, 0.0])
    # IMU 0 on limb 0 leaves 0 (none) to IMU 1; on limb 1 it leaves limb 0 (1.5); on none as well
    expected = np.exp([2.0 + 0.0, 1.0 + 1.5, 0.0 + 1.5])
    np.testing.assert_allclose(probabilities(weight, none)[0], expected / expected.sum())


def test_more_imus_than_limbs_and_excluded_pairs() -> None:
    weight = np.array([[5.0], [4.0], [-np.inf]])
    none = np.zeros(3)
    assert assign(weight, none).tolist() == [0, -1, -1]
    probability = probabilities(weight, none)
    assert probability[2, 0] == 0 and probability[2, 1] == 1
    assert probability[0, 0] == pytest.approx(1 / (1 + np.exp(-1)), abs=0.01)


def test_equal_imus_share() -> None:
    probability = probabilities(np.full((2, 2), 10.0), np.zeros(2))
    np.testing.assert_allclose(probability[:, :2], 0.5, atol=1e-4)
