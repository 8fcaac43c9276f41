"""`ukf` and `rts`: exact where linear, on simulated arms; the sigmas that baselines state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from simulated_scenes import NO_GAPS, arm, errors, rms, scene_of, turned_off

from smoother.baselines import rts as es
from smoother.baselines.rts import linearised, residuals, rts, start, ukf
from smoother.baselines.scene import Baseline
from smoother.measurements.inertial import InertialSignal
from smoother.recording import JOINTS


def states_of_an_arm(seed: int, rng: np.random.Generator) -> tuple[es.InertialTrajectory, InertialSignal]:
    """Ten nodes of a moving arm, their states off by a little, gravity and biases not zero."""
    scene = scene_of(arm("white", seed, occlusion_lengths_s=NO_GAPS, duration_s=5.0))
    states, _ = start(scene, es.levers_of(scene))
    part = slice(60, 70)
    near = es.InertialTrajectory(states.t[part], states.R[part], states.x[part])
    return near.moved(0.02 * rng.normal(size=(10, es.SIZE))), InertialSignal(scene.imu)


@pytest.mark.parametrize("column", range(es.SIZE))
def test_transition_is_the_derivative_of_the_prediction(column: int):
    rng = np.random.default_rng(5)
    states, signal = states_of_an_arm(3, rng)

    def ahead(at: es.InertialTrajectory) -> np.ndarray:
        """Error of the predicted next state against the unchanged one."""
        after, before = (es.predict(each, es.integrated(signal, each)) for each in (at, states))
        return es.less(after, before)[:, :9]

    step = 1e-5
    error = np.zeros((len(states.t), es.SIZE))
    error[:, column] = step
    numeric = (ahead(states.moved(error)) - ahead(states.moved(-error))) / (2 * step)
    F = es.transition(states, es.integrated(signal, states))
    # biases hold the rotation inside a interval of 33 ms to first order
    np.testing.assert_allclose(F[:, :9, column], numeric, rtol=0.02, atol=2e-4)


def test_measurements_are_the_derivative_of_the_residuals():
    made = arm("white", 2, occlusion_lengths_s=NO_GAPS, duration_s=5.0)
    scene = scene_of(made)
    states, camera = start(scene, es.levers_of(scene))
    rng = np.random.default_rng(0)
    error = 1e-4 * rng.normal(size=(len(states.t), es.SIZE))
    chain = linearised(states, camera, InertialSignal(scene.imu), scene)

    def loss(at: es.InertialTrajectory) -> np.ndarray:
        """Half the weighted squares of a node, the weights those of the linearisation."""
        left, first = residuals(at, camera), residuals(states, camera)
        size = np.linalg.norm(first, axis=2) / camera.sigma_m
        weight = 1.0 / (1.0 + (size / 2.8) ** 2) / camera.sigma_m**2
        total = 0.5 * np.nansum(weight[:, :, None] * left**2, axis=(1, 2))
        elbow = at.x[:, es.P] + at.R @ camera.levers["elbow"]
        off = np.linalg.norm(elbow - at.x[:, es.SHOULDER], axis=1) - camera.upper_arm_m
        share = np.minimum(np.gradient(at.t) / 0.09, 1.0)
        return total + 0.5 * share * (off / es.ARM_PRIOR.upper_arm_flex_m) ** 2

    slope = loss(states.moved(error)) - loss(states.moved(-error))
    expected = -2.0 * np.einsum("ni,ni->n", chain.vector[..., 0], error)
    np.testing.assert_allclose(slope, expected, rtol=0.01, atol=0.01 * np.abs(expected).max())


def test_rts_bears_wrong_samples():
    clean, spoilt = (
        arm("white", 1, occlusion_lengths_s=(1.0,), outliers=part, outlier_m=0.5) for part in (0.0, 0.05)
    )
    before, after = (
        rms(errors(made, rts(scene_of(made)))[scene_of(made).occluded]) for made in (clean, spoilt)
    )
    # Cauchy's loss: a wrong sample pulls a hundredth of what it would
    assert after < before + 0.006


@pytest.mark.parametrize("baseline", [rts, ukf])
def test_strap_alone_is_enough(baseline: Baseline):
    made = arm("white", 3, occlusion_lengths_s=(1.0,), strap=True)
    scene = scene_of(made, tilt_deg=2.0)
    joints = np.full_like(scene.joints, np.nan)
    strap = JOINTS.index("strap")
    joints[:, strap] = made.recording.arm.position[: len(joints), strap]
    point = np.where(scene.visible[:, None], joints[:, strap], np.nan)
    joints[~scene.visible] = np.nan
    bare = replace(made.calibration, lever_arms={}, upper_arm=None)
    path = baseline(replace(scene, joints=joints, point=point, point_sigma_m=0.008, calibration=bare))
    error = errors(made, path)
    assert rms(error[4:][~scene.occluded[4:]]) < 0.012
    assert rms(error[scene.occluded]) < (0.02 if baseline is rts else 0.15)
    assert rms(turned_off(made, path.R_K_A)[200:]) < 3.0
