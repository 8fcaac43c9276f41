"""The layout for Foxglove names only what a result holds."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from results import made
from scipy.spatial.transform import Rotation

from smoother.io import write_recovery
from smoother.io.wire.schemas import message_class

LAYOUT = Path(__file__).parents[3] / "docs" / "unocclude.foxglove-layout.json"
STEP = re.compile(r"([a-z_]+)(?:\[(\d+)\])?")


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    return json.loads(LAYOUT.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def messages(tmp_path_factory) -> dict[str, list[Any]]:
    """Decoded messages of a result by topic."""
    path = tmp_path_factory.mktemp("layout") / "out.mcap"
    write_recovery(made("right"), path)
    found: dict[str, list[Any]] = {}
    with open(path, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            one = message_class(schema.name)()
            one.ParseFromString(message.data)
            found.setdefault(channel.topic, []).append(one)
    return found


def is_number(path: str) -> bool:
    """Whether a path is a reference line's value."""
    return re.fullmatch(r"[\d.]+", path) is not None


def paths(layout: dict[str, Any]) -> list[str]:
    """Every message path and topic that a panel shows."""
    found = []
    for config in layout["configById"].values():
        found += [path["value"] for path in config.get("paths", []) if not is_number(path["value"])]
        found += list(config.get("topics", {}))
        found += [config["topicPath"]] if "topicPath" in config else []
    return found


def value(message: Any, fields: list[str]) -> Any:
    """The value behind a message path."""
    for field in fields:
        name, index = STEP.fullmatch(field).groups()
        assert name in [known.name for known in message.DESCRIPTOR.fields], f"{name} is no field"
        message = getattr(message, name)
        if index is not None:
            message = message[int(index)]
    return message


def test_every_path_leads_to_a_value(layout, messages):
    named = paths(layout)
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


def test_sigma_is_shown_and_not_variance(layout):
    shown = [path["value"] for path in layout["configById"]["Plot!sigma"]["paths"]]
    assert shown == [f"/unocclude/forearm.pose_covariance[{7 * axis}].@sqrt" for axis in range(3)]


def test_lines_in_degrees(layout):
    lines = [path for path in layout["configById"]["Plot!flexion"]["paths"] if is_number(path["value"])]
    assert len(lines) == 3
    for line in lines:
        assert line["label"] == f"{np.degrees(float(line['value'])):.0f} degrees"


def test_titles_stand_in_the_keys_of_both_programs(layout):
    for config in layout["configById"].values():
        assert config["foxglovePanelTitle"] == config["lichtblickPanelTitle"] != ""


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


def test_the_topics_that_users_are_to_see_are_there(layout):
    topics = {path.partition(".")[0].partition("[")[0] for path in paths(layout)}
    assert topics >= {f"/unocclude/{name}" for name in ("forearm", "arm", "arm_camera", "gaps", "joints")}


def test_the_wrist_is_the_wrist(messages):
    for topic in ("/unocclude/skeleton", "/unocclude/camera"):
        assert messages[topic][0].joints[2].name == "wrist_right"
    assert messages["/unocclude/joints"][0].joints[0].name == "elbow_flexion_right"


def test_every_panel_has_its_place_and_the_other_way_round(layout):
    def leaves(node: Any) -> list[str]:
        if isinstance(node, str):
            return [node]
        assert node["direction"] in ("row", "column")
        assert 0 < node["splitPercentage"] < 100
        return leaves(node["first"]) + leaves(node["second"])

    placed = leaves(layout["layout"])
    assert sorted(placed) == sorted(layout["configById"])
    assert len(set(placed)) == len(placed)
    kinds = {panel.partition("!")[0] for panel in placed}
    assert kinds == {"3D", "Plot", "StateTransitions", "RawMessages"}
