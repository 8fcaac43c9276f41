"""Recordings from MCAP files: all streams of a file, one arm or every arm of it, one IMU by itself."""

from __future__ import annotations

import json
import os
from collections.abc import Collection
from dataclasses import replace
from typing import Unpack, cast

import numpy as np

from ...calibration import ArmCalibration
from ...errors import RecordingError
from ...measurements.remedy import Remedy
from ...recording import JOINTS, CameraFrame, ImportNote, ImuStream, Recording
from ...runtime.printable import printable
from ...runtime.store import by_rows, large_array
from ..mcap.container import Container
from ..mcap.messages import SECOND_NS, Topic, damage_note, plain_name, seconds
from ..mcap.repair import repair_notes
from .camera_streams import cameras_from_plain, direction_of
from .choose import FileReading, Selection, choose_imu
from .clean import clean_imu
from .decode import JointDecoder, PlainDecoder, decoder_of
from .inertial import settle_imus
from .keypoints import lenses_from_plain, with_lenses
from .names import OTHER_SIDE
from .select import select_recordings
from .streams import (
    ARRIVAL,
    ORDER,
    FieldSamples,
    ImuSamples,
    PoseSamples,
    RecordingFile,
    in_order,
    without_outlying,
)

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


def _join_field(file: RecordingFile, field: FieldSamples) -> None:
    """Give a magnetometer to the IMU of its frame, or under the same name."""
    beside = [i for i in file.imus if field.topic.rpartition("/")[0] == i.topic.rpartition("/")[0]]
    framed = [imu for imu in file.imus if field.frame_id and imu.frame_id == field.frame_id]
    mine = [i for i in beside if i.frame_id == field.frame_id] or framed or beside
    if len(mine) != 1 or mine[0].mag is not None:
        file.notes.append(f"{field.topic}: the magnetometer belongs to no IMU by its names and was left out.")
        return
    order = np.argsort(field.stamp_ns, kind="stable")
    order = order[np.isfinite(field.mag[order]).all(axis=1)]
    if not len(order):
        return
    stamp, values = field.stamp_ns[order], field.mag[order]
    at, have = seconds(mine[0].stamp_ns, int(stamp[0])), seconds(stamp, int(stamp[0]))
    mag = large_array(mine[0].acc.shape)
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
    fields: list[FieldSamples] = []
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
        if isinstance(stream, ImuSamples):
            file.imus.append(stream)
        elif isinstance(stream, PoseSamples):
            file.poses.append(stream)
        elif stream is not None:
            fields.append(stream)
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
