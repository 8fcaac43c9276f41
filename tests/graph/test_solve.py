"""What a window's solution interpolates, corrects, keeps and refuses."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from scenes import arm, first_window, plain

import smoother.graph.solve
import smoother.window.nodes
from smoother.errors import SolveError
from smoother.graph.solve import solve
from smoother.simulation import SimulatedArm
from smoother.window.problem import Window


def one_window(noise_m: float = 0.008) -> Window:
    """1.1 s of a moving arm, all joints visible: 34 nodes, elbow, wrist, hand and shoulder."""
    preset = "white" if noise_m > 0.005 else "clean"  # the IMU without errors too
    made = arm(3, preset, noise_m=noise_m, protocol="random", duration_s=1.1, occlusion_lengths_s=())
    return every_frame(made)


def every_frame(made: SimulatedArm) -> Window:
    """The only window of a recording, each camera frame a node."""
    with patch.object(smoother.window.nodes, "GROUPED_S", 0.0):
        return first_window(made.recording, made.calibration)


def test_covariances_between_the_computed_ones() -> None:
    """Marginals are taken at some nodes: what is interpolated errs on the careful side.

    A sigma that bends upwards at the ends of a window of one second is the worst case: half as much again.
    """
    window = replace(plain(one_window()), considered=None)
    interpolated = solve(window, with_covariance=True)
    with patch.multiple(smoother.graph.solve, COVARIANCE_S=1e-6, SHOULDER_COVARIANCE_S=1e-6):
        computed = solve(window, with_covariance=True)
    both = (interpolated.forearm.pose_covariance, computed.forearm.pose_covariance)
    some, every = (np.sqrt(np.einsum("nii->ni", C)) for C in both)
    assert (some / every).min() > 0.85
    assert (some / every).max() < 1.7
    assert (some / every).mean() < 1.15
    np.testing.assert_allclose(some[[0, -1]], every[[0, -1]], rtol=1e-9)


def test_a_wrong_upper_arm_is_corrected_towards_the_truth() -> None:
    """A length known to 5 cm and 3 cm wrong: the window must correct it towards the truth."""
    window = one_window(0.001)
    layout, shared = window.priors.layout, window.priors.shared
    mean, covariance = shared.mean.copy(), shared.covariance.copy()
    true = mean[layout.upper_arm].copy()
    mean[layout.upper_arm] += 0.03
    covariance[layout.upper_arm] = covariance[:, layout.upper_arm] = 0.0
    covariance[layout.upper_arm, layout.upper_arm] = 0.05**2
    prior = replace(window.priors, shared=replace(shared, mean=mean, covariance=covariance))
    found = solve(plain(replace(window, priors=prior)), with_covariance=False).shared
    # the camera sees elbow and shoulder to within millimetres
    assert abs(found[layout.upper_arm] - true)[0] < 0.01


def test_what_nothing_determines_is_a_sentence_with_the_time() -> None:
    """No camera sample at all leaves position free: no key number, no traceback of another library."""
    window = replace(one_window(), joint_measurements=(), shoulder=None)
    layout = replace(window.priors.layout, joints=(), has_upper_arm=False)
    shared = window.priors.shared
    shared = replace(shared, mean=shared.mean[:8], covariance=shared.covariance[:8, :8])
    window = replace(window, priors=replace(window.priors, layout=layout, shared=shared))
    with pytest.raises(SolveError, match=r"between \d+\.\d s and \d+\.\d s is not determined"):
        solve(window, with_covariance=True)
