"""The stages in which a window with a long gap is solved: their order, their ends, and what comes out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gtsam
import pytest
from scipy.stats import chi2
from small_window import NOISE, small_window

from smoother.graph import optimise as module
from smoother.graph.build import build
from smoother.graph.optimise import LOOSE_M, Optimum, explained, optimise
from smoother.window.problem import Window

SIGMA_M = NOISE.upper_arm_sigma_m
#: The gap is from node 3 to 6, and these knots of the shoulder are in it.
KNOTS = [2, 3]


@pytest.fixture
def window() -> Window:
    return replace(small_window(1, upper=False)[0], considered=None)


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """A gap of 0.18 s is a long one, and every stage has its full length."""
    monkeypatch.setattr(module, "LONG_S", 0.15)
    monkeypatch.setattr(module, "STEP_S", 0.025)
    monkeypatch.setattr(module, "FINE_STEP_S", 0.01)


class Descents:
    """What the optimiser was run on: sigmas of the upper arm at the knots, most iterations, tolerance."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, raised: float = 0.0) -> None:
        self.calls: list[tuple[list[float], int, float]] = []
        self.answers: list[Optimum] = []
        original = module._descend

        def descend(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, *rest: Any) -> Optimum:
            factors = (graph.at(i) for i in range(graph.size()))
            lengths = [each for each in factors if isinstance(each, gtsam.RangeFactorWithTransformBias3D)]
            sigmas = [float(each.noiseModel().sigmas()[0]) for each in lengths]
            found, (iterations, tolerance, _) = original(graph, values, *rest), rest
            if self.calls and sigmas == [SIGMA_M] * 6:  # as if the upper arm did not fit
                found = replace(found, error=found.error + raised)
            self.calls.append((sigmas, iterations, tolerance))
            self.answers.append(found)
            return found

        monkeypatch.setattr(module, "_descend", descend)

    @property
    def stages(self) -> list[list[float]]:
        """Sigmas at the gap's knots, descent by descent; all others stay as they are."""
        for sigmas, _, _ in self.calls:
            assert [sigma for k, sigma in enumerate(sigmas) if k not in KNOTS] == [SIGMA_M] * 4
        return [[round(sigmas[k], 6) for k in KNOTS] for sigmas, _, _ in self.calls]


def test_the_upper_arm_comes_in_step_by_step(window: Window, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loose at first, from the gap's ends inwards, then as it is; the answer is the straight one's."""
    graph, values, groups = build(window)
    straight = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    descents = Descents(monkeypatch)
    found = optimise(graph, values, groups, window, 1e-6)
    # knots at 0.06 s from one end and at the other's: the middle one is put in at the third step of 0.025
    assert descents.stages == [[LOOSE_M, LOOSE_M], [LOOSE_M, SIGMA_M], [LOOSE_M, SIGMA_M], [SIGMA_M, SIGMA_M]]
    last, stage = (module.LAST_ITERATIONS, 1e-6), (module.STAGE_ITERATIONS, module.STAGE_TOLERANCE)
    assert [call[1:] for call in descents.calls] == [last, stage, stage, last]
    assert found.error == pytest.approx(graph.error(straight), rel=1e-4)
    assert found.error == pytest.approx(found.graph.error(found.values), abs=1e-9)
    assert found.accepted and found.graph is graph
    assert found.iterations == sum(each.iterations for each in descents.answers)


def test_all_strategies_where_none_agrees(window: Window, monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors that differ from try to try: all five are tried, the lowest counts, and it is refused."""
    errors = iter([100.0, 70.0, 90.0, 80.0, 95.0])
    original, whole = module._descend, []

    def descend(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, *rest: Any) -> Optimum:
        found, (iterations, *_) = original(graph, values, *rest), rest
        whole.append(found)
        if len(whole) > 1 and iterations == module.LAST_ITERATIONS:
            found = replace(found, error=whole[0].error + next(errors))
            whole[-1] = found
        return found

    monkeypatch.setattr(module, "_descend", descend)
    refused = optimise(*build(window), window, 1e-6)
    assert next(errors, None) is None
    assert not refused.accepted and refused.error == whole[0].error and refused.graph is whole[0].graph
    monkeypatch.setattr(
        module, "explained", lambda excess, knots: excess == pytest.approx(70.0) and knots == 2
    )
    errors, whole[:] = iter([100.0, 70.0, 90.0, 80.0, 95.0]), []
    accepted = optimise(*build(window), window, 1e-6)
    assert accepted.accepted and accepted.error == pytest.approx(whole[0].error + 70.0)


@pytest.mark.parametrize(("apart", "tries"), [(0.9, 2), (1.1, 5)])
def test_two_that_agree_are_enough(
    apart: float, tries: int, window: Window, monkeypatch: pytest.MonkeyPatch
) -> None:
    original, count = module._descend, [0]

    def descend(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, *rest: Any) -> Optimum:
        found, (iterations, *_) = original(graph, values, *rest), rest
        if iterations == module.LAST_ITERATIONS:
            count[0] += 1
            found = replace(found, error=50.0 + apart * (count[0] - 2) if count[0] > 1 else 0.0)
        return found

    monkeypatch.setattr(module, "_descend", descend)
    optimise(*build(window), window, 1e-6)
    assert count[0] == 1 + tries


@pytest.mark.parametrize("knots", [1, 2, 50])
def test_the_limit_is_that_of_the_likelihood_ratio(knots: int) -> None:
    limit = 0.5 * chi2.isf(1e-5, knots)
    assert explained(limit * (1 - 1e-9), knots) and not explained(limit * (1 + 1e-9), knots)
