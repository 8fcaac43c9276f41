"""What a window's solution interpolates, corrects, keeps and refuses."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from scenes import first_window, moving, plain

import smoother.graph.solve
import smoother.window.nodes
from smoother.errors import SolveError
from smoother.graph.solve import solve
from smoother.window.problem import Window


@pytest.fixture
def window() -> Window:
    """1.1 s of a moving arm, all joints visible: 34 nodes, elbow, wrist, hand and shoulder."""
    made = moving(3, "white", 1.1, noise_m=0.008, occlusion_lengths_s=())
    with patch.object(smoother.window.nodes, "GROUPED_S", 0.0):  # each camera frame a node
        return first_window(made.recording, made.calibration)


def test_covariances_between_the_computed_ones(window: Window) -> None:
    """Marginals are taken at some nodes: what is interpolated errs on the careful side.

    A sigma that bends upwards at the ends of a window of one second is the worst case: half as much again.
    """
    window = replace(plain(window), considered=None)
    interpolated = solve(window, with_covariance=True)
    with patch.multiple(smoother.graph.solve, COVARIANCE_S=1e-6, SHOULDER_COVARIANCE_S=1e-6):
        computed = solve(window, with_covariance=True)
    both = (interpolated.forearm.pose_covariance, computed.forearm.pose_covariance)
    some, every = (np.sqrt(np.einsum("nii->ni", C)) for C in both)
    assert (some / every).min() > 0.85
    assert (some / every).max() < 1.7
    assert (some / every).mean() < 1.15
    np.testing.assert_allclose(some[[0, -1]], every[[0, -1]], rtol=1e-9)


def test_what_nothing_determines_is_a_sentence_with_the_time(window: Window) -> None:
    """No camera sample at all leaves position free: no key number, no traceback of another library."""
    window = replace(window, joint_measurements=(), shoulder=None)
    layout = replace(window.priors.layout, joints=(), has_upper_arm=False)
    shared = window.priors.shared
    shared = replace(shared, mean=shared.mean[:8], covariance=shared.covariance[:8, :8])
    window = replace(window, priors=replace(window.priors, layout=layout, shared=shared))
    with pytest.raises(SolveError, match=r"between \d+\.\d s and \d+\.\d s is not determined"):
        solve(window, with_covariance=True)
