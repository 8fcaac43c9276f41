"""Which IMU and which arm of a file belong together."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from ...errors import RecordingError
from ...recording import JOINTS, FloatArray, ImuStream, IntArray, JointState, JointTracks
from ...runtime.column import batches
from ...runtime.store import Store
from ...selfcal.coarse_clock import shifted_agreement
from .bodies import join_bodies
from .streams import ArmFrames, ImuSamples, PoseSamples, RecordingFile

if TYPE_CHECKING:
    from ...matching import ImuMatch, Limb

_FOREARM_WORDS = ("forearm", "wrist", "lower_arm", "hand", "watch", "arm")
_BASE_WORDS = ("base", "camera", "kinect", "k4a", "azure", "depth", "realsense")
_TRUNK_WORDS = ("trunk", "sternum", "chest", "torso", "thorax")
_TRUTH_WORDS = ("truth", "mocap", "reference", "optical", "vicon", "optitrack", "qualisys")
#: Correlation that a pair must reach, and its lead over the next, to be taken by motion alone.
_ENOUGH, _LEAD = 0.4, 0.1
_MOTION_S = 0.3
_LAG_S = 1.0
#: Clocks may be this far apart, s; the correlation of a pair must then reach this.
_FAR_S = 600.0
_ENOUGH_SHIFTED = 0.6
_MOTION_FRAMES = 20_000
#: Where no two joints tell a direction, the one seen most; of equals the first.
_POINTS = ("wrist", "strap", "hand", "elbow")


class Selection(TypedDict, total=False):
    """What to take of a file that holds several: keywords that readers hand on to `choose`.

    Attributes
    ----------
    imu, skeleton : str, optional
        Topic (or a part of it, or its frame_id).
    side : str, optional
        "left" or "right".
    body : int, optional
        The camera's number of the body.
    """

    imu: str | None
    skeleton: str | None
    side: str | None
    body: int | None


@dataclass
class StreamChoice:
    """What is to be used of a file.

    Attributes
    ----------
    imu : ImuSamples
        On the forearm.
    arm : ArmFrames
        The arm that it is on.
    side : str
        "left", "right" or "".
    base : ImuSamples, optional
        The IMU on the camera.
    truth : PoseSamples, optional
        The reference motion.
    notes : list of str
        How it was decided, one sentence each.
    upper : ImuSamples, optional
        The IMU on the same arm's upper arm.
    """

    imu: ImuSamples
    arm: ArmFrames
    side: str
    base: ImuSamples | None = None
    truth: PoseSamples | None = None
    notes: list[str] = field(default_factory=list)
    upper: ImuSamples | None = None


def role(stream: ImuSamples) -> str:
    """What a stream's names say it is on: "forearm", "upper_arm", "trunk", "base" or ""."""
    for words in (_words(stream.topic), _words(stream.frame_id)):
        if any(word in words for word in _TRUNK_WORDS):
            return "trunk"
        if "upper" in words:
            return "upper_arm"
        if any(word in words for word in _FOREARM_WORDS):
            return "forearm"
        if any(word in words for word in _BASE_WORDS):
            return "base"
    return ""


def named_side(*names: str) -> str:
    """The side that names speak of: "left", "right" or ""."""
    for name in names:
        words = _words(name)
        left, right = "left" in words, "right" in words
        if left != right:
            return "left" if left else "right"
    return ""


