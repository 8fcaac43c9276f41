"""Markers made into a truth: map, rigid plate, clock, frame, filling; captures of another kind."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import LEVERS, make_recording, make_recovery, path, turn
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from smoother.errors import CalibrationError, RecordingError, UnoccludeError
from smoother.evaluation.mocap.alignment import stated_frame
from smoother.evaluation.mocap.motion import (
    find_markers,
    find_shape,
    fit_poses,
    follow,
    map_by_names,
    plate_axes,
    read_marker_map,
    smoothed,
)
from smoother.evaluation.reference import read_reference
from smoother.evaluation.validate import validate
from smoother.io.export.markers import write_trc
from smoother.recording import CameraFrame

PLATE = np.array(
    [
        [-0.04, -0.026, 0.004],
        [-0.012, -0.037, 0.013],
        [0.022, -0.03, 0.002],
        [0.046, -0.008, 0.01],
        [0.01, 0.04, 0],
    ]
)
R_K_E = Rotation.from_rotvec([0.4, -1.9, 0.7])
T_K_E = np.array([0.6, -0.2, 1.1])
MAP = """
[markers]
shoulder = ["SHO"]
elbow = ["EL_M", "EL_L"]
wrist = ["WR_R", "WR_U"]
imu_plate = ["P1", "P2", "P3", "P4", "P5"]
"""
NAMES = ("SHO", "EL_M", "EL_L", "WR_R", "WR_U", "P1", "P2", "P3", "P4", "P5")
OFFSET_S, SKEW = -2.345, 40e-6


def captured(rng, *, noise_m=0.0002, lost=0.04, mount=None, place=(0.0, 0.0, 0.0)):
    """Times and markers (N, 10, 3) in {E} of the arm of `arms`, whose plate sits so on the IMU."""
    t = np.arange(0, 24, 1 / 120)
    at = np.clip(t * (1 + SKEW) + OFFSET_S, -1, 21)
    R, p = turn(at), path(at)
    across = 0.04 * R.apply([0.0, 0.0, 1.0])
    places = [np.tile([0.0, 0.3, 2.1], (len(t), 1))]
    for joint in ("elbow", "wrist"):
        centre = p + R.apply(LEVERS[joint])
        places += [centre + across, centre - across]
    mount = Rotation.identity() if mount is None else mount
    places += [p + R.apply(mount.apply(corner - PLATE.mean(axis=0)) + place) for corner in PLATE]
    in_camera = np.stack(places, axis=1)
    in_mocap = ((in_camera - T_K_E).reshape(-1, 3) @ R_K_E.as_matrix()).reshape(in_camera.shape)
    in_mocap = in_mocap + rng.normal(size=in_mocap.shape) * noise_m
    for marker in range(len(NAMES)):
        for begin in rng.integers(0, len(t), round(lost * len(t) / 40)):
            in_mocap[begin : begin + 40, marker] = np.nan
    return t, in_mocap


@pytest.fixture(scope="module")
def recovery():
    """An answer with 4 mm of noise on positions, and a second in which nothing was seen."""
    recording = make_recording()
    hidden = (recording.arm.t_s > 8) & (recording.arm.t_s < 9)
    return make_recovery(replace(recording, arm=recording.arm.hide(hidden)), error_m=0.004)


@pytest.fixture
def files(tmp_path):
    def write(text=MAP, prefix="", **changes):
        t, markers = captured(np.random.default_rng(7), **changes)
        write_trc(tmp_path / "m.trc", [prefix + name for name in NAMES], t, markers, 120.0, True)
        (tmp_path / "map.toml").write_text(text)
        w, x, y, z = np.roll(
            (Rotation.from_matrix(np.diag([-1.0, -1, 1])) * R_K_E).as_quat(canonical=True), 1
        )
        shift = np.diag([-1.0, -1, 1]) @ T_K_E
        (tmp_path / "cal.toml").write_text(
            'format = "unocclude calibration"\nversion = 1\n[camera_from_mocap]\n'
            f"rotation = [{w}, {x}, {y}, {z}]\ntranslation = {shift.tolist()}\n"
        )
        return {"path": tmp_path / "m.trc", "markers": tmp_path / "map.toml"}

    return write


PLACED = "\n[imu_plate]\n" + "".join(
    f"P{k} = {place.tolist()}\n" for k, place in enumerate(PLATE - PLATE.mean(axis=0), 1)
)


class TestReference:
    def test_frame_and_clock_are_solved_and_said(self, recovery, files):
        truth, alignment = read_reference(recovery=recovery, **files(MAP + PLACED))
        assert alignment.kind == "solved"
        assert "aligned" in alignment.titled("")
        assert alignment.clock.offset_s == pytest.approx(OFFSET_S, abs=2e-3)
        assert alignment.clock.offset_s == pytest.approx(OFFSET_S, abs=5 * alignment.clock.sigma_s + 1e-4)
        assert alignment.clock.skew == pytest.approx(SKEW, abs=4 * alignment.clock.skew_sigma)
        assert alignment.clock.skew_sigma < 1e-4
        off = Rotation.from_matrix(alignment.frame.R_K_E) * R_K_E.inv()
        assert np.degrees(off.magnitude()) < 0.5
        middle = R_K_E.inv().apply(np.array([0, 0, 2.0]) - T_K_E)
        assert np.linalg.norm(alignment.frame.place(middle[None])[0] - [0, 0, 2.0]) < 0.005
        found = validate(recovery, truth, alignment)
        assert found.all.position_rms_m == pytest.approx(0.004 * np.sqrt(3), rel=0.05)
        assert found.all.orientation_rms_deg < 0.5
        assert found.points["elbow"]["occluded"].position_rms_m < 0.01
        assert "aligned" in found.alignment.titled("Error")
        assert any("solved" in note for note in found.notes)

    def test_calibration_of_a_kinect_recording(self, recovery, files, tmp_path):
        chosen = files(MAP + PLACED)
        truth, alignment = read_reference(
            recovery=recovery, calibration=tmp_path / "cal.toml", camera_frame=CameraFrame.KINECT, **chosen
        )
        assert alignment.kind == "calibration"
        assert np.degrees((Rotation.from_matrix(alignment.frame.R_K_E) * R_K_E.inv()).magnitude()) < 1e-6
        np.testing.assert_allclose(alignment.frame.t_K_E, T_K_E, atol=1e-12)
        found = validate(recovery, truth, alignment)
        exact = path(truth.t_s[300:320])
        np.testing.assert_allclose(truth.position[300:320], exact, atol=6e-4)  # 0.2 mm of noise, smoothed
        assert found.all.orientation_rms_deg < 0.15
        # gravity tells a Kinect's axes where the recording does not
        again, _ = read_reference(recovery=recovery, calibration=tmp_path / "cal.toml", **chosen)
        np.testing.assert_array_equal(again.position, truth.position)

    def test_an_unknown_mounting_of_the_plate_is_solved(self, recovery, files, tmp_path):
        mount, place = Rotation.from_rotvec([0.3, 1.2, -2.0]), np.array([0.004, -0.003, 0.012])
        truth, alignment = read_reference(
            recovery=recovery,
            calibration=tmp_path / "cal.toml",
            camera_frame=CameraFrame.KINECT,
            **files(mount=mount, place=place),
        )
        assert any("rotation in the IMU was solved" in note for note in alignment.notes)
        assert any("place on the plate was solved" in note for note in alignment.notes)
        found = validate(recovery, truth, alignment)
        # the answer's orientation is exact here; markers of 0.2 mm on a slow motion leave 0.2 degrees
        assert found.all.orientation_rms_deg < 0.3
        assert found.all.position_rms_m == pytest.approx(0.004 * np.sqrt(3), rel=0.05)

    def test_a_mounting_from_the_map(self, recovery, files, tmp_path):
        """[plate] states the axes that the order of the plate's markers defines."""
        mount, place = Rotation.from_rotvec([0.3, 1.2, -2.0]), np.array([0.004, -0.003, 0.012])
        axes, origin = plate_axes(PLATE)
        R_A_P = mount * Rotation.from_matrix(axes)
        p_A_P = mount.apply(origin - PLATE.mean(axis=0)) + place
        w, x, y, z = R_A_P.as_quat(scalar_first=True)
        text = MAP + f"\n[plate]\nR_A_P = [{w}, {x}, {y}, {z}]\np_A_P = {p_A_P.tolist()}\n"
        truth, alignment = read_reference(
            recovery=recovery,
            calibration=tmp_path / "cal.toml",
            camera_frame=CameraFrame.KINECT,
            **files(text, mount=mount, place=place, noise_m=0.0),
        )
        assert not any("plate was solved" in note for note in alignment.notes)
        np.testing.assert_allclose(truth.position[300:320], path(truth.t_s[300:320]), atol=1e-4)
        assert validate(recovery, truth, alignment).all.orientation_rms_deg < 0.02

    def test_without_a_plate_the_joints_do(self, recovery, files):
        text = MAP.replace('imu_plate = ["P1", "P2", "P3", "P4", "P5"]', "")
        truth, alignment = read_reference(recovery=recovery, **files(text))
        assert alignment.clock.by == "speed of the joint centres"
        assert alignment.clock.offset_s == pytest.approx(OFFSET_S, abs=0.005)
        assert not np.isfinite(truth.position).any()
        found = validate(recovery, truth, alignment)
        assert found.points["wrist"]["all"].position_rms_m == pytest.approx(0.004 * np.sqrt(3), rel=0.1)

    def test_poses_can_be_aligned_when_asked(self, recovery, tmp_path):
        t = np.arange(0, 22, 0.01)
        at = np.clip(t + OFFSET_S, -1, 21)
        p, R = R_K_E.inv().apply(path(at) - T_K_E), R_K_E.inv() * turn(at)
        table = np.column_stack([t, p, R.as_quat(scalar_first=True)])
        np.savetxt(tmp_path / "t.csv", table, delimiter=",", header="t_s,x,y,z,qw,qx,qy,qz", comments="")
        truth, alignment = read_reference(tmp_path / "t.csv", recovery, align=True)
        assert alignment.kind == "solved"
        assert alignment.clock.offset_s == pytest.approx(OFFSET_S, abs=1e-3)
        assert validate(recovery, truth, alignment).all.position_rms_m < 0.0075
        _, plain = read_reference(tmp_path / "t.csv", recovery)
        assert plain.kind == "none"

    def test_refused_in_a_sentence(self, recovery, files, tmp_path):
        chosen = files()
        with pytest.raises(RecordingError, match="no marker 'WRX'; it has SHO, EL_M"):
            (tmp_path / "wrong.toml").write_text(MAP.replace("WR_R", "WRX"))
            read_reference(chosen["path"], recovery, markers=tmp_path / "wrong.toml")
        with pytest.raises(RecordingError, match=r"--markers MAP\.toml which markers make a joint"):
            read_reference(chosen["path"], recovery)
        with pytest.raises(RecordingError, match="clock could not be aligned"):
            turned = replace(recovery, quaternion=np.roll(recovery.quaternion[::-1], 500, axis=0))
            rng = np.random.default_rng(0)
            rolled = Rotation.from_rotvec(np.cumsum(rng.normal(size=(len(recovery), 3)) * 0.2, axis=0))
            read_reference(recovery=replace(turned, quaternion=rolled.as_quat(scalar_first=True)), **chosen)
        with pytest.raises(RecordingError, match="contains poses, not markers"):
            read_reference(tmp_path / "t.csv", recovery, markers=chosen["markers"])
        with pytest.raises(CalibrationError, match=r"no \[camera_from_mocap\]"):
            stated_frame(None, CameraFrame.KINECT, "cal.toml")
        with pytest.raises(CalibrationError, match="axes of the recording's camera are unknown"):
            stated_frame({"rotation": [1, 0, 0, 0], "translation": [0, 0, 0]}, None, "cal.toml")
        with pytest.raises(CalibrationError, match="unit quaternion"):
            stated_frame({"rotation": [1, 1, 0, 0], "translation": [0, 0, 0]}, CameraFrame.ZUP, "cal.toml")


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
        with pytest.raises(UnoccludeError, match=said):
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


