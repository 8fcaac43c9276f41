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
    return named_segment(stream.topic) or named_segment(stream.frame_id)


def named_segment(name: str) -> str:
    """The segment that a name speaks of, or ""."""
    spoken = words(name)
    return next((segment for segment, named in _SEGMENTS if any(word in spoken for word in named)), "")


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


def is_named(wanted: str, topic: str, frame_id: str) -> bool:
    """Whether a stream is what was asked for: by a part of its topic, or by its frame_id."""
    return wanted.strip("/").lower() in topic.lower() or wanted == frame_id


def words(name: str) -> str:
    """Lower case with the parts of CamelCase apart."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def is_of_other_arm(name: str, side: str, body: int | None = None) -> bool:
    """Whether a name speaks of another side than this one, or of another body."""
    other_side = bool(side) and named_side(name) not in ("", side)
    named = re.search(r"body_?(\d+)", words(name))
    return other_side or (body is not None and named is not None and int(named[1]) != body)


def free_name(name: str, taken: set[str]) -> str:
    """The name, or with a number where it is taken; it is taken from then on."""
    number, free = 2, name
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    taken.add(free)
    return free
