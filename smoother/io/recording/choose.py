"""Which streams of a file are meant and belong together: by option, else by name, else by motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any, TypedDict, Unpack

import numpy as np

from ...array_types import BoolArray, FloatArray, IntArray
from ...body import FURTHER, SEGMENTS, BodySegment
from ...errors import RecordingError
from ...linalg import runs
from ...recording import FOREARM_JOINTS, JOINTS, ImuStream, JointState, JointTracks
from ...runtime.store import by_rows
from ..mcap.messages import seconds
from .clean import clean_arm, clean_imu
from .streams import (
    ArmFrames,
    CameraStream,
    ImuSamples,
    PoseSamples,
    RecordingFile,
    is_named,
    is_of_other_arm,
    named_side,
    role_among,
    rows_of,
    words,
)

if TYPE_CHECKING:
    from ...matching import ImuMatch, Limb

#: A body that comes back within this time and distance is treated as the same one.
_AWAY_S = 30.0
_APART_M = 0.4
#: The shoulder moves least, so it is asked first; only the forearm's joints may have moved on while not seen.
_REACH_M = {
    JOINTS.index(joint): _APART_M + (0.4 if joint in FOREARM_JOINTS else 0.0)
    for joint in ("shoulder", "elbow", "wrist", "hand", "strap")
}


def join_bodies(arms: list[ArmFrames]) -> tuple[list[ArmFrames], list[str]]:
    """Join arms of one topic and side that are never seen together and take over where the other was lost."""
    joined: list[tuple[ArmFrames, set[int]]] = []  # with the numbers that each had so far
    notes = []
    for arm in sorted(arms, key=lambda arm: _first_and_last(arm)[0]):
        for place, (earlier, numbers) in enumerate(joined):
            if arm.body not in numbers and _goes_on(earlier, arm):
                merged = _merged(earlier, arm, arm.state != JointState.NOT_TRACKED)
                joined[place] = merged, numbers | {arm.body}
                why = "the camera lost the body and numbered it anew where it was; --body takes one alone."
                notes.append(f"{earlier.label} and body {arm.body} were joined: {why}")
                break
        else:
            joined.append((arm, {arm.body}))
    return [arm for arm, _ in joined], notes


def _merged(own: ArmFrames, other: ArmFrames, taken: BoolArray) -> ArmFrames:
    """An arm with another's joints where `taken` (F, 5)."""

    def either(here: BoolArray, its: FloatArray, mine: FloatArray) -> FloatArray:
        return np.asarray(np.where(here[:, :, None], its, mine))

    position = by_rows(either, taken, other.position, own.position)
    return replace(own, position=position, state=np.where(taken, other.state, own.state))


def _first_and_last(arm: ArmFrames) -> tuple[int, int]:
    """First and last frame in which anything of the arm is there; past the end for none."""
    there = np.flatnonzero((arm.state != JointState.NOT_TRACKED).any(axis=1))
    return (int(there[0]), int(there[-1])) if len(there) else (len(arm.stamp_ns), len(arm.stamp_ns))


def _goes_on(earlier: ArmFrames, later: ArmFrames) -> bool:
    """Whether it is the same arm of a body that is first seen when the other was lost, soon and near."""
    lost, back = _first_and_last(earlier)[1], _first_and_last(later)[0]
    if (earlier.topic, earlier.side) != (later.topic, later.side) or not lost < back < len(later.stamp_ns):
        return False
    if abs(int(later.stamp_ns[back]) - int(earlier.stamp_ns[lost])) / 1e9 > _AWAY_S:
        return False
    for joint, reach_m in _REACH_M.items():
        if earlier.state[lost, joint] and later.state[back, joint]:
            step = np.linalg.norm(later.position[back, joint] - earlier.position[lost, joint])
            return bool(step < reach_m)
    return False


#: Between two frames this close in time no person walks to where another stood.
_SOON_NS = 200_000_000
#: Both jump at least this far, m; what is left after exchanging is at most this share of the jumps.
_JUMP_M, _LEFT = 0.4, 0.35
_SHOULDER = JOINTS.index("shoulder")


