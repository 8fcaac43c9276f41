"""Drawn motions of a whole recovery: the answer's covariance, over windows and sections."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import answer, moving

from smoother import Recovery
from smoother.errors import UnoccludeError
from smoother.recovery.drawn_samples import _widened
from smoother.recovery.samples import widen_turns
from smoother.simulation import SimulatedArm

DRAWS = 300


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    """Two windows, with a gap in each."""
    return moving(2, duration_s=20.0, occlusion_lengths_s=(1.5,))


@pytest.fixture(scope="module")
def drawn(made: SimulatedArm) -> Recovery:
    return answer(made.recording, made.calibration, draws=DRAWS, seed=4)


def whitened(drawn: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Mean square of draws (k, n, d) in sigmas at each time (n,), a coordinate: 1 where they agree."""
    spread = np.einsum("kni,knj->nij", drawn, drawn, dtype=float) / len(drawn)
    return np.einsum("nii->n", np.linalg.solve(covariance, spread)) / drawn.shape[2]


def test_they_have_the_covariance_that_the_answer_states(drawn: Recovery) -> None:
    draws = drawn.draws
    assert draws is not None and len(draws) == DRAWS
    rows = np.searchsorted(drawn.t_s, draws.t_s)
    np.testing.assert_array_equal(drawn.t_s[rows], draws.t_s)
    pose = whitened(np.concatenate([draws.position, draws.rotation], axis=2), drawn.pose_covariance[rows])
    # six coordinates of 300 draws: a mean square is known to 3 %; between nodes covariances are interpolated
    assert abs(np.median(pose) - 1.0) < 0.06 and pose.min() > 0.75 and pose.max() < 1.25
    for joint in ("elbow", "wrist", "hand"):
        square = whitened(draws.joints[joint], drawn.joint_covariance[joint][rows])
        assert abs(np.median(square) - 1.0) < 0.1 and square.min() > 0.7 and square.max() < 1.3, joint
    # between the shoulder's knots the stated covariance is that of the knots, a straight line has less
    square = whitened(draws.joints["shoulder"], drawn.joint_covariance["shoulder"][rows])
    assert square.max() < 1.25 and square.min() > 0.4 and np.percentile(square, 95) > 0.9
    for values in (draws.position, draws.rotation, *draws.joints.values()):
        # the mean of 300 draws is off by 0.06 sigma; four times that anywhere
        assert (np.abs(values.mean(axis=0)) < 0.25 * values.std(axis=0)).all()
    inner = (drawn.t_s > 1.0) & (drawn.t_s < 19.0)
    faster = np.array([drawn.drawn(k).velocity - drawn.velocity for k in range(100)])[:, inner]
    ratio = faster.var(axis=0).sum(axis=1) / np.trace(drawn.velocity_covariance[inner], axis1=1, axis2=2)
    # the derivative of what is drawn 25 times per second; the interpolated covariances say no more
    assert 0.7 < np.median(ratio) < 1.3


@pytest.mark.slow
def test_the_same_seed_gives_the_same_motions_and_the_answer_stays(
    made: SimulatedArm, drawn: Recovery
) -> None:
    few = answer(made.recording, made.calibration, draws=2, seed=4)
    # the same but for the rounding of products that are as wide as there are draws
    np.testing.assert_allclose(few.draws.position, drawn.draws.position[:2], atol=1e-6)
    np.testing.assert_allclose(few.draws.rotation, drawn.draws.rotation[:2], atol=1e-6)
    for name in ("position", "quaternion", "pose_covariance"):
        np.testing.assert_array_equal(getattr(few, name), getattr(drawn, name))
    for wrong in ({"draws": -1}, {"draws": 2, "seed": -1}):
        with pytest.raises(UnoccludeError, match="0 or more; not -1"):
            answer(made.recording, made.calibration, **wrong)


def test_wide_angles_are_widened_as_their_covariance_is() -> None:
    """Exactly: the rows of a square root stand for the draws."""
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 6, 6)) * np.array([0.005, 0.1, 0.4])[:, None, None]
    covariance = root @ root.transpose(0, 2, 1)
    draws = root.transpose(0, 2, 1)  # (n, k, 6): their sum of squares is the covariance
    p, r = _widened(draws[:, :, :3], draws[:, :, 3:], covariance)
    both = np.concatenate([p, r], axis=2)
    np.testing.assert_allclose(np.einsum("nki,nkj->nij", both, both), widen_turns(covariance), rtol=1e-9)
    assert widen_turns(covariance)[2, 3, 3] > 2.0 * covariance[2, 3, 3]
    np.testing.assert_array_equal(both[0], draws[0])  # small angles stay
