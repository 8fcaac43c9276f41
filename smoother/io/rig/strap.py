"""The cameras of a recording that the strap is looked for with, and a simulated recording with images."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from calib.intrinsics import Intrinsics, PlacedCamera

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import Recording
from ...runtime.outputs import writing
from ..mcap.merge import Output
from ..mcap.messages import McapMessage, nanoseconds
from ..recording.write import as_file, recording_streams
from ..wire.schemas import message_class, parsed
from .images import (
    CAMERA_CALIBRATION,
    COMPRESSED_IMAGE,
    RAW_IMAGE,
    TRANSFORMS,
    ImageMessage,
    LensMessage,
    decoded_messages,
    is_infrared,
    jpeg_image,
    lens_message,
    raw_image,
    read_images,
)

if TYPE_CHECKING:
    from ...simulation.strap import StrapView

#: Child frame to its parent, R and t: p_parent = R p_child + t.
Transforms = dict[str, tuple[str, FloatArray, FloatArray]]


@dataclass
class StrapFound:
    """What the images gave, for figures and the report."""

    t_s: FloatArray  # (n,) s: times of the colour images looked at, after the first
    position: FloatArray  # (n, 3) m: of the sensor in {K}; nan where rejected
    sigma_m: FloatArray  # (n, 3) m: its standard deviation
    along: FloatArray  # (n,): part of the way from elbow to wrist
    reasons: list[str]  # "" where it was found
    topics: tuple[str, str] = ("", "")
    notes: list[str] = field(default_factory=list)

    @property
    def counts(self) -> dict[str, int]:
        """How often the strap was found, and rejected for which reason."""
        return dict(Counter(reason or "found" for reason in self.reasons))


def check_images(path: str | os.PathLike[str], colour: str | None = None, depth: str | None = None) -> None:
    """Refuse a recording without colour or depth images before any work is done for it."""
    cameras = Cameras(path, colour, depth, np.eye(3))
    for _ in cameras.images():
        if len(cameras.chosen) == 2:
            return


class Cameras:
    """The colour and the depth camera of a file, known by what their topics contain."""

    def __init__(
        self, path: str | os.PathLike[str], colour: str | None, depth: str | None, R_C_K: FloatArray
    ):
        self._path, self._wanted, self._R_C_K = path, {"colour": colour, "depth": depth}, R_C_K
        self._lenses: dict[str, Intrinsics] = {}
        self._transforms = _transforms(path)
        self.chosen: dict[str, str] = {}
        self.found = StrapFound(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), [])

    def images(self) -> Iterator[tuple[str, ImageMessage]]:
        """Yield ("colour" or "depth", image) in the file's order; nothing is unpacked yet."""
        met: set[str] = set()
        for message in read_images(self._path):
            if isinstance(message, LensMessage):
                folder = message.topic.rpartition("/")[0]
                self._lenses[message.frame_id] = self._lenses[folder] = message.intrinsics
                continue
            met.add(message.topic)
            own = next((role for role, topic in self.chosen.items() if topic == message.topic), "")
            if not own and (own := self._role(message)) not in ("", *self.chosen):
                self.chosen[own] = message.topic
            if own and self.chosen[own] == message.topic:
                yield own, message
        missing = [role for role in ("colour", "depth") if role not in self.chosen]
        if missing:
            raise RecordingError(
                f"{self._path} has no {' and no '.join(missing)} images that can be read (images in it:"
                f" {', '.join(sorted(met)) or 'none'}); record colour and depth (16UC1)."
            )
        self.found.topics = self.chosen["colour"], self.chosen["depth"]

    def _role(self, message: ImageMessage) -> str:
        """What a topic's images are, by their first one; "" for infrared and what was not asked for."""
        role = "depth" if message.pixels().dtype != np.uint8 else "colour"
        wanted = self._wanted[role]
        is_other = is_infrared(message) if wanted is None else wanted not in message.topic
        return "" if is_other else role

    def camera(
        self, role: str, shape: tuple[int, ...], image: ImageMessage, reference: ImageMessage
    ) -> PlacedCamera:
        """The camera of an image with its place in {K}; {K} is in the depth camera (`reference`)."""
        own = self._lenses.get(image.frame_id) or self._lenses.get(self.chosen[role].rpartition("/")[0])
        if own is None:
            raise RecordingError(
                f"{self._path}: there is no CameraCalibration (or CameraInfo) for the images of frame"
                f" {image.frame_id!r}; record it."
            )
        height, width = shape[:2]
        if abs(height / own.height - width / own.width) > 0.01:
            raise RecordingError(
                f"{self._path}: the intrinsics of frame {image.frame_id!r} are for {own.width} x {own.height}"
                f" pixels, its images have {width} x {height}."
            )
        between = transform_between(self._transforms, reference.frame_id, image.frame_id)
        if between is None:
            apart = f"no transform links {reference.frame_id} and {image.frame_id}"
            if (note := f"{apart}: both are assumed at one place") not in self.found.notes:
                self.found.notes.append(note)
        R, t = between or (np.eye(3), np.zeros(3))
        return PlacedCamera(own.resized(width, height), R @ self._R_C_K, t)


