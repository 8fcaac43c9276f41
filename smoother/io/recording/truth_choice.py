"""Which poses of a file are the truth of an arm."""

from __future__ import annotations

from .stream_names import named_body, named_side, words
from .streams import PoseSamples, RecordingFile

_TRUTH_WORDS = ("truth", "mocap", "reference", "optical", "vicon", "optitrack", "qualisys")


def is_of_other_arm(name: str, side: str, body: int | None = None) -> bool:
    """Whether a name speaks of another side than this one, or of another body."""
    other_side = bool(side) and named_side(name) not in ("", side)
    return other_side or (body is not None and named_body(name) not in (None, body))


def choose_truth(
    file: RecordingFile, side: str, body: int | None = None
) -> tuple[PoseSamples | None, list[str]]:
    """The poses that are the truth of an arm (of a body, where several are told apart), or None and why."""
    poses = [poses for poses in file.poses if not is_of_other_arm(poses.topic, side, body)]
    if len(poses) > 1:
        named = [p for p in poses if any(word in words(p.topic) for word in _TRUTH_WORDS)]
        sided = [p for p in named if named_side(p.topic) == side]
        poses = sided if len(sided) == 1 else named
        if len(poses) != 1:
            return None, [
                f"Of the poses {', '.join(p.topic for p in file.poses)} none is named as this arm's truth; "
                "none was taken."
            ]
    return (poses[0], []) if poses else (None, [])
