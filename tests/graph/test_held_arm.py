"""An arm that is held while hidden: what lies still, knots that count as one, an elbow on its sphere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_window import NOISE, UPPER_ARM_M, small_window

from smoother.graph.build import SAME_POSTURE, upper_arm_sigmas
from smoother.measurements.inertial import InertialSignal, inertial_attitude, is_still
from smoother.recording import ImuStream
from smoother.recovery.samples import Swing


@pytest.mark.parametrize(
    ("turned_deg", "counts_as"),
    [(0.0, 1.0), (np.degrees(SAME_POSTURE), 1.0 / (0.5 + 0.5 * np.exp(-0.5))), (90.0, 2.0)],
)
def test_knots_of_a_gap_count_by_the_postures_that_they_show(turned_deg: float, counts_as: float) -> None:
    window = small_window(1, upper=False)
    assert window.shoulder is not None
    in_gap = [k for k, node in enumerate(window.shoulder.node) if 3 <= node <= 6]
    R = np.tile(np.eye(3), (len(window.t), 1, 1))
    R[window.shoulder.node[in_gap[-1]]] = Rotation.from_rotvec([0, np.radians(turned_deg), 0]).as_matrix()
    start = replace(window.forearm.start, R=R)
    sigma = upper_arm_sigmas(replace(window, bodies=(replace(window.forearm, start=start),)))
    assert len(in_gap) == 2
    assert sum(NOISE.upper_arm_sigma_m**2 / sigma[in_gap] ** 2) == pytest.approx(counts_as, rel=2e-3)
    assert (np.delete(sigma, in_gap) == NOISE.upper_arm_sigma_m).all()  # what the camera sees counts alone


@pytest.mark.parametrize("sigma_m", [0.01, 0.05, 0.1])
def test_an_error_across_the_upper_arm_moves_the_elbow_along_it(sigma_m: float) -> None:
    """Against elbows put on the sphere itself; a turn of the forearm moves its elbow as a shift does."""
    along, lever = np.array([[0.6, 0.0, 0.8]]), np.array([[-0.1, 0.2, 0.05]])
    swing = Swing(along, UPPER_ARM_M, lever)
    rng = np.random.default_rng(3)
    root = np.diag([sigma_m] * 3 + [0.03] * 3)
    root[:3, 3:] = root[3:, :3] = 0.01 * rng.normal(size=(3, 3))  # place and turn have something in common
    root = 0.5 * (root + root.T)
    added = swing.variance((root @ root)[None])[0]
    drawn = rng.normal(size=(20_000, 6)) @ root
    elbow = drawn[:, :3] + np.cross(drawn[:, 3:], lever[0])
    elbow -= (elbow @ along[0])[:, None] * along[0]
    angle = np.linalg.norm(elbow, axis=1) / UPPER_ARM_M
    along_m = UPPER_ARM_M * (np.cos(angle) - 1.0)
    assert added == pytest.approx(np.mean(along_m**2) * np.outer(along[0], along[0]), rel=0.2, abs=1e-9)
    moved = swing.moved(drawn[None, :, :3], drawn[None, :, 3:])[0]
    assert moved - drawn[:, :3] == pytest.approx(along_m[:, None] * along[0], abs=1e-9)


@pytest.mark.parametrize(("sway_deg", "still"), [(0.0, True), (0.8, False), (2.5, False)])
def test_an_arm_that_sways_does_not_lie_still(sway_deg: float, still: bool) -> None:
    """At no moment: a sway turns back twice a period, and is still there for a short while."""
    t = np.arange(0.0, 12.0, 0.01)
    rate = 2 * np.pi * 0.6
    gyro, acc = np.zeros((len(t), 3)), np.tile([0.0, 0.0, 9.81], (len(t), 1))
    gyro[:, 2] = np.radians(sway_deg) * rate * np.cos(rate * t)
    noise = np.random.default_rng(4).normal(size=(2, len(t), 3)) * np.array([0.02, 0.002])[:, None, None]
    signal = InertialSignal(ImuStream("imu", t, acc + noise[0], gyro + noise[1]))
    found = is_still(signal, inertial_attitude(signal, 100.0), np.arange(2.0, 10.0, 0.26))
    assert found.all() if still else not found.any()
