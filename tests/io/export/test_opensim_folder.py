"""Orientations and the folder for OpenSim: read back plainly, and solved by OpenSim itself."""

from __future__ import annotations

import json
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from results import made, opensim_python, read_trc, without_answer
from scipy.spatial.transform import Rotation

from smoother.calibration import ArmCalibration, SegmentMounting
from smoother.cli.run import run
from smoother.errors import UnoccludeError
from smoother.io import prepare_export, write_recovery
from smoother.io.export.opensim_setup import opensim_files, write_opensim
from smoother.result import Recovery
from smoother.result.segment_motion import SegmentMotion, TrunkMotion

TOOL = Path(__file__).parents[3] / "tools" / "opensim_check.py"
R_F_A = Rotation.from_rotvec([0.4, -0.3, 0.9]).as_matrix()
R_U_B = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
UPPER_M, FORE_M = 0.31, 0.25


def two_imus(side: str = "right", count: int = 60) -> Recovery:
    """A rigid arm in front of a level Kinect, with an IMU on forearm and upper arm, moved by known angles.

    The geometry is written out here: the humerus turns R_y(a) R_x(-b) R_y(c - a), the elbow bends about z,
    the forearm turns about its bone; x forward, y up, z to the right. A left arm is the mirror image.
    """
    t = np.arange(count) / 50.0
    a, b, c = np.radians(40 + 30 * np.sin(t)), np.radians(60 + 25 * np.sin(2 * t)), np.radians(-20 + 40 * t)
    bend, turn = np.radians(70 + 40 * np.cos(3 * t)), np.radians(-30 + 50 * np.sin(2.5 * t))

    def about(axis: str, angle: np.ndarray) -> Rotation:
        return Rotation.from_rotvec(angle[:, None] * np.eye(3)["xyz".index(axis)])

    humerus = about("y", a) * about("x", -b) * about("y", c - a)
    radius = humerus * about("z", bend) * about("y", turn)
    elbow = humerus.apply([0.0, -UPPER_M, 0.0])
    wrist = elbow + radius.apply([0.0, -FORE_M, 0.0])
    # {F}: y elbow to wrist, x to the back of the hand, which at pro_sup 0 (thumb up) faces right
    F = np.stack([radius.apply(axis) for axis in ([0, 0, 1], [0, -1, 0], [1, 0, 0])], axis=2)
    U = humerus.as_matrix()
    to_K = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # who faces the camera
    if side == "left":
        flip = np.diag([1.0, 1.0, -1.0])
        elbow, wrist = elbow @ flip, wrist @ flip
        F = flip @ F @ np.diag([1.0, 1.0, -1.0])  # z is x cross y, whichever the hand
        U = flip @ U @ np.diag([-1.0, 1.0, 1.0])  # z to the lateral epicondyle, x = y cross z
    place = np.array([0.1, 0.2, 2.0])
    base = made(side).rows(slice(0, count))
    q_A = Rotation.from_matrix(to_K @ F @ R_F_A).as_quat(scalar_first=True)
    q_B = Rotation.from_matrix(to_K @ U @ R_U_B).as_quat(scalar_first=True)
    at = place + (0.9 * wrist + 0.1 * elbow) @ to_K.T
    joints = {
        "shoulder": np.tile(place, (count, 1)),
        "elbow": place + elbow @ to_K.T,
        "wrist": place + wrist @ to_K.T,
    }
    upper = SegmentMotion(joints["elbow"], q_B, np.zeros((count, 6, 6)), np.zeros(3))
    return replace(
        base,
        t_s=t,
        position=at,
        quaternion=q_A,
        joints=joints,
        joint_covariance={},
        segments={"upper_arm": upper},
        calibration=ArmCalibration(
            side=side, R_F_A=R_F_A, mountings={"upper_arm": SegmentMounting({}, R_bone=R_U_B)}
        ),
        gravity_direction=np.array([0.0, -1.0, 0.0]),
        gaps=(),
        residuals=None,
    )


def read_sto(path: Path) -> tuple[dict[str, str], np.ndarray, dict[str, np.ndarray]]:
    """A plain reading: header, times, quaternions by column."""
    lines = path.read_text().splitlines()
    end = lines.index("endheader")
    names = lines[end + 1].split("\t")
    rows = [line.split("\t") for line in lines[end + 2 :]]
    cells = {
        name: np.array([[float(part) for part in row[k].split(",")] for row in rows])
        for k, name in enumerate(names)
    }
    return dict(line.split("=") for line in lines[:end]), cells.pop("time")[:, 0], cells


