"""What names of streams say: the segment that an IMU is on, its side, a body's number."""

from __future__ import annotations

import re
from collections.abc import Sequence

from .streams import ImuSamples

OTHER_SIDE = {"left": "right", "right": "left"}
#: Words of names and the segment that they speak of; the first row that fits counts.
_SEGMENTS = (
    ("trunk", ("trunk", "sternum", "chest", "torso", "thorax")),
    ("upper_arm", ("upper",)),
    ("forearm", ("forearm", "wrist", "lower_arm", "watch")),
    ("hand", ("hand", "palm", "metacarp")),
    ("forearm", ("arm",)),
    ("base", ("base", "camera", "kinect", "k4a", "azure", "depth", "realsense")),
)


def role(stream: ImuSamples) -> str:
    """The segment by a stream's names: "forearm", "upper_arm", "hand", "trunk", "base" or ""."""
    for name in (words(stream.topic), words(stream.frame_id)):
        for segment, named in _SEGMENTS:
            if any(word in name for word in named):
                return segment
    return ""


def role_among(stream: ImuSamples, imus: Sequence[ImuSamples]) -> str:
    """Its role in a file: an IMU named after a hand is used as the forearm's where that arm has no other."""
    named = role(stream)
    if named != "hand":
        return named
    side = named_side(stream.topic, stream.frame_id)
    for other in imus:
        its_side = named_side(other.topic, other.frame_id)
        if role(other) in ("", "forearm") and (not side or its_side in ("", side)):
            return "hand"
    return "forearm"


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


def is_of_other_arm(name: str, side: str, body: int | None = None) -> bool:
    """Whether a name speaks of another side than this one, or of another body."""
    other_side = bool(side) and named_side(name) not in ("", side)
    return other_side or (body is not None and named_body(name) not in (None, body))
