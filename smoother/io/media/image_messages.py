"""Images and lenses as Foxglove messages."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib.intrinsics import Intrinsics

from ..wire.schemas import message_class

CAMERA_CALIBRATION, RAW_IMAGE = "foxglove.CameraCalibration", "foxglove.RawImage"
COMPRESSED_IMAGE, TRANSFORMS = "foxglove.CompressedImage", "foxglove.FrameTransforms"
_JPEG_QUALITY = 90


def raw_image(frame: str, encoding: str, image: NDArray[np.uint16], time_ns: int) -> bytes:
    """An image (height, width) of 16 bits a pixel as `foxglove.RawImage`."""
    message = message_class(RAW_IMAGE)(
        frame_id=frame,
        width=image.shape[1],
        height=image.shape[0],
        encoding=encoding,
        step=2 * image.shape[1],
        data=np.ascontiguousarray(image, "<u2").tobytes(),
    )
    message.timestamp.FromNanoseconds(time_ns)
    return bytes(message.SerializeToString(deterministic=True))


def jpeg_image(frame: str, grey: NDArray[np.uint8], time_ns: int) -> bytes:
    """A grey image (height, width) in three colours as `foxglove.CompressedImage`, JPEG."""
    import cv2

    colours = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    _, packed = cv2.imencode(".jpg", colours, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    message = message_class(COMPRESSED_IMAGE)(frame_id=frame, data=packed.tobytes(), format="jpeg")
    message.timestamp.FromNanoseconds(time_ns)
    return bytes(message.SerializeToString(deterministic=True))


def lens_message(frame: str, lens: Intrinsics, time_ns: int) -> bytes:
    """A lens as `foxglove.CameraCalibration`."""
    fx, fy, cx, cy = lens.fx, lens.fy, lens.cx, lens.cy
    message = message_class(CAMERA_CALIBRATION)(
        frame_id=frame,
        width=lens.width,
        height=lens.height,
        distortion_model="plumb_bob",
        D=lens.distortion,
        K=[fx, 0, cx, 0, fy, cy, 0, 0, 1],
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=[fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
    )
    message.timestamp.FromNanoseconds(time_ns)
    return bytes(message.SerializeToString(deterministic=True))
