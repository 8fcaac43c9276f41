"""What is measured of an angle, on angles that are known."""

from __future__ import annotations

import numpy as np
import pytest
from measured_arms import recovery_of

from smoother.measures import measure
from smoother.measures.angles import angle_figures, centre_of, centred, zone_figures

RATE = 100.0
T = np.arange(0.0, 10.0, 1 / RATE)
SEEN = np.zeros(len(T), dtype=bool)


def test_a_sinusoid():
    angle = 60.0 + 30.0 * np.sin(2 * np.pi * 0.5 * T)
    figures = angle_figures("elbow_flexion", angle, SEEN, RATE)
    # whole periods: its quantiles are 60 + 30 sin(pi (p - 1/2))
    assert figures["elbow_flexion_range_deg"].value == pytest.approx(60.0, abs=0.01)
    assert figures["elbow_flexion_min_deg"].value == pytest.approx(30.0, abs=0.01)
    assert figures["elbow_flexion_max_deg"].value == pytest.approx(90.0, abs=0.01)
    for percent in (5, 50, 95):
        exact = 60.0 + 30.0 * np.sin(np.pi * (percent / 100 - 0.5))
        assert figures[f"elbow_flexion_p{percent}_deg"].value == pytest.approx(exact, abs=0.2)
    assert figures["elbow_flexion_peak_speed_deg_s"].value == pytest.approx(30 * np.pi, rel=1e-3)


def test_time_in_zones_adds_up_and_ends_belong_above():
    figures = zone_figures("elbow_flexion", np.array([0.0, 9.999, 10.0, 15.0, np.nan, -0.001]), SEEN[:6])
    assert {zone: figure.value for zone, figure in figures.items()} == {-10: 20.0, 0: 40.0, 10: 40.0}
    wide = zone_figures("shoulder_plane", 400.0 * T, SEEN)
    assert sum(figure.value for figure in wide.values()) == pytest.approx(100.0)
    assert min(wide) == -180 and max(wide) == 170


def test_a_range_across_half_a_turn_does_not_jump():
    angle = (170.0 + 30.0 * np.sin(T) + 180.0) % 360.0 - 180.0  # 140 to 200, which is -160
    figures = angle_figures("shoulder_plane", centred(angle, centre_of(angle)), SEEN, RATE)
    assert figures["shoulder_plane_range_deg"].value == pytest.approx(60.0, abs=0.1)
    assert figures["shoulder_plane_peak_speed_deg_s"].value == pytest.approx(30.0, rel=0.01)


def test_an_angle_that_goes_all_the_way_round_has_no_range():
    assert np.isnan(centre_of(np.linspace(-180.0, 179.0, 500)))
    assert np.isfinite(centre_of(np.linspace(-180.0, 160.0, 500)))


def test_how_much_rests_on_what_was_not_seen():
    angle = 60.0 + 30.0 * np.sin(2 * np.pi * 0.1 * T)  # one maximum at 2.5 s, one minimum at 7.5 s
    hidden = (T > 1.0) & (T < 4.0)
    figures = angle_figures("elbow_flexion", angle, hidden, RATE)
    assert figures["elbow_flexion_max_deg"].share == 1.0
    assert figures["elbow_flexion_min_deg"].share == 0.0
    assert figures["elbow_flexion_range_deg"].share == 0.5
    zones = zone_figures("elbow_flexion", angle, hidden)
    assert zones[80].share > 0.9 and zones[30].share == 0.0


def test_too_few_samples_are_no_angle():
    angle = np.full(len(T), np.nan)
    angle[:20] = 50.0
    assert all(np.isnan(figure.value) for figure in angle_figures("pronation", angle, SEEN, RATE).values())


def test_an_elbow_bent_by_a_known_angle_and_a_level_arm():
    """The arm points to the person's right at shoulder height; the forearm bends forward from 30 to 90."""
    bend = np.radians(60.0 - 30.0 * np.cos(2 * np.pi * 0.2 * T))
    still = np.ones((len(T), 1))
    # the person faces a level Kinect: its x points to the person's right, z to the person's back
    shoulder, elbow = still * [0.2, 0.0, 2.0], still * [0.5, 0.0, 2.0]
    wrist = elbow + 0.25 * np.stack([np.cos(bend), np.zeros(len(T)), -np.sin(bend)], axis=1)
    rows = measure(recovery_of(T, {"shoulder": shoulder, "elbow": elbow, "wrist": wrist})).by_key
    assert rows["elbow_flexion_range_deg"].value == pytest.approx(60.0, abs=0.1)
    assert rows["elbow_flexion_max_deg"].value == pytest.approx(90.0, abs=0.1)
    assert rows["shoulder_elevation_p50_deg"].value == pytest.approx(90.0, abs=0.1)
    assert rows["shoulder_plane_p50_deg"].value == pytest.approx(0.0, abs=0.1)  # abduction
    assert rows["elbow_flexion_peak_speed_deg_s"].value == pytest.approx(30 * 2 * np.pi * 0.2, rel=0.01)
    # the hand's way is an arc of 60 degrees, twice a period of 5 s, for two periods
    assert rows["hand_path_length_m"].value == pytest.approx(4 * np.radians(60) * 0.25, rel=0.01)
