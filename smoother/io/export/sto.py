"""Orientations of IMUs to a STO file, as OpenSense (OpenSim's inverse kinematics of IMUs) reads them."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...linalg import median_rate_hz
from ...result import Recovery
from ...rotation import Rotation
from ...runtime.outputs import writing
from .markers import opensim_axes

#: The body of an OpenSim model that a segment is, by the names of OpenSim's own models of the arm. OpenSense
#: calls an IMU by its body's name and `_imu`.
BODIES = {"forearm": "radius", "upper_arm": "humerus", "hand": "hand", "trunk": "torso"}
_ROWS = 20_000


@dataclass(frozen=True)
class OrientationTable:
    """Orientations of one arm's IMUs in OpenSim's axes, a number in every cell.

    Attributes
    ----------
    t_s : ndarray, shape (G,), s
        The forearm IMU's own stamps; samples at which an IMU has no orientation are left out.
    quaternion : dict of str to ndarray, shape (G, 4)
        qw, qx, qy, qz by column: the IMU's axes to OpenSim's ground ({O}: x level towards the camera, y up,
        z to the right of a person who faces it). `torso_imu` is the thorax itself (ISB), its IMU's mounting
        taken off.
    rate_hz : float
        Median of the stamps.
    notes : tuple of str
        What a reader must know, one sentence each.
    """

    t_s: FloatArray
    quaternion: dict[str, FloatArray]
    rate_hz: float
    notes: tuple[str, ...]


def orientation_table(recovery: Recovery, level_down: FloatArray | None = None) -> OrientationTable:
    """The orientations of all IMUs of a recovery.

    Parameters
    ----------
    recovery : Recovery
        One arm.
    level_down : ndarray, shape (3,), optional
        Down in the camera's axes if the camera is level, for a method that did not find gravity.

    Returns
    -------
    table : OrientationTable

    Raises
    ------
    UnoccludeError
        No sample has all orientations, or neither gravity nor the camera's axes are known.
    """
    R_O_K = Rotation.from_matrix(opensim_axes(recovery, level_down).T)
    of_camera = {"forearm": recovery.quaternion}
    of_camera |= {name: motion.quaternion for name, motion in recovery.segments.items()}
    if recovery.trunk is not None:
        of_camera["trunk"] = recovery.trunk.quaternion
    known = np.stack([np.isfinite(each).all(axis=1) for each in of_camera.values()])
    rows = np.flatnonzero(known.all(axis=0))
    if not len(rows):
        without = [
            name.replace("_", " ") for name, has in zip(of_camera, known, strict=True) if not has.any()
        ]
        why = (
            f"there is none of the {', none of the '.join(without)}" if without else "they are never at once"
        )
        raise UnoccludeError(
            f"{recovery.name}: OpenSense needs the orientation of every IMU, and {why}; export to csv or"
            " parquet"
        )
    quaternion = {}
    for name, values in of_camera.items():
        turned = (R_O_K * Rotation.from_quat(values[rows], scalar_first=True)).as_quat(scalar_first=True)
        quaternion[f"{BODIES[name]}_imu"] = _continuous(turned)
    t_s = recovery.t_s[rows]
    notes: tuple[str, ...] = ()
    if left_out := len(recovery) - len(rows):
        notes = (f"{left_out} of {len(recovery)} samples are left out: an IMU has no orientation there.",)
    if "upper_arm" not in of_camera:
        notes += (
            "one IMU on the forearm does not show OpenSense how the elbow is bent: take trc and Inverse"
            " Kinematics for the angles.",
        )
    return OrientationTable(t_s, quaternion, median_rate_hz(t_s) if len(t_s) > 1 else 1.0, notes)


def write_sto(table: OrientationTable, path: str | os.PathLike[str], force: bool = False) -> None:
    """Write orientations as OpenSim 4 reads them: cells `qw,qx,qy,qz` between tabs.

    Parameters
    ----------
    table : OrientationTable
        What to write.
    path : path-like
        The file to write.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
    head = [f"DataRate={table.rate_hz:.6f}", "DataType=Quaternion", "version=3", "endheader"]
    columns = "\t".join(["time", *table.quaternion])
    line = "%.9f" + "\t%.9f,%.9f,%.9f,%.9f" * len(table.quaternion) + "\n"
    values = np.concatenate([table.t_s[:, None], *table.quaternion.values()], axis=1)
    with writing(path, force) as temporary, open(temporary, "w", encoding="ascii", newline="") as file:
        file.write("\n".join([*head, columns]) + "\n")
        for start in range(0, len(values), _ROWS):
            rows = values[start : start + _ROWS].tolist()
            file.write("".join([line % tuple(row) for row in rows]))


def _continuous(quaternion: FloatArray) -> FloatArray:
    """Quaternions (n, 4) with signs by which neighbours lie near each other: readers interpolate them."""
    turned = np.einsum("ni,ni->n", quaternion[1:], quaternion[:-1]) < 0.0
    sign = np.concatenate([[1.0], np.where(np.cumsum(turned) % 2, -1.0, 1.0)])
    return sign[:, None] * quaternion
