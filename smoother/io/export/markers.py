"""A recovery as markers before and after, for TRC and C3D files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...array_types import BoolArray, FloatArray
from ...errors import UnoccludeError
from ...joint_angles import torso_axes
from ...recording import JOINTS, JointState
from ...result import Recovery
from ...result.untrusted import untrusted_sentences
from ..result.usable import usable
from .c3d import C3dContent
from .grid import Grid, at_grid, constant_step, frames_at_grid, nearest

#: Axes that markers may be written in.
FRAMES = ("camera", "opensim")
#: Before a joint's name, what the camera said of it.
BEFORE = "camera_"
#: Residuals in a C3D file.
MEASURED, COMPUTED, NONE = 1.0, 0.0, -1.0
_RESIDUALS = (
    "Residual of shoulder, elbow, wrist, hand, imu: 1 = the camera saw the forearm, 0 = recovered while "
    "occluded, -1 = no answer. Of camera_*: 1 = tracked, 0 = guessed by the camera (inferred), -1 = nothing."
)


@dataclass(frozen=True)
class MarkerTable:
    """Markers of one arm with a constant time step.

    Attributes
    ----------
    grid : Grid
        The times.
    names : tuple of str
        Recovered joints and `imu`, then `camera_` and a joint.
    position : ndarray, shape (G, M, 3), m
        In the chosen axes; nan where there is none.
    residual : ndarray, shape (G, M)
        As C3D files have it: 1, 0, -1 (see `_RESIDUALS`).
    occluded : ndarray of bool, shape (G,)
        The camera did not see the forearm.
    sigma_m : ndarray, shape (G, A), m
        One standard deviation of the A recovered markers, root mean square over the axes.
    """

    grid: Grid
    names: tuple[str, ...]
    position: FloatArray
    residual: FloatArray
    occluded: BoolArray
    sigma_m: FloatArray


def marker_table(
    recovery: Recovery,
    frame: str = "camera",
    rate_hz: float | None = None,
    level_down: FloatArray | None = None,
    origin: str = "camera",
) -> MarkerTable:
    """Markers before and after.

    Parameters
    ----------
    recovery : Recovery
        One arm.
    frame : str
        "camera", or "opensim": x horizontally towards the camera (forward for a person who faces it), y up
        against gravity, z to that person's right; the origin stays in the camera.
    rate_hz : float, optional
        Rows a second; None for the IMU's rate.
    level_down : ndarray, shape (3,), optional
        Down in the camera's axes if the camera stands level, for a method that did not find gravity; None
        where the axes are not known.
    origin : str
        "camera", or "shoulder": the shoulder's median place, one point for all of the recording, so that
        the shoulder's own motion stays.

    Returns
    -------
    MarkerTable
        In the chosen axes.

    Raises
    ------
    UnoccludeError
        Gravity or the shoulder is needed and not known, or there are too few samples.
    """
    grid = constant_step(recovery, rate_hz)
    after = {joint: recovery.joints[joint] for joint in JOINTS[:-1] if joint in recovery.joints}
    after["imu"] = recovery.position
    spread = [recovery.joint_covariance.get(name) for name in list(after)[:-1]]
    spread.append(recovery.pose_covariance[:, :3, :3])
    near = nearest(recovery.t_s, grid)
    sigma = [
        np.full(len(near), np.nan) if one is None else np.sqrt(np.einsum("nii->n", one) / 3)[near]
        for one in spread
    ]
    occluded = recovery.occluded[near]
    position = [at_grid(recovery.t_s, values, grid) for values in after.values()]
    residual = [np.where(occluded, COMPUTED, MEASURED)] * len(position)
    before, flags = _camera(recovery, grid)
    whole = np.stack([*position, *before.values()], axis=1)
    marks = np.stack([*residual, *flags], axis=1)
    marks[~np.isfinite(whole).all(axis=2)] = NONE
    whole[marks == NONE] = np.nan
    if origin == "shoulder":
        whole -= shoulder_place(recovery)
    if frame == "opensim":
        whole = whole @ opensim_axes(recovery, level_down)
    names = (*after, *(BEFORE + joint for joint in before))
    return MarkerTable(grid, names, whole, marks, occluded, np.stack(sigma, axis=1))


def shoulder_place(recovery: Recovery) -> FloatArray:
    """The shoulder's median place (3,) in the camera's axes, m.

    Raises
    ------
    UnoccludeError
        The recovery has no shoulder.
    """
    places = recovery.joints.get("shoulder", np.empty((0, 3)))
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        raise UnoccludeError(
            f"{recovery.name}: it has no shoulder to put the origin into; leave --origin out"
        )
    return np.asarray(np.median(places, axis=0))


def opensim_axes(recovery: Recovery, level_down: FloatArray | None = None) -> FloatArray:
    """`R_K_O` (3, 3): OpenSim's axes (y up) in the camera's; a row vector of {K} times it is in {O}.

    Parameters
    ----------
    recovery : Recovery
        One arm.
    level_down : ndarray, shape (3,), optional
        See `marker_table`.

    Returns
    -------
    R_K_O : ndarray, shape (3, 3)
        By the direction of gravity.

    Raises
    ------
    UnoccludeError
        Neither gravity nor the camera's axes are known.
    """
    down = recovery.gravity_direction
    if not np.isfinite(down).all():
        if level_down is None:
            raise UnoccludeError(
                f"{recovery.name}: the method '{recovery.method}' found no gravity, so that OpenSim's y-up"
                " axes are not known; give --frame camera"
            )
        down = level_down
    return torso_axes(down)


def c3d_content(recovery: Recovery, table: MarkerTable, frame: str, version: str) -> C3dContent:
    """What the C3D file of a recovery holds."""
    answers = table.sigma_m.shape[1]
    near = nearest(recovery.t_s, table.grid)
    channels = {"occluded": (table.occluded.astype(float), "1")}
    if recovery.has_verdict:
        channels["trusted"] = (recovery.trusted[near].astype(float), "1")
    channels["usable"] = (usable(recovery)[near].astype(float), "1")
    for name, sigma in zip(table.names[:answers], table.sigma_m.T, strict=True):
        channels[f"sigma_{name}"] = (np.where(np.isfinite(sigma), 1000.0 * sigma, -1.0), "mm")
    start, end = table.grid.t_s[0], table.grid.t_s[-1]
    events = []
    for gap in recovery.gaps:
        if gap.end_s >= start and gap.start_s <= end:
            events.append(("gap start", float(np.clip(gap.start_s, start, end) - start)))
            events.append(("gap end", float(np.clip(gap.end_s, start, end) - start)))
    descriptions = ["recovered"] * answers + ["as the camera delivered it"] * (len(table.names) - answers)
    parameters = {
        "METHOD": [recovery.method],
        "VERSION": [version],
        "RECORDING": [recovery.name],
        "SIDE": [recovery.side or "not known"],
        "FRAME": [frame],
        "START_S": [f"{start:.9f}"],
        "ORIGIN_NS": [str(recovery.origin_ns)],
        "RESIDUALS": [_RESIDUALS],
        "VERDICT": [recovery.estimates.verdict or "nobody judged"],
        "UNTRUSTED": list(untrusted_sentences(recovery)) or ["none"],
        "CHANNELS": [
            "occluded, trusted, usable: 0 or 1 (trusted is missing where nobody judged)."
            " sigma_*: one standard deviation an axis, -1 = not known."
        ],
        "NOTES": list(recovery.notes) or ["none"],
    }
    return C3dContent(
        table.names,
        table.position,
        table.grid.rate_hz,
        table.residual,
        descriptions,
        channels,
        events,
        {"left": "Left", "right": "Right"}.get(recovery.side, "General"),
        parameters,
    )


def _camera(recovery: Recovery, grid: Grid) -> tuple[dict[str, FloatArray], list[FloatArray]]:
    """The camera's joints (G, 3) by name and their residuals (G,)."""
    arm = recovery.arm
    places: dict[str, FloatArray] = {}
    flags = []
    for number, joint in enumerate(JOINTS):
        state = arm.state[:, number]
        position = arm.position[:, number]
        has = (state != JointState.NOT_TRACKED) & np.isfinite(position).all(axis=1)
        if not has.any():
            continue
        tracked = (state == JointState.TRACKED).astype(float)
        columns = frames_at_grid(arm.t_s, np.column_stack([position, tracked]), has, grid)
        places[joint] = columns[:, :3]
        # Between a tracked and a guessed frame it is half a guess.
        flags.append(np.where(columns[:, 3] >= 1.0 - 1e-9, MEASURED, COMPUTED))
    return places, flags
