"""A simulated arm's recording with colour and depth images, as MCAP."""

from __future__ import annotations

import os
from collections.abc import Sequence
from itertools import islice
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib.intrinsics import PlacedCamera

from ...array_types import FloatArray, IntArray
from ...recording import Recording
from ...runtime.outputs import writing
from ..mcap.merge import Output, OutputStream
from ..mcap.stamps import nanoseconds
from ..recording.write import as_file, recording_streams
from ..wire.schemas import message_class
from .image_messages import (
    CAMERA_CALIBRATION,
    COMPRESSED_IMAGE,
    RAW_IMAGE,
    TRANSFORMS,
    jpeg_image,
    lens_message,
    raw_image,
)

COLOUR, DEPTH = "colour", "depth"


class ImagePair(Protocol):
    """A colour image and the depth image after it."""

    @property
    def grey(self) -> NDArray[np.uint8]:
        """Brightness (height, width)."""

    @property
    def depth_mm(self) -> NDArray[np.uint16]:
        """Depth (height, width), mm; 0 where there is none."""


def write_strap_recording(
    path: str | os.PathLike[str],
    recording: Recording,
    images: Sequence[ImagePair],
    times: FloatArray,
    cameras: tuple[PlacedCamera, PlacedCamera],
    depth_later_s: float,
    *,
    force: bool = False,
) -> None:
    """Write the recording, its images, both lenses and how the cameras stand to each other.

    Parameters
    ----------
    path : path-like
        The file.
    recording : Recording
        The arm and its IMU.
    images : sequence of ImagePair, length n
        Colour and depth.
    times : ndarray, shape (n,), s
        Of the colour images, on the camera's clock.
    cameras : (PlacedCamera, PlacedCamera)
        Colour and depth camera; the depth camera is where the skeleton's frame is.
    depth_later_s : float, s
        From a colour image to its depth image.
    force : bool
        Replace a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    stamp = nanoseconds(times, recording.origin_ns)
    later = stamp + round(1e9 * depth_later_s)
    colour, depth = cameras
    with writing(path, force) as temporary, Output(temporary) as output:
        streams = recording_streams(output, as_file(recording))
        for frame, camera in ((COLOUR, colour), (DEPTH, depth)):
            channel = output.channel(f"/{frame}/calibration", CAMERA_CALIBRATION)
            streams.append(_once(channel, stamp, lens_message(frame, camera.lens, int(stamp[0]))))
        streams.append(_once(output.channel("/tf", TRANSFORMS), stamp, _beside(colour)))
        channel = output.channel(f"/{COLOUR}/image", COMPRESSED_IMAGE)
        streams.append(
            OutputStream(
                channel,
                stamp,
                lambda rows: [
                    jpeg_image(COLOUR, pair.grey, int(at))
                    for pair, at in zip(images[rows], stamp[rows], strict=True)
                ],
            )
        )
        channel = output.channel(f"/{DEPTH}/image", RAW_IMAGE)
        streams.append(
            OutputStream(
                channel,
                later,
                lambda rows: [
                    raw_image(DEPTH, "16UC1", pair.depth_mm, int(at))
                    for pair, at in zip(images[rows], later[rows], strict=True)
                ],
            )
        )
        output.write(streams)


def _once(channel: int, stamp: IntArray, data: bytes) -> OutputStream:
    """A message that holds from the first image on."""
    return OutputStream(channel, stamp[:1], lambda rows: list(islice([data], rows.start, rows.stop)))


def _beside(colour: PlacedCamera) -> bytes:
    """Where the colour camera stands in the depth camera's image axes."""
    message = message_class(TRANSFORMS)()
    transform = message.transforms.add(parent_frame_id=DEPTH, child_frame_id=COLOUR)
    transform.rotation.w = 1.0
    offset = -colour.t_C_K
    transform.translation.x, transform.translation.y, transform.translation.z = offset.tolist()
    return bytes(message.SerializeToString(deterministic=True))
