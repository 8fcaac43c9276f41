"""Sessions with the panel: read from an MCAP recording, and simulated ones written as folder or MCAP.

A session holds images by pose, the lens, markers, and two IMUs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.file import to_toml
from calib.images import View, view
from calib.intrinsics import Intrinsics

from ...array_types import FloatArray
from ...errors import RecordingError, UnoccludeError
from ...recording import ImuStream
from ...runtime.outputs import check_output, writing, writing_folder
from ..mcap.container import Container
from ..mcap.merge import Output, OutputStream
from ..mcap.messages import SECOND_NS, Topic, nanoseconds, seconds
from ..recording.choose import choose_imu
from ..recording.clean import clean_imu
from ..recording.read import open_recording
from ..recording.streams import ImuSamples
from ..recording.write import imu_messages
from ..wire.cdr import markers_of
from ..wire.layout import BROKEN
from ..wire.schemas import message_class, parsed
from .images import (
    CAMERA_CALIBRATION,
    RAW_IMAGE,
    ImageMessage,
    LensMessage,
    lens_message,
    raw_image,
    read_images,
)

#: Depth and infrared image of one exposure have stamps this near, s.
PAIR_S = 0.02
#: Pairs that follow sooner than this belong to one pose, of which the middle one is taken, s.
POSE_S = 1.0
_INFRARED = ("infrared", "/ir", "_ir", "amplitude", "intensity")


@dataclass(frozen=True)
class PanelSession:
    """What a recording of a session contains."""

    views: list[View]  # A pair of images a pose
    times_s: list[float]  # Of the views
    panel: ImuStream  # The IMU on the panel and the one on the camera; times as in `times_s`
    base: ImuStream  # The IMU on the panel and the one on the camera; times as in `times_s`
    lens: Intrinsics  # Of the depth camera
    notes: list[str]  # What was dropped, one sentence each


def read_session(
    path: str | os.PathLike[str],
    panel_topic: str = "panel",
    base_topic: str = "base",
    lens: Intrinsics | None = None,
) -> PanelSession:
    """Read the panel's images and the IMUs on panel and camera."""
    file = open_recording(path)
    notes = list(file.notes)
    streams: list[ImuStream] = []
    stamped = []
    for name in (panel_topic, base_topic):
        kept, dropped = clean_imu(choose_imu(file, name), str(path))
        notes += dropped
        stamped.append(kept)
    if stamped[0].topic == stamped[1].topic:
        raise RecordingError(f"{path}: {stamped[0].topic} cannot be on the panel and on the camera.")
    origin = int(min(kept.stamp_ns[0] for kept in stamped))
    for kept in stamped:
        name = kept.topic.rpartition("/")[2]
        streams.append(ImuStream(name, seconds(kept.stamp_ns, origin), kept.acc, kept.gyro, kept.mag))
    pairs, lens = read_pairs(path, lens)
    views, times = [], []
    for depth, infrared in pairs:
        t_s = (depth.stamp_ns - origin) / 1e9
        views.append(view(depth.pixels(), infrared.pixels(), f"{Path(path).name} at {t_s:.2f} s"))
        times.append(t_s)
    return PanelSession(views, times, streams[0], streams[1], lens, notes)


