"""One window's graph against an independent slow solution of the same problem, and its own limits."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from curve import angle_rad
from scenes import arm, first_window, plain, point
from slow_window import Answer, SlowWindow

import smoother.graph.solve
import smoother.window.nodes
from smoother.errors import SolveError
from smoother.graph.solve import solve
from smoother.simulation import SimulatedArm
from smoother.window.problem import Window
from smoother.window.solution import Solution

#: How far the two may be apart, in sigmas: the graph stops at a relative decrease of 1e-4 of its error
#: (measured 0.016) and turns the covariance of an interval by the interval's own rotation (0.2 rad).
SIGMAS = 0.05


class Pair:
    """A window solved both ways."""

    def __init__(self, window: Window) -> None:
        self.window = plain(window)
        with patch.multiple(
            smoother.graph.solve, COVARIANCE_S=1e-6, SHOULDER_COVARIANCE_S=1e-6
        ):  # every node
            self.window = replace(self.window, considered=None)  # errors that the slow one does not know
            self.fast: Solution = solve(self.window, with_covariance=True)
        self.slow: Answer = SlowWindow(self.window).solve()


def one_window(noise_m: float = 0.008) -> Window:
    """1.1 s of a moving arm, all joints visible: 34 nodes, elbow, wrist, hand and shoulder."""
    preset = "white" if noise_m > 0.005 else "clean"  # the IMU without errors too
    made = arm(3, preset, noise_m=noise_m, protocol="random", duration_s=1.1, occlusion_lengths_s=())
    return every_frame(made)


def every_frame(made: SimulatedArm) -> Window:
    """The only window of a recording, each camera frame a node."""
    with patch.object(smoother.window.nodes, "GROUPED_S", 0.0):
        return first_window(made.recording, made.calibration)


@pytest.fixture(scope="module", params=[0.008, 0.001], ids=["white", "precise"])
def pair(request: pytest.FixtureRequest) -> Pair:
    return Pair(one_window(request.param))


@pytest.fixture(scope="module")
def point_pair() -> Pair:
    return Pair(every_frame(point(4, duration_s=1.1, occlusion_lengths_s=())))


def test_states_agree(pair: Pair) -> None:
    fast, slow = pair.fast.forearm.states, pair.slow.states
    assert 30 <= len(pair.window.t) <= 36
    assert np.abs(fast.p - slow.p).max() < 1e-4  # measured 3e-5
    assert np.abs(fast.v - slow.v).max() < 1e-3
    sigma = np.sqrt(np.trace(pair.slow.pose_covariance[:, 3:, 3:], axis1=1, axis2=2))
    assert (angle_rad(fast.R, slow.R) < SIGMAS * sigma).all()
    assert np.degrees(angle_rad(fast.R, slow.R).max()) < 0.05  # measured 0.023 of a sigma of 2 degrees


def test_the_same_optimum(pair: Pair) -> None:
    """The error that the graph states is the sum of squares that numpy finds."""
    assert pair.fast.error == pytest.approx(pair.slow.cost, rel=1e-3, abs=1e-3)


def test_covariances_agree(pair: Pair) -> None:
    """Inverse of J'J: sigmas within 1 %, that is 2 % of the covariance; correlations within 0.02."""
    for fast, slow in (
        (pair.fast.forearm.pose_covariance, pair.slow.pose_covariance),
        (pair.fast.forearm.velocity_covariance, pair.slow.velocity_covariance),
    ):
        sigma = np.sqrt(np.einsum("nii->ni", slow))
        np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", fast)), sigma, rtol=0.01)
        scale = sigma[:, :, None] * sigma[:, None, :]
        np.testing.assert_allclose(fast / scale, slow / scale, atol=0.02)


def test_covariances_between_the_computed_ones(pair: Pair) -> None:
    """Marginals are taken at some nodes: what is interpolated errs on the careful side.

    A sigma that bends upwards at the ends of a window of one second is the worst case: half as much again.
    """
    interpolated = solve(pair.window, with_covariance=True)
    both = (interpolated.forearm.pose_covariance, pair.fast.forearm.pose_covariance)
    some, every = (np.sqrt(np.einsum("nii->ni", C)) for C in both)
    assert (some / every).min() > 0.85
    assert (some / every).max() < 1.7
    assert (some / every).mean() < 1.15
    np.testing.assert_allclose(some[[0, -1]], every[[0, -1]], rtol=1e-9)


def test_biases_gravity_and_lever_arms_agree(pair: Pair) -> None:
    layout = pair.window.priors.layout
    sigma = np.sqrt(np.diag(pair.slow.shared_covariance))
    apart = np.abs(pair.fast.shared - pair.slow.shared) / sigma
    assert apart[layout.bias].max() < 2 * SIGMAS  # the softest directions of the problem
    assert apart[layout.gravity].max() < 2 * SIGMAS
    for joint in ("elbow", "wrist", "hand"):
        assert apart[layout.lever(joint)].max() < SIGMAS
    assert apart[layout.upper_arm].max() < SIGMAS  # a correction with the wrong sign is 1.7 off


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


def test_a_point_agrees_too(point_pair: Pair) -> None:
    """The strap alone: no lever arms, no shoulder."""
    fast, slow = point_pair.fast, point_pair.slow
    assert np.abs(fast.forearm.states.p - slow.states.p).max() < 1e-4
    sigma = np.sqrt(np.trace(slow.pose_covariance[:, 3:, 3:], axis1=1, axis2=2))
    assert (angle_rad(fast.forearm.states.R, slow.states.R) < SIGMAS * sigma).all()
    ratio = np.einsum("nii->ni", fast.forearm.pose_covariance) / np.einsum("nii->ni", slow.pose_covariance)
    np.testing.assert_allclose(ratio, 1.0, atol=0.02)


def test_an_arm_that_keeps_its_velocity() -> None:
    """Priors on the velocity's change in some intervals, against numpy, and that they do what they say."""
    window = plain(one_window())
    count = len(window.t) - 1
    change = np.full(count, np.inf)
    change[5:15] = 0.02
    held = Pair(replace(window, velocity_change=change))
    assert np.abs(held.fast.forearm.states.v - held.slow.states.v).max() < 1e-3
    assert held.fast.error == pytest.approx(held.slow.cost, rel=1e-3, abs=1e-3)
    free = solve(
        replace(window, velocity_change=np.full(count, np.inf)), with_covariance=False
    ).forearm.states.v
    moved, kept = (
        np.linalg.norm(np.diff(v, axis=0)[5:15], axis=1) for v in (free, held.fast.forearm.states.v)
    )
    assert kept.sum() < moved.sum()


def test_what_nothing_determines_is_a_sentence_with_the_time() -> None:
    """No camera sample at all leaves position free: no key number, no traceback of another library."""
    window = replace(one_window(), joint_measurements=(), shoulder=None)
    layout = replace(window.priors.layout, joints=(), has_upper_arm=False)
    shared = window.priors.shared
    shared = replace(shared, mean=shared.mean[:8], covariance=shared.covariance[:8, :8])
    window = replace(window, priors=replace(window.priors, layout=layout, shared=shared))
    with pytest.raises(SolveError, match=r"between \d+\.\d s and \d+\.\d s is not determined"):
        solve(window, with_covariance=True)
