"""A video file picture by picture, upright and with the times that its container states."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray
from ...errors import RecordingError

#: Turns that a picture can be given, degrees clockwise.
TURNS = (0, 90, 180, 270)
#: Frame rates of cameras, Hz.
_RATES_HZ = (1.0, 1000.0)
#: Times between pictures that differ by more than this from the usual one are of a variable rate.
_VARIES = 0.3


@dataclass
class Video:
    """A video that is open.

    Attributes
    ----------
    path : Path
        The file.
    width, height : int
        Of the pictures as they are given, pixels: turned as the file states, and as the user says.
    rate_hz : float, Hz
        As the container states it.
    count : int
        Pictures, as the container states it; 0 where it does not.
    stored_turn_deg : int
        The rotation of its pictures as stated in the file; it is applied.
    turn_deg : int
        By how much they are turned besides, clockwise.
    mirrored : bool
        Pictures are exchanged left for right.
    t_s : list of float, s
        Times of the pictures that were given so far.
    """

    path: Path
    width: int
    height: int
    rate_hz: float
    count: int
    stored_turn_deg: int = 0
    turn_deg: int = 0
    mirrored: bool = False
    t_s: list[float] = field(default_factory=list)
    _capture: Any = None

    def pictures(self) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Time, s, and pixels (height, width, 3) in red, green, blue of each picture, once."""
        import cv2

        turn = {
            90: cv2.ROTATE_90_CLOCKWISE,
            180: cv2.ROTATE_180,
            270: cv2.ROTATE_90_COUNTERCLOCKWISE,
        }.get(self.turn_deg)
        while True:
            there, pixels = self._capture.read()
            if not there:
                return
            self.t_s.append(self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3)
            if turn is not None:
                pixels = cv2.rotate(pixels, turn)
            if self.mirrored:
                pixels = cv2.flip(pixels, 1)
            yield self.t_s[-1], cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)

    def times(self) -> tuple[FloatArray, str]:
        """Times (F,) of all pictures that were given, and what is to be said of them.

        Where the container has none that rise, pictures count at its rate.
        """
        t_s = _rising(np.array(self.t_s))
        if t_s is None:
            return np.arange(len(self.t_s)) / self.rate_hz, (
                f"The video has no times of its pictures; they count at {self.rate_hz:.3g} a second."
            )
        step = np.diff(t_s)
        usual = float(np.median(step)) if len(step) else 0.0
        varies = (np.abs(step - usual) > _VARIES * usual).mean() if usual > 0 else 0.0
        if varies <= 0.01:
            return t_s, ""
        return t_s, (
            f"The video has a variable frame rate: {1e3 * step.min():.0f} to {1e3 * step.max():.0f} ms"
            " from picture to picture; the container's times count."
        )


def _rising(t_s: FloatArray) -> FloatArray | None:
    """Times, of which single ones that do not rise are put between their neighbours; None if many do not."""
    good = np.append(True, t_s[1:] > np.maximum.accumulate(t_s)[:-1])[: len(t_s)]
    if good.mean() < 0.99:
        return None
    rows = np.arange(len(t_s))
    even = np.interp(rows, rows[good], t_s[good])
    return even if (np.diff(even) > 0).all() else None


@contextmanager
def open_video(path: Path, turn_deg: int = 0, mirrored: bool = False) -> Iterator[Video]:
    """Open a video file.

    Parameters
    ----------
    path : Path
        Anything that OpenCV reads (MP4, MOV, AVI, MKV).
    turn_deg : int
        0, 90, 180 or 270: turn pictures clockwise, besides what the file itself says.
    mirrored : bool
        Exchange left for right, as a front camera's mirrored pictures need it.

    Raises
    ------
    RecordingError
        It is not there, or is not a video.
    """
    import cv2

    if not path.is_file():
        raise RecordingError(f"{path} does not exist; name the file of a video.")
    logging = cv2.utils.logging  # its lines about damaged files are less clear than our sentence
    previous = logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    try:
        rate_hz = capture.get(cv2.CAP_PROP_FPS) if capture.isOpened() else 0.0
        if not rate_hz > 0:
            raise RecordingError(
                f"{path} is not a video that can be read; export it again, or convert it to MP4 (H.264)."
            )
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 1)
        stored = round(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 360
        size = [int(capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
        width, height = size if turn_deg % 180 == 0 else size[::-1]
        count = max(int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)
        rate_hz = rate_hz if _RATES_HZ[0] <= rate_hz <= _RATES_HZ[1] else 30.0
        yield Video(path, width, height, rate_hz, count, stored, turn_deg, mirrored, [], capture)
    finally:
        capture.release()
        logging.setLogLevel(previous)
