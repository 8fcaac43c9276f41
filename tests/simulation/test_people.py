"""Several people with shuffled IMUs: what the scene claims is what the sensors measure."""

from __future__ import annotations

import numpy as np
import pytest

from smoother.recording import JOINTS
from smoother.simulation import ArmSimulation, PeopleSimulation, simulate_people

CLEAN = ArmSimulation.preset("clean", protocol="random", duration_s=6.0, imu_rate_hz=50)


def test_counts_and_names() -> None:
    scene = simulate_people(PeopleSimulation(people=3, sensors=6, on_table=2), CLEAN, 1)
    assert len(scene.arms) == 6 and {(body, side) for body, side, _ in scene.arms} == {
        (body, side) for body in range(3) for side in ("left", "right")
    }
    places = list(scene.truth.values())
    assert list(scene.truth) == [f"/imu/sensor_{k}" for k in range(1, 7)]
    assert places.count((None, "none")) == 2 and len(set(places)) == 5
    with pytest.raises(ValueError, match="8 places"):
        simulate_people(PeopleSimulation(sensors=10, on_table=1), CLEAN, 1)


def test_a_worn_imu_turns_with_its_limb_and_the_tables_does_not() -> None:
    """Without soft tissue the upper arm's sensor turns at least as fast as the bone's direction."""
    people = PeopleSimulation(sensors=9, on_table=1, hanging=0, clocks_apart_s=0, tissue_deg=0)
    scene = simulate_people(people, CLEAN, 2)
    arms = {(body, side): arm for body, side, arm in scene.arms}
    for worn in scene.worn:
        rate = np.linalg.norm(worn.stream.gyro, axis=1)
        if worn.body is None:
            assert rate.max() < 1e-9
            np.testing.assert_allclose(np.linalg.norm(worn.stream.acc, axis=1), 9.81, atol=1e-6)
            continue
        segment, side = worn.joint.rsplit("_", 1)
        arm = arms[worn.body, side]
        first, second = ("elbow", "wrist") if segment == "wrist" else ("shoulder", "elbow")
        along = arm.position[:, JOINTS.index(second)] - arm.position[:, JOINTS.index(first)]
        seen = np.isfinite(along).all(axis=1)
        along = along[seen] / np.linalg.norm(along[seen], axis=1, keepdims=True)
        turning = np.linalg.norm(np.gradient(along, arm.t_s[seen], axis=0), axis=1)
        sensed = np.interp(arm.t_s[seen], worn.stream.t_s, rate)
        # differences over two frames: a few per cent where the rate changes
        assert (turning[2:-2] <= 1.05 * sensed[2:-2] + 0.05).all()


def test_arms_of_one_person_sway_together() -> None:
    settings = CLEAN.model_copy(update={"sway_m": 0.03})
    scene = simulate_people(PeopleSimulation(hanging=1.0), settings, 4)
    shoulder = {(body, side): arm.position[:, JOINTS.index("shoulder")] for body, side, arm in scene.arms}
    for body in range(2):
        right, left = (x - x.mean(axis=0) for x in (shoulder[body, "right"], shoulder[body, "left"]))
        assert np.sqrt(np.mean((right - left) ** 2)) < 0.3 * np.sqrt(np.mean(right**2))