def written(recovery: Recovery, path: Path) -> Path:
    prepare_export(recovery, "sto").write(path, False)
    return path


def test_what_is_written_is_the_motion_in_y_up_axes(tmp_path: Path):
    recovery = two_imus()
    header, t_s, columns = read_sto(written(recovery, tmp_path / "a.sto"))
    assert header == {"DataRate": "50.000000", "DataType": "Quaternion", "version": "3"}
    assert list(columns) == ["radius_imu", "humerus_imu"]
    np.testing.assert_allclose(t_s, recovery.t_s, atol=1e-9)
    R_O_K = np.array(
        [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    )  # z of a Kinect points away from it
    for name, answer in (("radius_imu", recovery.quaternion), ("humerus_imu", recovery.upper.quaternion)):
        R_K_S = Rotation.from_quat(answer, scalar_first=True).as_matrix()
        found = Rotation.from_quat(columns[name], scalar_first=True).as_matrix()
        np.testing.assert_allclose(found, R_O_K @ R_K_S, atol=1e-7)
        assert np.all(np.einsum("ni,ni->n", columns[name][1:], columns[name][:-1]) > 0.9)  # no jump of sign


def test_rows_without_an_orientation_are_left_out_and_counted(tmp_path: Path):
    recovery = without_answer(two_imus(), 0.3, 0.5)
    export = prepare_export(recovery, "sto")
    _, t_s, columns = read_sto(written(recovery, tmp_path / "a.sto"))
    gone = int(((recovery.t_s > 0.3) & (recovery.t_s < 0.5)).sum())
    assert gone > 5 and len(t_s) == export.rows == len(recovery) - gone
    assert not ((t_s > 0.3) & (t_s < 0.5)).any()
    assert f"{gone} of {len(recovery)} samples are left out" in export.notes[0]
    assert all(np.isfinite(values).all() for values in columns.values())


def test_a_trunk_and_one_imu_alone(tmp_path: Path):
    recovery = two_imus()
    turned = Rotation.from_rotvec([0.0, 0.4, 0.0]).as_quat(scalar_first=True)
    trunk = TrunkMotion(
        np.tile(turned, (len(recovery), 1)), np.zeros((len(recovery), 3, 3)), np.eye(3), np.zeros(3)
    )
    *_, columns = read_sto(written(replace(recovery, trunk=trunk), tmp_path / "a.sto"))
    assert list(columns) == ["radius_imu", "humerus_imu", "torso_imu"]
    alone = prepare_export(replace(recovery, segments={}), "sto")
    assert any("does not show OpenSense how the elbow is bent" in note for note in alone.notes)
    assert not prepare_export(recovery, "sto").notes


def test_nothing_to_write_is_said():
    with pytest.raises(UnoccludeError, match="there is none of the forearm"):
        prepare_export(without_answer(two_imus(), -1.0, 100.0), "sto")


def test_the_model_has_the_frames_of_both_imus(tmp_path: Path):
    prepare_export(two_imus(), "osim").write(tmp_path / "a.osim", False)
    frames = {each.get("name") for each in ET.parse(tmp_path / "a.osim").iter("PhysicalOffsetFrame")}
    assert {"radius_imu", "humerus_imu"} <= frames
    unknown = replace(two_imus(), calibration=ArmCalibration(side="right"))
    prepare_export(unknown, "osim").write(tmp_path / "b.osim", False)
    frames = {each.get("name") for each in ET.parse(tmp_path / "b.osim").iter("PhysicalOffsetFrame")}
    assert not {"radius_imu", "humerus_imu"} & frames


def test_the_command_of_orientations(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_recovery(made(), tmp_path / "out.mcap")
    command = ["export", str(tmp_path / "out.mcap"), "--format", "sto", "-o", str(tmp_path / "out.sto")]
    done(*command, "--json", tmp_path / "s.json")
    assert "take trc and Inverse Kinematics" in capsys.readouterr().out
    [figures] = json.loads((tmp_path / "s.json").read_text())["files"]
    assert figures["frame"] == "opensim" and figures["rows"] == len(read_sto(tmp_path / "out.sto")[1])
    said = refused(capsys, *command, "--force", "--rate", "50", code=2)
    assert "--rate is for trc, mot, c3d, opensim, not for sto" in said


@pytest.mark.skipif(opensim_python() is None, reason="OpenSim is not installed (a tool, not a dependency)")
@pytest.mark.parametrize("side", ["right", "left"])
def test_opensense_finds_the_angles(tmp_path: Path, side: str):
    """OpenSim moves the exported model by the exported orientations alone, to the exported angles."""
    files = {}
    for kind in ("trc", "mot", "osim", "sto"):
        files[kind] = tmp_path / f"a.{kind}"
        prepare_export(two_imus(side), kind).write(files[kind], False)
    command = [str(opensim_python()), str(TOOL), str(files["trc"]), str(files["mot"]), "--side", side]
    command += ["--model", str(files["osim"]), "--orientations", str(files["sto"])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads(done.stdout[done.stdout.index("{") :])
    assert figures["opensense_rows"] == 60
    off = figures["opensense_minus_mot_deg"]
    assert set(off) == {"elv_angle", "shoulder_elv", "shoulder_rot", "elbow_flexion", "pro_sup"}
    # what the tool's own accuracy leaves of exact orientations
    assert max(each["max"] for each in off.values()) < 0.05, off


needs_opensim = pytest.mark.skipif(
    opensim_python() is None,
    reason="OpenSim is not installed (a tool, not a dependency): UNOCCLUDE_OPENSIM_PYTHON names its Python",
)


def folder_of(recovery: Recovery, path: Path) -> Path:
    write_opensim(opensim_files(recovery)[0], path)
    return path


def texts(path: Path, name: str) -> list[str]:
    return [each.text or "" for each in ET.parse(path).iter(name)]


def times(path: Path) -> list[tuple[float, float]]:
    return [(float(a), float(b)) for a, b in (each.split() for each in texts(path, "time_range"))]


def test_the_set_ups_name_files_and_markers_that_are_there(tmp_path: Path):
    folder = folder_of(two_imus(), tmp_path / "arm")
    written = {path.name for path in folder.iterdir()}
    named = {"model_file", "marker_file", "coordinate_file", "orientations_file"}
    for path in folder.glob("*.xml"):
        inputs = {text for name in named for text in texts(path, name)}
        assert inputs and inputs <= written, path.name
    markers = {each.get("name") for each in ET.parse(folder / "arm.osim").iter("Marker")}
    tasks = {each.get("name") for each in ET.parse(folder / "ik.xml").iter("IKMarkerTask")}
    _, columns, t_s, _ = read_trc(folder / "arm.trc")
    assert tasks == markers and tasks <= set(columns)
    assert times(folder / "ik.xml") == [(t_s[0], t_s[-1])]
    weights = {each.get("name") for each in ET.parse(folder / "imu_ik.xml").iter("OrientationWeight")}
    assert weights == {"radius_imu", "humerus_imu"}
    # what Scale may move in the generic model is what it is asked to place
    free = {
        each.get("name")
        for each in ET.parse(folder / "generic.osim").iter("Marker")
        if each.findtext("fixed") == "false"
    }
    idle = {
        each.get("name")
        for each in ET.parse(folder / "scale.xml").iter("IKMarkerTask")
        if each.findtext("apply") == "false"
    }
    assert idle == free == {"imu"}  # this arm has no hand


def test_scale_is_given_times_without_blanks(tmp_path: Path):
    """OpenSim's Scale leaves a length out where a marker of it is blank in its time, and says only so."""
    recovery = without_answer(two_imus(), 0.3, 0.5)
    folder = folder_of(recovery, tmp_path / "arm")
    known, pose = times(folder / "scale.xml")
    *_, t_s, place = read_trc(folder / "arm.trc")
    blank = ~np.isfinite(place[:, :3]).all(axis=(1, 2))
    assert blank.any() and not blank[(t_s >= known[0]) & (t_s <= known[1])].any()
    assert known[0] <= pose[0] < pose[1] <= known[1] and abs(pose[1] - pose[0] - 0.48) < 1e-6
    assert known[0] >= 0.5 - 1e-9  # the longer of the two parts
    with pytest.raises(UnoccludeError, match=r"never all there for 0\.5 s"):
        opensim_files(without_answer(two_imus(), 0.3, 0.9))


def test_one_imu_has_no_opensense():
    files, notes = opensim_files(made())
    assert "imu_ik.xml" not in files and "arm.sto" not in files
    assert any("OpenSense needs IMUs on forearm and upper arm" in note for note in notes)


def without_axes(recovery: Recovery) -> Recovery:
    assert recovery.calibration is not None
    return replace(recovery, calibration=replace(recovery.calibration, R_F_A=None))


def test_without_the_forearm_s_axes_no_model_has_the_imu(tmp_path: Path):
    folder = folder_of(without_axes(two_imus()), tmp_path / "arm")
    for name in ("arm.osim", "generic.osim"):
        model = ET.parse(folder / name)
        markers = {each.get("name") for each in model.iter("Marker")}
        assert markers == {"shoulder", "elbow", "wrist", "camera"}, name
        [turn] = [each for each in model.iter("Coordinate") if each.get("name") == "pro_sup"]
        assert turn.findtext("locked") == "true", name


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_recovery([made("left"), made("right")], tmp_path / "both.mcap")
    command = ["export", str(tmp_path / "both.mcap"), "--format", "opensim", "-o", str(tmp_path / "os")]
    done(*command, "--json", tmp_path / "o.json")
    folders = json.loads((tmp_path / "o.json").read_text())["folders"]
    assert [Path(each["folder"]).name for each in folders] == ["os_left", "os_right"]
    assert all((tmp_path / "os_left" / name).exists() for name in folders[0]["files"])
    assert run(command) == 1 and "is not empty" in capsys.readouterr().err
    done(*command, "--force", "--rate", "20")
    assert len(read_trc(tmp_path / "os_left" / "arm.trc")[2]) < len(made("left"))
    assert run([*command, "--force", "--frame", "camera"]) == 2


@needs_opensim
@pytest.mark.parametrize("side", ["right", "left"])
def test_opensim_solves_with_the_set_ups(tmp_path: Path, side: str):
    """Scale finds the arm's lengths, and both inverse kinematics the exported angles, blanks and all."""
    recovery = two_imus(side, 90)
    out = Rotation.from_quat(recovery.quaternion, scalar_first=True).apply(0.03 * R_F_A[0])
    # The IMU 3 cm off the bone, on the back of the wrist; nothing at all is known for 0.2 s.
    recovery = without_answer(replace(recovery, position=recovery.position + out), 0.3, 0.5)
    folder = folder_of(recovery, tmp_path / "arm")
    command = [str(opensim_python()), str(TOOL), "--folder", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads(done.stdout[done.stdout.index("{") :])
    assert figures["scale"] and figures["ik"] and figures["ik_scaled"] and figures["imu_ik"]
    scaled = ET.parse(folder / "scaled.osim")
    places = {each.get("name"): each.findtext("location") for each in scaled.iter("Marker")}
    lengths = [np.linalg.norm([float(each) for each in places[name].split()]) for name in ("elbow", "wrist")]
    np.testing.assert_allclose(lengths, [UPPER_M, FORE_M], atol=1e-6)
    # The pose that places the markers is a mean over half a second of motion.
    assert max(figures["scaled_minus_exported_m"].values()) < 0.01, figures
    assert figures["scaled_minus_exported_m"].keys() == {"shoulder", "elbow", "wrist", "imu", "camera"}
    # What the tool's accuracy leaves of exact markers and orientations.
    for name, most in (("ik", 0.001), ("imu_ik", 0.05)):
        off = figures[f"{name}_minus_mot_deg"]
        assert set(off) == {"elv_angle", "shoulder_elv", "shoulder_rot", "elbow_flexion", "pro_sup"}
        assert max(each["max"] for each in off.values()) < most, (name, off)


@needs_opensim
def test_opensim_solves_without_the_forearm_s_axes(tmp_path: Path):
    folder = folder_of(without_axes(two_imus("right", 40)), tmp_path / "arm")
    command = [str(opensim_python()), str(TOOL), "--folder", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads(done.stdout[done.stdout.index("{") :])
    for name in ("ik", "ik_scaled"):
        off = figures[f"{name}_minus_mot_deg"]
        assert set(off) == {"elv_angle", "shoulder_elv", "shoulder_rot", "elbow_flexion"}
        assert max(each["max"] for each in off.values()) < 0.001, (name, off)
