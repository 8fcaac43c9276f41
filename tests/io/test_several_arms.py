"""Every arm of a file that has an IMU: chosen, read, written and read back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from smoother.errors import RecordingError, UnoccludeError
from smoother.io import (
    read_recording,
    read_recordings,
    read_recovery,
    select_recording,
    select_recordings,
    write_recording,
    write_recovery,
)
from smoother.io.recording.streams import RecordingFile
from smoother.io.recording.write import as_file
from smoother.result import Recoveries, arm_tags
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_both_arms
from tests.helpers.made_results import recovery


@pytest.fixture(scope="module")
def both() -> tuple[SimulatedArm, SimulatedArm]:
    return simulate_both_arms(ArmSimulation(protocol="random", duration_s=12, occlusion_lengths_s=(1.0,)), 7)


@pytest.fixture
def file(both: tuple[SimulatedArm, SimulatedArm]) -> RecordingFile:
    return as_file([one.recording for one in both])


def test_both_arms_share_a_person(both: tuple[SimulatedArm, SimulatedArm]) -> None:
    right, left = (one.recording for one in both)
    assert (right.side, left.side) == ("right", "left")
    np.testing.assert_array_equal(right.arm.t_s, left.arm.t_s)  # one camera
    t = np.linspace(1.0, 10.0, 50)
    shoulders = [one.motion.joints(t)["shoulder"] for one in both]
    width = np.linalg.norm(shoulders[0] - shoulders[1], axis=1)
    assert width.min() > 0.25 and width.max() < 0.55
    np.testing.assert_array_equal(both[0].parameters["gravity"], both[1].parameters["gravity"])
    assert not np.allclose(both[0].calibration.R_F_A, both[1].calibration.R_F_A)  # put on anew


def test_names_with_sides_give_both_arms(both: tuple[SimulatedArm, SimulatedArm], tmp_path: Path) -> None:
    path = tmp_path / "both.mcap"
    write_recording([one.recording for one in both], path)
    arms = read_recordings(path)
    assert [arm.side for arm in arms] == ["left", "right"]
    assert len({arm.origin_ns for arm in arms}) == 1 and all(arm.body is None for arm in arms)
    for arm, made in zip(arms, (both[1].recording, both[0].recording), strict=True):
        alone = read_recording(path, side=made.side)
        assert arm.imu.name == alone.imu.name == f"/imu/forearm_{made.side}"
        np.testing.assert_array_equal(arm.imu.gyro, made.imu.gyro)
        np.testing.assert_array_equal(arm.arm.position, made.arm.position)
        other = both[1] if made is both[0].recording else both[0]
        assert arm.opposite is not None
        np.testing.assert_array_equal(arm.opposite.position, other.recording.arm.position)
        assert arm.truth is not None and made.truth is not None
        np.testing.assert_array_equal(arm.truth.position, made.truth.position)
    assert [arm.side for arm in read_recordings(path, side="right")] == ["right"]
    assert [arm.side for arm in read_recordings(path, imu="forearm_left")] == ["left"]


def test_one_arm_is_read_as_before(both: tuple[SimulatedArm, SimulatedArm]) -> None:
    for made in (as_file(both[0].recording), as_file([both[0].recording, both[1].recording])):
        made.imus = [imu for imu in made.imus if "right" in imu.topic]
        one, (same,) = select_recording(made), select_recordings(made)
        assert (one.notes, one.side, one.origin_ns, one.body) == (same.notes, same.side, same.origin_ns, None)
        np.testing.assert_array_equal(one.imu.acc, same.imu.acc)
        np.testing.assert_array_equal(one.arm.position, same.arm.position)


def test_a_side_without_an_imu_is_refused(file: RecordingFile) -> None:
    file.imus = [imu for imu in file.imus if "right" in imu.topic]
    with pytest.raises(RecordingError, match=r"no IMU is on an arm .* leave --side out"):
        select_recordings(file, side="left")


def test_motion_settles_which_of_two_imus_of_one_limb_is_worn(file: RecordingFile) -> None:
    lying = replace(file.imus[0], topic="/imu/wrist_right_spare", gyro=np.zeros_like(file.imus[0].gyro))
    file.imus.append(replace(lying, acc=np.tile([0.0, 0.0, 9.81], (len(lying.acc), 1))))
    left, right = select_recordings(file)
    assert (left.imu.name, right.imu.name) == ("/imu/forearm_left", "/imu/forearm_right")
    assert any("motion agrees best" in note for note in right.notes)


def test_two_equal_imus_on_one_limb_leave_this_arm_out(file: RecordingFile) -> None:
    twin = next(imu for imu in file.imus if "right" in imu.topic)
    file.imus.append(replace(twin, topic="/imu/wrist_right"))
    (left,) = select_recordings(file)
    assert left.side == "left"
    assert any(note.startswith("The right arm was left out:") and "--imu" in note for note in left.notes)


def test_an_imu_of_another_day_leaves_its_arm_out(file: RecordingFile) -> None:
    left_imu = next(imu for imu in file.imus if "left" in imu.topic)
    file.imus = [
        replace(imu, stamp_ns=imu.stamp_ns + 10**15) if imu is left_imu else imu for imu in file.imus
    ]
    (right,) = select_recordings(file)
    assert right.side == "right"
    assert any("left arm was left out" in note and "do not overlap" in note for note in right.notes)
    with pytest.raises(RecordingError, match="do not overlap"):
        select_recordings(file, side="left")


def test_motion_tells_where_unnamed_imus_of_one_person_are(file: RecordingFile) -> None:
    file.imus = [
        replace(imu, topic=f"/imu/{name}", frame_id="") for name, imu in zip("ab", file.imus, strict=True)
    ]
    arms = {arm.side: arm for arm in select_recordings(file)}
    assert {side: arm.imu.name for side, arm in arms.items()} == {"right": "/imu/a", "left": "/imu/b"}
    assert all("motion agrees best (probability" in " ".join(arm.notes) for arm in arms.values())


def test_topics_of_several_arms_and_people(tmp_path: Path) -> None:
    made = recovery(60)
    arms = [replace(made, side=side, body=body) for body, side in ((1, "left"), (1, "right"), (4, "right"))]
    assert arm_tags(arms) == ["body_1/left", "body_1/right", "body_4/right"]
    write_recovery(arms, tmp_path / "out.mcap")
    with open(tmp_path / "out.mcap", "rb") as stream:
        reader = make_reader(stream)
        topics = {channel.topic for _, channel, _ in reader.iter_messages()}
        names = {record.name for record in reader.iter_metadata()}
    assert {f"/unocclude/forearm/{tag}" for tag in arm_tags(arms)} <= topics
    assert {f"unocclude.result/{tag}" for tag in arm_tags(arms)} <= names
    back = Recoveries(tuple(read_recovery(tmp_path / "out.mcap")))
    assert [(arm.body, arm.side) for arm in back] == [(1, "left"), (1, "right"), (4, "right")]
    np.testing.assert_array_equal(back["body_4/right"].t_s, made.t_s)
    np.testing.assert_array_equal(back["left"].position, made.position)
    with pytest.raises(UnoccludeError, match="several arms fit 'right'; arms: body_1/left"):
        back["right"]
    with pytest.raises(UnoccludeError, match="there is no arm 'body_9/left'"):
        back["body_9/left"]


def test_one_arm_is_written_as_before(tmp_path: Path) -> None:
    made = recovery(60)
    write_recovery(made, tmp_path / "one.mcap")
    with open(tmp_path / "one.mcap", "rb") as stream:
        reader = make_reader(stream)
        (record,) = [one for one in reader.iter_metadata() if one.name.startswith("unocclude.result")]
        topics = {channel.topic for _, channel, _ in reader.iter_messages()}
    assert record.name == "unocclude.result" and "body" not in record.metadata
    assert json.loads(record.metadata["side"]) == made.side
    assert all(topic.count("/") == 2 for topic in topics if topic.startswith("/unocclude/"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"skeleton": "left"}, "a topic may hold both arms: for the left one give --side left"),
        (
            {"imu": "right", "side": "left"},
            "is on the right arm by its name: leave --side out, or give --side",
        ),
    ],
)
def test_what_fits_nothing_says_what_does(file: RecordingFile, options: dict[str, str], said: str) -> None:
    with pytest.raises(RecordingError, match=said):
        select_recording(file, **options)
    side = "left" if "skeleton" in options else "right"
    assert select_recording(file, side=side).side == side


def test_one_arms_stream_alone_says_what_fits(file: RecordingFile) -> None:
    """The message named all options, whichever of them could help."""
    (left,) = [arm for arm in file.arms if arm.side == "left"]
    (worn,) = [imu for imu in file.imus if "right" in imu.topic]
    other = "the skeleton shows the left arm only: give --swap left,right"
    for options in ({}, {"side": "left"}, {"side": "right"}):
        with pytest.raises(RecordingError, match=other):
            select_recording(replace(file, arms=[left], imus=[worn]), **options)
    with pytest.raises(RecordingError, match="on the right arm by its name: leave --side out"):
        select_recording(replace(file, imus=[worn]), side="left")
    unnamed = replace(worn, topic="/imu/sensor", frame_id="")
    with pytest.raises(RecordingError, match="it has /imu/sensor; for the right arm give --side right"):
        select_recording(replace(file, imus=[unnamed]), imu="right")
    assert select_recording(replace(file, imus=[unnamed]), side="right").side == "right"
    upper = replace(worn, topic="/imu/upper_arm_right")
    with pytest.raises(RecordingError, match=f"more than one .* give --imu {worn.topic}"):
        select_recording(replace(file, imus=[worn, upper]), imu="right")
