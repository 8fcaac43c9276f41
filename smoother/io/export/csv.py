"""A recovery as a CSV file."""

from __future__ import annotations

import os
from typing import NamedTuple

import numpy as np

from ...array_types import FloatArray
from ...body import SEGMENTS
from ...result import Recovery
from ...result.untrusted import usable
from ..mcap.messages import nanoseconds
from .rows import write_rows

_JOINTS = ("elbow", "wrist", "shoulder")
_ONE, _XYZ, _WXYZ = ("",), ("_x", "_y", "_z"), ("_qw", "_qx", "_qy", "_qz")
_POSITION, _SIGMA = "position in the camera's frame", "one standard deviation, per axis of the camera"


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
    r, nothing = recovery, np.full((len(recovery), 3), np.nan)
    rows: list[tuple[str, tuple[str, ...], FloatArray, str, str]] = [
        ("imu", _XYZ, r.position, "m", _POSITION),
        ("imu", _WXYZ, r.quaternion, "1", "rotation IMU axes to camera, quaternion"),
        *((joint, _XYZ, r.joints.get(joint, nothing), "m", _POSITION) for joint in _JOINTS),
        ("sigma", _XYZ, r.sigma_m, "m", _SIGMA),
        ("sigma_deg", _ONE, r.sigma_deg, "deg", "square root of the trace of the orientation's covariance"),
    ]
    for joint in ("wrist", "elbow", "shoulder"):
        spread = r.joint_covariance.get(joint)
        deviation = nothing if spread is None else np.sqrt(np.einsum("nii->ni", spread))
        rows.append((f"{joint}_sigma", _XYZ, deviation, "m", _SIGMA))
    rows.append(("v", ("x", "y", "z"), r.velocity, "m/s", "velocity of the IMU in the camera's frame"))
    if "hand" in r.joints:
        rows.append(("hand", _XYZ, r.joints["hand"], "m", _POSITION))
    angles = r.angles()
    for angle in angles.angles:
        rows.append((angle.column, _ONE, angles.values[angle.name], "deg", angle.meaning))
        rows.append((angle.sigma_column, _ONE, angles.sigmas[angle.name], "deg", "one standard deviation"))
    for name, motion in r.segments.items():
        segment = SEGMENTS[name]
        of, sigma, imu = segment.prefix, segment.sigma_name, f"{segment.label.replace(' ', '-')} IMU"
        rows += [
            (f"{of}_imu", _XYZ, motion.position, "m", f"position of the {imu} in the camera's frame"),
            (f"{of}_imu", _WXYZ, motion.quaternion, "1", f"rotation {imu} axes to camera, quaternion"),
            (sigma, _XYZ, motion.sigma_m, "m", _SIGMA),
            (f"{sigma}_deg", _ONE, motion.sigma_deg, "deg", f"as sigma_deg, of the {imu}"),
        ]
    if (trunk := r.trunk) is not None:
        about = "rotation thorax axes (ISB) to camera, quaternion"
        rows.append(("trunk", _WXYZ, trunk.quaternion, "1", about))
        rows.append(("trunk_sigma_deg", _ONE, trunk.sigma_deg, "deg", "as sigma_deg, of the thorax"))
    for camera in r.estimates.cameras:
        if camera.takes_part:
            saw = camera.saw_at(r.t_s).astype(float)
            rows.append((f"seen_by_{camera.name}", _ONE, saw, "1", "that camera saw the forearm"))
    return [
        ColumnGroup(
            [stem + ending for ending in endings],
            np.where(np.isfinite(values), values, np.nan).reshape(len(r), -1),
            *said,
        )
        for stem, endings, values, *said in rows
    ]
