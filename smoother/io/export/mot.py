"""Joint angles to a MOT file, OpenSim's format of motions."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np

from ...array_types import BoolArray, FloatArray
from ...errors import UnoccludeError
from ...joint_angles import defined, recovery_angles, wrapped_deg
from ...result import Recovery
from ...result.untrusted import untrusted_sentences
from ...runtime.outputs import writing
from .grid import Grid, at_grid, constant_step, nearest, unbroken

_ROWS = 20_000


@dataclass(frozen=True)
class MotTable:
    """Joint angles of one arm with a constant time step and a number in every cell.

    Attributes
    ----------
    t_s : ndarray, shape (G,), s
        After the recovery's origin.
    rate_hz : float
        Rows per second.
    angles : dict of str to ndarray, shape (G,), deg
        By coordinate.
    occluded : ndarray of bool, shape (G,)
        The camera did not see the forearm.
    answered : ndarray of bool, shape (G,)
        False where the method has no answer and a straight line bridges it.
    notes : tuple of str
        What a reader must know, one sentence each.
    trusted : ndarray of bool, shape (G,), optional
        Which rows are to be trusted; None where not judged.
    """

    t_s: FloatArray
    rate_hz: float
    angles: dict[str, FloatArray]
    occluded: BoolArray
    answered: BoolArray
    notes: tuple[str, ...]
    trusted: BoolArray | None = None


def mot_table(recovery: Recovery, rate_hz: float | None = None) -> MotTable:
    """The joint angles by the names of OpenSim's MoBL-ARMS model of the upper extremity, degrees.

    `elv_angle`, `shoulder_elv`, `shoulder_rot`: the humerus turns R_y(elv_angle) R_x(-shoulder_elv)
    R_y(shoulder_rot - elv_angle) (Saul et al., Comput Methods Biomech Biomed Engin 18:1445, 2015), so that
    ISB's axial rotation is shoulder_rot - elv_angle; `elbow_flexion`: 0 = straight; `pro_sup`: 0 = thumb up,
    90 = pronated, which is ISB's pronation - 90. A left arm has the angles of its mirror image. A column
    that the recovery cannot give is left out.

    Parameters
    ----------
    recovery : Recovery
        One arm.
    rate_hz : float, optional
        Rows per second; None for the IMU's rate.

    Returns
    -------
    MotTable
        From the first sample with all angles to the last.

    Raises
    ------
    UnoccludeError
        No joint angle is known anywhere: shoulder, elbow and wrist are needed.
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
    """Write joint angles as OpenSim reads them.

    Parameters
    ----------
    table : MotTable
        The angles.
    path : path-like
        The file to write.
    recovery : Recovery
        What they are of, for the header.
    force : bool
        Overwrite a file that exists.

    Raises
    ------
    UnoccludeError
        The file exists and `force` is not given, or it cannot be written.
    """
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
    with writing(path, force) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        file.write("\n".join(head) + "\n")
        for start in range(0, len(values), _ROWS):
            part = slice(start, start + _ROWS)
            rows = zip(table.t_s[part].tolist(), values[part].tolist(), flags[part].tolist(), strict=True)
            file.write("".join([line % (time, *row, *flag) for time, row, flag in rows]))


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