def unswap_bodies(arms: list[ArmFrames]) -> tuple[list[ArmFrames], list[str]]:
    """Give bodies their numbers back where two of one topic exchanged them."""
    arms, notes = list(arms), []
    bodies: dict[tuple[str, int], dict[str, int]] = {}  # by side the arm's place in the list
    for place, arm in enumerate(arms):
        bodies.setdefault(arm.key[:2], {})[arm.side] = place
    for (first, own), (second, others) in combinations(sorted(bodies.items()), 2):
        if first[0] != second[0] or own.keys() != others.keys():
            continue
        swaps = _swaps([arms[k] for k in own.values()], [arms[k] for k in others.values()])
        if not len(swaps):
            continue
        stamp = arms[next(iter(own.values()))].stamp_ns
        exchanged = np.zeros(len(stamp), bool)
        for row in swaps:
            exchanged[row:] ^= True
        taken = np.repeat(exchanged[:, None], len(JOINTS), axis=1)
        for i, k in ((own[side], others[side]) for side in own):
            arms[i], arms[k] = _merged(arms[i], arms[k], taken), _merged(arms[k], arms[i], taken)
        seconds = [f"{(int(stamp[run.start]) - int(stamp[0])) / 1e9:.1f}" for run in runs(exchanged)]
        notes.append(
            f"Bodies {first[1]} and {second[1]} of {first[0]} exchange their numbers"
            f" {', '.join(seconds[:5])} s after the first frame (each jumps to where the other was); they"
            " were exchanged back."
        )
    return arms, notes


def _swaps(first: list[ArmFrames], second: list[ArmFrames]) -> IntArray:
    """Rows from which on the numbers are exchanged, or exchanged back: by the places of the shoulders."""
    if len({len(arm.stamp_ns) for arm in (*first, *second)}) != 1:
        return np.empty(0, np.int64)
    there = np.all([arm.state[:, _SHOULDER] != JointState.NOT_TRACKED for arm in (*first, *second)], axis=0)
    rows = np.flatnonzero(there)
    soon = np.diff(first[0].stamp_ns[rows]) <= _SOON_NS
    a, b = (np.mean([arm.position[rows, _SHOULDER] for arm in arms], axis=0) for arms in (first, second))

    def apart(now: FloatArray, before: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(now[1:] - before[:-1], axis=1))

    own_a, own_b = apart(a, a), apart(b, b)
    crossed = apart(a, b) + apart(b, a)
    jumps = soon & (np.minimum(own_a, own_b) > _JUMP_M) & (crossed < _LEFT * (own_a + own_b))
    # after one exchange the next one is seen in the numbers as they are then: every jump counts
    return np.asarray(rows[1:][jumps])


def people(file: RecordingFile) -> tuple[list[ArmFrames], list[str]]:
    """The arms of every person, each under one number."""
    arms, swapped = unswap_bodies(file.arms)
    arms, joined = join_bodies(arms)
    return arms, swapped + joined


#: Clocks may be this far apart, s; and where an assignment within that leaves open what is meant.
REACH_S, FAR_S = 5.0, 600.0


def match_streams(
    file: RecordingFile,
    imus: Sequence[ImuSamples],
    arms: Sequence[ArmFrames],
    *,
    method: str = "motion",
    reach_s: float = REACH_S,
    may_be: Callable[[int, Limb], bool] | None = None,
) -> tuple[list[ImuMatch], list[str]]:
    """Match some IMUs of a file to some of its arms, by motion alone."""
    from ...matching import limbs_of, match_imus  # SciPy: where it is used

    source = str(file.path)
    notes: list[str] = []
    stamps = [*(imu.stamp_ns for imu in imus), *(arm.stamp_ns for arm in arms)]
    origin = min((int(each[0]) for each in stamps if len(each)), default=0)
    limbs: list[Limb] = []
    for arm in (arm for arm in arms if arm.tracked):
        try:
            frames, dropped = clean_arm(arm, source)
        except RecordingError as error:
            notes.append(f"{arm.label} cannot be matched: {error}")
            continue
        notes += dropped
        t_s = seconds(frames.stamp_ns, origin)
        tracks = JointTracks(arm.topic, t_s, frames.position, frames.state)
        limbs += limbs_of(tracks, arm.body, arm.side, arm.topic)
    streams: list[ImuStream] = []
    for imu in imus:
        try:
            samples, dropped = clean_imu(imu, source)
        except RecordingError as error:
            # one broken sensor of a box does not keep the others from being matched
            samples, dropped = rows_of(imu, slice(0, 0)), [f"{imu.topic} cannot be matched: {error}"]
        notes += dropped
        streams.append(samples.on_axis(origin))
    allowed = None
    if may_be is not None:
        allowed = np.array([[may_be(i, limb) for limb in limbs] for i in range(len(streams))], bool)
    level_down = replace(file, arms=list(arms)).level_down
    try:
        matches = match_imus(streams, limbs, level_down, method, reach_s, allowed)
    except RecordingError as error:
        raise RecordingError(f"{source}: {error}.") from None
    start = min((float(limb.tracks.t_s[0]) for limb in limbs), default=0.0) - reach_s
    end = max((float(limb.tracks.t_s[-1]) for limb in limbs), default=0.0) + reach_s
    for stream, match in zip(streams, matches, strict=True):
        if len(stream) and (stream.t_s[0] > end or stream.t_s[-1] < start):
            notes.append(
                f"{stream.name} and the camera have no time in common, so it cannot be matched; set the"
                f" clocks to within {reach_s:g} s of each other."
            )
        elif len(stream) and not match.is_known:
            best = " or ".join(f"{where} ({p:.0%})" for where, p in match.others[:2])
            notes.append(
                f"{stream.name} may be on {best}: the motion does not settle it; record some seconds in which"
                " this limb moves and the others do something else."
            )
    return matches, notes


