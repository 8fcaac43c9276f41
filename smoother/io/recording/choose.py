"""Which streams of a file are meant and belong together: by option, else by name, else by motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

from ...body import FURTHER, SEGMENTS, BodySegment
from ...errors import RecordingError
from .bodies import people
from .camera_streams import of_first_camera, same_arm
from .names import is_named, is_of_other_arm, named_side, role, role_among, words
from .streams import ArmFrames, CameraStream, ImuSamples, PoseSamples, RecordingFile

if TYPE_CHECKING:
    from ...matching import ImuMatch, Limb


class Selection(TypedDict, total=False):
    """What to take of a file that contains several: keywords that readers hand on to `choose`."""

    imu: str | None  # Topic (or a part of it, or its frame_id)
    skeleton: str | None  # Topic (or a part of it, or its frame_id)
    side: str | None  # "left" or "right"
    body: int | None  # The camera's number of the body


class FileReading(Selection, total=False):
    """How a file is read, and what of it: keywords that are handed on to `read_recording`."""

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


def topics_of(file: RecordingFile) -> str:
    """What a file contains, for messages."""
    listed = [f"{topic.name} ({topic.schema or 'no schema'})" for topic in file.topics if topic.count]
    if len(listed) > 8:
        listed = [*listed[:8], f"and {len(listed) - 8} more"]
    return ", ".join(listed) if listed else "no messages"


def choose_imu(file: RecordingFile, name: str | None = None) -> ImuSamples:
    """The IMU of that name, of whatever limb, or the only one that there is."""
    if name is None and len(file.imus) > 1:
        raise RecordingError(f"{file.path} has several IMUs ({_topics(file.imus)}); choose one with --imu.")
    return file.imus[0] if name is None and file.imus else _forearm_imus(file, name)[0]


def _forearm_imus(file: RecordingFile, name: str | None, of_several: bool = False) -> list[ImuSamples]:
    """The IMU of that name, or all that may be on a forearm by their names; of several people all unnamed."""
    if not file.imus:
        alone = ", ".join(
            f"{half.name} ({'gyroscope' if half.acc is None else 'accelerometer'})" for half in file.halves
        )
        raise RecordingError(
            f"{file.path} has no IMU with both sensors, but {alone} alone; record the other one as well."
            if alone
            else f"{file.path} has no IMU (sensor_msgs/Imu or unocclude.Imu); it has {topics_of(file)}; "
            "record the wrist's IMU as well."
        )
    if name is not None:
        wanted = name.strip("/")
        exact = [s for s in file.imus if wanted in (topic.strip("/") for topic in (s.topic, *s.made_of))]
        matches = exact or [s for s in file.imus if is_named(name, s.topic, s.frame_id)]
        if len(matches) != 1:
            what = "more than one IMU fits" if matches else "no IMU fits"
            raise RecordingError(
                f"{file.path}: {what} --imu {name}; give one of {_topics(matches or file.imus)}, or --side."
            )
        return matches
    roles = [(imu, role_among(imu, file.imus)) for imu in file.imus]
    candidates = [imu for imu, named in roles if named in ("", "forearm")]
    if not candidates:
        raise RecordingError(
            f"{file.path}: no IMU is named as one of a forearm; it has {_topics(file.imus)}; choose with"
            " --imu."
        )
    sure = [imu for imu, named in roles if named == "forearm" or (named == "" and _worn_on(imu))]
    return candidates if of_several else sure or candidates


def _topics(imus: Sequence[ImuSamples]) -> str:
    return ", ".join(stream.topic for stream in imus)


def _worn_on(imu: ImuSamples) -> str:
    return named_side(imu.topic, imu.frame_id)


_TRUTH_WORDS = ("truth", "mocap", "reference", "optical", "vicon", "optitrack", "qualisys")


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
            topics = ", ".join(p.topic for p in file.poses)
            return None, [f"Of the poses {topics} none is named as this arm's truth; none was taken."]
    return (poses[0], []) if poses else (None, [])


def _further_by_name(
    file: RecordingFile, forearm: ImuSamples, side: str, segment: BodySegment
) -> tuple[ImuSamples | None, list[str]]:
    """The IMU that names say is on a segment of the same arm, or None, and a sentence on it."""
    others = [imu for imu in file.imus if imu is not forearm]
    named = [imu for imu in others if role_among(imu, file.imus) == segment.name]
    fitting = [imu for imu in named if side and _worn_on(imu) == side]
    if not fitting and not any(role(imu) in ("", "forearm") for imu in others):  # there is one arm alone
        fitting = [imu for imu in named if not _worn_on(imu)] or ([] if side else named)
    if len(fitting) == 1:
        return fitting[0], [f"IMU {fitting[0].topic} is on the same arm's {segment.label} by its name."]
    if fitting:
        what = f"Of the {segment.label.replace(' ', '-')} IMUs {_topics(fitting)} none was taken"
        return None, [f"{what}: their names do not show which is meant."]
    return None, []


def _wanted_arms(file: RecordingFile, selection: Selection) -> list[ArmFrames]:
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
    skeleton, side, body = (selection.get(name) for name in ("skeleton", "side", "body"))
    fitting = [
        arm
        for arm in seen
        if (skeleton is None or is_named(str(skeleton), arm.topic, arm.frame_id))
        and (not side or arm.side in (side, ""))
        and (body is None or arm.body == body)
    ]
    if not fitting:
        given = {name: value for name, value in selection.items() if name != "imu" and value is not None}
        wanted = " ".join(f"--{name} {value}" for name, value in given.items())
        raise RecordingError(f"{file.path}: no tracked arm fits {wanted}; {_what_else(file)}.")
    return fitting


def _listing(file: RecordingFile) -> str:
    arms = ", ".join(arm.label for arm in file.arms if arm.tracked)
    return f"IMU {_topics(file.imus)} and skeleton {arms}"


def _what_else(file: RecordingFile) -> str:
    """What a file has, and what to give where the options, or names, exclude each other."""
    return (
        f"it has {_listing(file)}; choose with --imu, --skeleton, --side or --body, or exchange the"
        " skeleton's arms with --swap left,right"
    )


#: An arm is taken by motion alone where its IMU is on it with this probability.
_TAKEN_FROM = 0.8
_SIDES = ("left", "right")


def choose_arms(
    file: RecordingFile,
    *,
    prefer_side: str | None = None,
    alone: bool = False,
    **selection: Unpack[Selection],
) -> tuple[list[StreamChoice], list[str]]:
    """Settle which IMUs and arms belong together, in order of body and side, and why an arm is left out.

    By option, else by name, else by motion; `alone` settles the one arm that is meant.
    """
    file, others = of_first_camera(file, selection.get("skeleton"))
    notes: list[str] = []
    if selection.get("body") is None:
        arms, notes = people(file)
        file = replace(file, arms=arms)
    chosen: list[StreamChoice] = []
    errors: dict[str, RecordingError] = {}
    sides: list[str | None] = [selection.get("side")]
    if not alone and selection.get("imu") is None:
        arms = _wanted_arms(file, selection)
        of_several = len({arm.key[:2] for arm in arms}) > 1
        imus = _forearm_imus(file, None, of_several)
        if len(imus) > 1 and len(arms) > 1:
            worn, seen = {_worn_on(imu) for imu in imus}, {arm.side for arm in arms}
            if not of_several and worn == seen == set(_SIDES):  # one person, and names that show all
                prefer_side, sides = None, list(_SIDES)
            elif len(by_motion := _by_motion(file, arms, sides[0])) > 1:
                chosen, sides = by_motion, []
    for side in sides:
        try:
            chosen.append(_one_arm(file, prefer_side, {**selection, "side": side}))
        except RecordingError as error:
            errors[str(side)] = error
    if not chosen:
        raise next(iter(errors.values()))
    left_out = [left_out_words(f"{side} arm", error) for side, error in errors.items()]
    return [_completed(one, file, others, notes) for one in chosen], left_out


def _completed(
    choice: StreamChoice, file: RecordingFile, others: RecordingFile | None, notes: list[str]
) -> StreamChoice:
    """A pair with all that belongs to it."""
    imu, side, body = choice.imu, choice.side, choice.body
    base = next((i for i in file.imus if i is not imu and role(i) == "base"), None)
    truth, more = choose_truth(file, side, body)
    notes, further = [*notes, *choice.notes, *more], dict(choice.further)
    for segment in FURTHER:
        if segment.name not in further and body is None:
            named, more = _further_by_name(file, imu, side, segment)
            notes += more
            further |= {} if named is None else {segment.name: named}
    if role(imu) == "hand":
        notes.append(
            f"IMU {imu.topic} is named after the hand and used as the forearm's: where the wrist"
            " bends, the result is off by centimetres. Wear one on the forearm too."
        )
    cameras, more = same_arm(others, choice.arm, imu)
    return replace(choice, base=base, truth=truth, notes=notes + more, further=further, cameras=cameras)


def _one_arm(file: RecordingFile, prefer_side: str | None, selection: Selection) -> StreamChoice:
    side = selection.get("side")
    arms, imus = _wanted_arms(file, selection), _forearm_imus(file, selection.get("imu"))
    pairs = [(i, a) for i in imus for a in arms if _agree(_worn_on(i), a.side, side)]
    if not pairs:
        raise RecordingError(f"{file.path}: no IMU is on an arm that the skeleton shows; {_what_else(file)}.")
    if prefer_side and not side:
        pairs = [(i, a) for i, a in pairs if (a.side or _worn_on(i)) in (prefer_side, "")] or pairs
    said = []
    imu, arm = pairs[0]
    if len(pairs) > 1:
        (imu, arm), why = _pair_by_motion(file, pairs)
        said = [f"Of {_listing(file)}, IMU {imu.topic} and {arm.label} were taken: {why}."]
    elif len(file.imus) > 1 or len(file.arms) > 1:
        said = [f"IMU {imu.topic} and skeleton {arm.label} were taken."]
    return StreamChoice(imu, arm, arm.side or _worn_on(imu) or side or "", notes=said)


def _agree(*sides: str | None) -> bool:
    """Whether sides, as far as they are known, are one."""
    return len({*sides} - {"", None}) <= 1


def left_out_words(arm: str, error: Exception) -> str:
    """That an arm is not among the results, and why."""
    return f"The {arm} was left out: {error}"


def _assigned(
    file: RecordingFile,
    imus: list[ImuSamples],
    arms: list[ArmFrames],
    may_be: Callable[[int, Limb], bool],
    is_far: bool = False,
) -> tuple[list[ImuMatch], list[str]]:
    """One assignment of these IMUs to all limbs of these arms; none where streams cannot be used."""
    from .match import FAR_S, REACH_S, match_streams  # SciPy: where it is used

    try:
        return match_streams(file, imus, arms, may_be=may_be, reach_s=FAR_S if is_far else REACH_S)
    except RecordingError:
        return [], []  # what cannot be used is said when it is read, if it is what is meant


Pair = tuple[ImuSamples, ArmFrames]


def _pair_by_motion(file: RecordingFile, pairs: Sequence[Pair]) -> tuple[Pair, str]:
    """The pair that moves together by one assignment of all: with clocks that agree nearly, or not at all."""
    imus = list({id(imu): imu for imu, _ in pairs}.values())
    arms = list({id(arm): arm for _, arm in pairs}.values())
    pair_of = {(imu.topic, *arm.key): (imu, arm) for imu, arm in pairs}

    def may_be(row: int, limb: Limb) -> bool:
        worn_as_named = limb.segment == "wrist" or role(imus[row]) != "forearm"
        return worn_as_named and (imus[row].topic, *limb.arm) in pair_of

    for is_far in (False, True):
        found = [(m, m.limb) for m in _assigned(file, imus, arms, may_be, is_far)[0] if m.limb is not None]
        matched = [(m, pair_of[m.imu, *limb.arm]) for m, limb in found if limb.segment == "wrist"]
        if len(matched) == 1:
            ((match, pair),) = matched
            apart = f", with the clocks {abs(match.clock_offset_s):.1f} s apart" if is_far else ""
            sure = f"probability {match.probability:.2f} among all limbs in view"
            return pair, f"their motion agrees best{apart} ({sure})"
        if matched:
            break
    elsewhere = {m.imu: limb.label for m, limb in found if limb.segment != "wrist" and m.is_sure}
    if all(imu.topic in elsewhere for imu, _ in pairs):
        where = ", ".join(f"{name} as {label}" for name, label in elsewhere.items())
        raise RecordingError(
            f"{file.path}: no IMU moves as a forearm that the camera shows ({where}); "
            "choose with --imu and --side if one is on a forearm."
        )
    kinds: dict[str, set[Any]] = {
        "--imu": {imu.topic for imu, _ in pairs},
        "--skeleton": {arm.topic for _, arm in pairs},
        "--side": {arm.side for _, arm in pairs},
        "--body": {arm.key[:2] for _, arm in pairs},
    }
    needed = " and ".join(option for option, values in kinds.items() if len(values) > 1)
    moves = ", ".join(f"{m.imu} moves as {limb.label}" for m, limb in found)
    shows = moves if matched else "their motion does not show which belong together"
    raise RecordingError(
        f"{file.path} has {_listing(file)}; one arm is wanted here, and {shows}; choose with {needed}."
    )


def _by_motion(file: RecordingFile, arms: Sequence[ArmFrames], side: str | None) -> list[StreamChoice]:
    """A choice for every arm on whose forearm an IMU is, by one assignment of all IMUs to all limbs."""
    imus = [imu for imu in file.imus if role(imu) not in ("base", "trunk")]

    def may_be(row: int, limb: Limb) -> bool:
        named = role_among(imus[row], imus)
        segment = {"": limb.segment, "forearm": "wrist"}.get(named, named)
        return limb.segment == segment and _agree(_worn_on(imus[row]), limb.side, side)

    matches, open_notes = _assigned(file, imus, list(arms), may_be)
    on_arm: dict[tuple[str, int, str], dict[str, tuple[ImuSamples, float]]] = {}
    for imu, match in zip(imus, matches, strict=False):
        if (limb := match.limb) is not None and match.probability >= _TAKEN_FROM:
            on_arm.setdefault(limb.arm, {})[limb.segment] = imu, match.probability
    worn = [arm for arm in sorted(arms, key=lambda arm: arm.key) if "wrist" in on_arm.get(arm.key, {})]
    several = len({arm.key[:2] for arm in worn}) > 1
    choices = []
    for arm in worn:
        found = on_arm[arm.key]
        imu, sure = found["wrist"]
        taken = f"IMU {imu.topic} and {arm.label} were taken: their motion agrees best (probability"
        notes = [*open_notes, f"{taken} {sure:.2f} among all limbs in view)."]
        further = {each.name: found[each.name] for each in FURTHER if each.name in found}
        for name, (stream, sure) in further.items():
            where = f"the same arm's {SEGMENTS[name].label} by its motion (probability {sure:.2f})"
            notes.append(f"IMU {stream.topic} is on {where}.")
        streams = {name: stream for name, (stream, _) in further.items()}
        body = arm.body if several else None
        choices.append(StreamChoice(imu, arm, arm.side, notes=notes, further=streams, body=body))
    used = {stream.topic for one in choices for stream in (one.imu, *one.further.values())}
    unused = [_unused(match) for match in matches if match.imu not in used]
    return [replace(one, notes=[*one.notes, *filter(None, unused)]) for one in choices]


def _unused(match: ImuMatch) -> str:
    """What is said of an IMU that belongs to no arm that is recovered; one left open is said already."""
    where, how_sure = match.limb, f"(probability {match.probability:.2f})"
    if where is None:
        return f"IMU {match.imu} is on no limb in view {how_sure}." if match.is_known else ""
    if where.segment != "wrist":
        return f"IMU {match.imu} is on {where.label} {how_sure} and not used: that forearm has none."
    return (
        f"IMU {match.imu} may be on {where.label} {how_sure}, too doubtful to recover that arm; if it is,"
        f" give --imu {match.imu}."
    )
