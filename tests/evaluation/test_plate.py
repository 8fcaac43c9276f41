"""Maps of markers, rigid plates, smoothing and filling."""

from __future__ import annotations

import numpy as np
import pytest
from arms import path, turn
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from smoother.errors import RecordingError
from smoother.evaluation.mocap.markers import (
    fill_on_plate,
    find_markers,
    find_shape,
    fit_poses,
    follow,
    map_by_names,
    read_marker_map,
)
from smoother.evaluation.mocap.motion import smoothed

PLATE = np.array(
    [
        [-0.04, -0.026, 0.004],
        [-0.012, -0.037, 0.013],
        [0.022, -0.03, 0.002],
        [0.046, -0.008, 0.01],
        [0.01, 0.04, 0],
    ]
)


class TestMap:
    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("", r"\[markers\] table is missing"),
            ("[markers]\nknee = ['K']", "key 'knee'"),
            ("[markers]\nwrist = 3", "wrist must be a list"),
            ("[markers]\nwrist = []", "wrist must be a list"),
            ("[markers]\nimu_plate = ['A', 'B']", "a pose needs three"),
            ("[markers]\nwrist=['A']\n[plate]\nR_A_P = [1, 1, 0, 0]", "unit quaternion"),
            ("[markers]\nwrist=['A']\n[plate]\np_A_P = [1, 0]", "must be 3 numbers"),
            ("[markers]\nimu_plate=['A','B','C']\n[imu_plate]\nA=[0,0,0]\nB=[1,0,0]", "fewer than three"),
            ("[markers", "not TOML"),
        ],
    )
    def test_refused(self, tmp_path, text, said):
        (tmp_path / "m.toml").write_text(text)
        with pytest.raises(RecordingError, match=said):
            read_marker_map(tmp_path / "m.toml")

    def test_prefixes(self):
        assert find_markers(["RWRA"], ["Anna:RELB", "Anna:RWRA"], "map", "file") == [1]
        assert find_markers(["Anna:RWRA"], ["RELB", "RWRA"], "map", "file") == [1]
        assert find_markers(["Bea:RWRA"], ["Anna:RWRA", "Bea:RWRA"], "map", "file") == [1]
        with pytest.raises(RecordingError, match="may be any of Anna:RWRA, Bea:RWRA"):
            find_markers(["RWRA"], ["Anna:RWRA", "Bea:RWRA"], "map", "file")
        with pytest.raises(RecordingError, match="no marker"):
            find_markers(["Bea:RWRA"], ["Anna:RWRA"], "map", "file")

    def test_markers_called_as_joints_need_no_map(self):
        assert map_by_names(["Wrist", "S:elbow", "C7"], "file").joints == {
            "elbow": ("S:elbow",),
            "wrist": ("Wrist",),
        }