def match_file(
    file: RecordingFile,
    method: str = "motion",
    reach_s: float | None = None,
    skeleton: str | None = None,
) -> tuple[list[ImuMatch], list[str]]:
    """Settle which IMU of a file is on which body and limb, by motion alone; names are not asked."""
    if not file.imus:
        raise RecordingError(f"{file.path} has no IMU to match; record the IMUs as well.")
    arms = [arm for arm in file.arms if skeleton is None or is_named(skeleton, arm.topic, arm.frame_id)]
    if file.arms and not arms:
        topics = ", ".join(dict.fromkeys(arm.topic for arm in file.arms))
        raise RecordingError(f"{file.path}: no skeleton fits --skeleton {skeleton}; it has {topics}.")
    if not any(arm.tracked for arm in arms):
        raise RecordingError(
            f"{file.path} shows no arm to match IMUs to (no forearm joint is tracked); "
            "record again with the arms in view of the camera for some seconds."
        )
    arms, notes = people(replace(file, arms=arms))
    reach_s = REACH_S if reach_s is None else reach_s
    matches, more = match_streams(file, file.imus, arms, method=method, reach_s=reach_s)
    notes += more
    for imu, match in zip(file.imus, matches, strict=True):
        if match.limb is None or not match.is_sure:
            continue
        named, side = role_among(imu, file.imus), imu.side
        segment = "forearm" if match.limb.segment == "wrist" else match.limb.segment
        # a hand has no limb of its own to be matched to: the forearm's is the nearest
        other_limb = named not in ("", segment) and (named, segment) != ("hand", "forearm")
        if other_limb or (side and match.limb.side and side != match.limb.side):
            notes.append(
                f"{imu.topic} moves as {match.limb.label}, which its name contradicts; if it was mixed up, "
                f"name it in the recording or give --imu {imu.topic} with --side and --body."
            )
    return matches, notes


def further_cameras(file: RecordingFile) -> dict[str, CameraStream]:
    """A file's cameras beyond the first, by the topic of their skeleton."""
    topics = sorted({arm.topic for arm in file.arms if arm.tracked})
    if file.cameras:
        return {topic: camera for topic, camera in file.cameras.items() if topic in topics}
    frames = {arm.topic: arm.frame_id for arm in file.arms}
    if len(topics) < 2 or len({frames[topic] for topic in topics} - {""}) < len(topics):
        return {}
    seen = {topic: max(arm.tracked for arm in file.arms if arm.topic == topic) for topic in topics}
    flat = {arm.topic for arm in file.arms if arm.lens is not None}  # a camera with depth comes first
    first = min(topics, key=lambda topic: (topic in flat, -seen[topic], topic))
    kinds = {arm.topic: arm.camera_frame for arm in file.arms}
    return {topic: CameraStream(frames[topic], kinds[topic]) for topic in topics if topic != first}


def of_first_camera(file: RecordingFile, skeleton: str | None) -> tuple[RecordingFile, RecordingFile | None]:
    """A file without the skeletons of its further cameras, and one with these alone."""
    if skeleton is not None:
        return file, None
    cameras = further_cameras(file)
    if not cameras:  # keypoints beside the skeleton that was made of them: one camera is not two
        with_depth = [arm for arm in file.arms if arm.lens is None]
        return (replace(file, arms=with_depth) if any(arm.tracked for arm in with_depth) else file), None
    first = replace(file, arms=[arm for arm in file.arms if arm.topic not in cameras], cameras={})
    arms = [arm for arm in file.arms if arm.topic in cameras]
    return first, replace(file, arms=arms, cameras=cameras)


