"""OpenSim's storage files: joint angles (MOT), and orientations of IMUs (STO), as OpenSense reads them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...angles.definitions import defined, recovery_angles, wrapped_deg
from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...linalg import median_rate_hz, nearest
from ...result import Recovery
from ...result.untrusted import untrusted_sentences
from ...rotation import Rotation
from .markers import level_note, opensim_axes
from .prepare import Export, Grid, at_grid, constant_step, marks_of, unbroken, write_rows


def prepare_mot(recovery: Recovery, rate_hz: float | None = None) -> Export:
    """The joint angles by the names of OpenSim's MoBL-ARMS model of the upper extremity, degrees.

    `elv_angle`, `shoulder_elv`, `shoulder_rot`: the humerus turns R_y(elv_angle) R_x(-shoulder_elv)
    R_y(shoulder_rot - elv_angle) (Saul et al., Comput Methods Biomech Biomed Engin 18:1445, 2015), so that
    ISB's axial rotation is shoulder_rot - elv_angle; `elbow_flexion`: 0 = straight; `pro_sup`: 0 = thumb up,
    90 = pronated, which is ISB's pronation - 90. A left arm has the angles of its mirror image. A column
    that the recovery cannot give is left out.
    """
    grid = constant_step(recovery, rate_hz)
    isb = recovery_angles(recovery if grid.same else _resampled(recovery, grid))
    angles = {
        "elv_angle": isb["shoulder_plane"],
        "shoulder_elv": isb["shoulder_elevation"],
        "shoulder_rot": wrapped_deg(isb["shoulder_rotation"] + isb["shoulder_plane"]),
        "elbow_flexion": isb["elbow_flexion"],
        "carrying_angle": isb["carrying"],
        "pro_sup": wrapped_deg(isb["pronation"] - 90.0),
    }
    angles = {name: values for name, values in angles.items() if np.isfinite(values).any()}
    if "elbow_flexion" not in angles:
        nothing = np.empty(0)
        needed = ("shoulder", "elbow", "wrist")
        missing = [name for name in needed if not np.isfinite(recovery.joints.get(name, nothing)).any()]
        why = f"it has no {', no '.join(missing)}" if missing else "they are never all there at once"
        raise UnoccludeError(
            f"{recovery.name}: joint angles need shoulder, elbow and wrist, and {why}; export to csv, trc,"
            " c3d or parquet"
        )
    answered = np.asarray(np.isfinite(np.stack(list(angles.values()))).all(axis=0))
    if not answered.any():
        raise UnoccludeError(
            f"{recovery.name}: no sample has all of the angles {', '.join(angles)}; export to csv or parquet"
        )
    first, last = np.flatnonzero(answered)[[0, -1]]
    part, place = slice(int(first), int(last) + 1), np.arange(len(answered))
    near, t_s = nearest(recovery.t_s, grid.t_s)[part], grid.t_s[part]
    values = np.stack([np.interp(place, place[answered], of[answered])[part] for of in angles.values()], 1)
    ours = {name: mark[near] for name, mark in marks_of(recovery).items() if name != "usable"}
    marks = {"occluded": ours["occluded"], "answered": answered[part]} | ours
    columns = ["time", *angles, *marks]
    told: list[str] = []
    if recovery.has_verdict:
        told = ["trusted: 0 where the answer is not to be trusted.", recovery.estimates.verdict]
        told += [f"Not to be trusted: {each}" for each in untrusted_sentences(recovery)]
    side = f" {recovery.side} arm" if recovery.side else ""
    head = [
        " ".join(f"unocclude {recovery.method}{side} {recovery.name}".split()),
        "version=1",
        f"nRows={len(t_s)}",
        f"nColumns={len(columns)}",
        "inDegrees=yes",
        "",
        "Angles in degrees, coordinates of MoBL-ARMS; ISB's axial rotation is shoulder_rot - elv_angle.",
        "occluded: 1 where the camera did not see the forearm. answered: 0 where a straight line bridges",
        f"a stretch without an answer. Times are relative to {recovery.origin_ns} ns of the IMU's clock.",
        *(" ".join(line.split()) for line in told if line),
        "",
        "endheader",
        "\t".join(columns),
        "",
    ]
    line = "%.9f" + "\t%.9f" * len(angles) + "\t%d" * len(marks) + "\n"
    table = [t_s, values, np.stack(list(marks.values()), 1).astype(int)]
    notes = []
    if bridged := int((~answered[part]).sum()):
        notes.append(
            f"{bridged / grid.rate_hz:.2f} s without an answer are bridged by straight lines in the MOT"
            " file; its column `answered` is 0 there."
        )
    if cut := len(answered) - len(t_s):
        notes.append(
            f"{cut / grid.rate_hz:.2f} s without an answer at the ends are left out of the MOT file."
        )
    well = defined(isb)
    for name, of in {"pronation": "pro_sup", "shoulder_plane": "elv_angle and shoulder_rot"}.items():
        known = np.isfinite(isb[name])
        share = float((known & ~well[name]).sum() / max(known.sum(), 1))
        if share > 0.01:
            notes.append(
                f"{of}: within 15 degrees of a posture that does not define it in {100 * share:.0f} % of the"
                " samples (straight elbow, hanging arm), where noise turns it."
            )
    return Export(
        len(t_s),
        lambda path, force: write_rows(path, "\n".join(head), line, table, force),
        grid.rate_hz,
        notes=tuple(notes),
    )


def _resampled(recovery: Recovery, grid: Grid) -> Recovery:
    """The joints and the orientation at the grid's times."""
    joints = {name: at_grid(recovery.t_s, values, grid) for name, values in recovery.joints.items()}
    quaternion = recovery.quaternion.copy()
    for run in unbroken(recovery.t_s, np.asarray(np.isfinite(quaternion).all(axis=1))):
        quaternion[run] = _continuous(quaternion[run])
    return replace(recovery, t_s=grid.t_s, joints=joints, quaternion=at_grid(recovery.t_s, quaternion, grid))


