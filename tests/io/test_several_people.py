"""Several people: numbers that the camera exchanged or gave anew, and IMUs without telling names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from smoother.io import select_recordings
from smoother.io.recording.bodies import join_bodies, people, unswap_bodies
from smoother.io.recording.streams import ArmFrames, RecordingFile
from smoother.io.recording.write import as_session
from smoother.recording import JointState
from smoother.simulation import ArmSimulation, PeopleSimulation, simulate_people

Crowd = tuple[RecordingFile, dict[str, tuple[int | None, str]]]


@pytest.fixture(scope="module")
def crowd() -> Crowd:
    """Two people, an IMU on each of three limbs and one on the table."""
    arm = ArmSimulation.preset("white", protocol="random", duration_s=15.0)
    who = PeopleSimulation(people=2, sensors=4, on_table=1, hanging=0.0, in_time=0.0, clocks_apart_s=0.2)
    made = simulate_people(who, arm, 10)
    return as_session(made.name, [one.stream for one in made.worn], made.arms, made.camera_frame), made.truth


def renumbered(arms: list[ArmFrames], number: Callable[[int, float], int | None]) -> list[ArmFrames]:
    """The same arms under other numbers: `number(body, share of the frames)`, None = not seen."""
    made: dict[tuple[int, str], ArmFrames] = {}
    for arm in arms:
        for row in range(len(arm.stamp_ns)):
            body = number(arm.body, row / len(arm.stamp_ns))
            if body is None:
                continue
            if (body, arm.side) not in made:
                nothing = np.full_like(arm.position, np.nan)
                made[body, arm.side] = replace(
                    arm, body=body, position=nothing, state=np.zeros_like(arm.state)
                )
            target = made[body, arm.side]
            target.position[row], target.state[row] = arm.position[row], arm.state[row]
    return list(made.values())


def assert_same_arms(found: list[ArmFrames], truth: list[ArmFrames], rows: np.ndarray) -> None:
    assert {(arm.body, arm.side) for arm in found} == {(arm.body, arm.side) for arm in truth}
    for arm in truth:
        (mine,) = [one for one in found if (one.body, one.side) == (arm.body, arm.side)]
        np.testing.assert_array_equal(mine.position[rows], arm.position[rows])


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
    file, _ = crowd
    swapped = renumbered(file.arms, lambda body, share: 1 - body if 0.3 < share < 0.7 else body)
    found, notes = unswap_bodies(swapped)
    assert_same_arms(found, file.arms, np.arange(len(file.arms[0].stamp_ns)))
    assert len(notes) == 1 and "exchange their numbers" in notes[0]
    same, none = unswap_bodies(file.arms)
    assert not none and all(one is other for one, other in zip(same, file.arms, strict=True))


def test_who_comes_back_where_they_were_is_joined_by_place(crowd: Crowd) -> None:
    file, _ = crowd
    away = renumbered(
        file.arms, lambda body, share: body if body == 0 or share < 0.45 else None if share < 0.5 else 7
    )
    found, notes = join_bodies(away)
    rows = np.flatnonzero(np.arange(len(away[0].stamp_ns)) / len(away[0].stamp_ns) >= 0.5)
    assert_same_arms(found, file.arms, rows)
    assert len(notes) == 2 and all("where it was" in note for note in notes)


def exchanged_places(file: RecordingFile) -> RecordingFile:
    """Both are lost; one comes back where the other stood, both under new numbers."""
    new = {0: 5, 1: 6}
    arms = renumbered(
        file.arms, lambda body, share: body if share < 0.48 else None if share < 0.52 else new[body]
    )
    place = {arm.body: np.nanmean(arm.position[:, 0], axis=0) for arm in arms if arm.side == "right"}
    for arm in arms:
        if arm.body in (5, 6):
            there = arm.state != JointState.NOT_TRACKED
            arm.position[there] += place[1 if arm.body == 5 else 0] - place[arm.body]
    return replace(file, arms=arms)


def test_imus_tell_who_came_back_where_the_other_stood() -> None:
    arm = ArmSimulation.preset("white", protocol="random", duration_s=30.0)
    who = PeopleSimulation(people=2, sensors=4, on_table=0, hanging=0.0, in_time=0.0, clocks_apart_s=0.2)
    made = simulate_people(who, arm, 2)
    assert {body for body, _ in made.truth.values()} == {0, 1}  # both wear something
    file = as_session(made.name, [one.stream for one in made.worn], made.arms, made.camera_frame)
    moved = exchanged_places(file)
    by_place, _ = join_bodies(moved.arms)
    by_imu, notes = people(moved)
    assert {one.body for one in by_imu} == {one.body for one in by_place} == {0, 1}
    last = len(moved.arms[0].stamp_ns) - 1
    for one in by_imu:
        (origin,) = [a for a in moved.arms if (a.body, a.side) == ({0: 5, 1: 6}[one.body], one.side)]
        np.testing.assert_array_equal(one.position[last], origin.position[last])
    wrong = next(a for a in by_place if a.body == 0 and a.side == "right")
    (other,) = [a for a in moved.arms if (a.body, a.side) == (6, "right")]
    np.testing.assert_array_equal(wrong.position[last], other.position[last])  # place alone is fooled
    assert any("the IMU that both wear" in note for note in notes)
    assert any("they wear different IMUs" in note for note in notes)
