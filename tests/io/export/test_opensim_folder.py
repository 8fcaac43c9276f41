"""The folder for OpenSim: its set-ups name what is there, and OpenSim itself solves with them."""

from __future__ import annotations

import json
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from results import made, read_trc, without_answer
from scipy.spatial.transform import Rotation
from test_sto_files import FORE_M, R_F_A, TOOL, UPPER_M, opensim_python, two_imus

from smoother.cli.run import run
from smoother.errors import UnoccludeError
from smoother.io import write_recovery
from smoother.io.export.opensim_setup import opensim_files, write_opensim
from smoother.result import Recovery

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


def test_one_imu_has_no_opensense(tmp_path: Path):
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
    assert run([*command, "--json", str(tmp_path / "o.json")]) == 0
    folders = json.loads((tmp_path / "o.json").read_text())["folders"]
    assert [Path(each["folder"]).name for each in folders] == ["os_left", "os_right"]
    assert all((tmp_path / "os_left" / name).exists() for name in folders[0]["files"])
    assert run(command) == 1 and "is not empty" in capsys.readouterr().err
    assert run([*command, "--force", "--rate", "20"]) == 0
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
