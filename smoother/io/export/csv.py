"""A recovery as a CSV file."""

from __future__ import annotations

import os

import numpy as np

from ...recording import FloatArray
from ...result import Recovery
from ...runtime.atomic import writing
from ..mcap.stamps import nanoseconds
from ..result.usable import usable

_ROWS = 20_000
_JOINTS = ("elbow", "wrist", "shoulder")


def export_csv(recovery: Recovery, path: str | os.PathLike[str], force: bool = False) -> None:
    """Write one row a forearm-IMU sample; cells are empty where the method has no answer.

    Parameters
    ----------
    recovery : one arm.
    path : the file to write.
    force : overwrite a file that exists.

    Notes
    -----
    Metres in the camera frame; `imu_q*` is the rotation IMU axes to camera; `t_s` is the IMU's own
    stamp with nine decimals; sigmas are one standard deviation an axis; velocity of the IMU, m/s.
    `usable` (the last column) is 1 where there is an answer, below the limit on sigma if one was set.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    header, values = csv_columns(recovery)
    header, good = [*header, "usable"], usable(recovery).astype(int)
    stamp = nanoseconds(recovery.t_s, recovery.origin_ns)
    occluded = recovery.occluded.astype(int)
    line = "%s%d.%09d,%d" + ",%.9f" * values.shape[1] + ",%d\n"
    with writing(path, force) as temporary, open(temporary, "w", encoding="ascii", newline="") as file:
        file.write(",".join(header) + "\n")
        for start in range(0, len(stamp), _ROWS):
            part = slice(start, start + _ROWS)
            whole, rest = np.divmod(np.abs(stamp[part]), 1_000_000_000)
            sign = np.where(stamp[part] < 0, "-", "").tolist()
            heads = zip(sign, whole.tolist(), rest.tolist(), occluded[part].tolist(), strict=True)
            rows = zip(heads, values[part].tolist(), good[part].tolist(), strict=True)
            text = "".join([line % (*head, *row, last) for head, row, last in rows])
            file.write(text.replace("nan", ""))


def csv_columns(recovery: Recovery) -> tuple[list[str], FloatArray]:
    """Header of the export, and its number columns (N, C) between `t_s`, `occluded` and `usable`."""
    count = len(recovery)
    nothing = np.full((count, 3), np.nan)
    groups: list[tuple[list[str], FloatArray]] = [
        (_xyz("imu"), recovery.position),
        ([f"imu_q{part}" for part in "wxyz"], recovery.quaternion),
    ]
    groups += [(_xyz(joint), recovery.joints.get(joint, nothing)) for joint in _JOINTS]
    groups += [(_xyz("sigma"), recovery.sigma_m), (["sigma_deg"], recovery.sigma_deg[:, None])]
    for joint in ("wrist", "elbow", "shoulder"):
        spread = recovery.joint_covariance.get(joint)
        sigma = nothing if spread is None else np.sqrt(np.einsum("nii->ni", spread))
        groups.append((_xyz(f"{joint}_sigma"), sigma))
    groups.append((["vx", "vy", "vz"], recovery.velocity))
    if "hand" in recovery.joints:
        groups.append((_xyz("hand"), recovery.joints["hand"]))
    header = ["t_s", "occluded", *(name for names, _ in groups for name in names)]
    values = np.concatenate([values.reshape(count, -1) for _, values in groups], axis=1)
    values[~np.isfinite(values)] = np.nan
    return header, values


def _xyz(name: str) -> list[str]:
    return [f"{name}_{axis}" for axis in "xyz"]
