"""Both arms of one person, arms of several people, clocks far apart: which IMU is on which arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from importers import select_recording
from mcap.reader import make_reader

from smoother.errors import RecordingError, UnoccludeError
from smoother.io import read_recording, read_recordings, read_recovery, write_recording, write_recovery
from smoother.io.recording.choose import choose_arms, unswap_bodies
from smoother.io.recording.read import select_recordings
from smoother.io.recording.streams import ArmFrames, RecordingFile
from smoother.io.recording.write import as_file, as_session
from smoother.result import Recoveries, arm_tags
from smoother.simulation import (
    ArmSimulation,
    PeopleSimulation,
    SimulatedArm,
    simulate_both_arms,
    simulate_people,
)
from tests.helpers.made_results import recovery


@pytest.fixture(scope="module")
def both() -> tuple[SimulatedArm, SimulatedArm]:
    return simulate_both_arms(ArmSimulation(protocol="random", duration_s=12, occlusion_lengths_s=(1.0,)), 7)


@pytest.fixture
def file(both: tuple[SimulatedArm, SimulatedArm]) -> RecordingFile:
    return as_file([one.recording for one in both])


def test_names_with_sides_give_both_arms(both: tuple[SimulatedArm, SimulatedArm], tmp_path: Path) -> None:
    path, t = tmp_path / "both.mcap", np.linspace(1.0, 10.0, 50)
    shoulders = [one.motion.joints(t)["shoulder"] for one in both]  # of one person
    width = np.linalg.norm(shoulders[0] - shoulders[1], axis=1)
    assert width.min() > 0.25 and width.max() < 0.55
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


def test_one_arms_stream_alone_says_what_fits(file: RecordingFile) -> None:
    """What is said names both arms and the options, one of which helps."""
    (left,) = [arm for arm in file.arms if arm.side == "left"]
    (worn,) = [imu for imu in file.imus if "right" in imu.topic]
    for options in ({}, {"side": "left"}, {"side": "right"}):
        with pytest.raises(RecordingError, match=r"forearm_right and skeleton .*left.* --swap left,right"):
            select_recording(replace(file, arms=[left], imus=[worn]), **options)
    unnamed = replace(worn, topic="/imu/sensor", frame_id="")
    with pytest.raises(RecordingError, match="give one of /imu/sensor, or --side"):
        select_recording(replace(file, imus=[unnamed]), imu="right")
    assert select_recording(replace(file, imus=[unnamed]), side="right").side == "right"
    upper = replace(worn, topic="/imu/upper_arm_right")
    with pytest.raises(RecordingError, match=f"more than one .* give one of {worn.topic}"):
        select_recording(replace(file, imus=[worn, upper]), imu="right")


Crowd = tuple[RecordingFile, dict[str, tuple[int | None, str]]]


@pytest.fixture(scope="module")
def crowd() -> Crowd:
    """Two people, an IMU on each of three limbs and one on the table."""
    arm = ArmSimulation.preset("white", protocol="random", duration_s=15.0)
    who = PeopleSimulation(people=2, sensors=4, on_table=1, hanging=0.0, in_time=0.0, clocks_apart_s=0.2)
    made = simulate_people(who, arm, 10)
    return as_session(made.name, [one.stream for one in made.worn], made.arms, made.camera_frame), made.truth


@pytest.mark.slow
def test_every_worn_forearm_is_taken_with_its_body(crowd: Crowd) -> None:
    file, truth = crowd
    arms = select_recordings(file)
    wrists = {name: where for name, where in truth.items() if where[1].startswith("wrist")}
    assert {body for body, _ in wrists.values()} == {0, 1}
    assert {arm.imu.name: (arm.body, f"wrist_{arm.side}") for arm in arms} == wrists
    (table,) = [name for name, (body, _) in truth.items() if body is None]
    (above,) = [name for name, (_, joint) in truth.items() if joint.startswith("upper_arm")]
    for arm in arms:
        assert any(f"IMU {arm.imu.name} and " in note and "probability" in note for note in arm.notes)
        assert any(f"IMU {table} is on no limb in view" in note for note in arm.notes)
        assert any(f"IMU {above} is on upper_arm" in note and "not used" in note for note in arm.notes)
        assert arm.upper_imu is None and "of body" in arm.arm_label
    assert len(select_recordings(file, side="left")) == 1
    (only,) = select_recordings(file, body=1)
    assert only.side == "right" and only.imu.name == next(n for n, where in wrists.items() if where[0] == 1)


def test_exchanged_numbers_are_put_back(crowd: Crowd) -> None:
    arms, share = crowd[0].arms, np.linspace(0.0, 1.0, len(crowd[0].arms[0].stamp_ns))
    own, other = {(arm.body, arm.side): arm for arm in arms}, (share > 0.3) & (share < 0.7)

    def exchanged(arm: ArmFrames) -> ArmFrames:
        with_ = own[1 - arm.body, arm.side]
        position = np.where(other[:, None, None], with_.position, arm.position)
        return replace(arm, position=position, state=np.where(other[:, None], with_.state, arm.state))

    found, notes = unswap_bodies([exchanged(arm) for arm in arms])
    for arm, true in zip(found, arms, strict=True):
        assert arm.key == true.key
        np.testing.assert_array_equal(arm.position, true.position)
    assert len(notes) == 1 and "exchange their numbers" in notes[0]
    same, none = unswap_bodies(arms)
    assert not none and all(one is other for one, other in zip(same, arms, strict=True))


@pytest.mark.parametrize("shift_s", [0.1, -8.0, 11.8])
def test_the_arm_is_told_by_motion(file: RecordingFile, shift_s: float):
    (right,) = [imu for imu in file.imus if "right" in imu.topic]
    stamp = right.stamp_ns + round(1e9 * shift_s)
    file.imus = [replace(right, topic="/imu/device", frame_id="", stamp_ns=stamp)]
    ((choice,), _) = choose_arms(file, alone=True)
    assert choice.side == "right"
    assert ("s apart" in choice.notes[0]) == (abs(shift_s) > 1)
    file.arms = [replace(choice.arm, side=side) for side in ("left", "right")]  # that move alike
    with pytest.raises(RecordingError, match="does not show which belong together; choose with --side"):
        choose_arms(file, alone=True)
