"""Which columns of a table are which joint's: one row a frame, in the spellings of many programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from .joint_names import ARM, BLAZEPOSE, JointName, joint_name, words_of

_AXES = {"x": 0, "y": 1, "z": 2, "posx": 0, "posy": 1, "posz": 2, "tx": 0, "ty": 1, "tz": 2}
_CONFIDENCE = {
    *("c", "conf", "confidence", "state", "tracking", "tracked", "trackingstate", "visibility", "vis", "v"),
    *("score", "presence", "likelihood", "status", "level"),
}
#: Columns with one of these words are no position.
_ELSE = {
    *("rot", "rotation", "orientation", "orient", "ori", "quat", "quaternion", "qx", "qy", "qz", "qw", "w"),
    *("euler", "roll", "pitch", "yaw", "depth", "color", "colour", "screen", "pixel", "px", "image", "img"),
    *("proj", "projected", "angle", "velocity", "vel", "acc", "speed", "residual", "reprojection", "error"),
    *("uncertainty", "sigma", "std", "cov", "q"),
}
_NORMALISED = {"norm", "normalized", "normalised"}
_BODY = (
    *("body idx", "body id", "bodyid", "bodyidx", "body", "tracking id", "trackingid", "person", "person id"),
    *("skeleton id", "skeletonid", "user id", "userid", "user", "player", "player id", "subject", "track id"),
    *("body index", "body num", "pose id", "pose index", "pose idx", "id"),
)
_TIME = (
    *(
        "timestamp",
        "time stamp",
        "timestamps",
        "times",
        "ts",
        "date",
        "time",
        "t",
        "seconds",
        "device",
        "device timestamp",
        "relative time",
    ),
    *("elapsed", "elapsed time", "datetime", "date time", "clock", "ticks", "system timestamp", "frame time"),
)
_FRAME = ("frame", "frame number", "frame no", "frame index", "frame idx", "frame id", "framenumber", "index")
_UNIT_WORDS = {
    **dict.fromkeys(("us", "usec", "usecs", "microsecond", "microseconds", "micros"), 1e-6),
    **dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds", "millis"), 1e-3),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosecond", "nanoseconds", "nanos"), 1e-9),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    "ticks": 1e-7,
}


@dataclass
class JointColumns:
    """Columns (from 0) of a table with one row a frame and body.

    Attributes
    ----------
    axes : dict of str to tuple of int
        Columns of x, y, z by joint and side (`wrist_right`).
    rest : list of (JointName, tuple of int)
        Parts of the body that are no joint of an arm (hips, head).
    confidence : dict of str to int
        Column of the confidence or state by joint and side.
    time, frame, body : int, optional
        Columns of the time, of the frame's number, of the body's number.
    time_scale : float, optional
        Seconds in a unit of the time, where its name states it.
    world : bool
        Columns that are named "world" were taken, beside others that are not.
    normalised : bool
        Columns are named as normalised image coordinates.
    numbered : bool
        Joints are numbered, not named (33 landmarks).
    incomplete : set of str
        Columns of joints of an arm that have two axes and nowhere the third.
    """

    axes: dict[str, tuple[int, int, int]] = field(default_factory=dict)
    rest: list[tuple[JointName, tuple[int, int, int]]] = field(default_factory=list)
    confidence: dict[str, int] = field(default_factory=dict)
    time: int | None = None
    frame: int | None = None
    body: int | None = None
    time_scale: float | None = None
    world: bool = False
    normalised: bool = False
    numbered: bool = False
    incomplete: set[str] = field(default_factory=set)

    def has_arm(self) -> bool:
        """Whether there is a side with an elbow and a wrist or hand."""
        return any(
            f"elbow_{side}" in self.axes and {f"wrist_{side}", f"hand_{side}"} & self.axes.keys()
            for side in ("left", "right")
        )


@dataclass(frozen=True)
class _Column:
    """One column's name taken apart."""

    at: int
    key: str  # what it is of: the name's remaining words
    axis: int | None
    world: bool
    normalised: bool


