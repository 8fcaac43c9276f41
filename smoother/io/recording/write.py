"""A recording to an MCAP file, in Foxglove's and our own protobuf messages."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calib.intrinsics import Intrinsics

from ...array_types import FloatArray
from ...body import SEGMENTS
from ...linalg import runs
from ...recording import JOINTS, Camera, CameraFrame, ImuStream, JointState, JointTracks, Recording
from ...runtime.outputs import writing
from ..mcap.merge import Output, OutputStream
from ..mcap.messages import nanoseconds
from .decode import KEYPOINTS
from .keypoints import CAMERA_TOPIC, NAMED_TOPIC, TOPIC, cameras_plain, lenses_plain, pixels_of
from .read import CLOCKS_UNRELATED, METADATA
from .streams import (
    OTHER_SIDE,
    ArmFrames,
    CameraStream,
    ImuSamples,
    KnownLens,
    PoseSamples,
    RecordingFile,
    free_name,
)

CAMERA = "camera"
#: Pixels of the images of a camera without depth whose lens a recording no longer has.
IMAGE = (1280, 720)


def write_recording(
    recording: Recording | Sequence[Recording] | RecordingFile,
    path: str | os.PathLike[str],
    *,
    force: bool = False,
) -> None:
    """Write a recording, or several arms of one session, to an MCAP file.

    `read_recording` gives it back: times to the nanosecond, values as they were.

    Parameters
    ----------
    recording : Recording or sequence of Recording or RecordingFile
        One arm, several arms (of one camera), or all that a file held.
    path : path-like
        The file to write.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    file = recording if isinstance(recording, RecordingFile) else as_file(recording)
    with writing(path, force) as temporary, Output(temporary) as output:
        output.write(recording_streams(output, file))


def recording_streams(output: Output, file: RecordingFile) -> list[OutputStream]:
    """Enter a recording's metadata and channels into an output; its messages, to be written."""
    output.metadata(METADATA, recording_metadata(file))
    outgoing = [imu_messages(output, imu) for imu in file.imus]
    outgoing += [arm_messages(output, arm) for arm in file.arms]
    return outgoing + [each for poses in file.poses for each in _pose_messages(output, poses)]


def recording_metadata(file: RecordingFile) -> dict[str, str]:
    """What a file states of its recording besides the streams."""
    metadata = {"notes": json.dumps(file.notes), "name": file.name}
    if file.camera_frame is not None:
        metadata["camera_frame"] = str(file.camera_frame)
    if file.clocks_unrelated:
        metadata["clocks"] = CLOCKS_UNRELATED
    plain = {
        "gravity": None if file.gravity_hint is None else file.gravity_hint.tolist(),
        "cameras": cameras_plain(file.cameras),
        "lenses": lenses_plain(file.lenses),
        "truth_score": {
            each.topic: [[run.start, run.stop] for run in runs(each.score)]
            for each in file.poses
            if each.score is not None
        },
    }
    return metadata | {name: json.dumps(value) for name, value in plain.items() if value}


