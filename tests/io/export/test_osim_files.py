"""The model of the arm: scaled to the arm; moved by OpenSim's inverse kinematics where it is installed."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done
from results import made, read_trc, without_answer
from scipy.spatial.transform import Rotation

from smoother.calibration import ArmCalibration
from smoother.errors import UnoccludeError
from smoother.io import prepare_export, read_recording, write_recovery
from smoother.io.export.osim import GENERIC, arm_measures, osim_text
from smoother.recording import JointTracks, Recording
from smoother.result import Recovery

DATA = Path(__file__).parents[3] / "data"
MOTION_S = (3.0, 4.2)
UPPER_M = 0.3


@pytest.fixture(scope="module")
def demo() -> Recording:
    return read_recording(DATA / "demo.mcap")


@pytest.fixture(scope="module")
def right(demo) -> Recovery:
    """The truth of the demo as if it were a result: a rigid arm, exact, with the IMU on its back."""
    truth = demo.truth
    rows = slice(*np.searchsorted(truth.t_s, MOTION_S).tolist())
    like = made("right").rows(slice(0, rows.stop - rows.start))
    quaternion, position = truth.quaternion[rows], truth.position[rows]
    R_K_A = Rotation.from_quat(quaternion, scalar_first=True)
    # The simulated strap wobbles about the bones: here it holds still.
    levers = {
        name: np.median(R_K_A.inv().apply(truth.joints[name][rows] - position), axis=0)
        for name in ("elbow", "wrist", "hand")
    }
    joints = {name: position + R_K_A.apply(lever) for name, lever in levers.items()}
    upward = truth.joints["shoulder"][rows] - joints["elbow"]
    joints["shoulder"] = joints["elbow"] + UPPER_M * upward / np.linalg.norm(upward, axis=1)[:, None]
    y = levers["wrist"] - levers["elbow"]
    y /= np.linalg.norm(y)
    x = -levers["elbow"] + (levers["elbow"] @ y) * y  # outward: the IMU is on the back of the forearm
    x /= np.linalg.norm(x)
    return replace(
        like,
        t_s=truth.t_s[rows],
        position=position,
        quaternion=quaternion,
        joints=joints,
        joint_covariance={name: like.pose_covariance[:, :3, :3] for name in joints},
        calibration=ArmCalibration(side="right", R_F_A=np.stack([x, y, np.cross(x, y)])),
        gravity_direction=np.array([0.0, -1.0, 0.0]),
        gaps=(),
        residuals=None,
        arm=JointTracks("/skeleton", np.empty(0), np.empty((0, 5, 3)), np.empty((0, 5), np.int8)),
    )


@pytest.fixture(scope="module")
def left(right) -> Recovery:
    """Its mirror image: a left arm with the same angles."""
    mirror = np.diag([-1.0, 1.0, 1.0])
    turn = Rotation.from_quat(right.quaternion, scalar_first=True).as_matrix()
    mirrored = Rotation.from_matrix(mirror @ turn @ mirror).as_quat(scalar_first=True)
    F = np.diag([1.0, 1.0, -1.0]) @ right.calibration.R_F_A @ mirror
    return replace(
        right,
        side="left",
        position=right.position @ mirror,
        quaternion=mirrored,
        joints={name: values @ mirror for name, values in right.joints.items()},
        calibration=ArmCalibration(side="left", R_F_A=F),
    )


def exported(recovery: Recovery, folder: Path) -> dict[str, Path]:
    files = {kind: folder / f"out.{kind}" for kind in ("trc", "mot", "osim")}
    for kind, path in files.items():
        prepare_export(recovery, kind).write(path, False)
    return files


def test_the_generic_model_in_data_is_the_one_that_is_written():
    assert (DATA / "arm.osim").read_text(encoding="utf-8") == osim_text(GENERIC)


def test_markers_and_coordinates_have_the_names_of_the_other_files(right, tmp_path):
    files = exported(right, tmp_path)
    model = ET.parse(files["osim"])
    markers = [marker.get("name") for marker in model.iter("Marker")]
    _, names, _, _ = read_trc(files["trc"])
    assert markers == ["shoulder", "elbow", "wrist", "hand", "imu"]
    assert set(markers) <= set(names)
    columns = files["mot"].read_text().partition("endheader\n")[2].partition("\n")[0].split("\t")
    coordinates = {each.get("name"): each for each in model.iter("Coordinate")}
    assert {"elv_angle", "shoulder_elv", "shoulder_rot", "elbow_flexion", "pro_sup"} <= set(columns)
    assert set(columns) - {"time", "occluded", "answered"} <= set(coordinates)
    assert {name for name, each in coordinates.items() if each.findtext("locked") == "true"} == {
        f"base_r{axis}" for axis in "xyz"
    }


def test_measures(right, left):
    measures = arm_measures(right)
    distance = np.linalg.norm(right.joints["elbow"] - right.joints["shoulder"], axis=1)
    np.testing.assert_allclose(measures.upper_m, distance, atol=1e-9)  # a rigid arm, in double precision
    distance = np.linalg.norm(right.joints["wrist"] - right.joints["elbow"], axis=1)
    np.testing.assert_allclose(measures.forearm_m, distance, atol=1e-9)
    off = np.linalg.norm(right.position - right.joints["elbow"], axis=1)
    np.testing.assert_allclose(np.linalg.norm(measures.places["imu"]), off, atol=1e-9)
    assert measures.places["imu"][0] < -0.01  # on the back of the forearm, as x was chosen
    other = arm_measures(left)
    for name, place in measures.places.items():
        np.testing.assert_allclose(other.places[name], place, atol=1e-9)
    assert osim_text(other) != osim_text(measures)


def test_without_the_forearms_axes_pronation_is_locked(right, tmp_path):
    recovery = replace(right, calibration=None)
    ready = prepare_export(recovery, "osim")
    assert "R_F_A" in ready.notes[0]
    ready.write(tmp_path / "a.osim", False)
    model = ET.parse(tmp_path / "a.osim")
    assert "imu" not in [marker.get("name") for marker in model.iter("Marker")]
    locked = {each.get("name") for each in model.iter("Coordinate") if each.findtext("locked") == "true"}
    assert "pro_sup" in locked


def test_what_has_no_arm(tmp_path, capsys):
    with pytest.raises(UnoccludeError, match="it has no shoulder, no elbow, no wrist; export to csv"):
        prepare_export(made(strap=True), "osim")
    with pytest.raises(UnoccludeError, match="never all there"):
        prepare_export(without_answer(made(), -1, 100), "osim")
    write_recovery([made("left"), made("right")], tmp_path / "both.mcap")
    done("export", tmp_path / "both.mcap", "--format", "osim", "-o", tmp_path / "a.osim")
    models = {path.name: ET.parse(path).getroot()[0].get("name") for path in tmp_path.glob("*.osim")}
    assert models == {"a_left.osim": "left_arm", "a_right.osim": "right_arm"}
    capsys.readouterr()


@pytest.mark.parametrize("frame", ["camera", "opensim"])
def test_the_origin_in_the_shoulder(tmp_path, frame):
    recovery = made("right")
    table, plain = (tmp_path / "a.trc", tmp_path / "b.trc")
    prepare_export(recovery, "trc", frame, origin="shoulder").write(table, False)
    prepare_export(recovery, "trc", frame).write(plain, False)
    _, names, _, moved = read_trc(table)
    *_, before = read_trc(plain)
    shoulder = names.index("shoulder")
    np.testing.assert_allclose(np.nanmedian(recovery.joints["shoulder"], axis=0), [0.0, 0.3, 2.1], atol=0.01)
    if frame == "camera":
        np.testing.assert_allclose(np.nanmedian(moved[:, shoulder], axis=0), 0.0, atol=1e-5)
    shift = before - moved
    assert np.nanmax(np.abs(shift - np.nanmedian(shift, axis=(0, 1)))) < 2e-5  # mm, two roundings
    assert np.nanmax(np.abs(moved[:, shoulder])) < 30.0  # mm: the shoulder stays at zero


def test_a_strap_alone_has_no_shoulder_for_the_origin():
    with pytest.raises(UnoccludeError, match="no shoulder for the origin"):
        prepare_export(made(strap=True), "c3d", origin="shoulder")


@pytest.mark.parametrize("side", ["right", "left"])
def test_inverse_kinematics_gives_the_angles(side, request, tmp_path, monkeypatch):
    """OpenSim finds the exported angles from the exported markers alone."""
    pytest.importorskip("opensim", reason="opensim is not installed (a tool, not a dependency)")
    from opensim_check import against, inverse_kinematics, motion_file

    monkeypatch.chdir(tmp_path)
    recovery = request.getfixturevalue(side)
    files = {kind: str(path) for kind, path in exported(recovery, tmp_path).items()}
    times, angles = inverse_kinematics(files["osim"], files["trc"])
    assert len(times) == len(recovery)
    figures = against(times, angles, *motion_file(files["mot"]))
    assert set(figures) == {"elv_angle", "shoulder_elv", "shoulder_rot", "elbow_flexion", "pro_sup"}
    # A rigid arm, exact but for the tool's accuracy of 1e-5 in the markers' fit.
    assert max(each["max"] for each in figures.values()) < 0.3, figures


def test_the_generic_model_loads(tmp_path, monkeypatch):
    opensim = pytest.importorskip("opensim", reason="opensim is not installed (a tool, not a dependency)")
    monkeypatch.chdir(tmp_path)
    opensim.Logger.removeFileSink()
    opensim.Logger.setLevelString("Error")
    model = opensim.Model(str(DATA / "arm.osim"))
    state = model.initSystem()
    wrist = model.getMarkerSet().get("wrist").getLocationInGround(state)
    elbow = model.getMarkerSet().get("elbow").getLocationInGround(state)
    assert abs(np.linalg.norm([wrist.get(i) - elbow.get(i) for i in range(3)]) - GENERIC.forearm_m) < 1e-9
