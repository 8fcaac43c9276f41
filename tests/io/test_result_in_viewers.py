"""What a result holds for programs that draw it: beads, a log of the gaps, the level frame."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from arms import make_recording
from mcap.reader import make_reader
from results import made, without_answer

from smoother.io import read_recovery, write_recording, write_recovery
from smoother.io.result.drawing import world_axes
from smoother.io.wire.schemas import message_class
from smoother.recording import CameraFrame

WANTED = ("beads", "log", "tf", "arm")


def decoded(path: Path) -> dict[str, list[Any]]:
    """Messages by topic, of the topics under test."""
    messages = defaultdict(list)
    with open(path, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.topic.split("/")[2:3] and channel.topic.split("/")[2] in WANTED:
                one = message_class(schema.name)()
                one.ParseFromString(message.data)
                messages[channel.topic].append(one)
    return messages


def beads_of(cloud: Any) -> tuple[np.ndarray, np.ndarray]:
    """Places (B, 3) and colours (B, 4) by the cloud's own description of its fields."""
    kinds = {7: "<f4", 1: "u1"}
    layout = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [kinds[field.type] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_stride,
        }
    )
    rows = np.frombuffer(cloud.data, layout)
    places = np.stack([rows[axis] for axis in "xyz"], axis=1)
    return places, np.stack([rows[name] for name in ("red", "green", "blue", "alpha")], axis=1)


def test_beads_lie_on_the_bones(tmp_path):
    recovery = made("right")
    write_recovery(recovery, tmp_path / "out.mcap")
    clouds = decoded(tmp_path / "out.mcap")["/unocclude/beads"]
    assert len(clouds) == len(recovery.arm.t_s)
    for cloud in clouds[:: len(clouds) // 20]:
        k = int(np.abs(recovery.t_s - cloud.timestamp.ToNanoseconds() * 1e-9).argmin())
        places, colors = beads_of(cloud)
        shoulder, elbow, wrist = (recovery.joints[name][k] for name in ("shoulder", "elbow", "wrist"))
        for joint in (shoulder, elbow, wrist):
            assert np.abs(places - joint).max(axis=1).min() < 1e-6  # single precision at 2 m
        for one, other in ((shoulder, elbow), (elbow, wrist)):
            along = (places - one) @ (other - one) / ((other - one) @ (other - one))
            off = np.linalg.norm(places - one - along[:, None] * (other - one), axis=1)
            assert ((off < 1e-6) & (along > 0.01) & (along < 0.99)).sum() >= 5
        orange = (colors[:, 0] > colors[:, 2]).all()
        assert orange == recovery.occluded[k]
        assert orange or (colors[:, 2] > colors[:, 0]).all()
    assert len({beads_of(cloud)[1].tobytes() for cloud in clouds}) == 2


def test_beads_of_little(tmp_path):
    """A strap alone is one bead; times without an answer have a cloud without any, which clears the last."""
    write_recovery(made(strap=True), tmp_path / "strap.mcap")
    clouds = decoded(tmp_path / "strap.mcap")["/unocclude/beads"]
    assert {len(beads_of(cloud)[0]) for cloud in clouds} == {1}
    write_recovery(without_answer(made(), 9.5, 10.5), tmp_path / "some.mcap")
    counts = [len(beads_of(cloud)[0]) for cloud in decoded(tmp_path / "some.mcap")["/unocclude/beads"]]
    assert 28 <= counts.count(0) <= 32  # a second at 30 Hz
    assert len(set(counts)) == 2


def test_a_line_of_the_log_for_each_gap(tmp_path):
    recovery = made("left")
    write_recovery(recovery, tmp_path / "out.mcap")
    lines = decoded(tmp_path / "out.mcap")["/unocclude/log"]
    assert len(lines) == len(recovery.gaps) == 2
    for line, gap in zip(lines, recovery.gaps, strict=True):
        assert abs(line.timestamp.ToNanoseconds() * 1e-9 - gap.start_s) < 1e-8
        assert line.message == f"left forearm occluded for {gap.length_s:.2f} s"
    write_recovery(made(hidden=()), tmp_path / "none.mcap")
    assert not decoded(tmp_path / "none.mcap")["/unocclude/log"]


def test_a_level_frame_in_every_transform(tmp_path):
    """Also where there is no pose; for two arms one and the same; without gravity as the file says."""
    write_recovery([without_answer(made("left"), 9.5, 10.5), made("right")], tmp_path / "both.mcap")
    messages = decoded(tmp_path / "both.mcap")
    turns = set()
    for side in ("left", "right"):
        for message in messages[f"/unocclude/tf/{side}"]:
            world = [one for one in message.transforms if one.parent_frame_id == "world"]
            assert len(world) == 1
            turns.add(world[0].rotation.SerializeToString())
    assert len(turns) == 1
    hold = replace(made(), gravity_direction=np.full(3, np.nan))
    write_recovery(hold, tmp_path / "hold.mcap")
    assert all(len(message.transforms) == 1 for message in decoded(tmp_path / "hold.mcap")["/unocclude/tf"])
    write_recording(replace(make_recording(), camera_frame=CameraFrame.OPTICAL), tmp_path / "rec.mcap")
    write_recovery(hold, tmp_path / "level.mcap", source=tmp_path / "rec.mcap")
    names = {
        one.parent_frame_id for m in decoded(tmp_path / "level.mcap")["/unocclude/tf"] for one in m.transforms
    }
    assert "world" in names


def test_world_axes():
    for frame in CameraFrame:
        turn = world_axes(frame.down)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) > 0.99
        np.testing.assert_allclose(turn @ frame.down, [0, 0, -1], atol=1e-12)
    # What lies before an optical camera is at negative x, what is to its right at positive y.
    turn = world_axes(CameraFrame.OPTICAL.down)
    np.testing.assert_allclose(turn @ [0, 0, 2], [-2, 0, 0], atol=1e-12)
    np.testing.assert_allclose(turn @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_the_additions_cost_little_and_change_nothing_that_is_read(tmp_path):
    recovery = made("right")
    write_recovery(recovery, tmp_path / "one.mcap")
    write_recovery(recovery, tmp_path / "two.mcap")
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "two.mcap").read_bytes()
    again = read_recovery(tmp_path / "one.mcap")[0]
    np.testing.assert_array_equal(again.position, recovery.position)
    assert again.gaps == recovery.gaps
    sizes: dict[str, int] = defaultdict(int)
    with open(tmp_path / "one.mcap", "rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            sizes[channel.topic] += len(message.data)
    added = sizes["/unocclude/beads"] + sizes["/unocclude/log"]
    assert added < 0.1 * (sum(sizes.values()) - added)
