"""The dense marginals against GTSAM's own, where GTSAM's do not give up."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, G, V, X

import smoother.passes
from smoother.config import Config, Windows
from smoother.graph import build
from smoother.marginals import _Dense
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.smoothing import smooth
from smoother.window import Window


def test_dense_and_gtsam_agree(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    """Same linear system, two eliminations: to rounding of a condition number of about 1e10."""
    seen: list[Window] = []
    real = smoother.passes.solve

    def listen(window: Window, **wanted: bool) -> object:
        seen.append(window)
        return real(window, **wanted)

    monkeypatch.setattr(smoother.passes, "solve", listen)
    made = simulate_arm(ArmSimulation(protocol="random", duration_s=6.0), seed=3)
    smooth(replace(made.recording, truth=None), made.calibration, Config(windows=Windows(processes=1)))
    graph, values = build(seen[-1])
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    fast, slow = gtsam.Marginals(graph, values), _Dense(graph, values)
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
