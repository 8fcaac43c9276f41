"""Two sections over their border: what only one of them knows stays."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.recovery.blended_columns import between_quaternions, blend
from smoother.rotation import Rotation

SHARE = np.array([0.0, 0.2, 0.5, 0.8, 1.0, 1.0])


def test_both_known():
    column = np.ones((7, 3))
    blend(column, slice(1, 7), np.full((6, 3), 3.0), SHARE)
    np.testing.assert_allclose(column[:, 0], [1.0, *(1.0 + 2.0 * SHARE)])


def test_what_the_later_section_does_not_know_stays():
    column, later = np.ones((6, 2)), np.full((6, 2), 3.0)
    later[[1, 2, 5], 0] = np.nan
    blend(column, slice(0, 6), later, SHARE)
    np.testing.assert_allclose(column[:, 0], [1.0, 1.0, 1.0, 2.6, 3.0, np.nan])
    np.testing.assert_allclose(column[:, 1], 1.0 + 2.0 * SHARE)


def test_what_the_earlier_section_does_not_know_is_taken_from_the_later():
    column = np.full((6, 2, 2), np.nan)
    blend(column, slice(0, 6), np.full((6, 2, 2), 3.0), SHARE)
    np.testing.assert_array_equal(column, 3.0)


def test_quaternions_on_the_way():
    before = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    after = np.tile(Rotation.from_rotvec(np.array([0.0, 0.0, 0.8])).as_quat(scalar_first=True), (4, 1))
    before[0], after[1] = np.nan, np.nan
    between = between_quaternions(before, after, np.full(4, 0.25))
    np.testing.assert_allclose(between[:2], [after[0], before[1]])
    assert Rotation.from_quat(between[2:], scalar_first=True).magnitude() == pytest.approx(0.2)
