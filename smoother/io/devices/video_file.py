"""A video as a camera: the person's landmarks in space and in pixels, by MediaPipe's pose landmarker."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import CameraFrame
from ..media.pose_landmarks import (
    Pose,
    Progress,
    Video,
    check_model,
    find_poses,
    mediapipe_module,
    open_video,
    persons,
)
from ..tables.joints import BLAZEPOSE, joint_name
from ..tables.skeleton_formats import RELATIVE_NOTE, share_states
from ..tables.skeletons import Conventions, ImagePoints, RawSkeleton, SkeletonTable
from ..tables.table import FileHead, amount

#: Bytes at the beginning of videos: where they stand, and what they are.
_MARKS = ((4, b"ftyp"), (0, b"\x1aE\xdf\xa3"), (8, b"AVI "))
#: Whoever is seen for less than this, s, is a mistake of the network's or passes by.
_PASSES_BY_S = 1.0
#: A trunk that is this much longer across the picture than along it is horizontal.
_ACROSS = 1.5
#: A person that moves by more than this part of the picture's width from one picture to the next is another.
_JUMP = 0.25


def is_video(raw: bytes) -> bool:
    """Whether a file begins as MP4, MOV, MKV, WebM or AVI do."""
    return any(raw[at : at + len(mark)] == mark for at, mark in _MARKS)


@dataclass
class PoseVideo:
    """An importer of videos; see `Format`."""

    model: Path | None  # Of the pose landmarker
    people: int = 2  # As many are looked for at most
    mirrored: bool = False  # The camera stored a mirror image
    turn_deg: int = 0  # Rotate the pictures clockwise, in addition to the file's own rotation
    progress: Progress | None = None  # Told how far it is
    key: str = "video"  # See `Format`
    title: str = "video, MediaPipe pose landmarker"  # See `Format`
    kind: str = "skeleton"  # See `Format`
    recognised_by: str = "the beginning of MP4, MOV, MKV, WebM or AVI"  # See `Format`

    def recognises(self, head: FileHead) -> bool:
        """Whether the file is a video."""
        return is_video(head.raw)

    @staticmethod
    def refuse(path: Path) -> NoReturn:
        """Say that a file is not a video; raises `RecordingError`."""
        raise RecordingError(
            f"{path} is not a video (MP4, MOV, AVI, MKV); export or convert it, or name another file."
        )

    def read(self, path: Path) -> list[SkeletonTable]:
        """Find the persons in all pictures."""
        mediapipe_module()  # what is missing is said before minutes of work
        model = check_model(self.model)
        with open_video(path, self.turn_deg, self.mirrored) as video:
            poses = find_poses(video, model, self.people, self.progress)
            t_s, said = video.times()
        numbers = persons(poses)
        seen = _seen(numbers, t_s)
        if not seen:
            raise RecordingError(
                f"{path}: no person was found in {amount(len(poses), 'picture', 'pictures')}; record so that"
                " head, shoulders and hips are in the picture, from the front and in good light."
            )
        raw = _raw(path, t_s, poses, numbers, seen)
        raw.notes += [RELATIVE_NOTE, *([said] if said else []), *_about(video, poses, numbers, seen)]
        tables = raw.skeletons(Conventions("m", CameraFrame.OPTICAL, relative=True))
        for table in tables:
            person = seen[table.body]
            table.image = _image_points(video, poses, numbers, person)
        return tables


def _seen(numbers: list[list[int]], t_s: FloatArray) -> list[int]:
    """Who is in the video, most often seen first; who only passes by is not."""
    frames = np.bincount([number for frame in numbers for number in frame], minlength=1)
    usual = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    least = min(_PASSES_BY_S / usual if usual > 0 else 1.0, 0.5 * frames.max())
    order = np.argsort(-frames, kind="stable").tolist()
    return [person for person in order if frames[person] and frames[person] >= least]


def _raw(
    path: Path, t_s: FloatArray, poses: list[list[Pose]], numbers: list[list[int]], seen: list[int]
) -> RawSkeleton:
    """A row a picture and person, as a file of world landmarks has them; one too where no person is seen."""
    rows: list[tuple[float, float, FloatArray]] = []
    nothing = np.full((len(BLAZEPOSE), 4), np.nan)
    for t, frame, mine in zip(t_s, poses, numbers, strict=True):
        here = [
            (t, float(seen.index(who)), pose.world)
            for pose, who in zip(frame, mine, strict=True)
            if who in seen
        ]
        rows += sorted(here, key=lambda row: row[1]) or [(t, np.nan, nothing)]
    table = np.stack([world for _, _, world in rows])
    raw = RawSkeleton(path, {}, time_scale=1.0)
    raw.time, raw.body = np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
    for at, name in enumerate(BLAZEPOSE):
        meaning = joint_name(name)
        if meaning is None:
            continue
        if not meaning.joint:
            raw.rest.append((meaning, table[:, at, :3]))
            continue
        raw.position[meaning.joint] = table[:, at, :3]
        raw.state[meaning.joint] = share_states(table[:, at, 3])
    return raw


def _image_points(
    video: Video, poses: list[list[Pose]], numbers: list[list[int]], person: int
) -> ImagePoints:
    """A person's joints in all pictures."""
    joints = {
        meaning.joint: at
        for at, name in enumerate(BLAZEPOSE)
        if (meaning := joint_name(name)) is not None and meaning.joint
    }
    points = {joint: np.full((len(poses), 3), np.nan) for joint in joints}
    for row, (frame, mine) in enumerate(zip(poses, numbers, strict=True)):
        if person in mine:
            pixels = frame[mine.index(person)].pixels
            for joint, at in joints.items():
                points[joint][row] = pixels[at]
    return ImagePoints(video.width, video.height, points)


