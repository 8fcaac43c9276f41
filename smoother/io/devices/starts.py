"""Clocks that have nothing in common: where each of them starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...array_types import FloatArray

#: Streams that share less than this, s, or less than this part of the shorter one, share no clock.
SHARED_S, SHARED_PART = 1.0, 0.05
#: A clock that begins nearer to zero than this, s, counts from the file's own start.
FROM_ZERO_S = 1.0


@dataclass
class Timed:
    """Times of a stream, and what to call it.

    Attributes
    ----------
    label : str
        For sentences.
    t_s : ndarray, shape (n,), s
        Increasing, on its own clock.
    is_imu : bool
        An IMU, not a camera.
    source : str
        The file; "" where it does not matter.
    """

    label: str
    t_s: FloatArray
    is_imu: bool
    source: str = ""


def shifts(streams: list[Timed], imu_starts_at_s: float | None = None) -> tuple[list[float], list[str]]:
    """What to add to each stream's times so that all of them can be in one recording.

    Streams that overlap share a clock and are moved together. Where the IMUs' clock has nothing in common
    with the camera's, both start at zero: the motion tells the rest.

    Parameters
    ----------
    streams : list of Timed
        All cameras and IMUs.
    imu_starts_at_s : float, s, optional
        When the first IMU sample was taken, after the first camera frame.

    Returns
    -------
    shift_s : list of float, s
        By stream.
    sentences : list of str
        What was done.
    """
    camera = [stream for stream in streams if not stream.is_imu]
    groups = _groups([row for row, stream in enumerate(streams) if stream.is_imu], streams)
    if not camera or not groups:
        return [0.0] * len(streams), []
    shift = [0.0] * len(streams)
    first_frame = min(float(stream.t_s[0]) for stream in camera)
    if imu_starts_at_s is not None:
        first_sample = min(float(streams[row].t_s[0]) for group in groups for row in group)
        for group in groups:
            own = first_sample if len(groups) == 1 else min(float(streams[row].t_s[0]) for row in group)
            for row in group:
                shift[row] = first_frame + imu_starts_at_s - own
        return shift, [
            f"The first IMU sample was put {abs(imu_starts_at_s):g} s"
            f" {'before' if imu_starts_at_s < 0 else 'after'} the camera's first frame, as was said."
        ]
    apart = [
        group for group in groups if not any(_share(streams[row].t_s, c.t_s) for row in group for c in camera)
    ]
    if not apart:
        return shift, []
    shift = [-first_frame] * len(streams)  # a stream that shares the camera's clock starts with it
    sentences = []
    for group in apart:
        own = min(float(streams[row].t_s[0]) for row in group)
        for row in group:
            shift[row] = -own
        names = ", ".join(streams[row].label for row in group)
        sentences.append(
            f"The clock of {names} ({_message(own)}) has nothing in common with the camera's"
            f" ({_message(first_frame)}): both start at zero, and the motion tells the offset"
            " (--imu-starts-at S where it cannot)."
        )
    return shift, sentences


def count_from_zero(streams: list[Timed]) -> bool:
    """Whether cameras and IMUs each count from zero, so that nothing says when one started after the other.

    Parameters
    ----------
    streams : list of Timed
        All cameras and IMUs, as recorded; of one file, they share its clock.
    """
    first = [float(stream.t_s[0]) for stream in streams]
    kinds = {stream.is_imu for stream in streams}
    one_file = len({stream.source for stream in streams}) == 1 and bool(streams[0].source)
    return len(kinds) == 2 and not one_file and max(abs(each) for each in first) < FROM_ZERO_S


def _groups(rows: list[int], streams: list[Timed]) -> list[list[int]]:
    """IMUs that share a clock, as far as their times overlap."""
    groups: list[list[int]] = []
    for row in rows:
        mine = [g for g in groups if any(_share(streams[row].t_s, streams[other].t_s) for other in g)]
        groups = [g for g in groups if g not in mine] + [[*(r for g in mine for r in g), row]]
    return groups


def _share(a: FloatArray, b: FloatArray) -> bool:
    shared = min(float(a[-1]), float(b[-1])) - max(float(a[0]), float(b[0]))
    shorter = min(float(a[-1] - a[0]), float(b[-1] - b[0]))
    return shared > min(SHARED_S, 0.5 * shorter) and shared > SHARED_PART * shorter


def _message(first_s: float) -> str:
    """A clock by what it starts at."""
    if first_s > 1e8:
        return f"from {np.datetime64(int(first_s), 's')} UTC on"
    return f"from {first_s:.1f} s on"
