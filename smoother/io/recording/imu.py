"""One IMU of a recording by itself: for what needs no camera."""

from __future__ import annotations

import os

from ...errors import RecordingError
from ...recording import ImuStream
from ..mcap.stamps import SECOND_NS, seconds
from .clean import clean_imu
from .imu_choice import choose_imu
from .read import open_recording


def read_imu(path: str | os.PathLike[str], imu: str | None = None) -> tuple[ImuStream, list[str]]:
    """Read one IMU from an MCAP file; a skeleton need not be there.

    Parameters
    ----------
    path : path-like
        The file.
    imu : str, optional
        Topic (or a part of it, or its frame_id) to take, where there are several.

    Returns
    -------
    stream : ImuStream
        Its samples.
    notes : list of str
        What was dropped or chosen, one sentence each.

    Raises
    ------
    RecordingError
        The file cannot be read, holds no IMU or several, or its samples cannot be used.
    """
    file = open_recording(path)
    with file.damage_told():
        chosen = choose_imu(file, imu)
        kept, notes = clean_imu(chosen, str(file.path))
    if kept.stamp_ns[-1] - kept.stamp_ns[0] <= 0:
        raise RecordingError(f"{path}: {kept.topic} lasts no time; record it again.")
    origin = int(kept.stamp_ns[0]) // SECOND_NS * SECOND_NS
    stream = ImuStream(kept.topic, seconds(kept.stamp_ns, origin), kept.acc, kept.gyro, kept.mag)
    return stream, [*file.notes, *notes]
