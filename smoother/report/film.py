"""Pictures of the person beside the moving arm: few, small, and in a page only where they are asked for."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..errors import RecordingError
from ..io.mcap.container import Container
from ..io.mcap.messages import Topic
from ..io.media.images import IMAGES, ImageMessage, read_images
from ..result import Recovery

#: A picture is no wider than this, pixels, and there are no more per second.
MOST_WIDE, MOST_HZ = 320, 10.0
#: All pictures of a page together, bytes before they are written as text; longer films have fewer a second.
MOST_BYTES = 8_000_000
#: About the size of a picture, bytes: what the rate of a long film is chosen by.
USUAL_BYTES = 9_000
_QUALITY = 60
#: A picture is shown for no longer than this, or two of its intervals, s.
_HELD_S = 0.5


@dataclass(frozen=True)
class Film:
    """Pictures on the clock of a page.

    Attributes
    ----------
    times_s : ndarray, shape (n,), s
        Increasing, on the IMU's clock.
    jpeg : list of bytes
        One a time.
    source : str
        Where they are from, in words.
    """

    times_s: FloatArray
    jpeg: list[bytes]
    source: str

    @property
    def words(self) -> str:
        """That the pictures are in the page, for its reader."""
        rate_hz = (len(self.jpeg) - 1) / max(float(self.times_s[-1] - self.times_s[0]), 1e-9)
        return (
            f" The video is {self.source}, reduced to {rate_hz:.2g} pictures per second. It is part of this"
            " page: anyone who has the page sees the person."
        )

    def plain(self) -> dict[str, Any]:
        """As the page's player takes it."""
        step = float(np.median(np.diff(self.times_s))) if len(self.jpeg) > 1 else _HELD_S
        return {
            "times": [round(float(t), 3) for t in self.times_s],
            "jpeg": [b64encode(one).decode("ascii") for one in self.jpeg],
            "longest": max(_HELD_S, 2 * step),
        }


def recorded_film(path: Path, recovery: Recovery) -> Film:
    """Pictures of the camera's own images in a recording (MCAP): colour where there is any, else infrared.

    Parameters
    ----------
    path : Path
        The recording.
    recovery : Recovery
        Of it; gives the times and the relation of the clocks.

    Raises
    ------
    RecordingError
        There are no such images in the time of the recovery.
    """
    topic = image_topic(path)

    def images() -> Iterator[tuple[float, NDArray]]:
        offset_s = recovery.clock_offset_s if np.isfinite(recovery.clock_offset_s) else 0.0
        latest, due = -np.inf, -np.inf
        for message in read_images(path, lambda each: each.name == topic):
            if not isinstance(message, ImageMessage):
                continue
            t = (message.stamp_ns - recovery.origin_ns) / 1e9 + offset_s
            if t <= latest or t < due:  # stamps that go back; what would not be shown stays packed
                continue
            latest, due = t, t + 0.5 / MOST_HZ
            pixels = message.pixels()
            is_rgb = message.encoding.startswith("rgb")
            yield t, pixels[:, :, [2, 1, 0]] if is_rgb else pixels[:, :, :3] if pixels.ndim == 3 else pixels

    film = make_film(images(), *_times(recovery), f"the recording's own images ({topic})")
    if film is None:
        raise RecordingError(
            f"{path}: the images of {topic} were not taken at the time of the IMU's samples; leave out"
            " --with-images."
        )
    return film


def image_topic(path: Path) -> str:
    """The topic of a recording whose images show a person best.

    Raises
    ------
    RecordingError
        There is none.
    """
    container = Container(path)
    found: list[str] = []

    def seen(topic: Topic) -> bool:
        if topic.schema in IMAGES and topic.name not in found:
            found.append(topic.name)
        return False

    for _ in container.batches(seen):
        pass
    shown = [name for name in found if not any(word in name.lower() for word in _DEPTH)]
    shown.sort(key=lambda name: (not any(word in name.lower() for word in _COLOUR), found.index(name)))
    if not shown:
        raise RecordingError(
            f"{path} has no images of the camera's; give the film of another camera with --video FILE, or"
            " leave out --with-images."
        )
    return shown[0]