def as_file(recording: Recording | Sequence[Recording]) -> RecordingFile:
    """The streams of recordings under the topics that they are written to."""
    recordings = [recording] if isinstance(recording, Recording) else list(recording)
    first = recordings[0]
    file = RecordingFile(Path(first.name), camera_frame=first.camera_frame, gravity_hint=first.gravity_hint)
    file.clocks_unrelated = any(one.clocks_unrelated for one in recordings)
    topics: set[str] = set()
    sides: set[tuple[int, str]] = set()
    others: list[ArmFrames] = []
    for one in recordings:
        file.notes += [note for note in one.notes if note not in file.notes]
        body = one.body or 0
        while (body, one.side) in sides:
            body += 1
        sides.add((body, one.side))
        trunk, has_trunk = one.trunk, "/imu/trunk" in topics
        if trunk is not None and trunk.other_arm is not None and one.side and not has_trunk:
            others.append(replace(_frames(file, one, trunk.other_arm, body), side=OTHER_SIDE[one.side]))
        worn = [(imu_topic(one.imu.name, one.side), one.imu)]
        worn += [(imu_topic(imu.name, one.side, segment), imu) for segment, imu in one.further_imus.items()]
        shared = {"/imu/base": one.base_imu, "/imu/trunk": None if trunk is None else trunk.imu}
        worn += [(topic, imu) for topic, imu in shared.items() if imu is not None and topic not in topics]
        file.imus += [ImuSamples.of(free_name(topic, topics), imu, one.origin_ns) for topic, imu in worn]
        file.arms.append(_frames(file, one, one.arm, body))
        for camera in one.cameras:
            file.arms.append(_frames(file, one, camera.arm, body, camera))
            stream = CameraStream(camera.name, camera.camera_frame, camera.gravity_hint)
            file.cameras[file.arms[-1].topic] = stream
        if (truth := one.truth) is not None:
            suffix = f"/{one.side or len(sides)}" if len(recordings) > 1 else ""
            suffix = suffix if one.body is None else f"/body_{one.body}{suffix}"
            named = free_name(f"/truth{suffix}", topics), CAMERA, nanoseconds(truth.t_s, one.origin_ns)
            score = None if truth.score.all() else truth.score
            file.poses.append(PoseSamples(*named, truth.position, truth.quaternion, score, truth.joints))
    # one that is there as an arm of its own is not written twice
    file.arms += [arm for arm in others if (arm.body, arm.side) not in sides]
    return file


def _frames(
    file: RecordingFile, one: Recording, arm: JointTracks, body: int, camera: Camera | None = None
) -> ArmFrames:
    """A camera's frames under its topic; rays of a camera without depth become pixels again."""
    name, topic = (CAMERA, "/skeleton") if camera is None else (camera.name, f"{CAMERA_TOPIC}{camera.name}")
    named = (name, body, one.side, nanoseconds(arm.t_s, one.origin_ns))
    if arm.pixel_rad is None:
        return ArmFrames(topic, *named, arm.position, arm.state)
    topic = TOPIC if camera is None else NAMED_TOPIC.format(name)
    if topic not in file.lenses:  # which lens it was does not matter to the rays: one that has the angle
        focal, seen = 1.0 / arm.pixel_rad, np.asarray(arm.position)[np.asarray(arm.state) > 0][:, :2]
        reach = 2.0 * focal * np.abs(seen).max(axis=0) if len(seen) else np.zeros(2)
        width, height = np.maximum(IMAGE, np.ceil(np.nan_to_num(reach))).astype(int).tolist()
        share = arm.focal_share
        lens = Intrinsics(width, height, focal, focal, 0.5 * width, 0.5 * height, focal_share=share)
        file.lenses[topic] = KnownLens(lens, None if camera is None else camera.pose)
    lens = file.lenses[topic].lens
    return ArmFrames(topic, *named, pixels_of(arm, lens), arm.state, CameraFrame.OPTICAL, lens)


def as_session(
    name: str,
    imus: Sequence[ImuStream],
    arms: Sequence[tuple[int, str, JointTracks]],
    camera_frame: CameraFrame | None = None,
) -> RecordingFile:
    """Arms of several bodies before one camera, and IMUs that belong to no arm yet, as a file's streams."""
    file = RecordingFile(Path(name), camera_frame=camera_frame)
    topics: set[str] = set()
    # stamps are not negative: a clock that is behind starts later
    times = [*(imu.t_s for imu in imus), *(arm.t_s for *_, arm in arms)]
    early = min((float(t[0]) for t in times if len(t)), default=0.0)
    origin_ns = int(np.ceil(max(-early, 0.0))) * 1_000_000_000
    for imu in imus:
        file.imus.append(ImuSamples.of(free_name(imu_topic(imu.name), topics), imu, origin_ns))
    for body, side, arm in arms:
        stamp = nanoseconds(arm.t_s, origin_ns)
        file.arms.append(ArmFrames("/skeleton", CAMERA, body, side, stamp, arm.position, arm.state))
    return file


