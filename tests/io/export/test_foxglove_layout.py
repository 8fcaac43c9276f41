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


def paths(layout: dict[str, Any]) -> list[str]:
    """Every message path and topic that a panel shows."""
    found = []
    for config in layout["configById"].values():
        found += [path["value"] for path in config.get("paths", [])]
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
        assert topic in messages, f"{topic} is not in a result"
        found = [value(message, fields) for message in messages[topic]]
        if fields:
            numbers = np.array(found, float)
            assert np.isfinite(numbers).any()
            assert len(np.unique(numbers[np.isfinite(numbers)])) > 1 or "covariance" in path


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
