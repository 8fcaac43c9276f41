"""Tables of devices, with mended times, put into a recording."""

from __future__ import annotations

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...recording import JOINTS, JointState
from ..mcap.stamps import nanoseconds
from ..recording.clean import clean_arm, clean_imu
from ..recording.joint_rows import JointRows
from ..recording.skeletons import joint_code
from ..recording.streams import ImuSamples, RecordingFile
from .protocol import ImuTable, SkeletonTable

#: Slower or faster than any IMU that is worn, samples a second.
_RATES_HZ = (2.0, 10_000.0)


def add_skeleton(
    file: RecordingFile, tables: list[SkeletonTable], source: str, topic: str, shift_s: float
) -> None:
    """Put the arms of a file's bodies into a recording; all of them share its frames.

    Parameters
    ----------
    file : RecordingFile
        The recording.
    tables : list of SkeletonTable
        Bodies with mended times.
    source : str
        The file, for messages.
    topic : str
        What to write them to.
    shift_s : float, s
        What to add to the times.

    Raises
    ------
    RecordingError
        No joint of a forearm is tracked, or the positions are in no metres.
    """
    stamps = [nanoseconds(times_of(table) + shift_s, 0) for table in tables]
    frames = np.unique(np.concatenate(stamps))
    rows = JointRows()
    for table, stamp in zip(tables, stamps, strict=True):
        frame = np.searchsorted(frames, stamp)
        body = np.full(len(stamp), table.body, np.int64)
        for name, position in table.position.items():
            code = joint_code(name)
            if code is None:
                continue
            side, joint = (np.full(len(stamp), value, np.int64) for value in code)
            state = table.state[name].astype(np.int64)
            state[~np.isfinite(position).all(axis=1)] = JointState.NOT_TRACKED
            rows.add_joints(frame, body, side, joint, state, np.array(position, dtype=float))
    first = tables[0]
    arms = rows.arms(frames, topic, "camera", first.frame)
    for arm in arms:
        if arm.tracked:
            clean_arm(arm, source)
    if not any(arm.tracked for arm in arms):
        raise RecordingError(
            f"{source}: no elbow, wrist, hand or strap is tracked in any frame ({', '.join(JOINTS)} are"
            " read); record again with the arm in view."
        )
    file.arms += arms
    if file.camera_frame is None and file.gravity_hint is None:
        file.camera_frame, file.gravity_hint = first.frame, first.gravity_hint


def add_imu(file: RecordingFile, topic: str, table: ImuTable, source: str, shift_s: float) -> None:
    """Put an IMU with mended times into a recording, if its units can be; as `add_skeleton`."""
    assert table.acc is not None and table.gyro is not None
    stamp = nanoseconds(times_of(table) + shift_s, 0)
    samples = ImuSamples(topic, topic.rpartition("/")[2], stamp, table.acc, table.gyro, table.mag)
    clean_imu(samples, source)
    file.imus.append(samples)
    file.notes += rate_note(samples)


def rate_note(samples: ImuSamples) -> list[str]:
    """A sentence where an IMU's rate is none of such a sensor: its times are in another unit."""
    step_s = float(np.median(np.diff(samples.stamp_ns))) / 1e9 if len(samples.stamp_ns) > 1 else 0.0
    if not step_s > 0 or _RATES_HZ[0] <= 1 / step_s <= _RATES_HZ[1]:
        return []
    return [
        f"{samples.topic}: its times make {1 / step_s:.3g} samples a second, which is no IMU's rate; if they"
        " are in another unit, give time_unit in a recording.toml."
    ]


def times_of(table: ImuTable | SkeletonTable) -> FloatArray:
    """Times of a table that was mended."""
    assert table.t_s is not None
    return table.t_s
