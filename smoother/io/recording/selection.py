"""Which streams of a file are meant, by options and by their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, TypedDict

from ...body import BodySegment
from ...errors import RecordingError
from .streams import ArmFrames, CameraStream, ImuSamples, PoseSamples, RecordingFile

if TYPE_CHECKING:
    from ...runtime.store import Store


class Selection(TypedDict, total=False):
    """What to take of a file that contains several: keywords that readers hand on to `choose`."""

    imu: str | None  # Topic (or a part of it, or its frame_id)
    skeleton: str | None  # Topic (or a part of it, or its frame_id)
    side: str | None  # "left" or "right"
    body: int | None  # The camera's number of the body


class FileReading(Selection, total=False):
    """How a file is read, and what of it: keywords that are handed on to `read_recording`."""

    store: Store | None  # Where samples and frames are to lie
    truth: bool  # False passes over the reference motion
    swap_sides: bool  # The skeleton's left arm is the right one, and the other way round


@dataclass
class StreamChoice:
    """What is to be used of a file."""

    imu: ImuSamples  # On the forearm
    arm: ArmFrames  # The arm that it is on
    side: str  # "left", "right" or ""
    base: ImuSamples | None = None  # The IMU on the camera
    truth: PoseSamples | None = None  # The reference motion
    notes: list[str] = field(default_factory=list)  # How it was decided, one sentence each
    # The IMUs on the same arm's further segments, by the segment's name
    further: dict[str, ImuSamples] = field(default_factory=dict)
    body: int | None = None  # The camera's number of the person, where arms of several were chosen
    # Further cameras, and what each saw of the arm
    cameras: list[tuple[CameraStream, ArmFrames]] = field(default_factory=list)


OTHER_SIDE = {"left": "right", "right": "left"}
_FOREARM_WORDS = ("forearm", "wrist", "lower_arm", "watch")
_HAND_WORDS = ("hand", "palm", "metacarp")
_BASE_WORDS = ("base", "camera", "kinect", "k4a", "azure", "depth", "realsense")
_TRUNK_WORDS = ("trunk", "sternum", "chest", "torso", "thorax")


def role(stream: ImuSamples) -> str:
    """The segment by a stream's names: "forearm", "upper_arm", "hand", "trunk", "base" or ""."""
    for name in (words(stream.topic), words(stream.frame_id)):
        if any(word in name for word in _TRUNK_WORDS):
            return "trunk"
        if "upper" in name:
            return "upper_arm"
        if any(word in name for word in _FOREARM_WORDS):
            return "forearm"
        if any(word in name for word in _HAND_WORDS):
            return "hand"
        if "arm" in name:
            return "forearm"
        if any(word in name for word in _BASE_WORDS):
            return "base"
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


def topics_of(file: RecordingFile) -> str:
    """What a file contains, for messages."""
    listed = [f"{topic.name} ({topic.schema or 'no schema'})" for topic in file.topics if topic.count]
    if len(listed) > 8:
        listed = [*listed[:8], f"and {len(listed) - 8} more"]
    return ", ".join(listed) if listed else "no messages"


def choose_imu(file: RecordingFile, name: str | None = None) -> ImuSamples:
    """The IMU of that name, of whatever limb, or the only one that there is."""
    if name is None and len(file.imus) > 1:
        listed = ", ".join(stream.topic for stream in file.imus)
        raise RecordingError(f"{file.path} has several IMUs ({listed}); choose one with --imu.")
    if name is None and len(file.imus) == 1:
        return file.imus[0]
    return forearm_imus(file, name)[0]


def forearm_imus(file: RecordingFile, name: str | None) -> list[ImuSamples]:
    """The IMU of that name, or all that may be on a forearm by their names."""
    if not file.imus and file.halves:
        alone = ", ".join(
            f"{half.name} ({'gyroscope' if half.acc is None else 'accelerometer'})" for half in file.halves
        )
        raise RecordingError(
            f"{file.path} has no IMU with both sensors, but {alone} alone; record the other one as well."
        )
    if not file.imus:
        raise RecordingError(
            f"{file.path} has no IMU (sensor_msgs/Imu or unocclude.Imu); it has {topics_of(file)}; "
            "record the wrist's IMU as well."
        )
    listed = ", ".join(stream.topic for stream in file.imus)
    if name is not None:
        wanted = name.strip("/")
        exact = [s for s in file.imus if wanted in (topic.strip("/") for topic in (s.topic, *s.made_of))]
        matches = exact or [s for s in file.imus if is_named(name, s.topic, s.frame_id)]
        if len(matches) != 1:
            what = "more than one IMU fits" if matches else "no IMU fits"
            raise RecordingError(
                f"{file.path}: {what} --imu {name}; it has {listed}{_what_fits(name, matches, file.imus)}."
            )
        return matches
    candidates = [stream for stream in file.imus if role_among(stream, file.imus) in ("", "forearm")]
    if not candidates:
        raise RecordingError(
            f"{file.path}: no IMU is named as one of a forearm; it has {listed}; choose with --imu."
        )
    named = [
        s for s in candidates if role_among(s, file.imus) == "forearm" or named_side(s.topic, s.frame_id)
    ]
    return named or candidates