def imu_topic(name: str, side: str = "", limb: str = "forearm") -> str:
    """The topic `/imu/NAME` of a limb's IMU by the name that it has."""
    if name.startswith("/imu/"):
        return name
    clean = "_".join(part for part in name.strip("/").replace("/", "_").split() if part)
    if limb in SEGMENTS and SEGMENTS[limb].parent and SEGMENTS[limb].prefix not in clean.lower():
        # by its name it is found again
        clean = ""
    return f"/imu/{clean or limb + ('_' + side if side else '')}"


def imu_messages(output: Output, imu: ImuSamples) -> OutputStream:
    """Messages of an IMU, on its topic."""
    acc, gyro = imu.vectors

    def columns(part: slice) -> dict[str, NDArray]:
        mag = {} if imu.mag is None else {"magnetic_field": imu.mag[part]}
        sensors = {"linear_acceleration": acc[part], "angular_velocity": gyro[part]}
        return {"timestamp": imu.stamp_ns[part]} | sensors | mag

    return output.stream(imu.topic, "unocclude.Imu", imu.stamp_ns, {"frame_id": imu.frame_id}, columns)


def arm_messages(
    output: Output,
    arm: ArmFrames,
    present: list[int] | None = None,
    strap_covariance: FloatArray | None = None,  # (F, 9) m^2
) -> OutputStream:
    """Skeletons or keypoints of an arm, on its topic; joints that are never there are left out."""
    suffix = f"_{arm.side}" if arm.side else ""
    if present is None:
        present = joints_there(arm.state)
    schema, field = ("unocclude.Skeleton", "joints") if arm.lens is None else (KEYPOINTS, "keypoints")

    def columns(part: slice) -> dict[str, NDArray]:
        values, state = arm.position[part], arm.state[part]
        each: dict[str, NDArray] = {"timestamp": arm.stamp_ns[part]}
        for k, i in enumerate(present):
            at, mine = f"{field}.{k}", values[:, i]
            if arm.lens is None:
                each |= {f"{at}.position": mine, f"{at}.state": state[:, i]}
            else:
                seen = np.where(state[:, i, None] == JointState.NOT_TRACKED, 0.0, np.nan_to_num(mine))
                each |= {f"{at}.{name}": seen[:, k] for k, name in enumerate(("u", "v", "score"))}
            if strap_covariance is not None and JOINTS[i] == "strap":
                each[f"{at}.position_covariance"] = np.nan_to_num(strap_covariance[part])
        return each

    constants = {
        "frame_id": arm.frame_id,
        "body": arm.body,
        field: [{"name": JOINTS[i] + suffix} for i in present],
    }
    return output.stream(arm.topic, schema, arm.stamp_ns, constants, columns)


def joints_there(state: NDArray[np.int8]) -> list[int]:
    """Joints, by number, that are there in any frame."""
    return np.flatnonzero((state != JointState.NOT_TRACKED).any(axis=0)).tolist()


def _pose_messages(output: Output, poses: PoseSamples) -> list[OutputStream]:
    def columns(part: slice) -> dict[str, NDArray]:
        turn = poses.quaternion[part][:, [1, 2, 3, 0]]
        pose = {"pose.position": poses.position[part], "pose.orientation": turn}
        return {"timestamp": poses.stamp_ns[part]} | pose

    stamp_ns, frame_id = poses.stamp_ns, poses.frame_id
    outgoing = [output.stream(poses.topic, "foxglove.PoseInFrame", stamp_ns, {"frame_id": frame_id}, columns)]
    if poses.joints:
        position = np.full((len(stamp_ns), len(JOINTS), 3), np.nan)
        for joint, values in poses.joints.items():
            position[:, JOINTS.index(joint)] = values
        state = np.where(np.isfinite(position).all(axis=2), JointState.TRACKED, 0).astype(np.int8)
        frames = ArmFrames(f"{poses.topic}/joints", frame_id, 0, "", stamp_ns, position, state)
        outgoing.append(arm_messages(output, frames))
    return outgoing