class TestRigid:
    @settings(max_examples=30, deadline=None)
    @given(st.integers(0, 10**6))
    def test_poses_come_back_whatever_is_hidden(self, seed):
        rng = np.random.default_rng(seed)
        R, p = Rotation.random(60, rng=rng), rng.normal(size=(60, 3))
        seen = np.einsum("nij,mj->nmi", R.as_matrix(), PLATE) + p[:, None]
        seen[rng.uniform(size=seen.shape[:2]) < 0.3] = np.nan
        found = follow(PLATE, seen)
        known = np.isfinite(found.residual_m)
        assert known[np.isfinite(seen[:, :, 0]).sum(axis=1) >= 4].all()
        np.testing.assert_allclose(found.rotation[known], R.as_matrix()[known], atol=1e-9)
        np.testing.assert_allclose(found.position[known], p[known], atol=1e-9)

    def test_the_shape_is_found_though_no_frame_shows_all(self):
        rng = np.random.default_rng(1)
        R = Rotation.random(400, rng=rng)
        seen = np.einsum("nij,mj->nmi", R.as_matrix(), PLATE) + rng.normal(size=(400, 1, 3))
        seen += rng.normal(size=seen.shape) * 0.0002
        seen[np.arange(400), np.arange(400) % 5] = np.nan
        shape = find_shape(seen)
        rotation, origin = fit_poses(PLATE, shape[None], np.ones((1, 5)))
        residual = shape - PLATE @ rotation[0].T - origin[0]
        assert np.linalg.norm(residual, axis=1).max() < 1e-4

    def test_against_scipy(self):
        rng = np.random.default_rng(2)
        seen = rng.normal(size=(20, 5, 3))
        rotation, _ = fit_poses(PLATE, seen, np.ones((20, 5)))
        for k in range(20):
            slow, _ = Rotation.align_vectors(seen[k] - seen[k].mean(axis=0), PLATE - PLATE.mean(axis=0))
            np.testing.assert_allclose(rotation[k], slow.as_matrix(), atol=1e-9)

    def test_swapped_labels_are_set_aside(self):
        rng = np.random.default_rng(3)
        R = Rotation.random(100, rng=rng).as_matrix()
        seen = np.einsum("nij,mj->nmi", R, PLATE)
        seen[40:60, 4] += 0.03
        found = follow(find_shape(seen), seen)
        assert found.mistaken == 20
        assert found.residual_m.max() < 1e-9
        assert not found.used[40:60, 4].any()

    def test_three_on_a_line_give_no_pose(self):
        line = np.array([[0.0, 0, 0], [0.03, 0, 0], [0.06, 0.001, 0], [0.02, 0.04, 0]])
        seen = np.repeat(line[None], 2, axis=0)
        seen[1, 3] = np.nan
        found = follow(line, seen)
        assert np.isfinite(found.residual_m).tolist() == [True, False]


def test_smoothing_takes_noise_away_and_leaves_the_motion():
    rng = np.random.default_rng(4)
    t = np.arange(0, 10, 1 / 120)
    R, p = turn(4 * t), path(4 * t)
    noisy = R * Rotation.from_rotvec(rng.normal(size=(len(t), 3)) * np.radians(0.1))
    rotation, position = smoothed(t, noisy.as_matrix(), p + rng.normal(size=p.shape) * 2e-4)
    left = (Rotation.from_matrix(rotation) * R.inv()).magnitude()
    before = (noisy * R.inv()).magnitude()
    assert np.sqrt(np.mean(left**2)) < 0.5 * np.sqrt(np.mean(before**2))
    assert np.sqrt(np.mean((position - p) ** 2)) < 1e-4
    exact, _ = smoothed(t, R.as_matrix(), p)
    assert (Rotation.from_matrix(exact) * R.inv()).magnitude().max() < np.radians(0.01)


def test_short_holes_of_markers_on_the_forearm_are_filled():
    rng = np.random.default_rng(8)
    t = np.arange(0, 12, 1 / 120)
    R, p = turn(2 * t), path(2 * t)
    # a marker beyond the elbow: it moves against the forearm
    swing = np.column_stack([0.03 * np.sin(2 * t), -0.2 + 0.01 * np.cos(3 * t), 0.03 * np.cos(2 * t)])
    true = p + R.apply(swing)
    seen = true + rng.normal(size=true.shape) * 2e-4
    holes = [(100, 140), (400, 480), (700, 900), (1400, 1440)]
    for begin, end in holes:
        seen[begin:end] = np.nan
    filled, count = fill_on_plate(t, seen, R.as_matrix(), p)
    assert count == 120  # neither the long hole nor the one at the end
    assert np.isnan(filled[700:900]).all()
    assert np.isnan(filled[1400:]).all()
    for begin, end in holes[:2]:
        assert np.linalg.norm((filled - true)[begin:end], axis=1).max() < 0.002  # 0.67 s, 0.2 mm
    kept = np.isfinite(seen)
    np.testing.assert_array_equal(filled[kept], seen[kept])
