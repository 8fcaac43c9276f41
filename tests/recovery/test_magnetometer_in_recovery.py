"""The magnetometer: the field's direction, what is left out, and what it brings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenes import FIELD_K, Scene, answer, point, recovered, with_field

from smoother.recording import Recording
from smoother.recovery.magnetometer import Field, middle_direction
from smoother.simulation import SimulatedArm


def note(scene: Scene) -> str:
    return " ".join(line for line in scene.recovery.notes if "magnetometer" in line)


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    """A sensor that turns a lot and moves little: its heading is poorly known from motion."""
    return point(3, "realistic", duration_s=30.0, speed=0.6)


@pytest.fixture(scope="module")
def plain(made: SimulatedArm) -> Scene:
    return recovered(made)


@pytest.fixture(scope="module")
def helped(made: SimulatedArm) -> Scene:
    return recovered(made, with_field(made.recording))


def test_an_undisturbed_field_makes_the_orientation_better(plain: Scene, helped: Scene) -> None:
    assert "magnetometer is used" in note(helped) and "left out" not in note(helped)
    with_it, without = helped.validation.all, plain.validation.all
    assert with_it.orientation_rms_deg < without.orientation_rms_deg
    assert with_it.position_rms_m < 1.05 * without.position_rms_m
    rng = np.random.default_rng(1)
    good, bad = FIELD_K + rng.normal(0.0, 0.02, (60, 3)), rng.normal(0.0, 1.0, (20, 3))
    few = middle_direction(np.vstack([good, bad]))  # is not pulled by a few
    for direction in (helped.recovery.estimates.magnetic_field_direction, few):
        assert np.degrees(np.arccos(np.array(direction) @ FIELD_K / np.linalg.norm(FIELD_K))) < 2.0


def near_for_six_seconds(seen: Recording) -> Recording:
    t = seen.imu.t_s
    near = ((t > 11.0) & (t < 17.0))[:, None] * np.array([0.35, -0.3, 0.25])
    return with_field(seen, near)


def begins_at(start_s: float, seen: Recording) -> Recording:
    seen = with_field(seen)
    mag = np.where(seen.imu.t_s[:, None] < start_s, np.nan, seen.imu.mag)
    return replace(seen, imu=replace(seen.imu, mag=mag))


def uncalibrated(seen: Recording) -> Recording:
    seen = with_field(seen)
    return replace(seen, imu=replace(seen.imu, mag_calibrated=False))


@pytest.mark.parametrize(
    ("change", "said", "is_used"),
    [
        (near_for_six_seconds, "as it disagrees there", True),
        (lambda seen: with_field(seen, np.array([0.9, 0.6, -0.8])), "was left out", False),  # on the sensor
        (uncalibrated, "", False),
        # samples that are missing are no iron; too little is left to know the direction by
        pytest.param(partial(begins_at, 11.0), "magnetometer is used", True, marks=pytest.mark.slow),
        pytest.param(partial(begins_at, 24.0), "too few of its samples", False, marks=pytest.mark.slow),
        (partial(begins_at, 99.0), "has no samples", False),
    ],
    ids=["a magnet for a while", "a magnet", "not calibrated", "late", "too late", "empty"],
)
def test_what_is_wrong_is_left_out(
    change: Callable[[Recording], Recording], said: str, is_used: bool, made: SimulatedArm, plain: Scene
) -> None:
    scene = recovered(made, change(made.recording))
    assert said in note(scene) and bool(said) == bool(note(scene))
    assert ("iron" in note(scene)) <= ("was left out" in note(scene))
    if is_used:
        assert scene.validation.all.orientation_rms_deg < 1.02 * plain.validation.all.orientation_rms_deg
        estimates = scene.recovery.estimates
        assert (estimates.magnetometer_blocks_used == estimates.magnetometer_blocks) == ("used" in said)
    else:
        np.testing.assert_allclose(scene.recovery.position, plain.recovery.position, atol=1e-4)


def test_a_window_has_the_directions_of_its_time() -> None:
    """At the nearest node; their mean is known no better than the field's direction in the room."""
    directions = np.eye(3)[[0, 1, 2, 0]]
    field = Field(np.array([1.0, 3.0, 5.0, 9.0]), directions, FIELD_K, 0.04, 0.01)
    t = np.array([2.0, 2.5, 3.1, 4.0, 4.8, 8.9])
    found = field.at_nodes(t)
    assert found.node.tolist() == [2, 4]
    np.testing.assert_array_equal(found.in_A, directions[1:3])
    np.testing.assert_array_equal(found.in_K, FIELD_K)
    assert found.sigma_rad == pytest.approx(np.sqrt(0.04**2 + 2 * 0.01**2))
    assert field.at_nodes(t + 10.0) is None
    short = with_field(point(3, "white", duration_s=9.0).recording)
    assert "too short" in " ".join(answer(short).notes)
