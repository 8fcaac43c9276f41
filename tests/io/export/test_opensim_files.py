"""MOT and STO exports: what OpenSim's arm models and OpenSense make of them, stretches without an answer."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from results import export, jittered, made, opensim_python, read_mot, without_answer
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from smoother.angles.definitions import torso_axes, wrapped_deg
from smoother.errors import UnoccludeError
from smoother.io import write_recovery
from smoother.io.export import prepare_export
from smoother.result import Recovery, SegmentMotion, TrunkMotion

TOOL = Path(__file__).parents[3] / "tools" / "opensim_check.py"
ANGLES = ["elv_angle", "shoulder_elv", "shoulder_rot", "elbow_flexion"]


def with_forearm_axes(recovery: Recovery) -> Recovery:
    """The same with a calibration that knows the forearm's axes: y from elbow to wrist in {A}."""
    return replace(recovery, calibration=replace(recovery.calibration, R_F_A=np.eye(3)))


def about(axis: str, angle_deg: np.ndarray) -> Rotation:
    return Rotation.from_euler(axis, angle_deg[:, None], degrees=True)


def turned(angles: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """`R_T_H`, `R_T_F` (N, 3, 3) of a right arm from the coordinates of MoBL-ARMS, y up along each bone."""
    plane = angles["elv_angle"]
    humerus = about("y", plane) * about("x", -angles["shoulder_elv"])
    humerus *= about("y", angles["shoulder_rot"] - plane)
    forearm = humerus * about("z", angles["elbow_flexion"]) * about("y", angles["pro_sup"] + 90.0)
    return humerus.as_matrix(), forearm.as_matrix()


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_angles_put_the_bones_where_they_are(tmp_path, side):
    recovery = with_forearm_axes(made(side))
    header, columns, table = read_mot(export(recovery, tmp_path / "a.mot"))
    assert header["inDegrees"] == "yes"
    assert columns == ["time", *ANGLES, "pro_sup", "occluded", "answered"]
    assert (int(header["nRows"]), int(header["nColumns"])) == table.shape
    angles = dict(zip(columns, table.T, strict=True))
    np.testing.assert_allclose(angles["time"], recovery.t_s, atol=1e-9)
    np.testing.assert_array_equal(angles["occluded"], recovery.occluded)
    humerus, forearm = turned(angles)
    mirror = np.diag([1.0, 1.0, -1.0 if side == "left" else 1.0])
    to_torso = mirror @ torso_axes(recovery.gravity_direction).T
    for bone, start, end in ((humerus, "shoulder", "elbow"), (forearm, "elbow", "wrist")):
        along = (recovery.joints[end] - recovery.joints[start]) @ to_torso.T
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        # Nine decimals of a degree leave 1e-11.
        np.testing.assert_allclose(-bone[:, :, 1], along, atol=1e-9)
    # The thumb: z of {F} of a right arm, against it on a left one. The IMU's y is the forearm's here.
    R_K_A = Rotation.from_quat(recovery.quaternion, scalar_first=True).as_matrix()
    thumb = (R_K_A[:, :, 2] * (-1 if side == "left" else 1)) @ to_torso.T
    # Supinated with the palm forward (pro_sup -90) z of the bone points to the thumb's side.
    across = thumb - (thumb * forearm[:, :, 1]).sum(axis=1, keepdims=True) * forearm[:, :, 1]
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    np.testing.assert_allclose(forearm[:, :, 2], across, atol=1e-9)


@pytest.mark.parametrize(("start", "end"), [(9.5, 10.5), (-1, 3), (17, 100)])
def test_stretches_without_an_answer(tmp_path, start, end):
    recovery = without_answer(made(), start, end)
    ready = prepare_export(recovery, "mot")
    ready.write(tmp_path / "a.mot", False)
    _, columns, table = read_mot(tmp_path / "a.mot")
    assert np.isfinite(table).all()
    np.testing.assert_allclose(np.diff(table[:, 0]), 0.0125, atol=2e-9)
    answered = table[:, columns.index("answered")] == 1
    inside = (table[:, 0] > start) & (table[:, 0] < end)
    np.testing.assert_array_equal(answered, ~inside)
    flexion = table[:, columns.index("elbow_flexion")]
    if inside.any():
        assert np.abs(np.diff(flexion[inside], 2)).max() < 1e-8  # a straight line, and it is said
        assert "0.99 s without an answer are bridged" in ready.notes[0]
    else:
        assert "at the ends are left out" in ready.notes[0]
        assert len(table) == ready.rows == np.isfinite(recovery.position[:, 0]).sum()


def test_what_defines_no_angle_is_said_or_left_out(tmp_path):
    recovery = made()
    level = replace(recovery, gravity_direction=np.full(3, np.nan))
    _, columns, _ = read_mot(export(level, tmp_path / "a.mot"))
    assert columns == ["time", "elbow_flexion", "occluded", "answered"]
    one, other = without_answer(recovery, -1, 10), without_answer(recovery, 10 - 1e-9, 100)
    apart = {**recovery.joints, "elbow": one.joints["elbow"], "wrist": other.joints["wrist"]}
    with pytest.raises(UnoccludeError, match="never all there at once"):
        prepare_export(replace(recovery, joints=apart), "mot")
    hanging = {**recovery.joints, "elbow": recovery.joints["shoulder"] + [0.0, -0.3, 0.001]}
    notes = prepare_export(replace(recovery, joints=hanging), "mot").notes
    assert any(note.startswith("elv_angle and shoulder_rot: within 15 degrees") for note in notes)


def test_uneven_stamps(tmp_path):
    recovery = with_forearm_axes(made())
    # A spline between noisy samples is not a truth: a smooth motion is.
    joints = {name: gaussian_filter1d(values, 20, axis=0) for name, values in recovery.joints.items()}
    recovery = replace(recovery, joints=joints)
    _, columns, even = read_mot(export(recovery, tmp_path / "a.mot"))
    _, _, uneven = read_mot(export(jittered(recovery), tmp_path / "b.mot", rate_hz=50.0))
    np.testing.assert_allclose(np.diff(uneven[:, 0]), 0.02, atol=2e-9)
    assert (uneven[:, columns.index("answered")] == 1).mean() > 0.95  # two lost samples in a row are a hole
    for name in ("elbow_flexion", "shoulder_elv", "pro_sup"):
        column = columns.index(name)
        true = CubicSpline(even[:, 0], np.unwrap(even[:, column], period=360))(uneven[:, 0])
        answered = uneven[:, columns.index("answered")] == 1
        # The forearm turns by 4000 degrees a second where the elbow is straight; 1e-5 elsewhere.
        off = wrapped_deg(uneven[answered, column] - true[answered])
        np.testing.assert_allclose(off, 0, atol=0.1)
        assert np.median(np.abs(off)) < 1e-4


@pytest.mark.skipif(opensim_python() is None, reason="OpenSim is not installed")
@pytest.mark.parametrize("side", ["left", "right"])
def test_opensim_opens_both_and_they_agree(tmp_path, side):
    recovery = without_answer(made(side), 9.5, 10.5)
    trc, mot = export(recovery, tmp_path / "a.trc"), export(recovery, tmp_path / "a.mot")

    def check(motion: Path) -> subprocess.CompletedProcess[str]:
        command = [str(opensim_python()), str(TOOL), str(trc), str(motion), "--side", side]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)

    done = check(mot)
    assert done.returncode == 0, done.stdout + done.stderr
    assert '"units": "mm"' in done.stdout
    header, columns, table = read_mot(mot)
    lines = mot.read_text().splitlines()
    table[:, columns.index("shoulder_rot")] += 1.0  # the check can fail
    wrong = tmp_path / "wrong.mot"
    head = lines[: lines.index("endheader") + 2]
    wrong.write_text("\n".join(head + ["\t".join(map(repr, row)) for row in table.tolist()]) + "\n")
    assert header["inDegrees"] == "yes"
    assert check(wrong).returncode == 1


