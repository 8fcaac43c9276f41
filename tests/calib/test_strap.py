"""The strap in rendered images: to millimetres where it is seen, and rejected where it is not."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.intrinsics import Intrinsics, PlacedCamera
from calib.strap import Depth, find_strap
from smoother.simulation.strap import Arm, StrapImageNoise, render

#: The colour camera sits 5 cm beside the depth camera, as in a Kinect.
COLOUR = PlacedCamera(Intrinsics(640, 360, 450.0, 450.0, 320.0, 180.0), t_C_K=np.array([0.05, 0.0, 0.0]))
INFRARED = PlacedCamera(Intrinsics(512, 424, 366.0, 366.0, 256.0, 212.0))


def an_arm(seed: int) -> tuple[Arm, np.random.Generator]:
    """A forearm somewhere in view, its strap near the wrist, often with a marker beside it."""
    rng = np.random.default_rng(seed)
    along = rng.normal(size=3) * [1.0, 1.0, 0.4]
    along /= np.linalg.norm(along)
    elbow = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), rng.uniform(1.5, 2.5)])
    length = rng.uniform(0.23, 0.28)
    strap, marker = length - rng.uniform(0.03, 0.07), rng.choice([None, 0.03, -0.03])
    return Arm(elbow, elbow + length * along, rng.uniform(0.03, 0.04), strap, marker=marker), rng


def look(arm: Arm, rng: np.random.Generator, joint_sigma_m: float, colour: PlacedCamera = COLOUR):
    """Render and search, with joints as a camera places them."""
    noise = StrapImageNoise(rng=rng)
    grey, _ = render(arm, colour, noise)
    _, z = render(arm, INFRARED, noise)
    elbow, wrist = (end + rng.normal(0, joint_sigma_m, 3) for end in (arm.elbow, arm.wrist))
    return find_strap(
        grey,
        colour,
        Depth(z, INFRARED),
        elbow,
        wrist,
        radius_m=arm.radius,
        joint_sigma_m=max(joint_sigma_m, 0.003),
    )


def test_five_millimetres():
    errors, nees = [], []
    for seed in range(24):
        arm, rng = an_arm(seed)
        seen = look(arm, rng, 0.008)
        if seen.found:
            error = seen.core - arm.strap_core
            errors.append(error)
            nees.append(error @ np.linalg.solve(seen.covariance, error) / 3)
    assert len(errors) >= 19
    lengths = np.linalg.norm(errors, axis=1)
    assert np.sqrt(np.mean(lengths**2)) < 0.005  # of the whole vector, with joints 8 mm off an axis
    assert lengths.max() < 0.012
    assert np.mean(nees) < 1.5


def test_a_marker_beside_the_strap_does_not_move_it():
    arm, _ = an_arm(0)
    places = []
    for marker in (None, 0.028, -0.028):
        seen = look(replace(arm, marker=marker), np.random.default_rng(1), 0.0)
        assert seen.found, seen.reason
        assert np.linalg.norm(seen.core - arm.strap_core) < 0.009  # at 2.6 m and half turned to the camera
        places.append(seen.core)
    # a pixel is 6 mm there, and strap and marker are as far apart
    assert np.linalg.norm(np.array(places[1:]) - places[0], axis=1).max() < 0.007


def test_nothing_is_found_where_the_strap_cannot_be_seen():
    """The body stands before the arm while the camera goes on to call its joints tracked; or no strap."""
    accepted = 0
    for seed in range(12):
        arm, rng = an_arm(seed)
        middle = 0.5 * (arm.elbow + arm.wrist)
        trunk = (middle - [0.0, 0.0, 0.3], np.array([0.22, 0.4, 0.12]))
        accepted += look(replace(arm, trunk=trunk), rng, 0.008).found
        accepted += look(replace(arm, strap=None, marker=None), rng, 0.008).found
    assert accepted == 0


def test_the_papers_criteria():
    arm, rng = an_arm(3)
    near = look(replace(arm, strap=0.06, marker=None), rng, 0.0)
    assert near.reason == "the strap is nearer to the elbow than to the wrist"
    assert np.isnan(near.core).all()
    grey, _ = render(arm, COLOUR)
    _, z = render(arm, INFRARED)
    # joints that are both 7 cm too far away, along the ray: the same pixels, another place
    far = [end * (1 + 0.07 / end[2]) for end in (arm.elbow, arm.wrist)]
    lens = replace(COLOUR, t_C_K=np.zeros(3))
    grey, _ = render(arm, lens)
    seen = find_strap(grey, lens, Depth(z, INFRARED), *far, radius_m=arm.radius)
    assert seen.reason == "the strap is more than 5 cm off the elbow-wrist line"
    ahead = np.array([0.0, 0.0, 0.25])
    seen = find_strap(
        grey, lens, Depth(z, INFRARED), np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 2.0]) - ahead
    )
    assert seen.reason == "the forearm points to the camera"
    blind = find_strap(grey, lens, Depth(np.full_like(z, np.nan), INFRARED), arm.elbow, arm.wrist)
    assert blind.reason == "no depth at the strap"
    away = np.array([5.0, 0.0, 0.0])
    outside = find_strap(grey, lens, Depth(z, INFRARED), arm.elbow + away, arm.wrist + away)
    assert outside.reason == "the forearm is not inside the image"


@given(
    st.lists(st.floats(-0.08, 0.08), min_size=5, max_size=5),
    st.floats(-0.3, 0.3),
    st.floats(-0.3, 0.3),
    st.floats(0.8, 3.0),
)
@settings(max_examples=40, deadline=None)
def test_pixels_and_rays_are_each_others_inverse(bend: list[float], x: float, y: float, z: float):
    turn, _ = cv2.Rodrigues(np.array([0.02, -0.03, 0.01]))
    terms = tuple(np.array(bend) * [1, 1, 0.05, 0.05, 0.2])
    camera = replace(COLOUR, lens=replace(COLOUR.lens, distortion=terms), R_C_K=turn)
    point = np.array([[x, y, z]])
    pixel, depth = camera.pixels(point)
    ray = camera.rays(pixel)
    assert camera.origin + depth[0] * ray[0] == pytest.approx(point[0], abs=2e-3)
    matrix = np.array([[450.0, 0, 320], [0, 450, 180], [0, 0, 1]])
    slow, _ = cv2.projectPoints(
        point,
        cv2.Rodrigues(turn)[0],
        camera.t_C_K,
        matrix,
        np.array(terms),
    )
    assert pixel[0] == pytest.approx(slow.ravel(), abs=1e-6)
