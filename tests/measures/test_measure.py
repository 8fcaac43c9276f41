"""All measures of a recovery: intervals, shares, tables, of angles, and their document."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from measured_arms import recovery_of, simulated, with_draws
from scipy.spatial.transform import Rotation

from smoother.calibration import SegmentMounting
from smoother.errors import UnoccludeError
from smoother.measures import Measure, Measures, MeasureSettings, measure, measure_both
from smoother.measures.definitions import MeasureDefinition, definition_of, interval
from smoother.measures.figures import (
    alpha_volume,
    angle_figures,
    centre_of,
    centred,
    reach_figures,
    voxel_means,
    zone_figures,
)
from smoother.measures.symmetry import symmetry_index
from smoother.result import Estimates, Recovery, SegmentMotion
from smoother.result.verdict import UntrustedInterval
from smoother.runtime.printable import plain


@pytest.fixture(scope="module")
def answer() -> Recovery:
    return with_draws(simulated(0, repetitions=1), count=22)


@pytest.fixture(scope="module")
def measures(answer: Recovery) -> Measures:
    return measure(answer)


def bending(t: np.ndarray, bend: np.ndarray) -> Recovery:
    """An upper arm that is level to the person's right and rests, and a forearm that bends forward."""
    still = np.ones((len(t), 1))
    # the person faces a level Kinect: its x points to the person's right, z to the person's back
    elbow = still * [0.5, 0.0, 2.0]
    wrist = elbow + 0.25 * np.stack([np.cos(bend), np.zeros(len(t)), -np.sin(bend)], axis=1)
    return recovery_of(t, {"shoulder": still * [0.2, 0.0, 2.0], "elbow": elbow, "wrist": wrist})


def test_every_measure_has_a_value_an_interval_and_a_share(measures: Measures):
    assert measures.n_draws == 22
    for row in measures.rows:
        assert definition_of(row.key).name == row.name
        if row.is_known:
            assert row.has_interval and row.low <= row.value <= row.high, row
            assert 0.0 <= row.recovered_share <= 1.0 and row.n_draws == 22 and not row.note
        else:
            assert row.note, row.key
    known = {row.key for row in measures.session if row.is_known}
    assert {"elbow_flexion_range_deg", "pronation_p95_deg", "sparc", "ldlj_v", "hand_path_length_m"} <= known


@pytest.mark.slow
def test_workers_change_no_figure(answer: Recovery, measures: Measures):
    beside = measure(answer, processes=2)
    np.testing.assert_array_equal(
        [[row.value, row.low, row.high, row.sigma] for row in beside.rows],
        [[row.value, row.low, row.high, row.sigma] for row in measures.rows],
    )


def test_movements_carry_their_own(measures: Measures):
    assert len(measures.movements) >= 3
    for number, movement in enumerate(measures.movements):
        row = measures.of("movement", number)["hand_path_length_m"]
        assert (row.start_s, row.end_s) == (movement.start_s, movement.end_s)
    ways = [measures.of("movement", k)["hand_path_length_m"].value for k in range(len(measures.movements))]
    assert 0.8 < sum(ways) / measures.by_key["hand_path_length_m"].value <= 1.0
    smooth = [measures.of("movement", k)["sparc"].value for k in range(len(measures.movements))]
    assert measures.by_key["sparc"].value == pytest.approx(np.mean(smooth))


def test_as_a_table_and_as_plain_values(measures: Measures):
    table = measures.to_table()
    assert table.num_rows == len(measures.rows) and table.column("side").to_pylist()[0] == "right"
    assert table.column("movement").null_count == len(measures.session)
    figures = json.loads(json.dumps(plain(measures.as_dict()), allow_nan=False))
    row = figures["measures"]["elbow_flexion_range_deg"]
    assert {"value", "low", "high", "unit", "recovered_share"} <= row.keys() and row["unit"] == "deg"
    assert len(figures["movements"]) == len(measures.movements)


def test_without_draws_there_are_values_and_a_word_on_it(answer: Recovery, measures: Measures):
    bare = measure(replace(answer, draws=None))
    assert not any(row.has_interval for row in bare.rows) and "--draws 64" in bare.notes[0]
    assert bare.by_key["hand_path_length_m"].value == measures.by_key["hand_path_length_m"].value
    few = measure(with_draws(replace(answer, draws=None), count=5))
    assert not any(row.has_interval for row in few.rows) and "5 drawn motions are too few" in few.notes[0]


