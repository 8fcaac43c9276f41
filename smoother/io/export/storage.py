"""OpenSim's storage files: joint angles (MOT), and orientations of IMUs (STO), as OpenSense reads them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...array_types import BoolArray, FloatArray
from ...errors import UnoccludeError
from ...joint_angles import defined, recovery_angles, wrapped_deg
from ...linalg import median_rate_hz
from ...result import Recovery
from ...result.untrusted import untrusted_sentences
from ...rotation import Rotation
from .grid import Grid, at_grid, constant_step, nearest, unbroken
from .markers import level_note, opensim_axes
from .rows import Export, write_rows


def prepare_mot(recovery: Recovery, rate_hz: float | None = None) -> Export:
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
    place, near, t_s = np.arange(len(answered)), nearest(recovery.t_s, grid)[part], grid.t_s[part]
    values = np.stack([np.interp(place, place[answered], of[answered])[part] for of in angles.values()], 1)
    marks = {"occluded": recovery.occluded[near], "answered": answered[part]}
    if recovery.has_verdict:
        marks["trusted"] = recovery.trusted[near]
    columns = ["time", *angles, *marks]
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
        *_trust_lines(recovery),
        "",
        "endheader",
        "\t".join(columns),
        "",
    ]
    line = "%.9f" + "\t%.9f" * len(angles) + "\t%d" * len(marks) + "\n"
    table = [t_s, values, np.stack(list(marks.values()), 1).astype(int)]
    notes = _notes(answered[part], len(answered) - len(t_s), grid.rate_hz, isb_angles)
    return Export(
        len(t_s),
        lambda path, force: write_rows(path, "\n".join(head), line, table, force),
        grid.rate_hz,
        notes=notes,
    )


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
    turned = {
        name: (R_O_K * Rotation.from_quat(values[rows], scalar_first=True)).as_quat(scalar_first=True)
        for name, values in of_camera.items()
    }
    t_s = recovery.t_s[rows]
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
    columns = "\t".join(["time", *(f"{BODIES[name]}_imu" for name in turned)])
    head = f"DataRate={rate_hz:.6f}\nDataType=Quaternion\nversion=3\nendheader\n{columns}\n"
    line = "%.9f" + "\t%.9f,%.9f,%.9f,%.9f" * len(turned) + "\n"
    table = [t_s, *map(_continuous, turned.values())]
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