def same_arm(
    others: RecordingFile | None, arm: ArmFrames, imu: ImuSamples
) -> tuple[list[tuple[CameraStream, ArmFrames]], list[str]]:
    """What each further camera saw of an arm: the skeleton of its side, of several people by the motion."""
    if others is None:
        return [], []
    found, notes = [], []
    for topic, camera in others.cameras.items():
        own = replace(others, arms=[each for each in others.arms if each.topic == topic], cameras={})
        arms, said = people(own)
        notes += said
        candidates = [each for each in arms if each.side == arm.side and each.tracked]
        if not candidates:
            notes.append(f"{camera.name} ({topic}) shows no {arm.side or 'such'} arm and was left out.")
            continue
        if len(candidates) > 1:
            with suppress(RecordingError):  # too short to match
                (match,), _ = match_streams(own, [imu], candidates, reach_s=FAR_S)
                candidates = [each for each in candidates if match.limb is None or each.key == match.limb.arm]
        found.append((camera, candidates[0]))
        notes.append(f"{camera.name}: skeleton {found[-1][1].label} was taken as a further camera's.")
    return found, notes


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
            f"{half.topic} ({'gyroscope' if half.acc is None else 'accelerometer'})" for half in file.halves
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
    sure = [imu for imu, named in roles if named == "forearm" or (named == "" and imu.side)]
    return candidates if of_several else sure or candidates


def _topics(imus: Sequence[ImuSamples]) -> str:
    return ", ".join(stream.topic for stream in imus)


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
    fitting = [imu for imu in named if side and imu.side == side]
    if not fitting and not any(imu.role in ("", "forearm") for imu in others):  # there is one arm alone
        fitting = [imu for imu in named if not imu.side] or ([] if side else named)
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
            worn, seen = {imu.side for imu in imus}, {arm.side for arm in arms}
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
    base = next((i for i in file.imus if i is not imu and i.role == "base"), None)
    truth, more = choose_truth(file, side, body)
    notes, further = [*notes, *choice.notes, *more], dict(choice.further)
    for segment in FURTHER:
        if segment.name not in further and body is None:
            named, more = _further_by_name(file, imu, side, segment)
            notes += more
            further |= {} if named is None else {segment.name: named}
    if imu.role == "hand":
        notes.append(
            f"IMU {imu.topic} is named after the hand and used as the forearm's: where the wrist"
            " bends, the result is off by centimetres. Wear one on the forearm too."
        )
    cameras, more = same_arm(others, choice.arm, imu)
    return replace(choice, base=base, truth=truth, notes=notes + more, further=further, cameras=cameras)


def _one_arm(file: RecordingFile, prefer_side: str | None, selection: Selection) -> StreamChoice:
    side = selection.get("side")
    arms, imus = _wanted_arms(file, selection), _forearm_imus(file, selection.get("imu"))
    pairs = [(i, a) for i in imus for a in arms if _agree(i.side, a.side, side)]
    if not pairs:
        raise RecordingError(f"{file.path}: no IMU is on an arm that the skeleton shows; {_what_else(file)}.")
    if prefer_side and not side:
        pairs = [(i, a) for i, a in pairs if (a.side or i.side) in (prefer_side, "")] or pairs
    said = []
    imu, arm = pairs[0]
    if len(pairs) > 1:
        (imu, arm), why = _pair_by_motion(file, pairs)
        said = [f"Of {_listing(file)}, IMU {imu.topic} and {arm.label} were taken: {why}."]
    elif len(file.imus) > 1 or len(file.arms) > 1:
        said = [f"IMU {imu.topic} and skeleton {arm.label} were taken."]
    return StreamChoice(imu, arm, arm.side or imu.side or side or "", notes=said)


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
        worn_as_named = limb.segment == "wrist" or imus[row].role != "forearm"
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
    imus = [imu for imu in file.imus if imu.role not in ("base", "trunk")]

    def may_be(row: int, limb: Limb) -> bool:
        named = role_among(imus[row], imus)
        segment = {"": limb.segment, "forearm": "wrist"}.get(named, named)
        return limb.segment == segment and _agree(imus[row].side, limb.side, side)

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
