"""OpenSim's storage files: joint angles (MOT), and orientations of IMUs (STO), as OpenSense reads them."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np

from ...array_types import BoolArray, FloatArray
from ...errors import UnoccludeError
from ...joint_angles import defined, recovery_angles, wrapped_deg
from ...linalg import median_rate_hz
from ...result import Recovery
from ...result.untrusted import untrusted_sentences
from ...rotation import Rotation
from .grid import Grid, at_grid, constant_step, nearest, unbroken
from .markers import opensim_axes
from .rows import write_rows


@dataclass(frozen=True)
class MotTable:
    """Joint angles of one arm with a constant time step and a number in every cell."""

    t_s: FloatArray  # (G,) s: after the recovery's origin
    rate_hz: float  # Rows per second
    angles: dict[str, FloatArray]  # dict of (G,) deg: by coordinate
    occluded: BoolArray  # bool (G,): the camera did not see the forearm
    answered: BoolArray  # bool (G,): False where the method has no answer and a straight line bridges it
    notes: tuple[str, ...]  # What a reader must know, one sentence each
    trusted: BoolArray | None = None  # bool (G,): which rows are to be trusted; None where not judged


def mot_table(recovery: Recovery, rate_hz: float | None = None) -> MotTable:
    """The joint angles by the names of OpenSim's MoBL-ARMS model of the upper extremity, degrees.

    `elv_angle`, `shoulder_elv`, `shoulder_rot`: the humerus turns R_y(elv_angle) R_x(-shoulder_elv)
    R_y(shoulder_rot - elv_angle) (Saul et al., Comput Methods Biomech Biomed Engin 18:1445, 2015), so that
    ISB's axial rotation is shoulder_rot - elv_angle; `elbow_flexion`: 0 = straight; `pro_sup`: 0 = thumb up,
    90 = pronated, which is ISB's pronation - 90. A left arm has the angles of its mirror image. A column
    that the recovery cannot give is left out.
    """
    grid = constant_step(recovery, rate_hz)
    isb_angles = recovery_angles(recovery if grid.same else _resampled(recovery, grid))
    angles = {
        "elv_angle": isb_angles["shoulder_plane"],
        "shoulder_elv": isb_angles["shoulder_elevation"],
        "shoulder_rot": wrapped_deg(isb_angles["shoulder_rotation"] + isb_angles["shoulder_plane"]),
        "elbow_flexion": isb_angles["elbow_flexion"],
        "carrying_angle": isb_angles["carrying"],
        "pro_sup": wrapped_deg(isb_angles["pronation"] - 90.0),
    }
    angles = {name: values for name, values in angles.items() if np.isfinite(values).any()}
    if "elbow_flexion" not in angles:
        missing = [joint for joint in ("shoulder", "elbow", "wrist") if not _known(recovery, joint)]
        why = f"it has no {', no '.join(missing)}" if missing else "they are never all there at once"
        raise UnoccludeError(
            f"{recovery.name}: joint angles need shoulder, elbow and wrist, and {why}; export to csv, trc,"
            " c3d or parquet"
        )
    answered: BoolArray = np.asarray(np.isfinite(np.stack(list(angles.values()))).all(axis=0))
    if not answered.any():
        raise UnoccludeError(
            f"{recovery.name}: no sample has all of the angles {', '.join(angles)}; export to csv or parquet"
        )
    first, last = np.flatnonzero(answered)[[0, -1]]
    part = slice(int(first), int(last) + 1)
    place = np.arange(len(answered))
    bridged = {name: np.interp(place, place[answered], values[answered]) for name, values in angles.items()}
    answered_part = answered[part]
    near = nearest(recovery.t_s, grid)[part]
    return MotTable(
        grid.t_s[part],
        grid.rate_hz,
        {name: values[part] for name, values in bridged.items()},
        recovery.occluded[near],
        answered_part,
        _notes(answered_part, len(answered) - len(answered_part), grid.rate_hz, isb_angles),
        recovery.trusted[near] if recovery.has_verdict else None,
    )


def write_mot(table: MotTable, path: str | os.PathLike[str], recovery: Recovery, force: bool = False) -> None:
    """Write joint angles as OpenSim reads them."""
    marks = {"occluded": table.occluded, "answered": table.answered}
    if table.trusted is not None:
        marks["trusted"] = table.trusted
    columns = [*table.angles, *marks]
    side = f" {recovery.side} arm" if recovery.side else ""
    title = " ".join(f"unocclude {recovery.method}{side} {recovery.name}".split())
    head = [
        title,
        "version=1",
        f"nRows={len(table.t_s)}",
        f"nColumns={len(columns) + 1}",
        "inDegrees=yes",
        "",
        "Angles in degrees, coordinates of MoBL-ARMS; ISB's axial rotation is shoulder_rot - elv_angle.",
        "occluded: 1 where the camera did not see the forearm. answered: 0 where a straight line bridges",
        f"a stretch without an answer. Times are relative to {recovery.origin_ns} ns of the IMU's clock.",
        *_trust_lines(recovery),
        "",
        "endheader",
        "\t".join(["time", *columns]),
    ]
    values = np.column_stack(list(table.angles.values()))
    flags = np.column_stack(list(marks.values())).astype(int)
    line = "%.9f" + "\t%.9f" * values.shape[1] + "\t%d" * flags.shape[1] + "\n"
    write_rows(path, "\n".join(head) + "\n", line, [table.t_s, values, flags], force)


def _trust_lines(recovery: Recovery) -> list[str]:
    """Lines of the header: what the column `trusted` says, the verdict, and what is not to be trusted."""
    if not recovery.has_verdict:
        return []
    lines = ["trusted: 0 where the answer is not to be trusted.", recovery.estimates.verdict]
    lines += [f"Not to be trusted: {each}" for each in untrusted_sentences(recovery)]
    return [" ".join(line.split()) for line in lines if line]


def _known(recovery: Recovery, joint: str) -> bool:
    return joint in recovery.joints and bool(np.isfinite(recovery.joints[joint]).any())


def _resampled(recovery: Recovery, grid: Grid) -> Recovery:
    """The joints and the orientation at the grid's times."""
    joints = {name: at_grid(recovery.t_s, values, grid) for name, values in recovery.joints.items()}
    quaternion = recovery.quaternion.copy()
    # Both signs mean the same rotation: one of them goes on smoothly.
    for run in unbroken(recovery.t_s, np.asarray(np.isfinite(quaternion).all(axis=1))):
        q = quaternion[run]
        turn = np.where((q[1:] * q[:-1]).sum(axis=1) < 0, -1.0, 1.0)
        q[1:] *= np.cumprod(turn)[:, None]
    return replace(recovery, t_s=grid.t_s, joints=joints, quaternion=at_grid(recovery.t_s, quaternion, grid))