def find_joint_columns(names: Sequence[str]) -> JointColumns:
    """Find the columns of the arms' joints by their names.

    Parameters
    ----------
    names : sequence of str
        Of all columns: `WRIST_RIGHT (x)`, `wrist_right_x`, `WristRight_X`, `right_wrist.x`, `landmark_16_x`,
        `x16`; with `(c)`, `_conf`, `_state`, `_visibility` beside them.

    Returns
    -------
    JointColumns
        Without joints where there are none.
    """
    result = JointColumns()
    parts = [part for at, name in enumerate(names) if (part := _taken_apart(at, name)) is not None]
    result.world = any(part.world for part in parts)
    if result.world:  # the same landmarks in the image beside those in the world
        parts = [part for part in parts if part.world]
    result.normalised = bool(parts) and all(part.normalised for part in parts)
    by_key: dict[str, dict[int | None, int]] = {}
    for part in parts:
        by_key.setdefault(part.key, {}).setdefault(part.axis, part.at)
    by_key = _named(by_key, result)
    lacking: dict[str, set[str]] = {}
    for key, columns in by_key.items():
        name = joint_name(key)
        there = {0, 1, 2} & columns.keys()
        if name is not None and name.joint and name.kind != "skin" and len(there) == 2:
            lacking[name.joint] = {names[columns[axis]] for axis in there}
        if name is None or len(there) < 3:
            continue
        triple = (columns[0], columns[1], columns[2])
        if name.joint and name.kind != "skin":
            if name.joint not in result.axes:
                result.axes[name.joint] = triple
                if None in columns:
                    result.confidence[name.joint] = columns[None]
        elif name.part not in ARM:
            result.rest.append((name, triple))
    result.incomplete = {
        name for joint, there in lacking.items() if joint not in result.axes for name in there
    }
    _bookkeeping(names, result)
    return result


@lru_cache(maxsize=4096)
def plain_words(name: str) -> str:
    """A column's name in plain words without its unit: `timestamp_usec` is `timestamp`."""
    words = words_of(name)
    bare = [word for word in words if word not in _UNIT_WORDS or words == [word]]
    return " ".join(bare)


def time_unit_of(name: str) -> float | None:
    """Seconds in the unit that a column's name states, None where it states none."""
    words = words_of(name)
    return next((_UNIT_WORDS[word] for word in reversed(words) if word in _UNIT_WORDS and word != "t"), None)


def column_named(names: Sequence[str], wanted: Sequence[str]) -> int | None:
    """The column whose plain words are the first of these that is there."""
    words = [plain_words(name) for name in names]
    return next((words.index(want) for want in wanted if want in words), None)


def _taken_apart(at: int, name: str) -> _Column | None:
    words = words_of(name)
    if not words or _ELSE & set(words):
        return None
    axes = [word for word in words if word in _AXES]
    of_confidence = [word for word in words if word in _CONFIDENCE]
    if len(axes) > 1 or (axes and of_confidence) or not (axes or of_confidence):
        return None
    rest = [w for w in words if w not in _AXES and w not in _CONFIDENCE and w not in ("world", *_NORMALISED)]
    if not rest:
        return None
    axis = _AXES[axes[0]] if axes else None
    return _Column(at, " ".join(rest), axis, "world" in words, bool(_NORMALISED & set(words)))


def _named(
    by_key: dict[str, dict[int | None, int]], result: JointColumns
) -> dict[str, dict[int | None, int]]:
    """Landmarks by their names where the columns number them (from 0 or 1)."""
    numbers: dict[int, dict[int | None, int]] = {}
    for key, columns in by_key.items():
        digits = [word for word in key.split() if word.isdigit()]
        if len(digits) == 1 and len({0, 1, 2} & columns.keys()) >= 2 and joint_name(key) is None:
            numbers.setdefault(int(digits[0]), columns)
    if any(name is not None and name.joint for name in map(joint_name, by_key)) or not numbers:
        return by_key
    first, last = min(numbers), max(numbers)
    base = 1 if (first, last) == (1, len(BLAZEPOSE)) else 0
    if last - base >= len(BLAZEPOSE) or len(numbers) < 6:
        return by_key  # some other set of points
    result.numbered = True
    return {BLAZEPOSE[number - base]: columns for number, columns in sorted(numbers.items())}


def _bookkeeping(names: Sequence[str], result: JointColumns) -> None:
    """Columns of time, frame and body, which are no joint's."""
    used = {at for triple in result.axes.values() for at in triple}
    free = [name if at not in used else "" for at, name in enumerate(names)]
    result.time = column_named(free, _TIME)
    result.frame = column_named(free, _FRAME)
    result.body = column_named(free, _BODY)
    if result.time is not None:
        result.time_scale = time_unit_of(names[result.time])