@pytest.mark.parametrize("what", ["mean", "middle of the extremes"])
def test_intervals_hold_the_truth_where_errors_are_as_drawn(what: str):
    """200 answers that are the truth and an error, with draws that are the answer and such errors."""
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 10.0, 200)
    truth = np.sin(t)

    def error(count: int) -> np.ndarray:
        slow = rng.normal(size=(count, 2, 6))
        waves = np.stack([f(np.outer(np.arange(1, 7), 0.3 * t)) for f in (np.cos, np.sin)])
        return 0.02 * np.einsum("nab,abt->nt", slow, waves)

    def of(series: np.ndarray) -> np.ndarray:
        ends = 0.5 * (series.max(axis=-1) + series.min(axis=-1))
        return series.mean(axis=-1) if what == "mean" else ends

    definition, held = MeasureDefinition(what, "m"), 0
    for _ in range(200):
        answer = truth + error(1)[0]
        low, high, _ = interval(float(of(answer)), of(answer + error(64)), definition)
        held += low <= of(truth) <= high
    # ends of 64 draws are rough: 92 % are held on average; binomial bounds of 1 % about 0.90 and 0.98
    assert 0.85 <= held / 200 <= 0.995


def test_how_the_upper_arm_s_imu_sits_is_in_the_interval():
    """A level upper arm whose IMU may be turned by 4 degrees about the bone: so may its rotation."""
    t = np.arange(0.0, 2.5, 0.025)
    bend = 1.0 + 0.3 * np.sin(2 * t)
    bare = bending(t, bend)
    # the bone's axes: y from elbow to shoulder, z to the lateral epicondyle (up), x = y cross z
    axes = np.column_stack([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    assert np.linalg.det(axes) == pytest.approx(1.0)
    quaternion = np.tile(Rotation.from_matrix(axes).as_quat(scalar_first=True), (len(t), 1))
    sigma = np.radians([0.0, 4.0, 0.0])
    upper = SegmentMotion(bare.joints["elbow"], quaternion, np.zeros((len(t), 6, 6)), sigma)
    calibration = replace(bare.calibration, mountings={"upper_arm": SegmentMounting({}, R_bone=np.eye(3))})
    answer = with_draws(
        replace(bare, segments={"upper_arm": upper}, calibration=calibration), count=40, sigma_m=0.0
    )
    rows = measure(answer).by_key
    assert rows["shoulder_rotation_p50_deg"].sigma == pytest.approx(4.0, rel=0.35)  # of 40 draws
    assert rows["shoulder_elevation_p50_deg"].sigma < 0.01
    assert rows["shoulder_rotation_range_deg"].sigma < 0.01  # one turn for the whole recording


def test_the_interval_lies_about_the_value():
    definition = MeasureDefinition("a length", "m", 0.0)
    drawn = 3.0 + np.linspace(-1.0, 1.0, 201)  # to one side of the answer, as draws of a path length are
    low, high, sigma = interval(2.0, drawn, definition)
    assert (low, high) == pytest.approx((2.0 - 0.95, 2.0 + 0.95)) and sigma == pytest.approx(
        drawn.std(ddof=1)
    )
    assert interval(0.5, drawn, definition)[0] == 0.0  # a length is not negative
    count = MeasureDefinition("peaks", "", 0.0, is_count=True)
    assert interval(2.0, np.repeat([2.0, 3.0], 50), count)[:2] == (2.0, 3.0)
    assert np.isnan(interval(np.nan, drawn, definition)).all()
    assert np.isnan(interval(2.0, drawn[:10], definition)).all()


def test_no_answer_at_all(answer: Recovery):
    nothing = replace(
        answer,
        position=np.full_like(answer.position, np.nan),
        joints={name: np.full_like(values, np.nan) for name, values in answer.joints.items()},
        draws=None,
    )
    rows = measure(nothing)
    assert not any(row.is_known and row.value for row in rows.session)
    assert rows.movements == () and "no answer" in rows.notes[0]


def test_a_pause_is_not_bridged():
    """A hand that is 1 m further after a pause of the IMU did not travel that metre at once."""
    t = np.concatenate([np.arange(0.0, 5.0, 0.01), np.arange(15.0, 20.0, 0.01)])
    wrist = np.stack([0.1 * np.sin(t) + (t > 10.0), np.zeros_like(t), np.full_like(t, 2.0)], axis=1)
    rows = measure(recovery_of(t, {"wrist": wrist})).by_key
    assert rows["hand_peak_speed_m_s"].value < 0.11
    way = sum(0.1 * np.abs(np.diff(np.sin(part))).sum() for part in (t[:500], t[500:]))
    assert rows["hand_path_length_m"].value == pytest.approx(way, rel=0.01)


def test_symmetry_as_robinson_defines_it():
    # a left force of 640 N and a right one of 680 N: 100 * 40 / 660
    np.testing.assert_allclose(symmetry_index(np.array([640.0]), np.array([680.0])), [6.0606], atol=1e-4)
    np.testing.assert_allclose(symmetry_index(np.array([0.0, 1.0]), np.array([1.0, 0.0])), [200.0, -200.0])


def test_both_arms():
    left, right = (
        with_draws(simulated(4, side, protocol="random", duration_s=4.0), count=20)
        for side in ("left", "right")
    )
    both = measure_both([right, left])
    assert (both.left.side, both.right.side) == ("left", "right")
    for row in both.rows:  # the left one is the right one's mirror image
        # the alpha shape's cubes are not mirrored
        assert abs(row.value) < (8.0 if "alpha" in row.key else 1.0) and row.low <= row.value <= row.high
    assert "elbow_flexion_range_deg_symmetry_percent" in both.by_key
    for wrong in ([left], [left, left], [left, replace(right, body=2)], []):
        with pytest.raises(UnoccludeError, match="left and the right arm"):
            measure_both(wrong)


def test_settings_are_checked():
    with pytest.raises(ValueError, match="extra"):
        MeasureSettings.model_validate({"smoothing": {"cutoff": 6.0}})
    fast = MeasureSettings.model_validate({"movements": {"start_m_s": 50.0, "rest_m_s": 0.03}})
    assert measure(simulated(0, repetitions=1), fast).movements == ()


def test_a_measure_says_how_much_rests_on_what_is_not_trusted():
    t = np.arange(0.0, 10.0, 0.05)
    bend = 1.0 + 0.5 * np.sin(2 * np.pi * 0.1 * t)  # largest at 2.5 s, smallest at 7.5 s
    bare = bending(t, bend)
    untrusted = (UntrustedInterval(1.0, 4.0, ("the camera saw another person",)),)
    rows = measure(replace(bare, estimates=Estimates(trusted=True, untrusted=untrusted))).by_key
    highest, lowest = rows["elbow_flexion_max_deg"], rows["elbow_flexion_min_deg"]
    assert (highest.untrusted_share, lowest.untrusted_share) == (1.0, 0.0)
    assert highest.note == "Rests to 100 % on gaps that are not trusted." and not lowest.note
    assert rows["elbow_flexion_range_deg"].as_dict()["untrusted_share"] == 0.5
    # of a recording that is not trusted at all, the verdict above everything says so
    refused = measure(replace(bare, estimates=Estimates(trusted=False))).by_key["elbow_flexion_min_deg"]
    assert refused.untrusted_share == 1.0 and not refused.note


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
    zones = {"-10_to_0": 20.0, "0_to_10": 40.0, "10_to_20": 40.0}
    assert {key: figure.value for key, figure in figures.items()} == {
        f"elbow_flexion_zone_{zone}_percent": percent for zone, percent in zones.items()
    }
    wide = zone_figures("shoulder_plane", 400.0 * T, SEEN)
    assert sum(figure.value for figure in wide.values()) == pytest.approx(100.0)
    assert {f"shoulder_plane_zone_{zone}_percent" for zone in ("-180_to_-170", "170_to_180")} < set(wide)


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
    assert zones["elbow_flexion_zone_80_to_90_percent"].share > 0.9
    assert zones["elbow_flexion_zone_30_to_40_percent"].share == 0.0


def test_too_few_samples_are_no_angle():
    angle = np.full(len(T), np.nan)
    angle[:20] = 50.0
    assert angle_figures("pronation", angle, SEEN, RATE) == {}


def test_an_elbow_bent_by_a_known_angle_and_a_level_arm():
    """The arm points to the person's right at shoulder height; the forearm bends forward from 30 to 90."""
    bend = np.radians(60.0 - 30.0 * np.cos(2 * np.pi * 0.2 * T))
    rows = measure(bending(T, bend)).by_key
    assert rows["elbow_flexion_range_deg"].value == pytest.approx(60.0, abs=0.1)
    assert rows["elbow_flexion_max_deg"].value == pytest.approx(90.0, abs=0.1)
    assert rows["shoulder_elevation_p50_deg"].value == pytest.approx(90.0, abs=0.1)
    assert rows["shoulder_plane_p50_deg"].value == pytest.approx(0.0, abs=0.1)  # abduction
    assert rows["elbow_flexion_peak_speed_deg_s"].value == pytest.approx(30 * 2 * np.pi * 0.2, rel=0.01)
    # the hand's way is an arc of 60 degrees, twice a period of 5 s, for two periods
    assert rows["hand_path_length_m"].value == pytest.approx(4 * np.radians(60) * 0.25, rel=0.01)


HELD_T = np.arange(0.0, 3.0, 0.02)
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
    shake = 0.001 * np.sin(2 * np.pi * HELD_T)[:, None]
    shoulder = np.array([0.2 * mirror, 0.3, 2.0])
    joints = {
        "shoulder": np.tile(shoulder, (len(HELD_T), 1)),
        "elbow": shoulder + elbow + 0.0 * shake,
        "wrist": shoulder + place + 0.0 * shake,
        "hand": shoulder + place + shake * [1.0, 0.0, 0.0],
    }
    return measure(recovery_of(HELD_T, joints, side)).by_key


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
    assert rows["repetition_count"].value == 2.0
    assert rows["hand_behind_back_reached"].value == 1.0 and rows["hand_to_head_reached"].value == 1.0
    assert 0.1 < rows["elbow_trunk_distance_mean_m"].value < rows["elbow_trunk_distance_max_m"].value < 0.65


def test_without_shoulder_nothing_is_said_of_zones():
    joints = {"wrist": np.tile([0.0, 0.0, 2.0], (len(HELD_T), 1)) + 0.1 * np.sin(HELD_T)[:, None]}
    rows = measure(recovery_of(HELD_T, joints)).by_key
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
