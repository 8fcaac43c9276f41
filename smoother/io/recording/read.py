"""Recordings from MCAP files: all streams of a file; its arms, chosen, cleaned, on one time axis; one IMU."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TypeVar, Unpack, cast

import numpy as np

from ...array_types import IntArray
from ...calibration import ArmCalibration
from ...errors import RecordingError
from ...measurements.remedy import Remedy
from ...recording import (
    JOINTS,
    CameraFrame,
    ImportNote,
    ImuStream,
    JointTracks,
    Recording,
    TrunkSensors,
    Truth,
    arm_words,
)
from ...runtime.printable import printable
from ...runtime.store import by_rows, large_array
from ..mcap.container import Container
from ..mcap.merge import repair_notes
from ..mcap.messages import SECOND_NS, Topic, damage_note, plain_name, seconds
from .choose import FileReading, Selection, StreamChoice, choose_arms, choose_imu, join_bodies, left_out_words
from .clean import clean_arm, clean_imu, clean_poses, settle_imus
from .decode import JointDecoder, PlainDecoder, decoder_of
from .keypoints import camera_of, cameras_from_plain, direction_of, lenses_from_plain, tracks_of, with_lenses
from .streams import (
    ARRIVAL,
    ORDER,
    OTHER_SIDE,
    ArmFrames,
    ImuSamples,
    PoseSamples,
    RecordingFile,
    in_order,
    without_outlying,
)

#: Stamps below this (some twelve days) count from a zero of their own, not from 1970.
_SMALL_NS = 1_000_000 * SECOND_NS
#: A stream that is there for a smaller share of the other's time is spoken of; pauses of the IMU, ns.
_COVERS, _PAUSE_NS = 0.9, 500_000_000
#: Streams with less in common, ns, or fewer samples of the IMU in it, hold nothing that could be solved.
_LEAST_NS, _FEWEST = SECOND_NS // 5, 3
Cleaned = TypeVar("Cleaned", ImuSamples, ArmFrames, PoseSamples)


def select_recordings(
    file: RecordingFile,
    *,
    prefer_side: str | None = None,
    alone: bool = False,
    **selection: Unpack[Selection],
) -> list[Recording]:
    """Make a recording of every arm with an IMU from what a file contains, or of the one that is meant."""
    arms: list[StreamChoice] = []
    errors: list[RecordingError] = []
    with file.damage_told():
        choices, left_out = choose_arms(file, prefer_side=prefer_side, alone=alone, **selection)
        for choice in choices:
            try:
                arms.append(_cleaned(choice, file))
            except RecordingError as error:
                errors.append(error)
                left_out.append(left_out_words(arm_words(choice.side, choice.body), error))
        if not arms:
            raise errors[0]
        origin = _origin_ns(arms)  # one zero for all
        recordings = [_recording(arm, file, origin) for arm in arms]
    return [replace(one, notes=(*one.notes, *left_out)) for one in recordings]


def _cleaned(choice: StreamChoice, file: RecordingFile) -> StreamChoice:
    """The same with streams that are cleaned, still with their stamps."""
    source, notes = str(file.path), [*file.notes, *choice.notes]

    def said(cleaned: tuple[Cleaned, list[str]]) -> Cleaned:
        notes.extend(cleaned[1])
        return cleaned[0]

    imu, arm = said(clean_imu(choice.imu, source)), said(clean_arm(choice.arm, source))
    _check_overlap(imu, arm, source, file.clocks_unrelated)
    if not file.clocks_unrelated:
        notes += _coverage(imu, arm)
    base = None if choice.base is None else said(clean_imu(choice.base, source))
    truth = None if choice.truth is None else said(clean_poses(choice.truth))
    further = {segment: said(clean_imu(stream, source)) for segment, stream in choice.further.items()}
    return replace(choice, imu=imu, arm=arm, base=base, truth=truth, further=further, notes=notes)


def _recording(choice: StreamChoice, file: RecordingFile, origin: int) -> Recording:
    arm, base, truth = choice.arm, choice.base, choice.truth
    opposite = _opposite_arm(file, choice, origin)
    trunk, notes = _trunk(file, choice, opposite, origin)
    found = [camera_of(*each, str(file.path), origin, file.lenses) for each in choice.cameras]
    notes += [note for _, more in found for note in more]
    return Recording(
        imu=choice.imu.on_axis(origin),
        arm=tracks_of(arm, origin),
        side=choice.side,
        camera_frame=arm.camera_frame if arm.lens is not None else file.camera_frame or arm.camera_frame,
        gravity_hint=file.gravity_hint,
        base_imu=None if base is None else base.on_axis(origin),
        truth=None if truth is None else _truth(truth, origin),
        origin_ns=origin,
        name=file.name,
        notes=(*choice.notes, *notes),
        further_imus={name: stream.on_axis(origin) for name, stream in choice.further.items()},
        body=choice.body,
        trunk=trunk,
        clocks_unrelated=file.clocks_unrelated,
        applied_fixes=file.applied_fixes,
        opposite=opposite,
        cameras=tuple(camera for camera, _ in found if camera is not None),
    )


def _trunk(
    file: RecordingFile, choice: StreamChoice, opposite: JointTracks | None, origin_ns: int
) -> tuple[TrunkSensors | None, list[str]]:
    """The trunk's IMU by its name with the other arm, whose shoulder shows the trunk's heading; sentences."""
    named = [imu for imu in file.imus if imu is not choice.imu and imu.role == "trunk"]
    if not named:
        return None, []
    if len(named) > 1:
        names = ", ".join(imu.topic for imu in named)
        return None, [f"Of the trunk IMUs {names} none was taken: their names do not show which is meant."]
    samples, notes = clean_imu(named[0], str(file.path))
    imu = replace(samples, mag=None).on_axis(origin_ns)
    return TrunkSensors(imu, opposite), [f"IMU {samples.topic} is on the trunk by its name.", *notes]


def _opposite_arm(file: RecordingFile, choice: StreamChoice, origin_ns: int) -> JointTracks | None:
    """The camera's joints of the same person's other arm; None where there is none that can be used."""
    sides = {"left", "right"}
    if any({arm.side, choice.arm.side} == sides for arm in file.arms):
        for arm in join_bodies(file.arms)[0]:
            if arm.key[:2] == choice.arm.key[:2] and {arm.side, choice.arm.side} == sides:
                with suppress(RecordingError):  # it was not asked for
                    return tracks_of(clean_arm(arm, str(file.path))[0], origin_ns)
                return None
    return None


def _origin_ns(arms: Sequence[StreamChoice]) -> int:
    """What the times of these arms count from, ns."""
    streams = [
        each for arm in arms for each in (arm.imu, arm.arm, arm.base, arm.truth, *arm.further.values())
    ]
    first = [int(stream.stamp_ns[0]) for stream in streams if stream is not None and len(stream.stamp_ns)]
    origin = min(first) // SECOND_NS * SECOND_NS
    return 0 if max(abs(stamp) for stamp in first) < _SMALL_NS else origin


def _check_overlap(imu: ImuSamples, arm: ArmFrames, source: str, unrelated: bool) -> None:
    """Refuse streams of which nothing can be solved: too short a time in common, or hardly a sample in it."""
    (start, end), (first, last) = ((int(s[0]), int(s[-1])) for s in (imu.stamp_ns, arm.stamp_ns))
    if unrelated:  # their stamps do not show what they have in common: at most the shorter one
        first, last = start, start + min(end - start, last - first)
    first, last = max(start, first), min(end, last)
    at, behind = np.searchsorted(imu.stamp_ns, [first, last])
    if last - first >= _LEAST_NS and behind - at >= _FEWEST:
        return
    rate_hz = 1e9 / max(float(np.median(np.diff(imu.stamp_ns))), 1.0)
    spans = f"(IMU {_span(imu.stamp_ns)} at {rate_hz:.3g} Hz, camera {_span(arm.stamp_ns)})"
    if last <= first:
        raise RecordingError(
            f"{source}: {imu.topic} and {arm.label} do not overlap in time, they are"
            f" {(first - last) / 1e9:.3f} s apart {spans}; record both at the same time, with clocks that"
            " agree to a second."
        )
    raise RecordingError(
        f"{source}: {imu.topic} and {arm.label} have only {(last - first) / 1e9:.3g} s and {behind - at}"
        f" samples of the IMU in common {spans}; if a file's times are in another unit, import it again with"
        " the right time_unit, else record both at the same time."
    )


def _coverage(imu: ImuSamples, arm: ArmFrames) -> list[str]:
    """A sentence where one stream is there for much less of the time than the other."""
    (imu_first, imu_last), (first, last) = ((int(s[0]), int(s[-1])) for s in (imu.stamp_ns, arm.stamp_ns))
    shared_s, imu_s, camera_s = (
        ns / 1e9 for ns in (min(imu_last, last) - max(imu_first, first), imu_last - imu_first, last - first)
    )
    steps = np.diff(imu.stamp_ns)
    there_s = min(imu_s - float(steps[steps > _PAUSE_NS].sum()) / 1e9, shared_s)
    sentences = []
    if there_s < _COVERS * camera_s:
        what = f"samples for {there_s:.1f} of the camera's {camera_s:.1f} s"
        sentences.append(f"{imu.topic}: there are {what}.")
    if shared_s < _COVERS * imu_s:
        what = f"frames for {shared_s:.1f} of the IMU's {imu_s:.1f} s"
        sentences.append(f"{arm.label}: there are {what}.")
    return sentences


def _span(stamp_ns: IntArray) -> str:
    return f"{stamp_ns[0] / 1e9:.3f} .. {stamp_ns[-1] / 1e9:.3f} s"


def _truth(poses: PoseSamples, origin: int) -> Truth:
    score = np.ones(len(poses.stamp_ns), bool) if poses.score is None else poses.score
    t_s = seconds(poses.stamp_ns, origin)
    return Truth(t_s, poses.position, poses.quaternion, score, dict(poses.joints))


TRUTH_PREFIX = "/truth"


def _join_truth_joints(file: RecordingFile) -> None:
    """Skeletons on truth topics are reference joints of the truth beside them."""
    for arm in [arm for arm in file.arms if arm.topic.startswith(TRUTH_PREFIX)]:
        file.arms.remove(arm)
        for poses in (poses for poses in file.poses if f"{poses.topic}/joints" == arm.topic):
            row = np.minimum(np.searchsorted(arm.stamp_ns, poses.stamp_ns), len(arm.stamp_ns) - 1)
            same = arm.stamp_ns[row] == poses.stamp_ns
            for i in np.flatnonzero(arm.state.any(axis=0)).tolist():
                poses.joints[JOINTS[i]] = by_rows(
                    lambda rows, is_same, its=arm.position[:, i]: np.where(
                        is_same[:, None], its[rows], np.nan
                    ),
                    row,
                    same,
                )


def _join_field(file: RecordingFile, field: ImuSamples) -> None:
    """Give a magnetometer to the IMU of its frame, or under the same name."""
    beside = [i for i in file.imus if field.topic.rpartition("/")[0] == i.topic.rpartition("/")[0]]
    framed = [imu for imu in file.imus if field.frame_id and imu.frame_id == field.frame_id]
    mine = [i for i in beside if i.frame_id == field.frame_id] or framed or beside
    if len(mine) != 1 or mine[0].mag is not None:
        file.notes.append(f"{field.topic}: the magnetometer belongs to no IMU by its names and was left out.")
        return
    assert field.mag is not None
    order = np.argsort(field.stamp_ns, kind="stable")
    order = order[np.isfinite(field.mag[order]).all(axis=1)]
    if not len(order):
        return
    stamp, values = field.stamp_ns[order], field.mag[order]
    at, have = seconds(mine[0].stamp_ns, int(stamp[0])), seconds(stamp, int(stamp[0]))
    mag = large_array((len(mine[0]), 3))
    for axis in range(3):
        mag[:, axis] = np.interp(at, have, values[:, axis])
    mine[0].mag = mag


#: Topics that a result adds; a recording is read without them.
RESULT_PREFIX = "/unocclude/"
METADATA = "unocclude.recording"
#: The value of `clocks` in its metadata where those of IMU and camera have nothing in common.
CLOCKS_UNRELATED = "unrelated"
#: The option that exchanges the skeleton's arms.
SWAPPED_SIDES = "--swap left,right"

#: Of the notes in a file's metadata this many are repeated, and this much of each.
_MOST_NOTES, _LONGEST_NOTE = 100, 1000


#: Schemas of motion that are not read, by the last part of their name, where the messages are JSON.
_MOTION = ("imu", "skeleton", "magneticfield", "posestamped", "poseinframe")


def open_recording(
    path: str | os.PathLike[str],
    *,
    only: Collection[str] = (),
    truth: bool = True,
) -> RecordingFile:
    """Read all streams of an MCAP file that a recording can be made of."""
    container = Container(path)
    # by topic, in the order in which they are met
    decoders: dict[int, PlainDecoder | JointDecoder | None] = {}
    for chunk in container.chunks():
        for position in dict.fromkeys(chunk.topic.tolist()):
            if position not in decoders:
                decoders[position] = _decoder(container.topics[position], truth)
            if (decoder := decoders[position]) is not None:
                decoder.feed(chunk.select(np.flatnonzero(chunk.topic == position)))
        is_imu = any(isinstance(each, PlainDecoder) and each.kind == "imu" for each in decoders.values())
        if only and is_imu and set(only) <= {topic.name for topic in container.topics if topic.count}:
            break
    found = [decoder for decoder in decoders.values() if decoder is not None]
    file = RecordingFile(container.path, notes=list(container.notes), metadata=container.metadata)
    file.damage = list(container.notes)
    for topic in container.topics:  # names as messages show them
        names = (plain_name(topic.schema), plain_name(topic.encoding))
        file.topics.append(replace(topic, name=topic.label, schema=names[0], encoding=names[1]))
    _gather(file, found)
    if file.metadata.get(METADATA, {}).get(ORDER) == ARRIVAL:
        file.imus, file.arms = [in_order(each) for each in file.imus], [in_order(each) for each in file.arms]
    file.imus = [without_outlying(imu, file.notes) for imu in file.imus]
    file.arms = [without_outlying(arm, file.notes) for arm in file.arms]
    file.poses = [without_outlying(poses, file.notes) for poses in file.poses]
    _tell_of_others(file)
    _take_metadata(file)
    with_lenses(file, {each.topic.label for each in found if isinstance(each, JointDecoder) and each.is_flat})
    return file


def _tell_of_others(file: RecordingFile) -> None:
    """Motion that is there in messages that are not read."""
    there = {"imu": file.imus, "skeleton": file.arms}
    kinds = {topic.name: topic.schema.replace(".", "/").rpartition("/")[2].lower() for topic in file.topics}
    json = [t.name for t in file.topics if t.encoding == "json" and kinds[t.name] in _MOTION]
    if json:
        why = "JSON messages are not read; record or convert them as protobuf or ROS 2's CDR."
        sentence = f"{', '.join(json)}: {why}"
        if not all(there.get(kinds[name], True) for name in json):
            raise RecordingError(f"{file.path}: {sentence}")
        file.notes.append(sentence)
    for topic in file.topics:
        if topic.schema.replace("/msg/", "/") == "sensor_msgs/JointState":
            what = "sensor_msgs/JointState contains angles, not joint positions; ignored."
            file.notes.append(f"{topic.name}: {what}")


def is_motion(topic: Topic) -> bool:
    """Whether a recording's streams are made of a topic: no image, sound, text or position on Earth is."""
    return _decoder(topic, truth=True) is not None


