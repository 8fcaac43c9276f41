"""What programs find that draw a result: beads, a log of the gaps, the level frame, the layout."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import make_recording
from mcap_messages import decoded
from results import made, without_answer
from scipy.spatial.transform import Rotation

from smoother.io import write_recording, write_recovery
from smoother.recording import CameraFrame


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


@pytest.fixture(scope="module")
def messages(tmp_path_factory) -> dict[str, list[Any]]:
    """Decoded messages of a result by topic."""
    path = tmp_path_factory.mktemp("layout") / "out.mcap"
    write_recovery(made("right"), path)
    return decoded(path)


def test_beads_lie_on_the_bones(messages):
    recovery, clouds = made("right"), messages["/unocclude/beads"]
    assert abs(len(clouds) - len(recovery.arm.t_s)) <= 0.15 * len(clouds)  # about the camera's rate
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


LAYOUT = Path(__file__).parents[3] / "docs" / "unocclude.foxglove-layout.json"
STEP = re.compile(r"([a-z_]+)(?:\[(\d+)\])?")


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    return json.loads(LAYOUT.read_text(encoding="utf-8"))


def value(message: Any, fields: list[str]) -> Any:
    """The value behind a message path, which has every field of it."""
    for field in fields:
        name, index = STEP.fullmatch(field).groups()
        message = getattr(message, name)
        message = message if index is None else message[int(index)]
    return message


def test_every_path_leads_to_a_value(layout, messages):
    panels = layout["configById"].values()
    shown = [path["value"] for config in panels for path in config.get("paths", [])]
    named = [path for path in shown if not re.fullmatch(r"[\d.]+", path)]  # a reference line's value
    for config in panels:
        named += [*config.get("topics", {}), *([config["topicPath"]] if "topicPath" in config else [])]
    assert len(named) >= 14
    for path in named:
        topic, *fields = path.split(".")
        root = bool(fields) and fields[-1] == "@sqrt"  # what both programs call the square root
        fields = fields[:-1] if root else fields
        assert not any("@" in field for field in fields), path
        assert topic in messages, f"{topic} is not in a result"
        found = [value(message, fields) for message in messages[topic]]
        if fields:
            numbers = np.array(found, float)
            assert np.isfinite(numbers).any()
            assert not root or (numbers >= 0).all()
            assert len(np.unique(numbers[np.isfinite(numbers)])) > 1 or "covariance" in path


def test_the_view_follows_a_level_frame(layout, messages):
    """`world` has z up: the hand-made gravity, turned into it, points down; the frames named are there."""
    view = layout["configById"]["3D!arm"]
    transforms = {
        one.child_frame_id: one for message in messages["/unocclude/tf"] for one in message.transforms
    }
    frames = {"world", *transforms}
    assert view["followTf"] == view["layers"]["grid"]["frameId"] == "world"
    assert {name.removeprefix("frame:") for name in view["transforms"]} <= frames
    camera = transforms["camera"]
    assert camera.parent_frame_id == "world"
    turn = camera.rotation
    down = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply(made("right").gravity_direction)
    np.testing.assert_allclose(down, [0, 0, -1], atol=1e-9)  # rounding
    assert transforms["forearm_imu"].parent_frame_id == "camera"
    # The forearm stays the first, as readers of older files expect it.
    assert messages["/unocclude/tf"][0].transforms[0].child_frame_id == "forearm_imu"