def read_pairs(
    path: str | os.PathLike[str], lens: Intrinsics | None = None, notes: list[str] | None = None
) -> tuple[list[tuple[ImageMessage, ImageMessage]], Intrinsics]:
    """Depth and infrared images of one exposure each, one pair a pose, and the depth camera's lens."""
    found: dict[bool, list[ImageMessage]] = {True: [], False: []}
    lenses: list[LensMessage] = []
    for message in read_images(path, notes=notes):
        if isinstance(message, LensMessage):
            lenses.append(message)
            continue
        name = f"{message.topic}/{message.frame_id}".lower()
        if any(word in message.topic.lower() for word in _INFRARED):
            found[False].append(message)
        elif "depth" in message.topic.lower() or ("depth" in name and message.encoding == "16UC1"):
            found[True].append(message)
    if not found[True] or not found[False]:
        lacks = "depth (16UC1, mm)" if not found[True] else "infrared"
        raise RecordingError(
            f"{path} has no {lacks} images on a topic that is named so; record /../depth and /../infrared."
        )
    stamps = np.array([image.stamp_ns for image in found[False]])
    pairs = []
    for depth in sorted(found[True], key=lambda image: image.stamp_ns):
        nearest = int(np.argmin(np.abs(stamps - depth.stamp_ns)))
        if abs(stamps[nearest] - depth.stamp_ns) <= PAIR_S * 1e9:
            pairs.append((depth, found[False][nearest]))
    if not pairs:
        raise RecordingError(
            f"{path}: depth and infrared images have no stamps in common; record them together."
        )
    times = np.array([depth.stamp_ns for depth, _ in pairs]) / 1e9
    runs = np.split(np.arange(len(pairs)), np.flatnonzero(np.diff(times) > POSE_S) + 1)
    named = [lens for lens in lenses if lens.frame_id == pairs[0][0].frame_id] or [
        lens for lens in lenses if "depth" in lens.topic.lower()
    ]
    lens = lens or (named[0].intrinsics if named else None)
    if lens is None:
        raise RecordingError(
            f"{path} has no lens (CameraCalibration, CameraInfo) of the depth camera; give --intrinsics."
        )
    return [pairs[run[len(run) // 2]] for run in runs], lens


#: Markers within this time of a pose's images are averaged, s.
ABOUT_S = 0.25
_SCENE, _ARRAY = "foxglove.SceneUpdate", "visualization_msgs/MarkerArray"
_NAMED = ("marker", "mocap")


def read_panel_session(
    path: str | os.PathLike[str],
    given: list[dict[str, FloatArray]],
    lens: Intrinsics | None,
    notes: list[str] | None = None,
) -> tuple[list[View], list[dict[str, FloatArray]], Intrinsics]:
    """Views of the panel, one per pose, with the mocap markers of their moment, and the lens."""
    path = Path(path)
    pairs, lens = read_pairs(path, lens, notes)
    if given and len(given) != len(pairs):
        raise RecordingError(
            f"{path} shows {len(pairs)} poses of the panel and --markers is given {len(given)} times; give it"
            " once per pose, in their order."
        )
    stamps = [depth.stamp_ns for depth, _ in pairs]
    first = stamps[0]
    views = [
        view(depth.pixels(), infrared.pixels(), f"{path.name} at {(depth.stamp_ns - first) / 1e9:.2f} s")
        for depth, infrared in pairs
    ]
    return views, given or _markers_at(path, stamps), lens


def _markers_at(path: Path, stamps: list[int]) -> list[dict[str, FloatArray]]:
    """Mean positions of the markers about every stamp."""
    tracks: list[dict[str, list[FloatArray]]] = [{} for _ in stamps]
    at = np.array(stamps)
    any_marker = False
    for stamp, name, position in _markers(path):
        any_marker = True
        nearest = int(np.argmin(np.abs(at - stamp)))
        if abs(at[nearest] - stamp) <= ABOUT_S * SECOND_NS:
            tracks[nearest].setdefault(name, []).append(position)
    if not any_marker:
        raise RecordingError(
            f"{path} has no mocap markers (SceneUpdate or MarkerArray on a topic named marker or mocap);"
            " give --markers once per pose."
        )
    for stamp, track in zip(stamps, tracks, strict=True):
        if not track:
            raise RecordingError(
                f"{path}: there are no mocap markers at the time of the images at"
                f" {(stamp - stamps[0]) / 1e9:.2f} s."
            )
    return [{name: np.mean(each, axis=0) for name, each in track.items()} for track in tracks]


def _markers(path: Path) -> Iterator[tuple[int, str, FloatArray]]:
    """Stamp (ns), name and position (3,) m of every marker in the file."""
    for message in Container(path).messages(_wanted):
        with suppress(*BROKEN):  # the other messages may be intact
            if message.topic.schema == _SCENE:
                yield from _scene_markers(message.data, message.log_ns)
                continue
            layout = markers_of(message.topic.schema_data)(message.data)
            if layout.counts["markers"]:
                block = np.frombuffer(message.data, np.uint8)[None]
                stamp = int(layout.stamps(block, np.array([message.log_ns]))[0])
                names, places = layout.many(block, "id")[0, :, 0], layout.many(block, "position")[0]
                for name, place in zip(names.tolist(), places.astype(float), strict=True):
                    yield stamp, str(name), place


def _wanted(topic: Topic) -> bool:
    schema = topic.schema.replace("/msg/", "/")
    return schema in (_SCENE, _ARRAY) and any(word in topic.name.lower() for word in _NAMED)


def _scene_markers(payload: bytes, log_ns: int) -> Iterator[tuple[int, str, FloatArray]]:
    for entity in parsed(_SCENE, payload).entities:
        stamp = entity.timestamp.ToNanoseconds() or log_ns
        for number, sphere in enumerate(entity.spheres):
            name = entity.id if len(entity.spheres) == 1 else f"{entity.id}_{number + 1}"
            place = sphere.pose.position
            yield stamp, name, np.array([place.x, place.y, place.z])


DEPTH_TOPIC = "/camera/depth/image"
INFRARED_TOPIC = "/camera/infrared/image"
LENS_TOPIC = "/camera/depth/calibration"
MARKER_TOPIC = "/mocap/markers"
MOCAP = "mocap"
#: Markers are shown as spheres of this size, m.
SHOWN_M = 0.016
CAMERA = "depth_camera"
_TRUTH = "truth.toml"


@dataclass(frozen=True)
class PanelShot:
    """What is written of one pose."""

    t_s: float  # Time of the images
    depth: NDArray[np.uint16]  # (height, width): depth in mm, 0 where there is none
    infrared: NDArray[np.uint16]  # (height, width): depth in mm, 0 where there is none
    marker_names: Sequence[str]  # Of the mocap
    markers: FloatArray  # (n, 3) m: their positions


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
    shots: Sequence[PanelShot],
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
        for number, shot in enumerate(shots, 1):
            name = f"pose_{number:02d}"
            for what, image in (("depth", shot.depth), ("infrared", shot.infrared)):
                _, packed = cv2.imencode(".png", image)
                (folder / f"{name}_{what}.png").write_bytes(packed.tobytes())
            _write_markers(folder / f"{name}_markers.csv", shot)
            for imu in imus:
                near = imu.select(np.abs(imu.t_s - shot.t_s) <= half_s)
                _write_imu(folder / f"{name}_imu_{imu.name}.csv", near)
        for file_name, document in tables.items():
            (folder / file_name).write_text(to_toml(document), encoding="utf-8")


def write_panel_recording(
    path: str | os.PathLike[str],
    shots: Sequence[PanelShot],
    imus: Sequence[ImuStream],
    lens: dict[str, Any],
    *,
    force: bool = False,
) -> None:
    """Write the session as MCAP: depth (16UC1, mm) and infrared images, lens, mocap markers, IMU samples."""
    stamp = nanoseconds(np.array([shot.t_s for shot in shots]), 0)
    numbers = {key: float(lens[key]) for key in ("fx", "fy", "cx", "cy")}
    seen = Intrinsics(lens["width"], lens["height"], **numbers, distortion=tuple(lens["distortion"]))
    with writing(path, force) as temporary, Output(temporary) as output:

        def stream(topic: str, schema: str, encode: Callable[[PanelShot, int], bytes]) -> OutputStream:
            def rows(part: slice) -> list[bytes]:
                return [encode(*each) for each in zip(shots[part], stamp[part].tolist(), strict=True)]

            return OutputStream(output.channel(topic, schema), stamp, rows)

        samples = [
            ImuSamples(f"/imu/{i.name}", i.name, nanoseconds(i.t_s, 0), i.acc, i.gyro, i.mag) for i in imus
        ]
        lens_channel = output.channel(LENS_TOPIC, CAMERA_CALIBRATION)
        lens_data = [lens_message(CAMERA, seen, int(stamp[0]))]
        output.write(
            [
                *(imu_messages(output, each) for each in samples),
                stream(DEPTH_TOPIC, RAW_IMAGE, lambda shot, at: raw_image(CAMERA, "16UC1", shot.depth, at)),
                stream(
                    INFRARED_TOPIC, RAW_IMAGE, lambda shot, at: raw_image(CAMERA, "mono16", shot.infrared, at)
                ),
                OutputStream(lens_channel, stamp[:1], lambda part: lens_data[part]),
                stream(MARKER_TOPIC, _SCENE, _scene),
            ]
        )


def _scene(shot: PanelShot, time_ns: int) -> bytes:
    """A sphere a marker, in the mocap's frame."""
    size, colour = dict.fromkeys("xyz", SHOWN_M), dict.fromkeys("rgba", 1.0)
    message = message_class(_SCENE)()
    for name, position in zip(shot.marker_names, shot.markers, strict=True):
        place = dict(zip("xyz", position.tolist(), strict=True))
        sphere = {"pose": {"position": place, "orientation": {"w": 1.0}}, "size": size, "color": colour}
        entity = message.entities.add(frame_id=MOCAP, id=name, spheres=[sphere])
        entity.timestamp.FromNanoseconds(time_ns)
    return bytes(message.SerializeToString(deterministic=True))


def _write_markers(path: Path, shot: PanelShot) -> None:
    rows = zip(shot.marker_names, shot.markers, strict=True)
    lines = [f"{name},{x:.6f},{y:.6f},{z:.6f}" for name, (x, y, z) in rows]
    path.write_text("\n".join(["marker,x,y,z", *lines, ""]), encoding="utf-8")


def _write_imu(path: Path, imu: ImuStream) -> None:
    columns = [imu.t_s[:, None], imu.acc, imu.gyro]
    header = "t_s,ax,ay,az,gx,gy,gz"
    if imu.mag is not None:
        columns.append(imu.mag)
        header += ",mx,my,mz"
    np.savetxt(path, np.hstack(columns), fmt="%.9g", delimiter=",", header=header, comments="")