#: The body of an OpenSim model that a segment is, by the names of OpenSim's own models of the arm. OpenSense
#: calls an IMU by its body's name and `_imu`.
BODIES = {"forearm": "radius", "upper_arm": "humerus", "hand": "hand", "trunk": "torso"}


def prepare_sto(
    recovery: Recovery,
    level_down: FloatArray | None = None,  # (3,)
) -> Export:
    """The orientations of all IMUs of a recovery in OpenSim's axes: cells `qw,qx,qy,qz` between tabs."""
    R_O_K = Rotation.from_matrix(opensim_axes(recovery, level_down).T)
    of_camera = {"forearm": recovery.quaternion}
    of_camera |= {name: motion.quaternion for name, motion in recovery.segments.items()}
    if recovery.trunk is not None:
        of_camera["trunk"] = recovery.trunk.quaternion
    known = {name: np.isfinite(each).all(axis=1) for name, each in of_camera.items()}
    rows = np.flatnonzero(np.all(list(known.values()), axis=0))
    if not len(rows):
        without = [name.replace("_", " ") for name, has in known.items() if not has.any()]
        none = f"there is none of the {', none of the '.join(without)}"
        raise UnoccludeError(
            f"{recovery.name}: OpenSense needs the orientation of every IMU, and"
            f" {none if without else 'they are never at once'}; export to csv or parquet"
        )
    t_s, table = recovery.t_s[rows], [recovery.t_s[rows]]
    for values in of_camera.values():
        turned = R_O_K * Rotation.from_quat(values[rows], scalar_first=True)
        table.append(_continuous(turned.as_quat(scalar_first=True)))
    notes = level_note(recovery)
    if left_out := len(recovery) - len(rows):
        what = f"{left_out} of {len(recovery)} samples are left out: an IMU has no orientation there."
        notes = (what, *notes)
    if "upper_arm" not in of_camera:
        notes += (
            "one IMU on the forearm does not show OpenSense how the elbow is bent: take trc and Inverse"
            " Kinematics for the angles.",
        )
    rate_hz = median_rate_hz(t_s) if len(t_s) > 1 else 1.0
    columns = "\t".join(["time", *(f"{BODIES[name]}_imu" for name in of_camera)])
    head = f"DataRate={rate_hz:.6f}\nDataType=Quaternion\nversion=3\nendheader\n{columns}\n"
    line = "%.9f" + "\t%.9f,%.9f,%.9f,%.9f" * len(of_camera) + "\n"
    return Export(
        len(t_s),
        lambda path, force: write_rows(path, head, line, table, force),
        frame="opensim",
        notes=notes,
    )


def _continuous(quaternion: FloatArray) -> FloatArray:
    """Quaternions (n, 4) with signs by which neighbours lie near each other: readers interpolate them."""
    turned = np.einsum("ni,ni->n", quaternion[1:], quaternion[:-1]) < 0.0
    sign = np.concatenate([[1.0], np.where(np.cumsum(turned) % 2, -1.0, 1.0)])
    return sign[:, None] * quaternion
