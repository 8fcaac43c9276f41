"""Folders of plain files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from importers import import_csv
from made_recordings import make, plain_texts

from smoother.errors import RecordingError
from smoother.io import open_csv, read_recording, write_recording
from smoother.recording import JOINTS, CameraFrame

Folder = Callable[..., Path]


def test_a_plain_recording(plain_folder: Folder, tmp_path: Path) -> None:
    made, folder = make(), plain_folder()
    found = import_csv(folder)
    assert (found.side, found.camera_frame, found.origin_ns) == ("right", CameraFrame.KINECT, 0)
    np.testing.assert_array_equal(found.gravity_hint, [0, -1, 0])
    np.testing.assert_allclose(found.imu.t_s, made.imu.t_s, atol=1e-9)
    np.testing.assert_allclose(found.imu.acc, made.imu.acc, atol=1e-8)
    np.testing.assert_allclose(found.arm.position, made.arm.position, atol=1e-8)
    np.testing.assert_array_equal(found.arm.state, made.arm.state)
    assert found.truth is not None
    assert np.isnan(found.truth.quaternion[0]).all() and found.truth.quaternion[1, 0] == 1
    write_recording(open_csv(folder / "recording.toml"), tmp_path / "a.mcap")  # it may be named itself
    again = read_recording(tmp_path / "a.mcap")
    np.testing.assert_array_equal(again.imu.t_s, found.imu.t_s)
    np.testing.assert_array_equal(again.arm.position, found.arm.position)
    assert again.origin_ns == 0


def test_several_bodies_and_sides(plain_folder: Folder) -> None:
    head, *lines = plain_texts()["skeleton"].splitlines()
    rows = [f"{head},body"]
    for line in lines:
        rows += [f"{line},0", f"{line.replace('right', 'left')},0"]
        rows += [f"{line},7"] if float(line.split(",")[0]) > 1 else []
    folder = plain_folder(skeleton="\n".join(rows) + "\n")
    arms = {(arm.body, arm.side): arm for arm in open_csv(folder).arms}
    assert set(arms) == {(0, "right"), (0, "left"), (7, "right")}
    # A frame in which a joint has no row is one in which it is not tracked.
    assert not arms[7, "right"].state[:30].any()
    assert len(arms[7, "right"].stamp_ns) == len(arms[0, "left"].stamp_ns)
    assert import_csv(folder, body=0).side == "right"
    with pytest.raises(RecordingError, match="choose with --body"):
        import_csv(folder)


#: A further camera, whose skeleton's file is beside the first one's.
LEFT = '[camera.left]\nskeleton = "left.csv"\nframe = "optical"\ngravity = [0, 1, 0]\n'


def test_several_cameras(plain_folder: Folder) -> None:
    texts = plain_texts()
    head, *rows = (line.split(",") for line in texts["skeleton"].splitlines())
    moved = [[*row[:2], str(float(row[2]) + 0.5) if row[2] else "", *row[3:]] for row in rows]
    left_rows = "\n".join(",".join(row) for row in (head, *moved))
    found = import_csv(plain_folder(recording=texts["recording"] + LEFT, left=left_rows))
    (left,) = found.cameras
    assert (left.name, left.camera_frame) == ("left", "optical")
    np.testing.assert_allclose(left.gravity_hint, [0, 1, 0])  # type: ignore[arg-type]
    apart = left.arm.position - found.arm.position
    np.testing.assert_allclose(apart[found.arm.tracked("wrist"), JOINTS.index("wrist"), 0], 0.5)
    others = texts["recording"][texts["recording"].index("[imu") :]
    alone = import_csv(plain_folder(recording=LEFT + others))  # the first named one is the camera
    assert not alone.cameras and alone.camera_frame == "optical"


#: The file that is changed, what is changed in it to what, and what is said.
WRONG = [
    ("recording", '"imu.csv"', '"no.csv"', r"no\.csv does not exist"),
    ("recording", '"kinect"', '"kinnect"', r"camera\.frame is 'kinnect'"),
    ("recording", "[truth]", "[truht]", "truht is not known here"),
    ("recording", 'frame = "kinect"\n', "", r"camera\.frame is missing"),
    ("recording", "gravity = [0, -2, 0]", "gravity = [0, 0, 0]", "gravity is not a direction"),
    ("recording", "gravity = [0, -2, 0]", "gravity = [0, 0]", r"camera\.gravity is"),
    ("recording", "[camera]", "[camera", "not readable TOML"),
    ("recording", 'file = "imu.csv"', 'file = "imu.csv"\ngyroscope_unit = "deg"', "gyroscope_unit is 'deg'"),
    *(
        ("recording", "[truth]", f"{section}[truth]", said)
        for section, said in (
            ('[camera.left]\nframe = "kinect"\n', "names no skeleton"),
            (LEFT.replace("[0, 1, 0]", "[0, 0, 0]"), r"\[camera.left\] gravity"),
            (LEFT.replace("skeleton", "skelton"), "is not known here"),
            (LEFT.replace("left.csv", "../left.csv"), "outside"),
        )
    ),
    ("imu", "t_s,ax,ay", "t_s,ax,b", r"has no column 'ay' \(ay\); its columns are t_s, ax, b, az"),
    ("imu", "0.013000000,", "0.013000000,x", r"imu\.csv, line 3: 'x.* in column ax is not a number"),
    ("imu", "0.013000000,", "0.013000000,1,", r"imu\.csv, line 3: 8 cells where there are 7"),
    ("skeleton", "elbow_right", "elbo_right", r"line 3: joint 'elbo_right' is not known"),
    ("skeleton", "not_tracked", "lost", "column state contains 'lost'"),
    ("truth", "0.1,1,2,3", "nan,1,2,3", r"truth\.csv, line 2: column t_s is empty"),
]


@pytest.mark.parametrize(("stem", "old", "new", "said"), WRONG)
def test_what_is_wrong_is_named(plain_folder: Folder, stem: str, old: str, new: str, said: str) -> None:
    text = plain_texts()[stem]
    assert old in text
    with pytest.raises(RecordingError, match=said) as caught:
        import_csv(plain_folder(**{"left": plain_texts()["skeleton"], stem: text.replace(old, new)}))
    assert "\n" not in str(caught.value)


def test_missing_and_empty_files(tmp_path: Path, plain_folder: Folder) -> None:
    with pytest.raises(RecordingError, match="the folder does not exist"):
        import_csv(tmp_path / "nowhere")
    with pytest.raises(RecordingError, match=r"recording\.toml does not exist"):
        import_csv(tmp_path)
    for imu, said in (("", "is empty; export"), ("t_s,ax,ay,az,gx,gy,gz\n\n", "no rows")):
        with pytest.raises(RecordingError, match=said):
            import_csv(plain_folder(imu=imu))


def test_a_camera_without_skeleton_leaves_the_imus(plain_folder: Folder) -> None:
    folder = plain_folder(recording=plain_texts()["recording"].replace('skeleton = "skeleton.csv"\n', ""))
    found = open_csv(folder)
    assert not found.arms and [imu.topic for imu in found.imus] == ["/imu/forearm_right"]
    with pytest.raises(RecordingError, match="has no skeleton"):
        import_csv(folder)


def test_a_skeleton_listed_joint_by_joint_is_no_clock_that_was_set_back(plain_folder: Folder) -> None:
    plain = import_csv(plain_folder())
    head, *rows = plain_texts()["skeleton"].strip().split("\n")
    rows.sort(key=lambda row: row.split(",")[1])
    found = open_csv(plain_folder(skeleton="\n".join([head, *rows]) + "\n"))
    assert not any("set back" in note for note in found.notes)
    np.testing.assert_array_equal(found.arms[0].position, plain.arm.position)


@pytest.mark.parametrize(
    ("described", "factor", "rate"), [('time_unit = "ms"\n', 1.0, "1e[+]05"), ("", 1e3, "0.1")]
)
def test_times_in_another_unit(
    plain_folder: Folder, tmp_path: Path, described: str, factor: float, rate: str
) -> None:
    """Seconds that are called ms, and the reverse: import says it, and to smooth is refused in a sentence."""
    texts = plain_texts()
    head, *rows = (line.split(",", 1) for line in texts["imu"].strip().split("\n"))
    imu = "\n".join([",".join(head), *(f"{float(t) * factor:.6f},{rest}" for t, rest in rows), ""])
    section = '[imu.forearm_right]\nfile = "imu.csv"\n'
    file = open_csv(plain_folder(imu=imu, recording=texts["recording"].replace(section, section + described)))
    assert any("which no IMU has" in note and "time_unit" in note for note in file.notes)
    write_recording(file, tmp_path / "a.mcap")
    with pytest.raises(RecordingError, match=rf"in common .* at {rate} Hz, .* time_unit"):
        read_recording(tmp_path / "a.mcap")
