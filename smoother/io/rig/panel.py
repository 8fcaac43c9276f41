"""Sessions with the panel: read from an MCAP recording, and simulated ones written as folder or MCAP.

A session holds images by pose, the lens, markers, and two IMUs.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from calib.file import to_toml
from calib.images import View, view
from calib.intrinsics import Intrinsics

from ...array_types import FloatArray
from ...errors import RecordingError, UnoccludeError
from ...recording import ImuStream
from ...runtime.outputs import check_output, writing, writing_folder
from ..mcap.merge import Output
from ..mcap.messages import SECOND_NS, McapMessage, Topic, nanoseconds
from ..recording.choose import choose_imu
from ..recording.clean import clean_imu
from ..recording.read import open_recording
from ..recording.streams import ImuSamples
from ..recording.write import imu_messages
from ..tables.columns import IMU_COLUMNS
from ..wire.cdr import markers_of
from ..wire.schemas import message_class, parsed
from .images import (
    CAMERA_CALIBRATION,
    RAW_IMAGE,
    ImageMessage,
    LensMessage,
    decoded_messages,
    is_infrared,
    lens_message,
    raw_image,
    read_images,
)

if TYPE_CHECKING:
    from ...simulation.panel import PanelPose

#: Depth and infrared image of one exposure have stamps this near, s.
PAIR_S = 0.02
#: Pairs that follow sooner than this belong to one pose, of which the middle one is taken, s.
POSE_S = 1.0
#: Markers within this time of a pose's images are averaged, s.
ABOUT_S = 0.25
#: Depth and infrared image of one exposure.
Pair = tuple[ImageMessage, ImageMessage]
_SCENE, _ARRAY = "foxglove.SceneUpdate", "visualization_msgs/MarkerArray"


def read_session(
    path: str | os.PathLike[str],
    panel_topic: str = "panel",
    base_topic: str = "base",
    lens: Intrinsics | None = None,
) -> tuple[list[View], list[float], list[ImuStream], Intrinsics, list[str]]:
    """Views of the panel, one a pose, and their times, s; the IMUs on panel and camera on the same clock, the
    depth camera's lens, and what was dropped.
    """
    file = open_recording(path)
    cleaned = [clean_imu(choose_imu(file, name), str(path)) for name in (panel_topic, base_topic)]
    stamped = [kept for kept, _ in cleaned]
    notes = [*file.notes, *(note for _, dropped in cleaned for note in dropped)]
    if stamped[0].topic == stamped[1].topic:
        raise RecordingError(f"{path}: {stamped[0].topic} cannot be on the panel and on the camera.")
    origin = int(min(kept.stamp_ns[0] for kept in stamped))
    streams = [replace(kept.on_axis(origin), name=kept.topic.rpartition("/")[2]) for kept in stamped]
    pairs, lens = read_pairs(path, lens)
    times = [(depth.stamp_ns - origin) / 1e9 for depth, _ in pairs]
    return _views(pairs, times, path), times, streams, lens, notes


def read_panel_session(
    path: str | os.PathLike[str],
    given: list[dict[str, FloatArray]],
    lens: Intrinsics | None,
    notes: list[str] | None = None,
) -> tuple[list[View], list[dict[str, FloatArray]], Intrinsics]:
    """Views of the panel, one per pose, with the mocap markers of their moment, and the lens."""
    pairs, lens = read_pairs(path, lens, notes)
    if given and len(given) != len(pairs):
        raise RecordingError(
            f"{path} shows {len(pairs)} poses of the panel and --markers is given {len(given)} times; give it"
            " once per pose, in their order."
        )
    stamps = np.array([depth.stamp_ns for depth, _ in pairs])
    views = _views(pairs, ((stamps - stamps[0]) / 1e9).tolist(), path)
    return views, given or _markers_at(Path(path), stamps), lens


def _views(pairs: list[Pair], times_s: list[float], path: str | os.PathLike[str]) -> list[View]:
    return [
        view(depth.pixels(), infrared.pixels(), f"{Path(path).name} at {t_s:.2f} s")
        for (depth, infrared), t_s in zip(pairs, times_s, strict=True)
    ]


def read_pairs(
    path: str | os.PathLike[str], lens: Intrinsics | None = None, notes: list[str] | None = None
) -> tuple[list[Pair], Intrinsics]:
    """Depth and infrared images of one exposure each, one pair a pose, and the depth camera's lens."""
    depths: list[ImageMessage] = []
    infrareds: list[ImageMessage] = []
    lenses: list[LensMessage] = []
    for message in read_images(path, notes=notes):
        topic = message.topic.lower()
        if isinstance(message, LensMessage):
            lenses.append(message)
        elif is_infrared(message) or "intensity" in topic:
            infrareds.append(message)
        elif "depth" in topic or ("depth" in message.frame_id.lower() and message.encoding == "16UC1"):
            depths.append(message)
    if not depths or not infrareds:
        lacks = "infrared" if depths else "depth (16UC1, mm)"
        raise RecordingError(
            f"{path} has no {lacks} images on a topic that is named so; record /../depth and /../infrared."
        )
    depths.sort(key=lambda image: image.stamp_ns)
    stamps, times = (np.array([image.stamp_ns for image in of]) for of in (infrareds, depths))
    near = np.abs(times[:, None] - stamps).argmin(axis=1)
    paired = np.flatnonzero(np.abs(times - stamps[near]) <= PAIR_S * 1e9)
    if not len(paired):
        raise RecordingError(
            f"{path}: depth and infrared images have no stamps in common; record them together."
        )
    poses = np.split(paired, np.flatnonzero(np.diff(times[paired]) > POSE_S * 1e9) + 1)
    pairs = [(depths[k], infrareds[near[k]]) for k in (pose[len(pose) // 2] for pose in poses)]
    named = [each for each in lenses if each.frame_id == depths[paired[0]].frame_id]
    named += [each for each in lenses if "depth" in each.topic.lower()]
    if lens is None and not named:
        raise RecordingError(
            f"{path} has no lens (CameraCalibration, CameraInfo) of the depth camera; give --intrinsics."
        )
    return pairs, lens or named[0].intrinsics


def _markers_at(path: Path, stamps: NDArray[np.int64]) -> list[dict[str, FloatArray]]:
    """Mean positions of the markers about every stamp."""

    def wanted(topic: Topic) -> bool:
        schema, name = topic.schema.replace("/msg/", "/"), topic.name.lower()
        return schema in (_SCENE, _ARRAY) and ("marker" in name or "mocap" in name)

    tracks: list[dict[str, list[FloatArray]]] = [{} for _ in stamps]
    found = list(decoded_messages(path, wanted, _markers))
    if not found:
        raise RecordingError(
            f"{path} has no mocap markers (SceneUpdate or MarkerArray on a topic named marker or mocap);"
            " give --markers once per pose."
        )
    for stamp, name, position in found:
        nearest = int(np.argmin(np.abs(stamps - stamp)))
        if abs(stamps[nearest] - stamp) <= ABOUT_S * SECOND_NS:
            tracks[nearest].setdefault(name, []).append(position)
    for stamp, track in zip(stamps, tracks, strict=True):
        if not track:
            raise RecordingError(
                f"{path}: there are no mocap markers at the time of the images at"
                f" {(stamp - stamps[0]) / 1e9:.2f} s."
            )
    return [{name: np.mean(each, axis=0) for name, each in track.items()} for track in tracks]


def _markers(message: McapMessage) -> Iterator[tuple[int, str, FloatArray]]:
    """Stamp (ns), name and position (3,) m of every marker of a message."""
    if message.topic.schema == _SCENE:
        for entity in parsed(_SCENE, message.data).entities:
            stamp = entity.timestamp.ToNanoseconds() or message.log_ns
            for number, sphere in enumerate(entity.spheres, 1):
                name = entity.id if len(entity.spheres) == 1 else f"{entity.id}_{number}"
                place = sphere.pose.position
                yield stamp, name, np.array([place.x, place.y, place.z])
        return
    layout = markers_of(message.topic.schema_data)(message.data)
    if layout.counts["markers"]:
        block = np.frombuffer(message.data, np.uint8)[None]
        stamp = int(layout.stamps(block, np.array([message.log_ns]))[0])
        names, places = layout.many(block, "id")[0, :, 0], layout.many(block, "position")[0]
        for number, place in zip(names.tolist(), places.astype(float), strict=True):
            yield stamp, str(number), place


# ----------------------------------------------------------------------------------------- simulated sessions

DEPTH_TOPIC, INFRARED_TOPIC = "/camera/depth/image", "/camera/infrared/image"
LENS_TOPIC, MARKER_TOPIC = "/camera/depth/calibration", "/mocap/markers"
CAMERA, MOCAP = "depth_camera", "mocap"
#: Markers are shown as spheres of this size, m.
SHOWN_M = 0.016
_TRUTH = "truth.toml"


def check_folder(path: Path, force: bool = False) -> None:
    """Refuse a folder that could not be written in the end, before any work is done for it."""
    if path.is_dir() and any(path.iterdir()):
        if not force:
            raise UnoccludeError(f"{path} exists already; give another name, or --force to replace it.")
        if not (path / _TRUTH).is_file():
            raise UnoccludeError(f"{path} contains other things than a simulation; give another name.")
    elif not path.is_dir():
        if path.exists():
            raise UnoccludeError(f"{path} is a file; name a folder to write to.")
        check_output(path)


def write_panel_folder(
    path: str | os.PathLike[str],
    poses: Sequence[PanelPose],
    imus: Sequence[ImuStream],
    half_s: float,
    tables: dict[str, dict[str, Any]],
    *,
    force: bool = False,
) -> None:
    """Write images, mocap markers and IMU samples of every pose, and TOML tables."""
    import cv2

    check_folder(Path(path), force)
    with writing_folder(path) as folder:
        for number, pose in enumerate(poses, 1):
            name = f"pose_{number:02d}"
            for what, image in (("depth", pose.depth), ("infrared", pose.infrared)):
                _, packed = cv2.imencode(".png", np.rint(image).astype(np.uint16))
                (folder / f"{name}_{what}.png").write_bytes(packed.tobytes())
            markers = zip(pose.marker_names, pose.markers, strict=True)
            lines = ["marker,x,y,z", *(f"{each},{x:.6f},{y:.6f},{z:.6f}" for each, (x, y, z) in markers), ""]
            (folder / f"{name}_markers.csv").write_text("\n".join(lines), encoding="utf-8")
            for imu in imus:
                near = imu.select(np.abs(imu.t_s - pose.t_s) <= half_s)
                vectors = [values for values in (near.acc, near.gyro, near.mag) if values is not None]
                header = ",".join(["t_s", *IMU_COLUMNS[1 : 1 + 3 * len(vectors)]])
                rows = np.hstack([near.t_s[:, None], *vectors])
                file = folder / f"{name}_imu_{imu.name}.csv"
                np.savetxt(file, rows, fmt="%.9g", delimiter=",", header=header, comments="")
        for file_name, document in tables.items():
            (folder / file_name).write_text(to_toml(document), encoding="utf-8")


def write_panel_recording(
    path: str | os.PathLike[str],
    poses: Sequence[PanelPose],
    imus: Sequence[ImuStream],
    lens: Intrinsics,
    *,
    force: bool = False,
) -> None:
    """Write the session as MCAP: depth (16UC1, mm) and infrared images, lens, mocap markers, IMU samples."""
    stamp = nanoseconds(np.array([pose.t_s for pose in poses]), 0)
    of_lens = lens_message(CAMERA, lens, int(stamp[0]))
    samples = [ImuSamples.of(f"/imu/{each.name}", each, 0) for each in imus]
    with writing(path, force) as temporary, Output(temporary) as output:

        def depth(row: int) -> bytes:
            return raw_image(CAMERA, "16UC1", poses[row].depth, stamp[row])

        def infrared(row: int) -> bytes:
            return raw_image(CAMERA, "mono16", poses[row].infrared, stamp[row])

        output.write(
            [
                *(imu_messages(output, each) for each in samples),
                output.each(DEPTH_TOPIC, RAW_IMAGE, stamp, depth),
                output.each(INFRARED_TOPIC, RAW_IMAGE, stamp, infrared),
                output.each(LENS_TOPIC, CAMERA_CALIBRATION, stamp[:1], [of_lens].__getitem__),
                output.each(MARKER_TOPIC, _SCENE, stamp, lambda row: _scene(poses[row], int(stamp[row]))),
            ]
        )


def _scene(pose: PanelPose, time_ns: int) -> bytes:
    """A sphere a marker, in the mocap's frame."""
    size, colour = dict.fromkeys("xyz", SHOWN_M), dict.fromkeys("rgba", 1.0)
    message = message_class(_SCENE)()
    for name, position in zip(pose.marker_names, pose.markers, strict=True):
        place = dict(zip("xyz", position.tolist(), strict=True))
        sphere = {"pose": {"position": place, "orientation": {"w": 1.0}}, "size": size, "color": colour}
        entity = message.entities.add(frame_id=MOCAP, id=name, spheres=[sphere])
        entity.timestamp.FromNanoseconds(time_ns)
    return bytes(message.SerializeToString(deterministic=True))
