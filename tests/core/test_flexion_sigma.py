"""The sigma of the elbow's flexion against errors that were drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_results import recovery
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.joint_angles import arm_angles, elbow_flexion_sigma, wrapped_deg
from smoother.linalg import unit
from smoother.result import Recovery

COUNT, DRAWS = 60, 8_000
#: The same errors everywhere but for their directions: small enough that the angle follows them linearly.
POSITION_M, TURN_RAD, SHOULDER_M = 0.003, 0.008, 0.006


def _covariances(rng: np.random.Generator, size: int, sigma: FloatArray) -> FloatArray:
    """(COUNT, size, size), every element correlated with every other."""
    root = rng.normal(size=(COUNT, size, size)) / np.sqrt(size)
    correlated = root @ root.transpose(0, 2, 1) + 0.3 * np.eye(size)
    return np.asarray(correlated * sigma[:, None] * sigma)


def bent_arms(seed: int = 0) -> Recovery:
    """Arms bent by 20 to 150 degrees, the IMU near the wrist, off the forearm's axis."""
    rng = np.random.default_rng(seed)
    made = recovery(COUNT, seed)
    shoulder = rng.normal(size=(COUNT, 3))
    humerus, other = unit(rng.normal(size=(COUNT, 3))), rng.normal(size=(COUNT, 3))
    across = unit(other - np.einsum("ni,ni->n", other, humerus)[:, None] * humerus)
    flexion = np.radians(np.linspace(20.0, 150.0, COUNT))[:, None]
    forearm = np.cos(flexion) * humerus + np.sin(flexion) * across
    elbow = shoulder + 0.30 * humerus
    wrist = elbow + 0.25 * forearm
    sigma = np.repeat([POSITION_M, TURN_RAD], 3)
    return replace(
        made,
        position=elbow + 0.2 * forearm + 0.03 * rng.normal(size=(COUNT, 3)),
        joints={"shoulder": shoulder, "elbow": elbow, "wrist": wrist},
        pose_covariance=_covariances(rng, 6, sigma),
        joint_covariance={"shoulder": _covariances(rng, 3, np.full(3, SHOULDER_M))},
    )


def drawn_sigma(made: Recovery, sample: int, rng: np.random.Generator) -> float:
    """Standard deviation of the flexion of a sample over drawn errors of IMU and shoulder, degrees."""
    joints = {name: position[sample] for name, position in made.joints.items()}
    pose = rng.multivariate_normal(np.zeros(6), made.pose_covariance[sample], DRAWS)
    moved = {
        joint: made.position[sample]
        + pose[:, :3]
        + Rotation.from_rotvec(pose[:, 3:]).apply(joints[joint] - made.position[sample])
        for joint in ("elbow", "wrist")
    }
    off = rng.multivariate_normal(np.zeros(3), made.joint_covariance["shoulder"][sample], DRAWS)
    drawn = arm_angles(moved | {"shoulder": joints["shoulder"] + off}, DRAWS)["elbow_flexion"]
    true = arm_angles({name: position[None] for name, position in joints.items()}, 1)["elbow_flexion"]
    return float(np.sqrt(np.mean(wrapped_deg(drawn - true) ** 2)))


@pytest.mark.parametrize("seed", range(2))
def test_against_drawn_errors(seed: int) -> None:
    made, rng = bent_arms(seed), np.random.default_rng(seed)
    drawn = np.array([drawn_sigma(made, sample, rng) for sample in range(COUNT)])
    stated = elbow_flexion_sigma(made)
    np.testing.assert_allclose(stated, drawn, rtol=0.1)
    assert drawn.max() > 1.2 * drawn.min()  # the samples differ: one figure for all would not do


def test_either_error_alone() -> None:
    """A shoulder off by s across the humerus, and a forearm turned by an angle about the elbow's axis."""
    made = bent_arms()
    upper = 0.30
    nothing, shoulder = np.zeros((COUNT, 6, 6)), np.tile(SHOULDER_M**2 * np.eye(3), (COUNT, 1, 1))
    off = replace(made, pose_covariance=nothing, joint_covariance={"shoulder": shoulder})
    np.testing.assert_allclose(elbow_flexion_sigma(off), np.degrees(SHOULDER_M / upper), rtol=1e-6)
    turned = nothing.copy()
    turned[:, 3:, 3:] = TURN_RAD**2 * np.eye(3)
    about_the_elbow = replace(
        made,
        position=made.joints["elbow"],
        pose_covariance=turned,
        joint_covariance={"shoulder": np.zeros((COUNT, 3, 3))},
    )
    np.testing.assert_allclose(elbow_flexion_sigma(about_the_elbow), np.degrees(TURN_RAD), rtol=1e-6)


@pytest.mark.parametrize("missing", ["shoulder", "elbow", "wrist"])
def test_without_a_joint_it_is_not_known(missing: str) -> None:
    made = bent_arms()
    joints = {name: position for name, position in made.joints.items() if name != missing}
    assert np.isnan(elbow_flexion_sigma(replace(made, joints=joints))).all()


def test_without_a_stated_shoulder_it_is_not_known() -> None:
    sigma = elbow_flexion_sigma(replace(bent_arms(), joint_covariance={}))
    assert sigma.shape == (COUNT,) and np.isnan(sigma).all()


def test_samples_without_an_answer_have_none() -> None:
    made = bent_arms()
    pose = made.pose_covariance.copy()
    pose[3] = np.nan
    sigma = elbow_flexion_sigma(replace(made, pose_covariance=pose))
    assert np.flatnonzero(np.isnan(sigma)).tolist() == [3]
