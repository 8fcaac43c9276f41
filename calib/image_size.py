"""Packed images: looked at before they are unpacked, since some bytes may state gigabytes."""

from __future__ import annotations

import os
import struct

import numpy as np
from numpy.typing import NDArray

#: A larger image is none of a camera; 111 bytes of PNG may state a thousand times as much.
MOST_PIXELS = 1 << 26
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
#: JPEG's markers of frames: they hold height and width.
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}


def unpacked(packed: bytes, others: bool = False) -> NDArray:
    """The pixels of an image, by OpenCV.

    Parameters
    ----------
    packed : bytes
        The file.
    others : bool
        Also unpack other formats than PNG and JPEG.

    Returns
    -------
    ndarray, shape (height, width) or (height, width, channels)
        As they are stored.

    Raises
    ------
    ValueError
        It is damaged, or larger than any camera's image.
    """
    # What OpenCV itself holds for too large; it looks at it once, when it unpacks its first image.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))
    import cv2

    stated_size(packed, others)
    _check_chunks(packed)
    try:
        image = cv2.imdecode(np.frombuffer(packed, np.uint8), cv2.IMREAD_UNCHANGED) if packed else None
    except cv2.error as error:  # formats whose size is not looked at before
        raise ValueError(f"it is damaged, or larger than {MOST_PIXELS} pixels") from error
    if image is None:
        raise ValueError("it is damaged")
    return np.asarray(image)


def stated_size(packed: bytes, others: bool = False) -> tuple[int, int]:
    """Width and height of a PNG or a JPEG.

    Parameters
    ----------
    packed : bytes
        The file.
    others : bool
        Pass over images of other formats; their size is zero.

    Returns
    -------
    width, height : int

    Raises
    ------
    ValueError
        It is neither, breaks off before it states its size, or is larger than any camera's image.
    """
    try:
        if packed[: len(_PNG)] == _PNG:
            width, height = struct.unpack_from(">II", packed, 16)
        elif packed[: len(_JPEG)] == _JPEG:
            width, height = _jpeg_size(packed)
        else:
            if others:
                return 0, 0
            raise ValueError("neither PNG nor JPEG")
    except (struct.error, IndexError) as error:
        raise ValueError("the image breaks off") from error
    if width * height > MOST_PIXELS:
        raise ValueError(f"it states {width} x {height} pixels, which no camera has")
    return width, height


def _jpeg_size(packed: bytes) -> tuple[int, int]:
    place = len(_JPEG)
    while True:
        while packed[place] == 0xFF:
            place += 1
        marker = packed[place]
        if marker in _FRAMES:
            height, width = struct.unpack_from(">HH", packed, place + 4)
            return width, height
        if not marker:
            raise ValueError("the image is damaged")
        place += 1 + struct.unpack_from(">H", packed, place + 1)[0]


def _check_chunks(packed: bytes) -> None:
    """Refuse a PNG whose chunks reach beyond its end: OpenCV takes memory for as much as they state."""
    place = len(_PNG)
    while packed[: len(_PNG)] == _PNG and place + 8 <= len(packed):
        length, kind = struct.unpack_from(">I4s", packed, place)
        place += 12 + length
        if place > len(packed):
            raise ValueError("the image breaks off")
        if kind == b"IEND":
            return
