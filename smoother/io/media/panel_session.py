"""A session with the panel from an MCAP file: pairs of depth and infrared images, the lens, and two IMUs."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calib.intrinsics import Intrinsics
from calib.panel.images import View, view

from ...errors import RecordingError
from ...recording import ImuStream
from ..mcap.stamps import seconds
from ..recording.clean import clean_imu
from ..recording.imu_choice import choose_imu
from ..recording.read import open_recording
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