def _notes(kept: BoolArray, cut: int, rate_hz: float, isb_angles: dict[str, FloatArray]) -> tuple[str, ...]:
    notes = []
    if not kept.all():
        notes.append(
            f"{(~kept).sum() / rate_hz:.2f} s without an answer are bridged by straight lines in the MOT"
            " file; its column `answered` is 0 there."
        )
    if cut:
        notes.append(f"{cut / rate_hz:.2f} s without an answer at the ends are left out of the MOT file.")
    trusted = defined(isb_angles)
    for name, of in (
        ("pronation", "pro_sup"),
        ("shoulder_plane", "elv_angle and shoulder_rot"),
    ):
        known = np.isfinite(isb_angles[name])
        share = float((known & ~trusted[name]).sum() / max(known.sum(), 1))
        if share > 0.01:
            notes.append(
                f"{of}: within 15 degrees of a posture that does not define it in {100 * share:.0f} % of the"
                " samples (straight elbow, hanging arm), where noise turns it."
            )
    return tuple(notes)


#: The body of an OpenSim model that a segment is, by the names of OpenSim's own models of the arm. OpenSense
#: calls an IMU by its body's name and `_imu`.
BODIES = {"forearm": "radius", "upper_arm": "humerus", "hand": "hand", "trunk": "torso"}


@dataclass(frozen=True)
class OrientationTable:
    """Orientations of one arm's IMUs in OpenSim's axes, a number in every cell."""

    t_s: FloatArray  # (G,) s: the forearm IMU's own stamps
    quaternion: dict[str, FloatArray]  # dict of (G, 4): qw, qx, qy, qz by column
    rate_hz: float  # Median of the stamps
    notes: tuple[str, ...]  # What a reader must know, one sentence each


def orientation_table(
    recovery: Recovery,
    level_down: FloatArray | None = None,  # (3,)
) -> OrientationTable:
    """The orientations of all IMUs of a recovery."""
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
    """Write orientations as OpenSim 4 reads them: cells `qw,qx,qy,qz` between tabs."""
    head = [f"DataRate={table.rate_hz:.6f}", "DataType=Quaternion", "version=3", "endheader"]
    columns = "\t".join(["time", *table.quaternion])
    line = "%.9f" + "\t%.9f,%.9f,%.9f,%.9f" * len(table.quaternion) + "\n"
    text = "\n".join([*head, columns]) + "\n"
    write_rows(path, text, line, [table.t_s, *table.quaternion.values()], force)


def _continuous(quaternion: FloatArray) -> FloatArray:
    """Quaternions (n, 4) with signs by which neighbours lie near each other: readers interpolate them."""
    turned = np.einsum("ni,ni->n", quaternion[1:], quaternion[:-1]) < 0.0
    sign = np.concatenate([[1.0], np.where(np.cumsum(turned) % 2, -1.0, 1.0)])
    return sign[:, None] * quaternion