@pytest.fixture(scope="module")
def exact():
    return make_recovery(make_recording(), error_m=0.002)


def written(folder: Path, t: np.ndarray, markers: np.ndarray, text: str = MAP) -> dict[str, Path]:
    write_trc(folder / "m.trc", NAMES, t, markers, 120.0, True)
    (folder / "map.toml").write_text(text)
    return {"path": folder / "m.trc", "markers": folder / "map.toml"}


@pytest.mark.parametrize("factor", [1000.0, 0.001, 10.0, 1 / 25.4])
def test_a_wrong_unit_shows_by_the_bones(tmp_path, exact, factor):
    t, markers = captured(np.random.default_rng(1))
    with pytest.raises(RecordingError, match=r"elbow and wrist are .* m apart; check .* unit, mm"):
        read_reference(recovery=exact, **written(tmp_path, t, factor * markers))


def test_a_marker_of_another_body_on_the_plate_is_refused(tmp_path, exact):
    t, markers = captured(np.random.default_rng(1))
    text = MAP.replace('["P1", "P2", "P3", "P4", "P5"]', '["P1", "P2", "SHO"]')
    with pytest.raises(RecordingError, match=r"\(P1, P2, SHO\) do not move as one body"):
        read_reference(recovery=exact, **written(tmp_path, t, markers, text))