def _about(video: Video, poses: list[list[Pose]], numbers: list[list[int]], seen: list[int]) -> list[str]:
    """What is to be said of a video and of who is in it."""
    notes = []
    if video.stored_turn_deg:
        notes.append(f"The file was filmed turned by {video.stored_turn_deg} degrees; it was turned upright.")
    if video.mirrored:
        notes.append("The pictures were flipped left to right (--mirrored).")
    else:
        notes.append(
            "Assumed not mirrored. Front cameras of phones often store a mirror image, in which the right arm"
            " looks like a left one: if writing in the picture reads backwards, import it again with"
            " --mirrored."
        )
    mine = [frame[who.index(seen[0])] for frame, who in zip(poses, numbers, strict=True) if seen[0] in who]
    absent = len(poses) - len(mine)
    if absent:
        notes.append(f"In {absent} of {len(poses)} pictures no person was found; the arm is occluded there.")
    if len(seen) > 1:
        notes.append(
            f"{len(seen)} people are in the video; the motion shows who wears the IMU, or choose --body 0 to"
            f" {len(seen) - 1} (0 was seen most often)."
        )
    trunk = np.array([pose.trunk for pose in mine])
    jumps = int((np.abs(np.diff(trunk, axis=0)).max(axis=1, initial=0.0) > _JUMP * video.width).sum())
    if jumps and len(seen) == 1:
        notes.append(
            f"The person found jumps across the picture {jumps} times: another one may have been taken for"
            " him or her; cut the video, or cover the other person."
        )
    return notes + _lies(mine)


def _lies(mine: list[Pose]) -> list[str]:
    """What is to be said where the trunk does not stand upright in the picture."""
    sides = ("left", "right")
    shoulders, hips = (
        np.array([[pose.pixels[BLAZEPOSE.index(f"{side}_{part}"), :2] for side in sides] for pose in mine])
        for part in ("shoulder", "hip")
    )
    down = np.median(hips.mean(axis=1) - shoulders.mean(axis=1), axis=0)
    if abs(down[0]) > _ACROSS * abs(down[1]):
        turn = 90 if down[0] > 0 else 270
    elif down[1] < 0 and abs(down[1]) > _ACROSS * abs(down[0]):
        turn = 180
    else:
        return []
    how = "across the picture" if turn != 180 else "upside down in the picture"
    return [
        f"The person is {how}. If a player shows the video so too, import it again with --turn {turn};"
        " as it is, down is wrong unless the person lies."
    ]