def _what_fits(name: str, matches: list[ImuSamples], imus: list[ImuSamples]) -> str:
    """What to give instead of a name that fits none or several IMUs, for the end of a sentence."""
    forearms = [stream for stream in matches if role(stream) in ("", "forearm")]
    if len(forearms) == 1:
        return f"; for the one on the forearm give --imu {forearms[0].topic}"
    side = named_side(name)
    may_be = any(named_side(stream.topic, stream.frame_id) in (side, "") for stream in imus)
    return f"; for the {side} arm give --side {side}" if side and may_be else ""


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


_ONLY_ONE_ARM = (
    "the skeleton shows the {} arm only: give --swap left,right if the camera's program exchanged the two"
)


def choose_further(
    file: RecordingFile, forearm: ImuSamples, side: str, segment: BodySegment
) -> tuple[ImuSamples | None, list[str]]:
    """The IMU that names say is on a segment of the same arm, or None, and a sentence on it."""
    named = [imu for imu in file.imus if imu is not forearm and role_among(imu, file.imus) == segment.name]
    sided = [imu for imu in named if side and named_side(imu.topic, imu.frame_id) == side]
    other_forearms = [i for i in file.imus if i is not forearm and role(i) in ("", "forearm")]
    free = [imu for imu in named if not named_side(imu.topic, imu.frame_id)]
    fitting = sided or ([] if other_forearms else free)
    if not side and not fitting and not other_forearms:
        fitting = named
    if len(fitting) == 1:
        return fitting[0], [f"IMU {fitting[0].topic} is on the same arm's {segment.label} by its name."]
    if len(fitting) > 1:
        names = ", ".join(imu.topic for imu in fitting)
        return None, [
            f"Of the {segment.label.replace(' ', '-')} IMUs {names} none was taken: their names do not show"
            " which is meant."
        ]
    return None, []


def wanted_arms(
    file: RecordingFile, skeleton: str | None, side: str | None, body: int | None
) -> list[ArmFrames]:
    """The tracked arms that fit what was asked for."""
    if not file.arms and not file.frames_without_body:
        if any(name.partition("/")[0] == "unocclude.result" for name in file.metadata):
            raise RecordingError(f"{file.path} is a result; name the recording that it was made from.")
        raise RecordingError(
            f"{file.path} has no skeleton (unocclude.Skeleton, or MarkerArray of the Azure Kinect driver); "
            f"it has {topics_of(file)}; record the body tracking as well."
        )
    seen = [arm for arm in file.arms if arm.tracked]
    if not seen:
        frames = max((len(arm.stamp_ns) for arm in file.arms), default=file.frames_without_body)
        raise RecordingError(
            f"{file.path} has {frames} skeleton frames and no forearm joint is tracked in any of them; "
            "record again with the arm in view of the camera for some seconds."
        )
    fitting = [
        arm
        for arm in seen
        if (skeleton is None or is_named(skeleton, arm.topic, arm.frame_id))
        and (not side or arm.side in (side, ""))
        and (body is None or arm.body == body)
    ]
    if not fitting:
        wanted = [
            f"--{name} {value}"
            for name, value in (("skeleton", skeleton), ("side", side), ("body", body))
            if value is not None
        ]
        raise RecordingError(
            f"{file.path}: no tracked arm fits {' '.join(wanted)}; it has "
            f"{', '.join(arm.label for arm in seen)}{_what_arm_fits(seen, skeleton, side)}."
        )
    return fitting


def _what_arm_fits(seen: list[ArmFrames], skeleton: str | None, side: str | None) -> str:
    """What to give instead of options that no arm fits, for the end of a sentence."""
    named = named_side(skeleton or "")
    if named and not side and any(arm.side == named for arm in seen):
        return f"; a topic may contain both arms: for the {named} one give --side {named}"
    sides = {arm.side for arm in seen}
    if side and sides == {OTHER_SIDE[side]}:
        return f"; {_ONLY_ONE_ARM.format(OTHER_SIDE[side])}"
    return ""


def why_no_pair(imus: list[ImuSamples], arms: list[ArmFrames], side: str | None) -> str:
    """Why no IMU may be on an arm of that side, and what to do, for the end of a sentence."""
    worn = {named_side(imu.topic, imu.frame_id) for imu in imus}
    if len(worn) != 1 or not (named := worn.pop()):
        return "choose with --imu, --skeleton, --side or --body"
    other, topic = OTHER_SIDE[named], imus[0].topic
    if {arm.side for arm in arms if arm.tracked} == {other}:
        return (
            f"{topic} is on the {named} arm by its name, and {_ONLY_ONE_ARM.format(other)}; if the IMU was"
            f" worn on the {other} arm, import it again as forearm_{other}"
        )
    if side == other:
        return (
            f"{topic} is on the {named} arm by its name: leave --side out, or give --side {named}; if it was"
            f" worn on the {other} arm, import it again as forearm_{other}"
        )
    return "choose with --imu, --skeleton, --side or --body"