def test_another_trial_of_the_same_rhythm_is_refused(tmp_path, exact):
    t, markers = captured(np.random.default_rng(1))
    # the same movements, each begun up to 0.6 s earlier or later
    rows = np.clip(np.searchsorted(t, t + 0.6 * np.sin(1.7 * t)), 0, len(t) - 1)
    with pytest.raises(RecordingError, match=r"agree nowhere .best correlation 0\.\d\d, 0.8 is needed"):
        read_reference(recovery=exact, **written(tmp_path, t, markers[rows]))


def test_a_second_of_mocap_is_too_little_for_a_clock(tmp_path, exact):
    t, markers = captured(np.random.default_rng(1))
    few = slice(600, 700)
    with pytest.raises(RecordingError, match=r"is known for less than 1\.0 s together"):
        read_reference(recovery=exact, **written(tmp_path, t[few], markers[few]))


def test_a_calibration_of_another_place_is_said(tmp_path, exact):
    t, markers = captured(np.random.default_rng(1))
    files = written(tmp_path, t, markers)
    (tmp_path / "cal.toml").write_text(
        "[camera_from_mocap]\nrotation = [1, 0, 0, 0]\ntranslation = [0, 0, 0]\n"
    )
    frame = {"calibration": tmp_path / "cal.toml", "camera_frame": CameraFrame.KINECT}
    truth, alignment = read_reference(recovery=exact, **files, **frame)
    assert any("m (median) from where the camera saw it" in note for note in alignment.notes)
    # the error is not taken for the sensor's place on the plate
    assert any("farther than a plate reaches" in note for note in alignment.notes)
    assert validate(exact, truth, alignment).all.position_rms_m > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("place", "said"), [((0, 0, 0), "is taken as"), ((0.02, 0, 0.01), "was solved")])
def test_the_plates_mean_is_the_sensor_where_nothing_tells_otherwise(tmp_path, exact, place, said):
    t, markers = captured(np.random.default_rng(1), mount=Rotation.from_rotvec([0, 0, 1.0]), place=place)
    truth, alignment = read_reference(recovery=exact, **written(tmp_path, t, markers))
    assert any(said in note and "[imu_plate]" in note for note in alignment.notes)
    # against the motion itself: the frame is solved, 2 mm of noise on thousands of samples
    inside = (truth.t_s > 1) & (truth.t_s < 19) & np.isfinite(truth.position).all(axis=1)
    off = np.linalg.norm(truth.position[inside] - path(truth.t_s[inside]), axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.003