_DEPTH, _COLOUR = ("depth", "point", "body_index", "mask"), ("color", "colour", "rgb")


def video_film(path: Path, offset_s: float, recovery: Recovery) -> Film:
    """Pictures of a video file.

    Parameters
    ----------
    path : Path
        Anything that OpenCV reads (MP4, AVI, MKV, MOV).
    offset_s : float, s
        From the recovery's first sample to the video's first picture; negative where the video began before.
    recovery : Recovery

    Raises
    ------
    RecordingError
        The file is not there, is not a video, or shows another time.
    """
    import cv2

    check_video(path)
    video = cv2.VideoCapture(str(path))
    start_s, end_s = _times(recovery)
    rate_hz = video.get(cv2.CAP_PROP_FPS)
    try:
        if not video.isOpened() or not rate_hz > 0:
            raise RecordingError(f"{path} cannot be read as a video; convert it to MP4 (H.264).")
        every = max(1, int(rate_hz / (2 * MOST_HZ)))

        def images() -> Iterator[tuple[float, NDArray]]:
            number = 0
            while video.grab():
                t = start_s + offset_s + number / rate_hz
                number += 1
                if t > end_s:
                    return
                if t < start_s or number % every:
                    continue
                there, pixels = video.retrieve()
                if there:
                    yield t, pixels

        film = make_film(images(), start_s, end_s, f"the file {path.name}")
    finally:
        video.release()
    if film is None:
        raise RecordingError(
            f"{path} shows nothing of the {end_s - start_s:.0f} s that were recorded: --video-offset is the"
            f" time from the recording's first sample to the video's first picture, s; it was {offset_s:g}."
        )
    return film


def check_video(path: Path) -> None:
    """Refuse a film that is not there.

    Raises
    ------
    RecordingError
        It is so.
    """
    if not path.is_file():
        raise RecordingError(f"{path} does not exist; --video takes a video file.")


def _times(recovery: Recovery) -> tuple[float, float]:
    return float(recovery.t_s[0]), float(recovery.t_s[-1])


def make_film(
    images: Iterable[tuple[float, NDArray]], start_s: float, end_s: float, source: str
) -> Film | None:
    """Choose and shrink pictures.

    Parameters
    ----------
    images : iterable of (float, ndarray)
        Time on the IMU's clock, s, in rising order, and pixels: grey, or as OpenCV has colours (BGR).
    start_s, end_s : float, s
        What is shown.
    source : str
        Where they are from, in words.

    Returns
    -------
    film : Film or None
        None without a picture in that time.
    """
    rate_hz = min(MOST_HZ, MOST_BYTES / USUAL_BYTES / max(end_s - start_s, 1e-9))
    times, jpeg, size = [], [], 0
    for t, pixels in _thinned(images, start_s, end_s, 1.0 / rate_hz):
        packed = _small(pixels)
        size += len(packed)
        if size > 1.5 * MOST_BYTES:
            break
        times.append(t)
        jpeg.append(packed)
    return Film(np.array(times), jpeg, source) if jpeg else None


def _thinned(
    images: Iterable[tuple[float, NDArray]], start_s: float, end_s: float, step_s: float
) -> Iterator[tuple[float, NDArray]]:
    due = start_s
    for t, pixels in images:
        if t > end_s:
            return
        if t + 1e-6 >= due:
            yield t, pixels
            due = max(due + step_s, t + 0.5 * step_s)


def _small(pixels: NDArray) -> bytes:
    """A picture as a small JPEG."""
    import cv2

    if pixels.dtype != np.uint8:  # infrared: the brightest few points are lamps
        top = max(float(np.percentile(pixels, 99)), 1.0)
        pixels = np.clip(pixels * (255.0 / top), 0, 255).astype(np.uint8)
    scale = MOST_WIDE / pixels.shape[1]
    if scale < 1:
        size = (MOST_WIDE, max(1, round(pixels.shape[0] * scale)))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    _, packed = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return bytes(packed.tobytes())