def choose(
    file: RecordingFile,
    *,
    imu: str | None = None,
    skeleton: str | None = None,
    side: str | None = None,
    body: int | None = None,
    prefer_side: str | None = None,
    store: Store | None = None,
) -> StreamChoice:
    """Settle which IMU and arm are meant: by option, else by name, else by motion.

    Parameters
    ----------
    file : RecordingFile
        All streams.
    imu, skeleton, side, prefer_side : str, optional
    body : int, optional
        As in `read_recording`.
    store : Store, optional
        Where joined arms are to lie; in memory if None.

    Returns
    -------
    StreamChoice
        With a sentence for each decision.

    Raises
    ------
    RecordingError
        Nothing fits, or more than one pair does; the message lists what the file has.
    """
    notes: list[str] = []
    if body is None:
        arms, notes = join_bodies(file.arms, store)
        file = replace(file, arms=arms)
    arms = _arms(file, skeleton, side, body)
    imus = _imus(file, imu)
    pairs = [(i, a) for i in imus for a in arms if _may_match(i, a, side)]
    if not pairs:
        raise RecordingError(
            f"{file.path}: no IMU is on an arm that the skeleton shows; it has {_listing(file)}; "
            "choose with --imu, --skeleton, --side or --body."
        )
    if prefer_side and not side:
        preferred = [(i, a) for i, a in pairs if _side(i, a) in (prefer_side, "")]
        pairs = preferred or pairs
    if len(pairs) > 1:
        pair, why = _by_motion(file, pairs, store)
        notes.append(f"Of {_listing(file)}, IMU {pair[0].topic} and {pair[1].label} were taken: {why}.")
    else:
        pair = pairs[0]
        if len(file.imus) > 1 or len(file.arms) > 1:
            notes.append(f"IMU {pair[0].topic} and skeleton {pair[1].label} were taken.")
    chosen_side = _side(*pair) or side or ""
    base = next((i for i in file.imus if i is not pair[0] and role(i) == "base"), None)
    truth, truth_notes = choose_truth(file, chosen_side)
    upper, upper_notes = choose_upper(file, pair[0], chosen_side)
    more = truth_notes + upper_notes
    return StreamChoice(pair[0], pair[1], chosen_side, base, truth, notes + more, upper)


def choose_upper(file: RecordingFile, forearm: ImuSamples, side: str) -> tuple[ImuSamples | None, list[str]]:
    """The IMU that names say is on the same upper arm, or None, and a sentence on it.

    One without a side in its name counts as on the arm of the only forearm IMU.
    """
    uppers = [imu for imu in file.imus if imu is not forearm and role(imu) == "upper_arm"]
    sided = [imu for imu in uppers if side and named_side(imu.topic, imu.frame_id) == side]
    other_forearms = [i for i in file.imus if i is not forearm and role(i) in ("", "forearm")]
    free = [imu for imu in uppers if not named_side(imu.topic, imu.frame_id)]
    fitting = sided or ([] if other_forearms else free)
    if not side and not fitting and not other_forearms:
        fitting = uppers
    if len(fitting) == 1:
        return fitting[0], [f"IMU {fitting[0].topic} is on the same arm's upper arm by its name."]
    if len(fitting) > 1:
        names = ", ".join(imu.topic for imu in fitting)
        return None, [
            f"Of the upper-arm IMUs {names} none was taken: their names do not tell which is meant."
        ]
    return None, []


