"""The stages in which a window with a long gap is solved: their order, their ends, and what comes out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gtsam
import pytest
from scipy.stats import chi2
from small_window import NOISE, small_window

from smoother.graph import optimise as module
from smoother.graph.build import build
from smoother.graph.optimise import LAST_ITERATIONS, LOOSE_M, Optimum, explained, optimise
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
    for name, value in {"LONG_S": 0.15, "STEP_S": 0.025, "FINE_STEP_S": 0.01}.items():
        monkeypatch.setattr(module, name, value)


#: A descent: its graph, most iterations, tolerance and answer.
Descent = tuple[gtsam.NonlinearFactorGraph, int, float, Optimum]


def listen(
    monkeypatch: pytest.MonkeyPatch, change: Callable[[int, Optimum], Optimum] = lambda number, found: found
) -> list[Descent]:
    """The descents that are made; the answers of whole ones may be changed, by their number."""
    original, made = module._descend, []

    def descend(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, *rest: Any) -> Optimum:
        found, (iterations, tolerance, _) = original(graph, values, *rest), rest
        if iterations == LAST_ITERATIONS:
            found = change(sum(each[1] == LAST_ITERATIONS for each in made), found)
        made.append((graph, iterations, tolerance, found))
        return found

    monkeypatch.setattr(module, "_descend", descend)
    return made


def sigmas_of(graph: gtsam.NonlinearFactorGraph) -> list[float]:
    """Of the upper arm at the gap's knots; all others stay as they are."""
    factors = (graph.at(i) for i in range(graph.size()))
    lengths = [each for each in factors if isinstance(each, gtsam.RangeFactorWithTransformBias3D)]
    sigmas = [float(each.noiseModel().sigmas()[0]) for each in lengths]
    assert [sigma for k, sigma in enumerate(sigmas) if k not in KNOTS] == [SIGMA_M] * 4
    return [round(sigmas[k], 6) for k in KNOTS]


def test_the_upper_arm_comes_in_step_by_step(window: Window, monkeypatch: pytest.MonkeyPatch) -> None:
    """Loose at first, from the gap's ends inwards, then as it is; the answer is the straight one's."""
    graph, values, groups = build(window)
    straight = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    descents = listen(monkeypatch)
    found = optimise(graph, values, groups, window, 1e-6)
    # knots at 0.06 s from one end and at the other's: the middle one is put in at the third step of 0.025
    inwards = [[LOOSE_M, LOOSE_M], [LOOSE_M, SIGMA_M], [LOOSE_M, SIGMA_M], [SIGMA_M, SIGMA_M]]
    assert [sigmas_of(graph) for graph, *_ in descents] == inwards
    last, stage = (LAST_ITERATIONS, 1e-6), (module.STAGE_ITERATIONS, module.STAGE_TOLERANCE)
    assert [each[1:3] for each in descents] == [last, stage, stage, last]
    assert found.error == pytest.approx(graph.error(straight), rel=1e-4)
    assert found.error == pytest.approx(found.graph.error(found.values), abs=1e-9)
    assert found.accepted and found.graph is graph
    assert found.iterations == sum(answer.iterations for *_, answer in descents)


@pytest.mark.parametrize(
    ("excess", "explains", "tries"),
    [
        ([100.0, 70.0, 90.0, 80.0, 95.0], False, 5),  # all differ: all are tried, and it is refused
        ([100.0, 70.0, 90.0, 80.0, 95.0], True, 5),  # the lowest counts
        ([50.0, 50.9], False, 2),  # two that agree are enough
        ([50.0, 51.1, 52.2, 53.3, 54.4], False, 5),
    ],
)
def test_strategies_are_tried_until_two_agree(
    excess: list[float], explains: bool, tries: int, window: Window, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors of the tries beyond the loose one's."""

    def change(number: int, found: Optimum) -> Optimum:
        return replace(found, error=descents[0][3].error + excess[number - 1]) if number else found

    descents = listen(monkeypatch, change)
    monkeypatch.setattr(
        module,
        "explained",
        lambda more, knots: explains and knots == 2 and more == pytest.approx(min(excess)),
    )
    found = optimise(*build(window), window, 1e-6)
    assert sum(each[1] == LAST_ITERATIONS for each in descents) == 1 + tries
    loose = descents[0]
    assert found.accepted is explains
    assert found.error == pytest.approx(loose[3].error + (min(excess) if explains else 0.0))
    assert explains or found.graph is loose[3].graph


@pytest.mark.parametrize("knots", [1, 2, 50])
def test_the_limit_is_that_of_the_likelihood_ratio(knots: int) -> None:
    limit = 0.5 * chi2.isf(1e-5, knots)
    assert explained(limit * (1 - 1e-9), knots) and not explained(limit * (1 + 1e-9), knots)