def _decoder(topic: Topic, truth: bool) -> PlainDecoder | JointDecoder | None:
    """What decodes a topic; None where it is not wanted."""
    decoder = None if topic.name.startswith(RESULT_PREFIX) else decoder_of(topic)
    is_pose = isinstance(decoder, PlainDecoder) and decoder.kind == "pose"
    is_joints = isinstance(decoder, JointDecoder) and topic.name.startswith(TRUTH_PREFIX)
    return decoder if truth or not (is_pose or is_joints) else None


def read_recording(
    path: str | os.PathLike[str],
    *,
    prefer_side: str | None = None,
    **reading: Unpack[FileReading],
) -> Recording:
    """Read one arm and the IMU on it from an MCAP file.

    Parameters
    ----------
    path : path-like
        The file.
    prefer_side : str, optional
        Side to take where the file leaves it open (a calibration's).
    truth : bool
        False passes over the reference motion; the recording has none.
    swap_sides : bool
        The skeleton's left arm is the right one, and the other way round.
    imu, skeleton : str, optional
        Topic (or a part of it, or its frame_id) to take.
    side : str, optional
        "left" or "right".
    body : int, optional
        The camera's number of the body.

    Returns
    -------
    Recording
        The recording; `notes` list what was dropped and what was chosen.

    Raises
    ------
    RecordingError
        The file cannot be read or used as it is, or leaves open what is meant.
    """
    return _read(path, reading, prefer_side=prefer_side, alone=True)[0]