def _arms(file: RecordingFile, skeleton: str | None, side: str | None, body: int | None) -> list[ArmFrames]:
    if not file.arms and not file.frames_without_body:
        raise RecordingError(
            f"{file.path} has no skeleton (unocclude.Skeleton, or MarkerArray of the Azure Kinect driver); "
            f"it has {_topics(file)}; record the body tracking as well."
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
        asked = [
            f"--{name} {value}"
            for name, value in (("skeleton", skeleton), ("side", side), ("body", body))
            if value is not None
        ]
        raise RecordingError(
            f"{file.path}: no tracked arm fits {' '.join(asked)}; it has "
            f"{', '.join(arm.label for arm in seen)}."
        )
    return fitting


def choose_imu(file: RecordingFile, name: str | None = None) -> ImuSamples:
    """The IMU of that name, of whatever limb, or the only one that there is.

    Parameters
    ----------
    file : RecordingFile
        All streams.
    name : str, optional
        Topic (or a part of it, or its frame_id).

    Returns
    -------
    ImuSamples
        As recorded.

    Raises
    ------
    RecordingError
        There is none, none of that name, or no name where there are several; the message lists them.
    """
    if name is None and len(file.imus) > 1:
        listed = ", ".join(stream.topic for stream in file.imus)
        raise RecordingError(f"{file.path} has several IMUs ({listed}); choose one with --imu.")
    if name is None and len(file.imus) == 1:
        return file.imus[0]
    return _imus(file, name)[0]


def _imus(file: RecordingFile, name: str | None) -> list[ImuSamples]:
    if not file.imus:
        raise RecordingError(
            f"{file.path} has no IMU (sensor_msgs/Imu or unocclude.Imu); it has {_topics(file)}; "
            "record the wrist's IMU as well."
        )
    listed = ", ".join(stream.topic for stream in file.imus)
    if name is not None:
        exact = [stream for stream in file.imus if stream.topic.strip("/") == name.strip("/")]
        matches = exact or [s for s in file.imus if is_named(name, s.topic, s.frame_id)]
        if len(matches) != 1:
            what = "more than one IMU fits" if matches else "no IMU fits"
            raise RecordingError(f"{file.path}: {what} --imu {name}; it has {listed}.")
        return matches
    candidates = [stream for stream in file.imus if role(stream) not in ("base", "upper_arm", "trunk")]
    if not candidates:
        raise RecordingError(
            f"{file.path}: no IMU is named as one of a forearm; it has {listed}; choose with --imu."
        )
    named = [s for s in candidates if role(s) == "forearm" or named_side(s.topic, s.frame_id)]
    return named or candidates


def _may_match(imu: ImuSamples, arm: ArmFrames, side: str | None) -> bool:
    sides = {named_side(imu.topic, imu.frame_id), arm.side, side or ""} - {""}
    return len(sides) <= 1


def _side(imu: ImuSamples, arm: ArmFrames) -> str:
    return arm.side or named_side(imu.topic, imu.frame_id)


def _by_motion(
    file: RecordingFile, pairs: list[tuple[ImuSamples, ArmFrames]], store: Store | None
) -> tuple[tuple[ImuSamples, ArmFrames], str]:
    matches = _matches(file, pairs, store)
    matched = [(pair, match) for pair, match in matches if match.limb and match.limb.segment == "wrist"]
    if len(matched) == 1:
        pair, match = matched[0]
        return pair, f"their motion agrees best (probability {match.probability:.2f} among all limbs in view)"
    elsewhere = {
        id(imu): match
        for (imu, _), match in matches
        if match.is_sure and match.limb and match.limb.segment != "wrist"
    }
    offered = pairs
    pairs = [pair for pair, _ in matched] or [pair for pair in pairs if id(pair[0]) not in elsewhere]
    if not pairs:
        where = ", ".join(f"{m.imu} as {m.limb.label}" for m in elsewhere.values() if m.limb)
        raise RecordingError(
            f"{file.path}: no IMU moves as a forearm that the camera shows ({where}); "
            "choose with --imu and --side if one is on a forearm all the same."
        )
    scores = np.array([motion_agreement(imu, arm) for imu, arm in pairs])
    shifted = [_shifted(imu, arm) for imu, arm in pairs]
    correlation, shift_s, far = shifted[int(np.argmax([row[0] for row in shifted]))]
    apart = ""
    if far and correlation >= max(_ENOUGH_SHIFTED, float(scores.max())):
        # the clocks are far apart: what agrees within a second does so by chance
        scores = np.array([row[0] for row in shifted])
        apart = f", with the clocks {abs(shift_s):.1f} s apart"
    order = np.argsort(-scores)
    best, second = scores[order[0]], max(scores[order[1:]].max(initial=0.0), 0.0)
    if best < _ENOUGH or best - second < _LEAD:
        options = [("--imu", len({id(i) for i, _ in offered}) > 1)]
        options += [("--skeleton", len({a.topic for _, a in offered}) > 1)]
        options += [("--side", len({a.side for _, a in offered}) > 1)]
        options += [("--body", len({(a.topic, a.body) for _, a in offered}) > 1)]
        needed = " and ".join(name for name, is_needed in options if is_needed)
        raise RecordingError(
            f"{file.path} has {_listing(file)}, and their motion does not tell which belong together; "
            f"choose with {needed}."
        )
    why = f"their motion agrees best{apart} (correlation {best:.2f}, the next {second:.2f})"
    further = [
        f"{match.imu} moves as {match.limb.label}"
        for pair, match in matched
        if match.limb and pair[0] is not pairs[order[0]][0]
    ]
    return pairs[order[0]], "; ".join([why, *further])


def _matches(
    file: RecordingFile, pairs: list[tuple[ImuSamples, ArmFrames]], store: Store | None
) -> list[tuple[tuple[ImuSamples, ArmFrames], ImuMatch]]:
    """Pairs that one assignment of all these IMUs to all limbs of these arms makes."""
    from .match_streams import match_streams  # what it imports is not needed where names settle it

    imus = list({id(imu): imu for imu, _ in pairs}.values())
    arms = list({id(arm): arm for _, arm in pairs}.values())
    pair_of = {(imu.topic, arm.topic, arm.body, arm.side): (imu, arm) for imu, arm in pairs}

    def may_be(row: int, limb: Limb) -> bool:
        worn_as_named = limb.segment == "wrist" or role(imus[row]) != "forearm"
        return worn_as_named and (imus[row].topic, limb.skeleton, limb.body, limb.side) in pair_of

    try:
        matches, _ = match_streams(file, imus, arms, store=store, may_be=may_be)
    except RecordingError:
        return []  # what cannot be used is said when it is read, if it is what is meant
    return [
        (pair_of[match.imu, match.limb.skeleton, match.limb.body, match.limb.side], match)
        for match in matches
        if match.limb is not None
    ]


def _shifted(imu: ImuSamples, arm: ArmFrames) -> tuple[float, float, bool]:
    """`shifted_agreement` of an IMU and an arm's first frames."""
    order = np.argsort(arm.stamp_ns, kind="stable")[:_MOTION_FRAMES]
    if not len(order):
        return 0.0, 0.0, False
    stamp, gyro = _gyro_until(imu, int(arm.stamp_ns[order].max() + 1e9 * _FAR_S))
    if len(stamp) < 2:
        return 0.0, 0.0, False
    zero = int(stamp[0])
    stream = ImuStream(imu.topic, (stamp - zero) / 1e9, gyro, gyro)
    t_s = (arm.stamp_ns[order] - zero) / 1e9
    tracks = JointTracks(arm.topic, t_s, arm.position[order], arm.state[order])
    return shifted_agreement(stream, tracks, _LAG_S)


def motion_agreement(imu: ImuSamples, arm: ArmFrames) -> float:
    """How well an IMU's turning agrees with what the camera sees of an arm.

    The rotation over 0.3 s by the gyroscope is correlated with the turn of the elbow-to-wrist
    direction over the same time (with the way of the point, where only one is tracked), at the
    best of the time shifts within a second. Of a long recording the arm's first 20,000 frames are taken.

    Parameters
    ----------
    imu : ImuSamples
    arm : ArmFrames
        As recorded.

    Returns
    -------
    float
        Correlation, -1 to 1; 0 where there is too little to compare.
    """
    at, moved = _arm_motion(arm)
    if len(at) < 20:
        return 0.0
    stamp, gyro = _gyro_until(imu, int(at.max() + 1e9 * (_LAG_S + 2 * _MOTION_S)))
    if len(stamp) < 20:
        return 0.0
    zero = int(stamp[0])
    t = (stamp - zero) / 1e9
    steps = 0.5 * (gyro[1:] + gyro[:-1]) * np.diff(t)[:, None]
    turned = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    first = (at - zero) / 1e9
    best = 0.0
    for lag in np.arange(-_LAG_S, _LAG_S + 1e-9, 0.04):
        start, stop = first + lag, first + lag + _MOTION_S
        inside = (start >= t[0]) & (stop <= t[-1])
        if inside.sum() < 20:
            continue
        turn = np.stack([np.interp(stop, t, c) - np.interp(start, t, c) for c in turned.T], axis=1)
        angle = np.linalg.norm(turn, axis=1)[inside]
        shift = moved[inside]
        if angle.std() > 1e-6 and shift.std() > 1e-9:
            best = max(best, float(np.corrcoef(angle, shift)[0, 1]))
    return best


def _gyro_until(imu: ImuSamples, stamp_ns: int) -> tuple[IntArray, FloatArray]:
    """Finite samples in the order of their stamps, up to the first after a time (all if stamps run back)."""
    stamp, gyro = imu.stamp_ns, imu.gyro
    if (stamp[1:] >= stamp[:-1]).all():
        stop = int(np.searchsorted(stamp, stamp_ns, "right")) + 1
        stamp, gyro = stamp[:stop], gyro[:stop]
    else:
        order = np.argsort(stamp, kind="stable")
        stamp, gyro = stamp[order], gyro[order]
    finite = np.isfinite(gyro).all(axis=1)
    return stamp[finite], gyro[finite]


def _arm_motion(arm: ArmFrames) -> tuple[FloatArray, FloatArray]:
    """Start times (ns) of steps of 0.3 s, and how far the forearm turned (rad) or moved (m) in them."""
    tracked = arm.state == JointState.TRACKED
    for part in batches(len(tracked)):
        tracked[part] &= np.isfinite(arm.position[part]).all(axis=2)
    elbow, wrist = JOINTS.index("elbow"), JOINTS.index("wrist")
    both = tracked[:, elbow] & tracked[:, wrist]
    is_pair = bool(both.sum() >= 20)
    point = max((JOINTS.index(joint) for joint in _POINTS), key=lambda index: tracked[:, index].sum())
    rows = np.flatnonzero(both if is_pair else tracked[:, point])
    rows = rows[np.argsort(arm.stamp_ns[rows], kind="stable")[:_MOTION_FRAMES]]
    stamp, seen = arm.stamp_ns[rows], arm.position[rows]
    along = seen[:, point]
    if is_pair:
        along = seen[:, wrist] - seen[:, elbow]
        along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
    if len(stamp) < 2:
        return np.empty(0), np.empty(0)
    later = np.searchsorted(stamp, stamp + int(_MOTION_S * 1e9))
    usable = later < len(stamp)
    later = np.minimum(later, len(stamp) - 1)
    step = (stamp[later] - stamp) / 1e9
    usable &= step < 1.5 * _MOTION_S
    moved = np.linalg.norm(along[later] - along, axis=1) * _MOTION_S / np.maximum(step, 1e-6)
    return stamp[usable].astype(float), moved[usable]


def choose_truth(file: RecordingFile, side: str) -> tuple[PoseSamples | None, list[str]]:
    """The poses that are the truth of an arm, or None and why."""

    def other_side(name: str) -> bool:
        return bool(side) and named_side(name) not in ("", side)

    poses = [poses for poses in file.poses if not other_side(poses.topic)]
    if len(poses) > 1:
        named = [p for p in poses if any(word in _words(p.topic) for word in _TRUTH_WORDS)]
        sided = [p for p in named if named_side(p.topic) == side]
        poses = sided if len(sided) == 1 else named
        if len(poses) != 1:
            return None, [
                f"Of the poses {', '.join(p.topic for p in file.poses)} none is named as this arm's truth; "
                "none was taken."
            ]
    return (poses[0], []) if poses else (None, [])


def is_named(asked: str, topic: str, frame_id: str) -> bool:
    """Whether a stream is what was asked for: by a part of its topic, or by its frame_id."""
    return asked.strip("/").lower() in topic.lower() or asked == frame_id


def _words(name: str) -> str:
    """Lower case with the parts of CamelCase apart."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def _listing(file: RecordingFile) -> str:
    imus = ", ".join(stream.topic for stream in file.imus)
    arms = ", ".join(arm.label for arm in file.arms if arm.tracked)
    return f"IMU {imus} and skeleton {arms}"


def _topics(file: RecordingFile) -> str:
    listed = [f"{topic.name} ({topic.schema or 'no schema'})" for topic in file.topics if topic.count]
    if len(listed) > 8:
        listed = [*listed[:8], f"and {len(listed) - 8} more"]
    return ", ".join(listed) if listed else "no messages"
