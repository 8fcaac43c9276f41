"""The numbers of a recovery with their units: what arrays, tables, CSV, Parquet and BIDS files have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..array_types import FloatArray
from ..body import SEGMENTS

if TYPE_CHECKING:
    from .recovery import Recovery

#: A recovery's columns of samples besides times, joints and segments.
SAMPLES = ("occluded", "position", "quaternion", "velocity", "pose_covariance", "velocity_covariance")
_POSITION, _SIGMA = "position in the camera's frame", "one standard deviation, per axis of the camera"


class Column(NamedTuple):
    """Numbers of every sample: a place, a quaternion, a sigma, an angle .."""

    name: str  # In `Recovery.to_arrays`
    values: FloatArray  # (N,), (N, 3) or (N, 4: qw, qx, qy, qz): nan where there is no answer
    unit: str  # "" of a quaternion
    description: str
    is_there: bool = True  # False for a joint that files have a column for, and this recovery has not

    @property
    def flat(self) -> list[str]:
        """Names with one number each: `wrist_x`, `imu_qw` .."""
        axes = {1: ("",), 3: ("_x", "_y", "_z"), 4: ("_qw", "_qx", "_qy", "_qz")}
        width = 1 if self.values.ndim == 1 else self.values.shape[1]
        return [self.name.removesuffix("_quaternion") + axis for axis in axes[width]]


def columns_of(recovery: Recovery) -> list[Column]:
    """All of them, in the order of the CSV's columns."""
    r, nothing = recovery, np.full((len(recovery), 3), np.nan)

    def joint(name: str) -> Column:
        return Column(name, r.joints.get(name, nothing), "m", _POSITION, name in r.joints)

    def joint_sigma(name: str) -> Column:
        spread = r.joint_covariance.get(name)
        sigma = nothing if spread is None else np.sqrt(np.einsum("nii->ni", spread))
        return Column(f"{name}_sigma", sigma, "m", _SIGMA, spread is not None)

    columns = [
        Column("imu", r.position, "m", _POSITION),
        Column("imu_quaternion", r.quaternion, "", "rotation IMU axes to camera, quaternion"),
        *map(joint, ("elbow", "wrist", "shoulder")),
        Column("sigma", r.sigma_m, "m", _SIGMA),
        Column("sigma_deg", r.sigma_deg, "deg", "square root of the trace of the orientation's covariance"),
        *map(joint_sigma, ("wrist", "elbow", "shoulder")),
        Column("velocity", r.velocity, "m/s", "velocity of the IMU in the camera's frame"),
    ]
    if "hand" in r.joints:
        columns += [joint("hand"), joint_sigma("hand")]
    angles = r.angles()
    for angle in angles.angles:
        columns.append(Column(angle.column, angles.values[angle.name], "deg", angle.meaning))
        sigma = angles.sigmas[angle.name]
        columns.append(Column(angle.sigma_column, sigma, "deg", "one standard deviation"))
    for name, motion in r.segments.items():
        segment = SEGMENTS[name]
        of, sigma_of, imu = segment.prefix, segment.sigma_name, f"{segment.label.replace(' ', '-')} IMU"
        turn = f"rotation {imu} axes to camera, quaternion"
        columns += [
            Column(f"{of}_imu", motion.position, "m", f"position of the {imu} in the camera's frame"),
            Column(f"{of}_imu_quaternion", motion.quaternion, "", turn),
            Column(sigma_of, motion.sigma_m, "m", _SIGMA),
            Column(f"{sigma_of}_deg", motion.sigma_deg, "deg", f"as sigma_deg, of the {imu}"),
        ]
    if (trunk := r.trunk) is not None:
        turn = "rotation thorax axes (ISB) to camera, quaternion"
        columns.append(Column("trunk_quaternion", trunk.quaternion, "", turn))
        columns.append(Column("trunk_sigma_deg", trunk.sigma_deg, "deg", "as sigma_deg, of the thorax"))
    for camera in r.estimates.cameras:
        if camera.takes_part:
            saw = camera.saw_at(r.t_s).astype(float)
            columns.append(Column(f"seen_by_{camera.name}", saw, "", "that camera saw the forearm"))
    return columns


def flat_columns(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arrays of `Recovery.to_arrays`, one a number."""
    return {
        name: values if values.ndim == 1 else values[:, k]
        for key, values in arrays.items()
        for k, name in enumerate(Column(key, values, "", "").flat)
    }
