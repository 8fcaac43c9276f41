"""The grey person: where the skeleton has it, by proportions elsewhere, and what is said of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import make_recording, make_recovery
from test_player import unpacked

from smoother.recording import JOINTS, CameraFrame, JointState, JointTracks
from smoother.report.person import persons, words_of


@pytest.fixture(scope="module")
def pair():
    recording = replace(make_recording(12.0), camera_frame=CameraFrame.KINECT)
    return recording, make_recovery(recording)


def points(person: dict) -> dict[str, np.ndarray]:
    values = unpacked(person["points"]).reshape(person["count"], len(person["names"]), 3)
    return {name: values[:, k] for k, name in enumerate(person["names"])}


def test_a_silhouette_stands_upright_on_the_arms_side_and_says_what_it_is(pair):
    recording, recovery = pair
    (person,) = persons([(recording, recovery)], CameraFrame.KINECT)
    found = points(person)
    shoulder = np.array([0.0, 0.3, 2.1])
    # half a step of 16 bits, and the shoulder does not move
    np.testing.assert_allclose(found["shoulder_right"], np.tile(shoulder, (person["count"], 1)), atol=1e-3)
    # Kinect: x to the camera's left, where a person who faces it has the right arm, y up, z away
    across = found["shoulder_right"] - found["shoulder_left"]
    np.testing.assert_allclose(
        across / (0.22 * person["stature"]), np.tile([1.0, 0, 0], (len(across), 1)), atol=0.01
    )
    assert (found["head"][:, 1] > 0.3 + 0.1).all() and (found["hip_left"][:, 1] < 0.3 - 0.3).all()
    assert (found["nose"][:, 2] < found["head"][:, 2]).all()
    assert person["other"] == "left" and (found["wrist"][:, 1] < found["elbow"][:, 1]).all()
    assert person["measured"] == [] and person["step"] == pytest.approx(0.1, rel=0.02)
    assert "silhouette" in words_of([person]) and "facing the camera" in words_of([person])


def test_the_other_arm_and_both_shoulders_are_the_skeletons_where_it_has_them(pair):
    recording, recovery = pair
    t = recording.arm.t_s
    position = np.full((len(t), len(JOINTS), 3), np.nan)
    position[:, JOINTS.index("shoulder")] = [-0.3, 0.3, 1.9]
    position[:, JOINTS.index("elbow")] = [-0.4, 0.1, 1.8]
    position[:, JOINTS.index("wrist")] = np.stack([0 * t - 0.4, 0.2 * np.sin(t), 1.6 + 0 * t], axis=1)
    state = np.where(np.isfinite(position).all(axis=2), JointState.TRACKED, JointState.NOT_TRACKED).astype(
        np.int8
    )
    away = (t > 5) & (t < 8)
    state[away] = JointState.NOT_TRACKED
    other = JointTracks("camera", t, position, state)
    (person,) = persons([(replace(recording, opposite=other), recovery)], CameraFrame.KINECT)
    found, at = points(person), person["start"] + person["step"] * np.arange(person["count"])
    seen = (at > 1) & (at < 4.8)
    np.testing.assert_allclose(found["wrist"][seen, 1], 0.2 * np.sin(at[seen]), atol=2e-3)
    assert np.isnan(found["wrist"][(at > 5.6) & (at < 7.4)]).all(), "what was not tracked is not drawn"
    np.testing.assert_allclose(
        found["shoulder_left"][seen], np.tile([-0.3, 0.3, 1.9], (seen.sum(), 1)), atol=2e-3
    )
    assert person["measured"] == ["both shoulders", "left arm"]
    # turned with the shoulders: left to right is (0.3, 0, 0.2), so that it faces (0.2, 0, -0.3)
    facing = found["nose"][seen] - found["head"][seen]
    np.testing.assert_allclose(facing[:, 0] / facing[:, 2], -0.2 / 0.3, atol=0.05)
    assert (facing[:, 2] < 0).all()
    assert "As measured: both shoulders and left arm." in words_of([person])


def test_two_arms_of_one_person_are_one_body_and_shoulders_in_one_place_are_not_believed(pair):
    _, recovery = pair
    left = {name: values - np.array([0.35, 0.0, 0.0]) for name, values in recovery.joints.items()}
    (person,) = persons([(None, recovery), (None, replace(recovery, side="left", joints=left))], None)
    assert person["other"] == "" and person["measured"] == ["both shoulders"]
    (same,) = persons([(None, recovery), (None, replace(recovery, side="left"))], None)
    assert same["measured"] == [] and np.isfinite(same["extent"]).all()
    assert len(persons([(None, recovery), (None, replace(recovery, body=2))], None)) == 2
    assert persons([(None, replace(recovery, joints={}))], None) == [] and words_of([]) == ""
