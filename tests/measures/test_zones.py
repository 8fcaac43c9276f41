"""Hand to mouth, head and back: postures about a person of known size."""

from __future__ import annotations

import numpy as np
import pytest
from measured_arms import recovery_of, simulated

from smoother.measures import Measure, measure

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


def test_how_near_the_hand_came():
    away = np.add(MOUTH, (0.0, 0.0, -0.2))
    # the zone ends 15 cm from the mouth
    assert held(tuple(away))["hand_to_mouth_distance_m"].value == pytest.approx(0.05, abs=0.002)


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
