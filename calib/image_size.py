"""The size that a packed image states, looked at before it is unpacked."""

from __future__ import annotations

import struct

#: A larger image is none of a camera; 111 bytes of PNG may state a thousand times as much.
MOST_PIXELS = 1 << 26
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
#: JPEG's markers of frames: they hold height and width.
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}


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