def two_imus() -> Recovery:
    """With an IMU on the upper arm that turns in its own way."""
    recovery = made().rows(slice(0, 60))
    turns = Rotation.from_rotvec(recovery.t_s[:, None] * [2.0, -1.0, 3.0] + [0.3, -0.8, 0.5])
    motion = recovery.position, turns.as_quat(scalar_first=True), np.zeros((60, 6, 6)), np.zeros(3)
    return replace(recovery, segments={"upper_arm": SegmentMotion(*motion)})


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


def test_what_is_written_is_the_motion_in_y_up_axes(tmp_path: Path):
    recovery = two_imus()
    header, t_s, columns = read_sto(export(recovery, tmp_path / "a.sto"))
    assert header == {"DataRate": "80.000000", "DataType": "Quaternion", "version": "3"}
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
    ready = prepare_export(recovery, "sto")
    _, t_s, columns = read_sto(export(recovery, tmp_path / "a.sto"))
    gone = int(((recovery.t_s > 0.3) & (recovery.t_s < 0.5)).sum())
    assert gone > 5 and len(t_s) == ready.rows == len(recovery) - gone
    assert not ((t_s > 0.3) & (t_s < 0.5)).any()
    assert f"{gone} of {len(recovery)} samples are left out" in ready.notes[0]
    assert all(np.isfinite(values).all() for values in columns.values())


def test_a_trunk_and_one_imu_alone(tmp_path: Path):
    recovery = two_imus()
    turned = Rotation.from_rotvec([0.0, 0.4, 0.0]).as_quat(scalar_first=True)
    trunk = TrunkMotion(
        np.tile(turned, (len(recovery), 1)), np.zeros((len(recovery), 3, 3)), np.eye(3), np.zeros(3)
    )
    *_, columns = read_sto(export(replace(recovery, trunk=trunk), tmp_path / "a.sto"))
    assert list(columns) == ["radius_imu", "humerus_imu", "torso_imu"]
    alone = prepare_export(replace(recovery, segments={}), "sto")
    assert any("does not show OpenSense how the elbow is bent" in note for note in alone.notes)
    assert not prepare_export(recovery, "sto").notes
    with pytest.raises(UnoccludeError, match="there is none of the forearm"):
        prepare_export(without_answer(recovery, -1.0, 100.0), "sto")


def test_the_command_of_orientations(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_recovery(made(), tmp_path / "out.mcap")
    command = ["export", str(tmp_path / "out.mcap"), "--format", "sto", "-o", str(tmp_path / "out.sto")]
    done(*command, "--json", tmp_path / "s.json")
    assert "take trc and Inverse Kinematics" in capsys.readouterr().out
    [figures] = json.loads((tmp_path / "s.json").read_text())["files"]
    assert figures["frame"] == "opensim" and figures["rows"] == len(read_sto(tmp_path / "out.sto")[1])
    said = refused(capsys, *command, "--force", "--rate", "50", code=2)
    assert "--rate is for trc, mot, c3d, not for sto" in said
