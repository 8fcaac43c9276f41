"""Reach volumes and zones about a person of known size."""

from __future__ import annotations

import numpy as np
import pytest
from measured_arms import recovery_of, simulated

from smoother.measures import Measure, measure
from smoother.measures.figures import alpha_volume, reach_figures, voxel_means

T = np.arange(0.0, 3.0, 0.02)
#: Of a stature of 1.75 m: upper arm and forearm are 0.186 and 0.146 of it.
STATURE, UPPER, FORE = 1.75, 0.3255, 0.2555


def held(wrist: tuple[float, float, float], side: str = "right") -> dict[str, Measure]:
    """The measures of a wrist that rests at a place from the shoulder: right or left outward, up, back; m."""
    mirror = -1.0 if side == "left" else 1.0
    place = np.array(wrist) * [mirror, 1.0, 1.0]
    # the elbow lies where both bones meet, on whichever side: the zones only need their lengths
    away = np.linalg.norm(place)
    along = (UPPER**2 - FORE**2 + away**2) / (2 * away) * place / away
    across = np.cross(place, [0.3, 0.2, 1.0])
    lift = np.sqrt(max(UPPER**2 - along @ along, 0.0))
    elbow = along + lift * across / np.linalg.norm(across)
    shake = 0.001 * np.sin(2 * np.pi * T)[:, None]
    shoulder = np.array([0.2 * mirror, 0.3, 2.0])
    joints = {
        "shoulder": np.tile(shoulder, (len(T), 1)),
        "elbow": shoulder + elbow + 0.0 * shake,
        "wrist": shoulder + place + 0.0 * shake,
        "hand": shoulder + place + shake * [1.0, 0.0, 0.0],
    }
    return measure(recovery_of(T, joints, side)).by_key


HALF, MOUTH = 0.129 * STATURE, (-0.129 * STATURE, 0.075 * STATURE, -0.06 * STATURE)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize(
    ("place", "reached"),
    [
        (MOUTH, {"hand_to_mouth", "hand_to_head"}),
        ((-HALF, 0.18 * STATURE, 0.0), {"hand_to_head"}),  # the crown
        ((-HALF, 0.117 * STATURE, 0.17), {"hand_to_head"}),  # behind the head
        ((-HALF, -0.3, 0.12), {"hand_behind_back"}),
        ((-HALF, -0.3, -0.2), set()),  # before the belly
        ((0.3, -0.1, -0.2), set()),  # out to the side
        ((0.15, -0.35, 0.15), set()),  # behind, beside the trunk
    ],
)
def test_where_the_hand_is(place: tuple[float, float, float], reached: set[str], side: str):
    rows = held(place, side)
    found = {
        key for key in ("hand_to_mouth", "hand_to_head", "hand_behind_back") if rows[f"{key}_reached"].value
    }
    assert found == reached
    for key in ("hand_to_mouth", "hand_to_head", "hand_behind_back"):
        assert (rows[f"{key}_distance_m"].value == 0.0) == (key in reached)


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_simulated_protocol_goes_behind_head_and_back(side: str):
    rows = measure(simulated(1, side)).by_key
    assert rows["hand_behind_back_reached"].value == 1.0 and rows["hand_to_head_reached"].value == 1.0
    assert 0.1 < rows["elbow_trunk_distance_mean_m"].value < rows["elbow_trunk_distance_max_m"].value < 0.65


def test_an_arm_that_hangs_reaches_nothing():
    rows = measure(simulated(1, protocol="hang", duration_s=10.0)).by_key
    assert not any(
        rows[f"{key}_reached"].value for key in ("hand_to_mouth", "hand_to_head", "hand_behind_back")
    )
    assert rows["movement_count"].value == 0.0


def test_without_shoulder_nothing_is_said_of_zones():
    joints = {"wrist": np.tile([0.0, 0.0, 2.0], (len(T), 1)) + 0.1 * np.sin(T)[:, None]}
    rows = measure(recovery_of(T, joints)).by_key
    assert np.isnan(rows["hand_to_mouth_reached"].value)
    assert (
        "shoulder" in rows["hand_to_mouth_reached"].note
        and "shoulder" in rows["elbow_flexion_range_deg"].note
    )


def test_a_cube():
    corners = np.array(list(np.ndindex(2, 2, 2)), float)
    figures = reach_figures(corners, np.arange(8) < 2, 1.0, 0.02, 10.0)
    assert figures["hand_reach_hull_l"] == pytest.approx((1000.0, 0.25))  # two of eight corners are recovered
    assert figures["hand_reach_alpha_l"].value == pytest.approx(1000.0)
    # the ball through a cube's corners has half its diagonal as radius
    assert alpha_volume(corners, 0.99 * np.sqrt(3) / 2) == 0.0


def test_what_has_no_volume():
    line = np.linspace(0, 1, 50)[:, None] * np.ones(3)
    for points in (line, np.zeros((2, 3)), np.full((30, 3), np.nan)):
        figures = reach_figures(points, np.zeros(len(points), bool), 0.5, 0.02, 0.3)
        assert all(np.isnan(figure.value) for figure in figures.values())


def test_cubes_are_the_different_rows():
    """One place far away, too: cubes are not numbered through."""
    points = np.random.default_rng(3).normal(0.0, 0.05, (500, 3))
    points[7] = [-3e9, 2e9, 5e9]
    rows, cube = np.unique(np.floor(points / 0.02).astype(int), axis=0, return_inverse=True)
    expected = [points[cube.reshape(-1) == number].mean(axis=0) for number in range(len(rows))]
    np.testing.assert_allclose(voxel_means(points, 0.02), expected, rtol=1e-12)
