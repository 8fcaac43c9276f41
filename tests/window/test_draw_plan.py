"""The random numbers of draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from smoother.window.draw_plan import DrawPlan, samples_apart


def covariance(size: int, seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(size, size))
    unit = np.logspace(0, -4, size)  # metres beside rad/s
    return (root @ root.T + 0.1 * np.eye(size)) * unit * unit[:, None]


PLAN = DrawPlan(count=50, seed=3, arm="left/None", every=4, shared=covariance(5, 0))


def test_a_number_belongs_to_its_draw_its_time_and_its_name() -> None:
    t = np.array([0.1, 0.2, 7.3])
    numbers = PLAN.at_times("node", t, 6)
    assert numbers.shape == (50, 3, 6)
    np.testing.assert_array_equal(PLAN.at_times("node", t[1:] + 1e-9, 6), numbers[:, 1:])
    np.testing.assert_array_equal(replace(PLAN, count=7).at_times("node", t, 6), numbers[:7])
    others = [
        PLAN.at_times("bias", t, 6),
        PLAN.at_times("node", t + 1e-5, 6),
        replace(PLAN, seed=4).at_times("node", t, 6),
        replace(PLAN, arm="right/None").at_times("node", t, 6),
    ]
    for other in others:  # 900 numbers: the correlation of independent ones is 0.033
        assert abs(np.corrcoef(numbers.ravel(), other.ravel())[0, 1]) < 0.15
    assert abs(numbers.mean()) < 0.15 and abs(numbers.std() - 1.0) < 0.1


def test_what_windows_share_has_each_windows_own_covariance_and_is_nearly_the_same() -> None:
    many = replace(PLAN, count=40_000)
    own = covariance(5, 0) + 0.2 * covariance(5, 1)
    errors = many.shared_errors(own)
    scale = np.sqrt(np.diag(own))
    # 40,000 draws: a correlation is known to 0.005
    np.testing.assert_allclose(
        np.cov(errors.T) / scale / scale[:, None], own / scale / scale[:, None], atol=0.03
    )
    pooled = many.shared_errors(many.shared)
    for axis in range(5):
        assert np.corrcoef(errors[:, axis], pooled[:, axis])[0, 1] > 0.9


@pytest.mark.parametrize(("rate", "every"), [(100.0, 4), (25.0, 1), (60.0, 2), (1000.0, 40), (10.0, 1)])
def test_drawn_times_are_25_a_second_or_more(rate: float, every: int) -> None:
    assert samples_apart(np.arange(300) / rate) == samples_apart(np.arange(500_000) / rate) == every
    assert samples_apart(np.zeros(1)) == 1
