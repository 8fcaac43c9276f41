"""A recovery as a CSV file."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from ...array_types import FloatArray
from ...body import SEGMENTS, BodySegment
from ...result import Recovery
from ...result.segment_motion import SegmentMotion, TrunkMotion
from ...result.untrusted import usable
from ..mcap.messages import nanoseconds
from .rows import write_rows

_JOINTS = ("elbow", "wrist", "shoulder")


class ColumnGroup(NamedTuple):
    """Columns of an export that belong together."""

    names: list[str]  # Of the columns
    values: FloatArray  # (N, columns): nan where there is no answer
    unit: str  # Of all of them
    description: str  # Of all of them


def export_csv(recovery: Recovery, path: str | os.PathLike[str], force: bool = False) -> None:
    """Write one row a forearm-IMU sample; cells are empty where the method has no answer."""
    header, values = csv_columns(recovery)
    header = [*header, "trusted", "usable"]
    marks = 2 * recovery.trusted.astype(np.uint8) + usable(recovery)
    words = np.array(["0,0", "0,1", "1,0", "1,1"] if recovery.has_verdict else [",0", ",1"] * 2)
    stamp = nanoseconds(recovery.t_s, recovery.origin_ns)
    whole, rest = np.divmod(np.abs(stamp), 1_000_000_000)
    line = "%s%d.%09d,%d" + ",%.9f" * values.shape[1] + ",%s\n"
    columns = [np.where(stamp < 0, "-", ""), whole, rest, recovery.occluded, values, words[marks]]
    write_rows(path, ",".join(header) + "\n", line, columns, force)


def csv_columns(recovery: Recovery) -> tuple[list[str], FloatArray]:
    """Header of the export, and its number columns (N, C) between `t_s`, `occluded` and the marks."""
    groups = column_groups(recovery)
    header = ["t_s", "occluded", *(name for group in groups for name in group.names)]
    return header, np.concatenate([group.values for group in groups], axis=1)


def column_groups(recovery: Recovery) -> list[ColumnGroup]:
    """The numbers of an export, in the order of their columns."""
    count = len(recovery)
    nothing = np.full((count, 3), np.nan)
    position, sigma = (
        ("m", "position in the camera's frame"),
        ("m", "one standard deviation, per axis of the camera"),
    )
    sigma_deg = "square root of the trace of the orientation's covariance"
    groups: list[tuple[list[str], FloatArray, str, str]] = [
        (_xyz("imu"), recovery.position, *position),
        (
            [f"imu_q{part}" for part in "wxyz"],
            recovery.quaternion,
            "1",
            "rotation IMU axes to camera, quaternion",
        ),
    ]
    groups += [(_xyz(joint), recovery.joints.get(joint, nothing), *position) for joint in _JOINTS]
    groups.append((_xyz("sigma"), recovery.sigma_m, *sigma))
    groups.append((["sigma_deg"], recovery.sigma_deg, "deg", sigma_deg))
    for joint in ("wrist", "elbow", "shoulder"):
        spread = recovery.joint_covariance.get(joint)
        deviation = nothing if spread is None else np.sqrt(np.einsum("nii->ni", spread))
        groups.append((_xyz(f"{joint}_sigma"), deviation, *sigma))
    groups.append((["vx", "vy", "vz"], recovery.velocity, "m/s", "velocity of the IMU in the camera's frame"))
    if "hand" in recovery.joints:
        groups.append((_xyz("hand"), recovery.joints["hand"], *position))
    angles = recovery.angles()
    for angle in angles.angles:
        groups.append(([angle.column], angles.values[angle.name], "deg", angle.meaning))
        groups.append(([angle.sigma_column], angles.sigmas[angle.name], "deg", "one standard deviation"))
    for name, motion in recovery.segments.items():
        groups += _segment(SEGMENTS[name], motion)
    if recovery.trunk is not None:
        groups += _trunk(recovery.trunk)
    groups += [
        (
            [f"seen_by_{camera.name}"],
            camera.saw_at(recovery.t_s).astype(float),
            "1",
            "that camera saw the forearm",
        )
        for camera in recovery.estimates.cameras
        if camera.takes_part
    ]
    return [
        ColumnGroup(names, np.where(np.isfinite(values), values, np.nan).reshape(count, -1), *said)
        for names, values, *said in groups
    ]


def _segment(segment: BodySegment, motion: SegmentMotion) -> list[tuple[list[str], FloatArray, str, str]]:
    """Columns of an IMU on a further segment."""
    of, imu = segment.prefix, f"{segment.label.replace(' ', '-')} IMU"
    return [
        (_xyz(f"{of}_imu"), motion.position, "m", f"position of the {imu} in the camera's frame"),
        (
            [f"{of}_imu_q{part}" for part in "wxyz"],
            motion.quaternion,
            "1",
            f"rotation {imu} axes to camera, quaternion",
        ),
        (_xyz(segment.sigma_name), motion.sigma_m, "m", "one standard deviation, per axis of the camera"),
        ([f"{segment.sigma_name}_deg"], motion.sigma_deg, "deg", f"as sigma_deg, of the {imu}"),
    ]


def _trunk(trunk: TrunkMotion) -> list[tuple[list[str], FloatArray, str, str]]:
    """Columns of the thorax."""
    return [
        (
            [f"trunk_q{part}" for part in "wxyz"],
            trunk.quaternion,
            "1",
            "rotation thorax axes (ISB) to camera, quaternion",
        ),
        (["trunk_sigma_deg"], trunk.sigma_deg, "deg", "as sigma_deg, of the thorax"),
    ]


def _xyz(name: str) -> list[str]:
    return [f"{name}_{axis}" for axis in "xyz"]
