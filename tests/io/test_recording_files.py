"""Recordings written and read back, and what is refused."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from importers import select_recording
from made_recordings import make

from smoother.errors import RecordingError, UnoccludeError
from smoother.io import describe, open_recording, read_recording, write_recording
from smoother.io.recording.choose import join_bodies
from smoother.io.recording.streams import ArmFrames
from smoother.io.recording.write import as_file
from smoother.recording import JointState, JointTracks, Recording


def assert_same(found: Recording, made: Recording) -> None:
    """To the nanosecond, which is all that a stamp holds."""
    for name in ("origin_ns", "side", "camera_frame"):
        assert getattr(found, name) == getattr(made, name)
    assert found.base_imu is not None and made.base_imu is not None
    assert found.truth is not None and made.truth is not None
    for one, other, names in (
        (found.imu, made.imu, ("acc", "gyro", "mag")),
        (found.base_imu, made.base_imu, ("acc", "gyro")),
        (found.arm, made.arm, ("position", "state")),
        (found.truth, made.truth, ("position", "quaternion", "score")),
    ):
        np.testing.assert_array_equal(np.rint(one.t_s * 1e9), np.rint(other.t_s * 1e9))
        for name in names:
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(found.truth.joints["elbow"], made.truth.joints["elbow"])
    np.testing.assert_array_equal(found.gravity_hint, made.gravity_hint)
    assert set(made.notes) <= set(found.notes)


@pytest.mark.parametrize("origin_ns", [0, 1_700_000_000 * 10**9])
def test_round_trip(tmp_path: Path, origin_ns: int) -> None:
    made = make(origin_ns=origin_ns)
    write_recording(made, tmp_path / "a.mcap")
    found = read_recording(tmp_path / "a.mcap")
    assert_same(found, made)
    assert found.name == "a.mcap"
    write_recording(found, tmp_path / "b.mcap")
    assert_same(read_recording(tmp_path / "b.mcap"), made)
    before_1970 = replace(made, origin_ns=-4_500_000_000)
    write_recording(before_1970, tmp_path / "c.mcap")
    found = read_recording(tmp_path / "c.mcap")
    assert found.origin_ns == 0
    np.testing.assert_allclose(found.imu.t_s, made.imu.t_s - 4.5, atol=1e-9)


def test_the_same_input_gives_the_same_bytes(tmp_path: Path, recording: Recording) -> None:
    write_recording(recording, tmp_path / "a.mcap")
    write_recording(recording, tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    with pytest.raises(UnoccludeError, match="force=True"):
        write_recording(recording, tmp_path / "a.mcap")


def only(arm: ArmFrames, keep: np.ndarray, body: int, moved: float = 0.0) -> ArmFrames:
    """The arm under another number, in some frames."""
    position, state = arm.position + moved, arm.state.copy()
    state[~keep], position[~keep] = JointState.NOT_TRACKED, np.nan
    return replace(arm, body=body, position=position, state=state)


def test_a_body_that_is_numbered_anew() -> None:
    file = as_file(make(20))
    (arm,), frames = file.arms, np.arange(len(file.arms[0].stamp_ns))
    first = only(arm, frames < 200, 1)
    file.arms = [first, only(arm, frames > 260, 4)]
    found = select_recording(file)
    assert any("numbered it anew" in note for note in found.notes)
    assert found.arm.tracked("shoulder")[:200].all() and found.arm.tracked("shoulder")[261:].all()
    assert not found.arm.tracked("shoulder")[200:261].any()
    assert not select_recording(file, body=4).arm.tracked("shoulder")[:200].any()
    # Somebody elsewhere, or at the same time, is somebody else.
    for other in (only(arm, frames > 260, 4, moved=1.0), only(arm, frames > 190, 4)):
        arms, notes = join_bodies([first, other])
        assert len(arms) == 2 and not notes


def refused(made: Recording, tmp_path: Path) -> str:
    write_recording(made, tmp_path / "bad.mcap", force=True)
    with pytest.raises(RecordingError) as caught:
        read_recording(tmp_path / "bad.mcap")
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(("factor", "unit", "key"), [(1000, "millimetres", "mm"), (100, "centimetres", "cm")])
@pytest.mark.parametrize("joints", [(1, 2), (2,)])
def test_skeleton_in_another_unit(
    recording: Recording, tmp_path: Path, factor: float, unit: str, key: str, joints: tuple[int, ...]
) -> None:
    arm = replace(recording.arm, position=recording.arm.position * factor, state=recording.arm.state.copy())
    arm.state[:, [joint for joint in range(5) if joint not in joints]] = 0
    said = refused(replace(recording, arm=arm), tmp_path)
    assert f"looks like {unit};" in said and f'position_unit = "{key}"' in said


def test_the_rate_of_frames_whose_arms_are_messages_of_their_own(tmp_path: Path) -> None:
    write_recording([make(side="right"), make(side="left")], tmp_path / "a.mcap")
    (row,) = [topic for topic in describe(tmp_path / "a.mcap")["topics"] if topic["name"] == "/skeleton"]
    assert row["count"] == 2 * len(make().arm) and row["rate_hz"] == pytest.approx(30, rel=0.01)


def test_nothing_visible_no_gravity_and_clocks_that_do_not_overlap(
    recording: Recording, tmp_path: Path
) -> None:
    arm, imu = recording.arm, recording.imu
    said = refused(replace(recording, imu=replace(imu, acc=0.01 * imu.acc)), tmp_path)
    assert "bad.mcap" in said and "/imu/forearm_right" in said and "gravity seems" in said
    nothing = JointTracks("x", arm.t_s, arm.position * np.nan, arm.state * 0)
    for hidden in (arm.hide(np.ones(len(arm), bool)), nothing):
        said = refused(replace(recording, arm=hidden), tmp_path)
        assert "no forearm joint is tracked" in said
    said = refused(replace(recording, arm=replace(arm, t_s=arm.t_s + 100), truth=None), tmp_path)
    assert "do not overlap" in said and "92.0" in said


def test_streams_that_are_not_there(recording: Recording, tmp_path: Path) -> None:
    file = as_file(recording)
    file.imus, imus = [], file.imus
    write_recording(file, tmp_path / "a.mcap")
    with pytest.raises(RecordingError, match=r"a\.mcap has no IMU .*it has /skeleton"):
        read_recording(tmp_path / "a.mcap")
    file.imus, file.arms = imus, []
    write_recording(file, tmp_path / "b.mcap")
    with pytest.raises(RecordingError, match=r"b\.mcap has no skeleton"):
        read_recording(tmp_path / "b.mcap")
    assert "no skeleton" in describe(tmp_path / "b.mcap")["missing"]["smooth"]


def test_a_damaged_metadata_record_is_one_sentence(recording: Recording, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_recording(recording, path)
    path.write_bytes(path.read_bytes().replace(b'["A note."', b'{"A note."'))
    with pytest.raises(
        RecordingError, match=r"a\.mcap: its metadata record .* cannot be read .*write it again"
    ):
        open_recording(path)


def test_isolated_bad_samples_are_dropped_and_counted(recording: Recording, tmp_path: Path) -> None:
    imu = replace(recording.imu, t_s=recording.imu.t_s.copy(), acc=recording.imu.acc.copy())
    imu.t_s[100], imu.t_s[200], imu.acc[300, 1] = imu.t_s[99], imu.t_s[150], np.nan
    write_recording(replace(recording, imu=imu), tmp_path / "a.mcap")
    found = read_recording(tmp_path / "a.mcap")
    assert len(found.imu) == len(imu) - 3
    assert any("3 of 800" in note and "1 not finite" in note for note in found.notes)
    assert (np.diff(found.imu.t_s) > 0).all()
    imu.acc[:60] = np.nan
    assert "61 not finite" in refused(replace(recording, imu=imu), tmp_path)


def test_importing_is_light() -> None:
    code = (
        "import sys, smoother.io; from smoother.io import read_recording, write_recovery\n"
        "assert not {'gtsam', 'open3d', 'cv2', 'plotly'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
