"""The dense marginals against GTSAM's own, where GTSAM's do not give up."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, G, V, X

import smoother.recovery.second_pass
from smoother.config import Config, Windows
from smoother.graph.build import build
from smoother.graph.marginals import marginals_of
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth
from smoother.window.problem import Window


class GivesUp:
    """GTSAM's marginals where they fail already when they are made."""

    def __init__(self, *_: object) -> None:
        raise RuntimeError("Indeterminate linear system detected")


class GivesUpLate:
    """GTSAM's marginals where they fail at a variable."""

    def __init__(self, *_: object) -> None:
        pass

    def marginalCovariance(self, _: int) -> None:
        raise RuntimeError("Indeterminate linear system detected")


def test_dense_and_gtsam_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    """Same linear system, two eliminations: to rounding of a condition number of about 1e10."""
    windows: list[Window] = []
    real = smoother.recovery.second_pass.solve

    def listen(window: Window, **wanted: bool) -> object:
        windows.append(window)
        return real(window, **wanted)

    monkeypatch.setattr(smoother.recovery.second_pass, "solve", listen)
    made = simulate_arm(ArmSimulation(protocol="random", duration_s=6.0), seed=3)
    smooth(replace(made.recording, truth=None), made.calibration, Config(windows=Windows(processes=1)))
    graph, values = build(windows[-1])
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    fast = gtsam.Marginals(graph, values)
    monkeypatch.setattr(gtsam, "Marginals", GivesUp)
    slow = marginals_of(graph, values)
    for key in (X(0), X(7), V(3), B(0), G(0)):
        expected = fast.marginalCovariance(key)
        np.testing.assert_allclose(
            slow.marginalCovariance(key), expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max()
        )
    joint = fast.jointMarginalCovariance([B(0), G(0)])
    np.testing.assert_allclose(
        slow.jointMarginalCovariance([B(0), G(0)]).at(B(0), G(0)),
        joint.at(B(0), G(0)),
        atol=1e-5 * float(np.abs(joint.at(B(0), G(0))).max()),
    )


@pytest.mark.parametrize("marginals", [GivesUp, GivesUpLate])
def test_where_gtsam_gives_up_the_dense_inverse_takes_over(
    monkeypatch: pytest.MonkeyPatch, marginals: type
) -> None:
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorVector(V(0), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, 2.0)))
    values.insert(V(0), np.zeros(3))
    monkeypatch.setattr(gtsam, "Marginals", marginals)
    np.testing.assert_allclose(marginals_of(graph, values).marginalCovariance(V(0)), 4.0 * np.eye(3))
