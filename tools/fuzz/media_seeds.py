"""The smallest images, sounds and Matlab files."""

from __future__ import annotations

import struct
from io import BytesIO

import numpy as np
from mcap.writer import CompressionType, Writer

from calib.intrinsics import Intrinsics
from smoother.io.media.images import (
    CAMERA_CALIBRATION,
    COMPRESSED_IMAGE,
    RAW_IMAGE,
    jpeg_image,
    lens_message,
    raw_image,
)
from smoother.io.wire.schemas import message_class

_NS = 1_700_000_000 * 10**9


def media_seeds() -> dict[str, list[bytes]]:
    """Inputs by target."""
    import cv2
    from scipy.io import savemat, wavfile

    grey = np.arange(64, dtype=np.uint16).reshape(8, 8)
    pictures = [cv2.imencode(".png", image)[1].tobytes() for image in (grey, grey.astype(np.uint8))]
    pictures.append(cv2.imencode(".jpg", grey.astype(np.uint8))[1].tobytes())
    sounds = []
    for kind in (np.int16, np.uint8, np.float32, np.int32):
        file = BytesIO()
        wavfile.write(file, 8000, np.arange(16).reshape(8, 2).astype(kind))
        sounds.append(file.getvalue())
    trial = BytesIO()
    savemat(trial, {"d_iner": np.ones((6, 6)), "d_skel": np.ones((20, 3, 4))}, do_compression=False)
    return {"picture": pictures, "sound": sounds, "matlab": [trial.getvalue()], "media": [_media(grey)]}


def _media(grey: np.ndarray) -> bytes:
    """A container of an image each kind, a lens and two blocks of sound."""
    audio = message_class("foxglove.RawAudio")(
        data=struct.pack("<8h", *range(8)), format="pcm-s16", sample_rate=8000, number_of_channels=1
    )
    audio.timestamp.FromNanoseconds(_NS)
    lens = Intrinsics(8, 8, 8.0, 8.0, 4.0, 4.0, (0.0,) * 5)
    messages = [
        (RAW_IMAGE, raw_image("depth", "16UC1", grey, _NS)),
        (COMPRESSED_IMAGE, jpeg_image("colour", grey.astype(np.uint8), _NS)),
        (CAMERA_CALIBRATION, lens_message("depth", lens, _NS)),
        ("foxglove.RawAudio", audio.SerializeToString()),
    ]
    file = BytesIO()
    writer = Writer(file, compression=CompressionType.NONE, enable_crcs=False)
    writer.start()
    for name, data in messages:
        schema = writer.register_schema(name, "protobuf", b"")
        channel = writer.register_channel(f"/{name}", "protobuf", schema)
        for _ in range(2):
            writer.add_message(channel, _NS, data, _NS)
    writer.finish()
    return file.getvalue()
