"""What the names of streams say: on which limb a sensor is, on which side, and whether it was asked for."""

from __future__ import annotations

import re

from .streams import ImuSamples, RecordingFile

OTHER_SIDE = {"left": "right", "right": "left"}
_FOREARM_WORDS = ("forearm", "wrist", "lower_arm", "hand", "watch", "arm")
_BASE_WORDS = ("base", "camera", "kinect", "k4a", "azure", "depth", "realsense")
_TRUNK_WORDS = ("trunk", "sternum", "chest", "torso", "thorax")


def role(stream: ImuSamples) -> str:
    """What a stream's names say it is on: "forearm", "upper_arm", "trunk", "base" or ""."""
    for name in (words(stream.topic), words(stream.frame_id)):
        if any(word in name for word in _TRUNK_WORDS):
            return "trunk"
        if "upper" in name:
            return "upper_arm"
        if any(word in name for word in _FOREARM_WORDS):
            return "forearm"
        if any(word in name for word in _BASE_WORDS):
            return "base"
    return ""


def named_side(*names: str) -> str:
    """The side that names speak of: "left", "right" or ""."""
    for name in names:
        left, right = "left" in words(name), "right" in words(name)
        if left != right:
            return "left" if left else "right"
    return ""


def named_body(name: str) -> int | None:
    """The camera's number of a body that a name speaks of ("body_2"), or None."""
    match = re.search(r"body_?(\d+)", words(name))
    return None if match is None else int(match.group(1))


def is_named(wanted: str, topic: str, frame_id: str) -> bool:
    """Whether a stream is what was asked for: by a part of its topic, or by its frame_id."""
    return wanted.strip("/").lower() in topic.lower() or wanted == frame_id


def words(name: str) -> str:
    """Lower case with the parts of CamelCase apart."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def topics_of(file: RecordingFile) -> str:
    """What a file holds, for messages."""
    listed = [f"{topic.name} ({topic.schema or 'no schema'})" for topic in file.topics if topic.count]
    if len(listed) > 8:
        listed = [*listed[:8], f"and {len(listed) - 8} more"]
    return ", ".join(listed) if listed else "no messages"
