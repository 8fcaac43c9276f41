"""The magnetometer: the field's direction, what is left out, and what it brings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import FIELD_K, Scene, point, recovered, with_field

from smoother.array_types import FloatArray
from smoother.recovery.magnetometer import Field, middle_direction
from smoother.simulation import SimulatedArm


def note(scene: Scene) -> str:
    return " ".join(line for line in scene.recovery.notes if "magnetometer" in line)


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    """A sensor that turns a lot and moves little: its heading is poorly known from motion."""
    return point(3, "realistic", duration_s=30.0, speed=0.6)


@pytest.fixture(scope="module")
def plain(made) -> Scene:
    return recovered(made)


@pytest.fixture(scope="module")
def helped(made) -> Scene:
    return recovered(made, with_field(made.recording))


@pytest.mark.slow
def test_an_undisturbed_field_makes_the_orientation_better(plain: Scene, helped: Scene) -> None:
    assert "magnetometer is used" in note(helped) and "left out" not in note(helped)
    with_it, without = helped.validation.all, plain.validation.all
    assert with_it.orientation_rms_deg < without.orientation_rms_deg
    assert with_it.position_rms_m < 1.05 * without.position_rms_m


def off_deg(direction: FloatArray) -> float:
    """Angle of a direction of the field from the true one."""
    return float(np.degrees(np.arccos(np.array(direction) @ FIELD_K / np.linalg.norm(FIELD_K))))


def test_the_fields_direction_is_found_and_not_pulled_by_a_few(helped: Scene) -> None:
    assert off_deg(helped.recovery.estimates.magnetic_field_direction) < 2.0
    rng = np.random.default_rng(1)
    good, bad = FIELD_K + rng.normal(0.0, 0.02, (60, 3)), rng.normal(0.0, 1.0, (20, 3))
    assert off_deg(middle_direction(np.vstack([good, bad]))) < 2.0


def test_magnets_are_left_out(made: SimulatedArm, plain: Scene) -> None:
    """One that comes near for six seconds there, one on the sensor everywhere."""
    t = made.recording.imu.t_s
    near = ((t > 11.0) & (t < 17.0))[:, None] * np.array([0.35, -0.3, 0.25])
    scene = recovered(made, with_field(made.recording, near))
    assert "as it disagrees there" in note(scene)
    assert scene.validation.all.orientation_rms_deg < 1.02 * plain.validation.all.orientation_rms_deg
    scene = recovered(made, with_field(made.recording, np.array([0.9, 0.6, -0.8])))
    assert "was left out" in note(scene)
    assert np.allclose(scene.recovery.position, plain.recovery.position, atol=1e-4, equal_nan=True)


@pytest.mark.slow
def test_samples_that_are_missing_are_no_iron(made: SimulatedArm, helped: Scene) -> None:
    def begins_at(start_s: float) -> Scene:
        seen = with_field(made.recording)
        mag = np.where(seen.imu.t_s[:, None] < start_s, np.nan, seen.imu.mag)
        return recovered(made, replace(seen, imu=replace(seen.imu, mag=mag)))

    scene = begins_at(11.0)
    assert "magnetometer is used" in note(scene) and "left out" not in note(scene)
    estimates = scene.recovery.estimates
    assert estimates.magnetometer_blocks_used == estimates.magnetometer_blocks
    # five means of two seconds have nothing, the windows overlap
    assert 8 <= estimates.magnetometer_blocks <= helped.recovery.estimates.magnetometer_blocks - 5
    # too little is left to know the direction by, which is no word of magnets either
    said = note(begins_at(24.0))
    assert "has too few of its samples" in said and "iron" not in said


def test_without_a_calibration_it_is_not_looked_at(made: SimulatedArm, plain: Scene) -> None:
    raw = with_field(made.recording)
    scene = recovered(made, replace(raw, imu=replace(raw.imu, mag_calibrated=False)))
    assert not note(scene)
    assert np.array_equal(scene.recovery.position, plain.recovery.position, equal_nan=True)


def test_a_short_recording_and_an_empty_magnetometer_are_noted() -> None:
    made = point(3, "white", duration_s=9.0)
    seen = with_field(made.recording)
    dead = replace(seen, imu=replace(seen.imu, mag=np.full_like(seen.imu.acc, np.nan)))
    assert "too short" in note(recovered(made, seen)) and "has no samples" in note(recovered(made, dead))


def test_a_window_has_the_directions_of_its_time():
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
