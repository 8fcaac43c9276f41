"""A session with the panel from an MCAP file: images by pose, the lens, markers, and two IMUs."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from calib.intrinsics import Intrinsics
from calib.panel.images import View, view

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import ImuStream
from ..mcap.container import Container
from ..mcap.messages import Topic
from ..mcap.stamps import SECOND_NS, ros_stamps, seconds
from ..recording.clean import clean_imu
from ..recording.read import open_recording
from ..recording.selection import choose_imu
from ..wire.layout import Grouper
from ..wire.schemas import parsed
from .images import ImageMessage, LensMessage, read_images

#: Depth and infrared image of one exposure have stamps this near, s.
PAIR_S = 0.02
#: Pairs that follow sooner than this belong to one pose, of which the middle one is taken, s.
POSE_S = 1.0
_INFRARED = ("infrared", "/ir", "_ir", "amplitude", "intensity")


@dataclass(frozen=True)
class PanelSession:
    """What a recording of a session holds.

    Attributes
    ----------
    views : list of View
        A pair of images a pose.
    times_s : list of float, s
        Of the views.
    panel, base : ImuStream
        The IMU on the panel and the one on the camera; times count as `times_s`.
    lens : Intrinsics, optional
        Of the depth camera, or None.
    notes : list of str
        What was dropped, one sentence each.
    """

    views: list[View]
    times_s: list[float]
    panel: ImuStream
    base: ImuStream
    lens: Intrinsics | None
    notes: list[str]


def read_session(
    path: str | os.PathLike[str], panel_topic: str = "panel", base_topic: str = "base"
) -> PanelSession:
    """Read the panel's images and the IMUs on panel and camera.

    Parameters
    ----------
    path : path-like
        The file.
    panel_topic, base_topic : str
        Topics of the IMUs, or parts of their names.

    Raises
    ------
    RecordingError
        The file cannot be read, or lacks the images or an IMU.
    """
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
    pairs, lens = read_pairs(path)
    views, times = [], []
    for depth, infrared in pairs:
        t_s = (depth.stamp_ns - origin) / 1e9
        views.append(view(depth.pixels(), infrared.pixels(), f"{Path(path).name} at {t_s:.2f} s"))
        times.append(t_s)
    return PanelSession(views, times, streams[0], streams[1], lens, notes)


def read_pairs(
    path: str | os.PathLike[str], notes: list[str] | None = None
) -> tuple[list[tuple[ImageMessage, ImageMessage]], Intrinsics | None]:
    """Depth and infrared images of one exposure each, one pair a pose, and the depth camera's lens.

    Parameters
    ----------
    path : path-like
        The file.
    notes : list of str, optional
        What is to be known of the file (it was cut off, a chunk is damaged) is added to it.

    Raises
    ------
    RecordingError
        There are no depth images, or no infrared images at their times.
    """
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
    return [pairs[run[len(run) // 2]] for run in runs], named[0].intrinsics if named else None


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
    """Views of the panel, one a pose, with the mocap markers of their moment, and the lens.

    Images that follow each other within a second belong to one pose, of which the middle one is taken.

    Parameters
    ----------
    path : path-like
        MCAP with depth and infrared images, and the markers as `foxglove.SceneUpdate` (a sphere a marker).
        or `visualization_msgs/MarkerArray` on a topic named `marker` or `mocap`, m.
    given : list of dict of str to ndarray
        Markers by pose that take the place of the recording's; may be empty.
    lens : Intrinsics, optional
        Takes the place of the recording's.
    notes : list of str, optional
        What is to be known of the file (it was cut off, a chunk is damaged) is added to it.

    Raises
    ------
    RecordingError
        The recording lacks images, markers or the lens.
    """
    path = Path(path)
    pairs, found_lens = read_pairs(path, notes)
    lens = lens or found_lens
    if lens is None:
        raise RecordingError(
            f"{path} holds no lens (CameraCalibration, CameraInfo) of the depth camera; give --intrinsics."
        )
    if given and len(given) != len(pairs):
        raise RecordingError(
            f"{path} shows {len(pairs)} poses of the panel and --markers is given {len(given)} times; give it"
            " once a pose, in their order."
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
            f"{path} holds no mocap markers (SceneUpdate or MarkerArray on a topic named marker or mocap);"
            " give --markers once a pose."
        )
    for stamp, track in zip(stamps, tracks, strict=True):
        if not track:
            raise RecordingError(
                f"{path}: there are no mocap markers about the images at {(stamp - stamps[0]) / 1e9:.2f} s."
            )
    return [{name: np.mean(each, axis=0) for name, each in track.items()} for track in tracks]


def _markers(path: Path) -> list[tuple[int, str, FloatArray]]:
    """Stamp (ns), name and position (3,) m of every marker in the file."""
    container = Container(path)
    found: list[tuple[int, str, FloatArray]] = []
    for batch in container.batches(_wanted):
        for position, messages in batch.items():
            topic = container.topics[position]
            payloads = [bytes(message.data) for message in messages]
            logs = [int(message.log_ns) for message in messages]
            if topic.schema == _SCENE:
                found += _scene_markers(payloads, logs)
            else:
                textured = b"texture_resource" in topic.schema_data or not topic.schema_data
                found += _array_markers(payloads, logs, textured)
    return found


def _wanted(topic: Topic) -> bool:
    schema = topic.schema.replace("/msg/", "/")
    return schema in (_SCENE, _ARRAY) and any(word in topic.name.lower() for word in _NAMED)


def _scene_markers(payloads: list[bytes], logs: list[int]) -> list[tuple[int, str, FloatArray]]:
    rows = []
    for payload, log in zip(payloads, logs, strict=True):
        try:
            entities = parsed(_SCENE, payload).entities
        except ValueError:
            continue  # a damaged message says nothing of the others
        for entity in entities:
            stamp = entity.timestamp.ToNanoseconds() or log
            for number, sphere in enumerate(entity.spheres):
                name = entity.id if len(entity.spheres) == 1 else f"{entity.id}_{number + 1}"
                place = sphere.pose.position
                rows.append((stamp, name, np.array([place.x, place.y, place.z])))
    return rows


def _array_markers(
    payloads: list[bytes], logs: list[int], textured: bool
) -> list[tuple[int, str, FloatArray]]:
    from ..wire.cdr import marker_array

    rows = []
    for index, block, layout in Grouper(partial(marker_array, textured=textured)).groups(payloads):
        if not layout.counts["markers"]:
            continue
        stamps = ros_stamps(block, layout)
        names = layout.many(block, "id")[:, :, 0]
        places = layout.many(block, "position").astype(float)
        for row, message in enumerate(index.tolist()):
            stamp = int(stamps[row]) or logs[message]
            rows += [(stamp, str(n), p) for n, p in zip(names[row].tolist(), places[row], strict=True)]
    return rows