def read_recordings(
    path: str | os.PathLike[str],
    *,
    prefer_side: str | None = None,
    **reading: Unpack[FileReading],
) -> list[Recording]:
    """Read every arm that has an IMU from an MCAP file: both arms, of one person or of several.

    A file with one arm gives what `read_recording` gives. What belongs together is settled by option, else
    by the sides in names, else by motion.

    Parameters
    ----------
    path, prefer_side, truth, swap_sides, imu, skeleton, side, body
        As in `read_recording`; the last four restrict.

    Returns
    -------
    list of Recording
        One per arm, at least one, in order of body and side; `body` is set where there are several people.
        An arm that cannot be used is left out, and `notes` of the others state it.

    Raises
    ------
    RecordingError
        As `read_recording`; no arm can be used.
    """
    return _read(path, reading, prefer_side=prefer_side)


def _read(
    path: str | os.PathLike[str], reading: FileReading, *, prefer_side: str | None = None, alone: bool = False
) -> list[Recording]:
    """The arms of a file, or the one that is meant."""
    chosen = dict(reading)
    file = open_recording(path, truth=bool(chosen.pop("truth", True)))
    if chosen.pop("swap_sides", False):
        for arm in file.arms:
            arm.side = OTHER_SIDE.get(arm.side, arm.side)
        file.notes.append(f"left and right of the skeleton were swapped ({SWAPPED_SIDES})")
        file.applied_fixes = (SWAPPED_SIDES,)
    return select_recordings(file, prefer_side=prefer_side, alone=alone, **cast(Selection, chosen))


