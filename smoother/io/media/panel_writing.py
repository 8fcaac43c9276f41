"""A simulated panel session as a folder of images and tables, and as an MCAP recording."""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib.file import to_toml
from calib.intrinsics import Intrinsics

from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...recording import ImuStream
from ...runtime.outputs import (
    check_output,
    locked_folder,
    remove_stale_tempfiles,
    temporary_name,
    umask,
    writing,
)
from ..mcap.merge import Output, OutputStream
from ..mcap.stamps import nanoseconds
from ..recording.streams import ImuSamples
from ..recording.write import imu_messages
from ..wire.schemas import message_class
from .images import CAMERA_CALIBRATION, RAW_IMAGE, lens_message, raw_image

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
    """What is written of one pose.

    Attributes
    ----------
    t_s : float, s
        Time of the images.
    depth, infrared : ndarray of uint16, shape (height, width)
        Depth in mm, 0 where there is none.
    marker_names : sequence of str
        Of the mocap.
    markers : ndarray, shape (n, 3), m
        Their positions.
    """

    t_s: float
    depth: NDArray[np.uint16]
    infrared: NDArray[np.uint16]
    marker_names: Sequence[str]
    markers: FloatArray


@contextmanager
def writing_folder(path: str | os.PathLike[str], force: bool = False) -> Iterator[Path]:
    """Yield a folder beside `path` to write into; it becomes `path` when all went well.

    Raises
    ------
    UnoccludeError
        See `check_folder`; or writing failed.
    """
    target = Path(path)
    check_folder(target, force)
    beside = temporary_name(target)
    old = beside.with_suffix(".old")
    try:
        remove_stale_tempfiles(target.absolute().parent)
        with locked_folder(beside):
            yield beside
            beside.chmod(stat.S_IMODE(target.stat().st_mode) if target.exists() else 0o777 & ~umask())
            if target.exists():
                target.rename(old)
            beside.rename(target)
    except OSError as error:
        full = "; make room and run again" if error.errno == errno.ENOSPC else ""
        raise UnoccludeError(f"{path} could not be written: {error.strerror or error}{full}.") from error
    finally:
        shutil.rmtree(beside, ignore_errors=True)
        if old.exists() and not target.exists():
            old.rename(target)
        shutil.rmtree(old, ignore_errors=True)


def check_folder(path: Path, force: bool = False) -> None:
    """Refuse a folder that could not be written in the end, before any work is done for it.

    With `force`, only a folder that a simulation wrote is replaced: never one that holds other things.

    Raises
    ------
    UnoccludeError
        `path` is a file, is a folder that must not be replaced, or has no folder to lie in.
    """
    if path.is_dir() and any(path.iterdir()):
        if not force:
            raise UnoccludeError(f"{path} exists already; give another name, or --force to replace it.")
        if not (path / _TRUTH).is_file():
            raise UnoccludeError(f"{path} holds other things than a simulation; give another name.")
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
    """Write images, mocap markers and IMU samples of every pose, and TOML tables.

    Parameters
    ----------
    path : path-like
        The folder; it appears only when it is whole.
    shots : sequence of PanelShot
        The poses.
    imus : sequence of ImuStream
        On the panel and on the camera; each pose gets the samples within `half_s` of its images.
    half_s : float, s
        See `imus`.
    tables : dict of str to dict
        TOML documents by file name.
    force : bool
        Replace a folder that exists.

    Raises
    ------
    UnoccludeError
        See `writing_folder`.
    """
    import cv2

    with writing_folder(path, force) as folder:
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
    """Write the session as MCAP: depth (16UC1, mm) and infrared images, lens, mocap markers, IMU samples.

    Parameters
    ----------
    lens : dict
        Width, height, fx, fy, cx, cy, distortion.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    stamp = nanoseconds(np.array([shot.t_s for shot in shots]), 0)
    with writing(path, force) as temporary, Output(temporary) as output:
        streams = [
            imu_messages(
                output,
                ImuSamples(f"/imu/{i.name}", i.name, nanoseconds(i.t_s, 0), i.acc, i.gyro, i.mag),
            )
            for i in imus
        ]
        for topic, encoding, images in (
            (DEPTH_TOPIC, "16UC1", [shot.depth for shot in shots]),
            (INFRARED_TOPIC, "mono16", [shot.infrared for shot in shots]),
        ):
            streams.append(_images(output, topic, encoding, stamp, images))
        streams.append(_lens(output, lens, stamp[:1]))
        streams.append(_marker_stream(output, stamp, shots))
        output.write(streams)


def _images(
    output: Output, topic: str, encoding: str, stamp: NDArray[np.int64], images: Sequence[NDArray]
) -> OutputStream:
    def encode(rows: slice) -> list[bytes]:
        return [
            raw_image(CAMERA, encoding, image, int(at))
            for at, image in zip(stamp[rows], images[rows], strict=True)
        ]

    return OutputStream(output.channel(topic, RAW_IMAGE), stamp, encode)


def _lens(output: Output, lens: dict[str, Any], stamp: NDArray[np.int64]) -> OutputStream:
    numbers = {key: float(lens[key]) for key in ("fx", "fy", "cx", "cy")}
    seen = Intrinsics(lens["width"], lens["height"], **numbers, distortion=tuple(lens["distortion"]))
    data = lens_message(CAMERA, seen, int(stamp[0]))
    channel = output.channel(LENS_TOPIC, CAMERA_CALIBRATION)
    return OutputStream(channel, stamp, lambda rows: [data] * len(stamp[rows]))


def _marker_stream(output: Output, stamp: NDArray[np.int64], shots: Sequence[PanelShot]) -> OutputStream:
    """A sphere a marker, in the mocap's frame."""

    def encode(part: slice) -> list[bytes]:
        out = []
        for at, shot in zip(stamp[part], shots[part], strict=True):
            message = message_class("foxglove.SceneUpdate")()
            for name, position in zip(shot.marker_names, shot.markers, strict=True):
                entity = message.entities.add(frame_id=MOCAP, id=name)
                entity.timestamp.FromNanoseconds(int(at))
                sphere = entity.spheres.add()
                sphere.pose.position.x, sphere.pose.position.y, sphere.pose.position.z = position.tolist()
                sphere.pose.orientation.w = 1.0
                sphere.size.x = sphere.size.y = sphere.size.z = SHOWN_M
                sphere.color.r = sphere.color.g = sphere.color.b = sphere.color.a = 1.0
            out.append(message.SerializeToString(deterministic=True))
        return out

    return OutputStream(output.channel(MARKER_TOPIC, "foxglove.SceneUpdate"), stamp, encode)


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
