"""Several cameras of a file: which skeletons are of the first one, and which arm each of the others shows."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...linalg import unit
from ...recording import Camera, CameraFrame
from .bodies import people
from .clean import clean_arm
from .keypoints import tracks_of
from .streams import ArmFrames, CameraStream, ImuSamples, KnownLens, RecordingFile

#: Where the skeletons of further cameras are written to, each under its name.
CAMERA_TOPIC = "/skeleton/"


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
            from .match import FAR_S, match_streams  # SciPy: where it is used

            with suppress(RecordingError):  # too short to match
                (match,), _ = match_streams(own, [imu], candidates, reach_s=FAR_S)
                candidates = [each for each in candidates if match.limb is None or each.key == match.limb.arm]
        found.append((camera, candidates[0]))
        notes.append(f"{camera.name}: skeleton {found[-1][1].label} was taken as a further camera's.")
    return found, notes


def camera_of(
    stream: CameraStream,
    arm: ArmFrames,
    source: str,
    origin_ns: int,
    lenses: Mapping[str, KnownLens],
) -> tuple[Camera | None, list[str]]:
    """A further camera with cleaned frames; None and a sentence where they cannot be used."""
    try:
        clean, notes = clean_arm(arm, source)
    except RecordingError as error:
        return None, [f"{stream.name} was left out: {error}"]
    tracks = tracks_of(clean, origin_ns)
    frame = stream.camera_frame or clean.camera_frame
    known = lenses.get(arm.topic)
    pose = None if known is None else known.pose
    return Camera(stream.name, tracks, frame, stream.gravity_hint, pose), notes


def cameras_plain(cameras: dict[str, CameraStream]) -> dict[str, dict[str, object]]:
    """As a file's metadata holds them."""
    return {
        topic: {
            "name": camera.name,
            "camera_frame": None if camera.camera_frame is None else str(camera.camera_frame),
            "gravity": None if camera.gravity_hint is None else [float(x) for x in camera.gravity_hint],
        }
        for topic, camera in cameras.items()
    }


def cameras_from_plain(values: dict[str, dict[str, object]]) -> dict[str, CameraStream]:
    """From metadata; raises `ValueError`, `TypeError` or `KeyError` where it is none."""
    return {
        str(topic): CameraStream(
            str(each["name"]),
            CameraFrame(str(each["camera_frame"])) if each.get("camera_frame") else None,
            direction_of(each["gravity"]) if each.get("gravity") is not None else None,
        )
        for topic, each in dict(values).items()
    }


def direction_of(value: object) -> FloatArray:
    """Down as plain values state it; raises `ValueError` or `TypeError` where they do not."""
    gravity = np.array(value, float).reshape(3)
    direction = np.asarray(unit(gravity))
    if not (np.isfinite(gravity).all() and abs(float(np.linalg.norm(direction)) - 1) < 1e-6):
        raise ValueError("gravity is not a direction")
    return direction