def _transforms(path: str | os.PathLike[str]) -> Transforms:
    """The tree of frames of a file (Foxglove's transforms), as last stated."""

    def decode(message: McapMessage) -> Iterator[tuple[str, tuple[str, FloatArray, FloatArray]]]:
        own = parsed(message.topic.schema, message.data)
        for each in own.transforms if hasattr(own, "transforms") else [own]:
            q, t = each.rotation, each.translation
            R = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()  # ValueError of zeros
            yield each.child_frame_id, (each.parent_frame_id, R, np.array([t.x, t.y, t.z]))

    return dict(decoded_messages(path, lambda t: t.schema in (TRANSFORMS, TRANSFORMS[:-1]), decode))


def transform_between(
    transforms: Transforms, source: str, target: str
) -> tuple[FloatArray, FloatArray] | None:
    """R and t with p_target = R p_source + t; None where the two frames do not hang together."""

    def to_root(frame: str) -> dict[str, tuple[FloatArray, FloatArray]]:
        poses, R, t = {frame: (np.eye(3), np.zeros(3))}, np.eye(3), np.zeros(3)
        while frame in transforms and len(poses) < 50:
            parent, own, shift = transforms[frame]
            R, t, frame = own @ R, own @ t + shift, parent
            poses[frame] = (R, t)
        return poses

    here, there = to_root(source), to_root(target)
    shared = next((frame for frame in here if frame in there), None)
    if shared is None:
        return None
    (R, t), (back, shift) = here[shared], there[shared]
    return back.T @ R, back.T @ (t - shift)


COLOUR, DEPTH = "colour", "depth"


def write_strap_recording(
    path: str | os.PathLike[str],
    recording: Recording,
    images: Sequence[StrapView],
    times: FloatArray,  # (n,) s
    cameras: tuple[PlacedCamera, PlacedCamera],
    depth_later_s: float,
    *,
    force: bool = False,
) -> None:
    """Write the recording, its images, both lenses and the cameras' relative pose."""
    stamp = nanoseconds(times, recording.origin_ns)
    later = stamp + round(1e9 * depth_later_s)
    colour, depth = cameras
    beside = {"parent_frame_id": DEPTH, "child_frame_id": COLOUR, "rotation": {"w": 1.0}}
    offset = dict(zip("xyz", (-colour.t_C_K).tolist(), strict=True))  # in the depth camera
    frames = message_class(TRANSFORMS)(transforms=[{**beside, "translation": offset}])
    once = {
        (f"/{COLOUR}/calibration", CAMERA_CALIBRATION): lens_message(COLOUR, colour.lens, int(stamp[0])),
        (f"/{DEPTH}/calibration", CAMERA_CALIBRATION): lens_message(DEPTH, depth.lens, int(stamp[0])),
        ("/tf", TRANSFORMS): bytes(frames.SerializeToString(deterministic=True)),
    }

    with writing(path, force) as temporary, Output(temporary) as output:
        streams = recording_streams(output, as_file(recording))
        for (topic, schema), data in once.items():  # they apply from the first image on
            streams.append(output.each(topic, schema, stamp[:1], [data].__getitem__))

        def jpeg(row: int) -> bytes:
            return jpeg_image(COLOUR, images[row].grey, stamp[row])

        def depth_image(row: int) -> bytes:
            return raw_image(DEPTH, "16UC1", images[row].depth_mm, later[row])

        streams.append(output.each(f"/{COLOUR}/image", COMPRESSED_IMAGE, stamp, jpeg))
        streams.append(output.each(f"/{DEPTH}/image", RAW_IMAGE, later, depth_image))
        output.write(streams)
