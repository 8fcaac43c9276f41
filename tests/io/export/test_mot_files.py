"""MOT exports: what OpenSim's arm models make of the angles, and stretches without an answer."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from results import export, jittered, made, opensim_python, read_mot, without_answer
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from smoother.angles.definitions import torso_axes, wrapped_deg
from smoother.errors import UnoccludeError
from smoother.io.export.prepare import prepare_export
from smoother.result import Recovery

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


def test_without_gravity_or_forearm_axes_columns_are_left_out(tmp_path):
    recovery = replace(made(), gravity_direction=np.full(3, np.nan))
    _, columns, _ = read_mot(export(recovery, tmp_path / "a.mot"))
    assert columns == ["time", "elbow_flexion", "occluded", "answered"]


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


def test_joints_that_are_never_there_together():
    recovery = made()
    one, other = without_answer(recovery, -1, 10), without_answer(recovery, 10 - 1e-9, 100)
    apart = {**recovery.joints, "elbow": one.joints["elbow"], "wrist": other.joints["wrist"]}
    with pytest.raises(UnoccludeError, match="never all there at once"):
        prepare_export(replace(recovery, joints=apart), "mot")


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


def test_a_posture_that_defines_no_angle_is_said():
    recovery = made()
    hanging = {**recovery.joints, "elbow": recovery.joints["shoulder"] + [0.0, -0.3, 0.001]}
    notes = prepare_export(replace(recovery, joints=hanging), "mot").notes
    assert any(note.startswith("elv_angle and shoulder_rot: within 15 degrees") for note in notes)


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
