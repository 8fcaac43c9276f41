"""Images and lenses in MCAP files: Foxglove's and ROS 2's messages, read and written."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.images import unpacked
from calib.intrinsics import Intrinsics

from ...errors import RecordingError
from ..mcap.container import Container
from ..mcap.messages import SECOND_NS, McapMessage, Topic
from ..wire.cdr import values_of
from ..wire.layout import BROKEN
from ..wire.schemas import message_class, parsed

CAMERA_CALIBRATION, RAW_IMAGE = "foxglove.CameraCalibration", "foxglove.RawImage"
COMPRESSED_IMAGE, TRANSFORMS = "foxglove.CompressedImage", "foxglove.FrameTransforms"
IMAGES = {RAW_IMAGE, COMPRESSED_IMAGE, "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"}
#: Words in the names of topics of infrared images.
_INFRARED = ("infrared", "/ir", "_ir", "amplitude")
LENSES = {CAMERA_CALIBRATION, "sensor_msgs/msg/CameraInfo"}
#: Encodings of uncompressed images: numpy's type and channels.
_ENCODINGS = {
    **dict.fromkeys(("mono8", "8UC1"), ("u1", 1)),
    **dict.fromkeys(("mono16", "16UC1"), ("u2", 1)),
    **dict.fromkeys(("rgb8", "bgr8"), ("u1", 3)),
    **dict.fromkeys(("rgba8", "bgra8"), ("u1", 4)),
    "32FC1": ("f4", 1),
}

Decoded = TypeVar("Decoded")


@dataclass(frozen=True)
class ImageMessage:
    """An image of a recording, still packed."""

    topic: str  # Where it came from
    frame_id: str  # Where it came from
    stamp_ns: int  # Its stamp; the log time where that is zero
    encoding: str  # Of the pixels; "" for a compressed image
    _unpack: Callable[[], NDArray]

    def pixels(self) -> NDArray:
        """(height, width) or (height, width, 3 or 4) pixels; a colour image as its encoding orders it."""
        try:
            return self._unpack()
        except (*BROKEN, KeyError) as error:
            raise RecordingError(
                f"{self.topic}: the image at {self.stamp_ns / 1e9:.3f} s cannot be read ({error}); "
                f"encodings read are {', '.join(_ENCODINGS)}, PNG and JPEG."
            ) from error


def is_infrared(image: ImageMessage) -> bool:
    """Whether a topic is named after infrared images."""
    return any(word in image.topic.lower() for word in _INFRARED)


@dataclass(frozen=True)
class LensMessage:
    """The lens of a recording's camera."""

    topic: str  # Where it came from
    frame_id: str  # Where it came from
    intrinsics: Intrinsics  # As OpenCV has them


def decoded_messages(
    path: str | os.PathLike[str],
    wanted: Callable[[Topic], bool],
    decode: Callable[[McapMessage], Iterator[Decoded]],
    what: str = "",
    notes: list[str] | None = None,
) -> Iterator[Decoded]:
    """What messages of wanted topics decode to, in the file's order; damaged ones are left out."""
    container, damaged = Container(path), 0
    for message in container.messages(wanted):
        try:
            yield from decode(message)
        except BROKEN:
            damaged += 1  # the others may be intact
    if notes is not None:
        notes += container.notes
        if damaged:
            notes.append(f"{container.path.name}: damaged messages of {what}, left out: {damaged}.")


def read_images(
    path: str | os.PathLike[str], notes: list[str] | None = None
) -> Iterator[ImageMessage | LensMessage]:
    """Yield images and lenses in the file's order; nothing is unpacked, memory stays flat."""
    return decoded_messages(path, lambda t: t.schema in IMAGES | LENSES, _decode, "images", notes)


