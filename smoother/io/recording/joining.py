"""Topics that belong to another topic's stream: reference joints, magnetometers of their own."""

from __future__ import annotations

import numpy as np

from ...array_types import FloatArray, IntArray
from ...recording import JOINTS
from ...runtime.store import Store, batches
from .streams import FieldSamples, ImuSamples, RecordingFile

TRUTH_PREFIX = "/truth"


def join_truth_joints(file: RecordingFile, store: Store) -> None:
    """Skeletons on truth topics are reference joints of the truth beside them."""
    for arm in [arm for arm in file.arms if arm.topic.startswith(TRUTH_PREFIX)]:
        file.arms.remove(arm)
        for poses in file.poses:
            if f"{poses.topic}/joints" != arm.topic:
                continue
            for i, joint in enumerate(JOINTS):
                if arm.state[:, i].any():
                    poses.joints[joint] = store.array((len(poses.stamp_ns), 3), 0.0)
            for part in batches(len(poses.stamp_ns)):
                row = np.searchsorted(arm.stamp_ns, poses.stamp_ns[part])
                row = np.minimum(row, len(arm.stamp_ns) - 1)
                same = arm.stamp_ns[row] == poses.stamp_ns[part]
                for joint, values in poses.joints.items():
                    there = arm.position[row, JOINTS.index(joint)]
                    values[part] = np.where(same[:, None], there, np.nan)


def join_field(file: RecordingFile, field: FieldSamples, store: Store) -> None:
    """Give a magnetometer to the IMU of its frame, or under the same name."""

    def beside(imu: ImuSamples) -> bool:
        return field.topic.rpartition("/")[0] == imu.topic.rpartition("/")[0]

    mine = [imu for imu in file.imus if imu.frame_id == field.frame_id and beside(imu)]
    mine = mine or [imu for imu in file.imus if field.frame_id and imu.frame_id == field.frame_id]
    mine = mine or [imu for imu in file.imus if beside(imu)]
    if len(mine) != 1 or mine[0].mag is not None:
        file.notes.append(f"{field.topic}: the magnetometer belongs to no IMU by its names and was left out.")
        return
    stamp, values = _usable_field(field)
    if not len(stamp):
        return
    zero = int(stamp[0])
    mag = store.array((len(mine[0].stamp_ns), 3), 0.0)
    for part in batches(len(mag)):
        at = mine[0].stamp_ns[part]
        first, last = np.searchsorted(stamp, [at.min(), at.max()], "right")
        near = slice(max(int(first) - 2, 0), int(last) + 2)
        x, have = (at - zero) / 1e9, (stamp[near] - zero) / 1e9
        mag[part] = np.stack([np.interp(x, have, values[near, i]) for i in range(3)], axis=1)
    mine[0].mag = mag


def _usable_field(field: FieldSamples) -> tuple[IntArray, FloatArray]:
    """Samples that are finite, in the order of their stamps; nothing is copied where all are so."""
    stamp, values = field.stamp_ns, field.mag
    if (stamp[1:] < stamp[:-1]).any():
        order = np.argsort(stamp, kind="stable")
        stamp, values = stamp[order], values[order]
    finite = np.isfinite(values).all(axis=1)
    return (stamp, values) if finite.all() else (stamp[finite], values[finite])
