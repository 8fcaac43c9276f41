"""Which poses of a file are the truth of an arm."""

from __future__ import annotations

from .stream_names import named_side, words
from .streams import PoseSamples, RecordingFile

_TRUTH_WORDS = ("truth", "mocap", "reference", "optical", "vicon", "optitrack", "qualisys")


def choose_truth(file: RecordingFile, side: str) -> tuple[PoseSamples | None, list[str]]:
    """The poses that are the truth of an arm, or None and why."""

    def other_side(name: str) -> bool:
        return bool(side) and named_side(name) not in ("", side)

    poses = [poses for poses in file.poses if not other_side(poses.topic)]
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