def _decode(message: McapMessage) -> Iterator[ImageMessage | LensMessage]:
    """A message of Foxglove's (protobuf) or of ROS' (cdr), whose fields have the same names."""
    topic, schema = message.topic, message.topic.schema
    its: Callable[[str], Any]
    if topic.encoding == "protobuf":
        its = partial(getattr, parsed(schema, message.data))
        stamp, big = its("timestamp").ToNanoseconds(), False
    else:
        its = values_of(message.data, schema.replace("/msg/", "/")).__getitem__
        stamp = int(its("sec")[0]) * SECOND_NS + int(its("nsec")[0])
        big = schema.endswith("/Image") and bool(its("big")[0])

    def numbers(*names: str) -> tuple[int, ...]:
        return tuple(int(np.ravel(its(name))[0]) for name in names)

    named = topic.name, its("frame_id")
    if schema in LENSES:
        width, height = numbers("width", "height")
        yield _lens(*named, (width, height), its("distortion_model"), its("D"), its("K"))
    elif schema.endswith("CompressedImage"):
        yield ImageMessage(*named, stamp or message.log_ns, "", partial(_uncompressed, bytes(its("data"))))
    else:
        height, width, step = numbers("height", "width", "step")
        unpack = partial(_raw, bytes(its("data")), its("encoding"), height, width, step, big)
        yield ImageMessage(*named, stamp or message.log_ns, its("encoding"), unpack)


def _lens(
    topic: str, frame_id: str, size: tuple[int, int], model: str, distortion: Any, matrix: Any
) -> LensMessage:
    """Eight terms of the rational model are cut to five where the last three are zero."""
    terms, K = ([float(x) for x in values] for values in (distortion, matrix))
    if model not in ("plumb_bob", "rational_polynomial", "") or any(terms[5:]):
        raise RecordingError(
            f"{topic}: the distortion model {model or 'without a name'} with {len(terms)} terms is not "
            "read; give the lens with --intrinsics."
        )
    if len(K) < 9 or K[0] <= 0 or K[4] <= 0:
        raise ValueError("the camera is not calibrated")
    return LensMessage(topic, frame_id, Intrinsics(*size, K[0], K[4], K[2], K[5], tuple(terms[:5])))


def _raw(data: bytes, encoding: str, height: int, width: int, step: int, big: bool) -> NDArray:
    kind, channels = _ENCODINGS[encoding]
    dtype = np.dtype((">" if big else "<") + kind)
    row = width * channels * dtype.itemsize
    lines = np.frombuffer(data, np.uint8)[: height * (step or row)].reshape(height, step or row)[:, :row]
    pixels = np.ascontiguousarray(lines).view(dtype).astype(dtype.newbyteorder("="))
    return pixels if channels == 1 else pixels.reshape(height, width, channels)


def _uncompressed(data: bytes) -> NDArray:
    # ROS' compressedDepth puts twelve bytes of its own before the PNG.
    start = data.find(b"\x89PNG", 0, 64)
    return unpacked(data[max(start, 0) :])


_JPEG_QUALITY = 90


def serialized(schema: str, time_ns: int, **fields: Any) -> bytes:
    """A Foxglove message with a stamp."""
    message = message_class(schema)(**fields)
    message.timestamp.FromNanoseconds(int(time_ns))
    return bytes(message.SerializeToString(deterministic=True))


def raw_image(frame: str, encoding: str, image: NDArray, time_ns: int) -> bytes:
    """An image (height, width) of 16 bits a pixel as `foxglove.RawImage`."""
    height, width = image.shape
    size = {"width": width, "height": height, "step": 2 * width}
    data = np.ascontiguousarray(np.rint(image), "<u2").tobytes()
    return serialized(RAW_IMAGE, time_ns, frame_id=frame, encoding=encoding, data=data, **size)


def jpeg_image(frame: str, grey: NDArray[np.uint8], time_ns: int) -> bytes:
    """A grey image (height, width) in three colours as `foxglove.CompressedImage`, JPEG."""
    import cv2

    colours = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    _, packed = cv2.imencode(".jpg", colours, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return serialized(COMPRESSED_IMAGE, time_ns, frame_id=frame, data=packed.tobytes(), format="jpeg")


def lens_message(frame: str, lens: Intrinsics, time_ns: int) -> bytes:
    """A lens as `foxglove.CameraCalibration`."""
    K = [lens.fx, 0, lens.cx, 0, lens.fy, lens.cy, 0, 0, 1]
    matrices = {"K": K, "R": np.eye(3).ravel(), "P": [*K[:3], 0, *K[3:6], 0, *K[6:], 0]}
    size = {"width": lens.width, "height": lens.height}
    model = {"distortion_model": "plumb_bob", "D": lens.distortion}
    return serialized(CAMERA_CALIBRATION, time_ns, frame_id=frame, **size, **model, **matrices)