def _gather(file: RecordingFile, decoders: list[PlainDecoder | JointDecoder]) -> None:
    fields: list[ImuSamples] = []
    for decoder in decoders:
        if broken := decoder.grouper.broken:
            what = f"{broken} messages of {decoder.topic.label} were dropped."
            file.notes.append(damage_note(file.name, what))
        if isinstance(decoder, JointDecoder):
            file.arms += (arms := decoder.arms())
            if not arms and not decoder.topic.name.startswith(TRUTH_PREFIX):
                file.frames_without_body += decoder.topic.count
            continue
        stream = decoder.stream()
        if isinstance(stream, PoseSamples):
            file.poses.append(stream)
        elif stream is not None:
            (fields if stream.acc is None else file.imus).append(stream)
    settle_imus(file)
    _join_truth_joints(file)
    for field in fields:
        _join_field(file, field)


def _take_metadata(file: RecordingFile) -> None:
    record = file.metadata.get(METADATA, {})
    try:
        if record.get("camera_frame"):
            file.camera_frame = CameraFrame(record["camera_frame"])
        if record.get("gravity"):
            file.gravity_hint = direction_of(json.loads(record["gravity"]))
        file.clocks_unrelated = record.get("clocks") == CLOCKS_UNRELATED
        if record.get("cameras"):
            file.cameras = cameras_from_plain(json.loads(record["cameras"]))
        if record.get("lenses"):
            file.lenses = lenses_from_plain(json.loads(record["lenses"]))
        notes = json.loads(record.get("notes", "[]"))
        file.notes += [ImportNote(printable(str(note)[:_LONGEST_NOTE])) for note in notes[:_MOST_NOTES]]
        file.notes += repair_notes(file.metadata)
        scores = json.loads(record.get("truth_score", "{}"))
        for poses in file.poses:
            if poses.topic in scores:
                poses.score = np.zeros(len(poses.stamp_ns), bool)
                for start, stop in scores[poses.topic][: len(poses.stamp_ns)]:
                    poses.score[start:stop] = True
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        raise RecordingError(
            f"{file.path}: its metadata record {METADATA} cannot be read ({error}); write it again."
        ) from error


def read_imu(path: str | os.PathLike[str], imu: str | None = None) -> tuple[ImuStream, list[str]]:
    """Read one IMU from an MCAP file; a skeleton need not be there."""
    file = open_recording(path)
    with file.damage_told():
        chosen = choose_imu(file, imu)
        kept, notes = clean_imu(chosen, str(file.path))
    if kept.stamp_ns[-1] - kept.stamp_ns[0] <= 0:
        raise RecordingError(f"{path}: {kept.topic} lasts no time; record it again.")
    return kept.on_axis(int(kept.stamp_ns[0]) // SECOND_NS * SECOND_NS), [*file.notes, *notes]


def read_arms(
    path: str | os.PathLike[str],
    calibration_file: str | os.PathLike[str] | None = None,
    *,
    remedy: Remedy | None = None,
    alone: bool = False,
    **reading: Unpack[FileReading],
) -> list[tuple[Recording, ArmCalibration | None]]:
    """Read every arm of a recording that has an IMU, or the one that is meant, each with its calibration."""
    remedy = remedy or Remedy()
    if calibration_file is None:
        return [(remedy.applied(one), None) for one in _read(path, reading, alone=alone)]
    from calib.file import corrected, known_arm, read_calibration
    from calib.intrinsics import camera_poses, with_camera_poses
    from calib.world import with_gravity

    calibration = read_calibration(calibration_file)
    sides = [name for name in calibration.arms if name != "any"]
    poses = camera_poses(calibration)
    arms: list[tuple[Recording, ArmCalibration | None]] = []
    recordings = _read(path, reading, prefer_side=sides[0] if len(sides) == 1 else None, alone=alone)
    for recording in recordings:
        recording = with_gravity(corrected(remedy.applied(recording), calibration), calibration)
        recording, own = with_camera_poses(recording, poses), calibration
        if calibration.arms and len(recordings) > 1 and not {recording.side, "any"} & set(calibration.arms):
            note = f"{calibration_file} has no {recording.side} arm: this one is found from the motion."
            recording, own = replace(recording, notes=(*recording.notes, note)), replace(calibration, arms={})
        given = known_arm(own, recording.side)  # none of sensors, clocks, frames alone
        arms.append((recording, given))
    return arms
