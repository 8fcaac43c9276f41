"""A recovery as markers before and after, in TRC and C3D files."""

from __future__ import annotations

import errno
import os
import shutil
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...angles.definitions import torso_axes
from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...linalg import nearest
from ...recording import JOINTS, JointState
from ...result import Recovery
from ...result.untrusted import untrusted_sentences
from ...runtime.outputs import writing
from .prepare import Export, Grid, at_grid, constant_step, marks_of, write_rows

#: Millimetres in the file, with this many decimals: a nanometre.
UNIT, PER_METRE, DECIMALS = "mm", 1000.0, 6
_COLUMNS = ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"]
_COLUMNS += ["OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"]


def write_trc(
    path: str | os.PathLike[str],
    names: Sequence[str],
    t_s: FloatArray,  # (N,) s
    position: FloatArray,  # (N, M, 3) m
    rate_hz: float,
    force: bool = False,
) -> None:
    """Write marker positions; cells are blank where a marker has none."""
    rate, count = f"{rate_hz:.10g}", str(len(t_s))
    head = [
        ["PathFileType", "4", "(X/Y/Z)", Path(path).name],
        _COLUMNS,
        [rate, rate, count, str(len(names)), UNIT, rate, "1", count],
        ["Frame#", "Time", *(cell for name in names for cell in (name, "", ""))],
        ["", "", *(f"{axis}{number}" for number in range(1, len(names) + 1) for axis in "XYZ")],
    ]
    # A tab ends every row: OpenSim drops an empty cell at the end of a line.
    line = "%d\t%.9f" + f"\t%.{DECIMALS}f" * (3 * len(names)) + "\t\n"
    values = blank(PER_METRE * position).reshape(len(t_s), -1)
    text = "".join("\t".join(cells) + "\n" for cells in head) + "\n"
    write_rows(path, text, line, [np.arange(1, len(t_s) + 1), t_s, values], force)


def blank(position: FloatArray) -> FloatArray:
    """Positions (.., 3) in which one that is not whole, or not finite, is nan on every axis."""
    return np.where(np.isfinite(position).all(axis=-1, keepdims=True), position, np.nan)


#: The header counts frames in 16 bits, and readers follow it.
MOST_FRAMES = 65_535
_BLOCK = 512
_LINE, _LINES = 120, 200
_INTEGER = 2  # ezc3d's number of the type


def write_c3d(
    path: str | os.PathLike[str],
    names: Sequence[str],
    position: FloatArray,  # (N, M, 3) m: nan where there is none
    rate_hz: float,
    force: bool = False,
    *,
    residual: FloatArray | None = None,  # (N, M): of each point by the format's convention
    descriptions: Sequence[str] = (),  # Of the points
    # Further signals (N,) at the frames' rate, by name, with their unit
    channels: Mapping[str, tuple[FloatArray, str]] | None = None,
    events: Sequence[tuple[str, float]] = (),  # Label and time, s from the first frame
    context: str = "General",  # Of the events: "Left", "Right" or "General"
    parameters: Mapping[str, Sequence[str]] | None = None,  # Group UNOCCLUDE
) -> None:
    """Write a C3D file (floating point, millimetres)."""
    import ezc3d

    check_frames(path, len(position), rate_hz)
    file, channels = ezc3d.c3d(), channels or {}

    def put(group: str, **values: Sequence[object]) -> None:
        for name, each in values.items():
            file["parameters"][group][name]["value"] = list(each)

    position = blank(PER_METRE * position)
    residual = np.where(np.isfinite(position[..., 0]), 0.0 if residual is None else residual, -1.0)
    put("POINT", RATE=[float(rate_hz)], UNITS=[UNIT], LABELS=names)
    if descriptions:
        put("POINT", DESCRIPTIONS=descriptions)
    homogeneous = np.ones((4, position.shape[1], len(position)))
    homogeneous[:3] = position.transpose(2, 1, 0)
    file["data"]["points"] = homogeneous
    file["data"]["meta_points"]["residuals"] = residual.T[None]
    file["data"]["meta_points"]["camera_masks"] = np.zeros((7, *residual.T.shape), dtype=bool)
    if channels:
        units = [unit for _, unit in channels.values()]
        put("ANALOG", RATE=[float(rate_hz)], LABELS=list(channels), UNITS=units)
        file["data"]["analogs"] = np.stack([values for values, _ in channels.values()])[None]
    if events:  # as other software writes them: times in minutes and seconds
        times = np.array([time for _, time in events])
        file.add_parameter("EVENT", "USED", [len(events)])
        file["parameters"]["EVENT"]["USED"]["type"] = _INTEGER
        file["parameters"]["EVENT"]["USED"]["value"] = np.array([len(events)])
        file.add_parameter("EVENT", "CONTEXTS", [context] * len(events))
        file.add_parameter("EVENT", "LABELS", [label for label, _ in events])
        file.add_parameter("EVENT", "TIMES", np.stack([times // 60, times % 60]))
    for name, texts in (parameters or {}).items():
        # A dimension of a parameter is one byte: longer texts go on in the next line.
        plain = [text.encode("ascii", "replace").decode() for text in texts]
        lines = [line for text in plain for line in textwrap.wrap(text, _LINE)]
        file.add_parameter("UNOCCLUDE", name, lines[:_LINES])
    with writing(path, force) as temporary:
        named = temporary.with_name(f"{temporary.name}.c3d")  # ezc3d insists on the ending
        try:
            file.write(os.fspath(named))
            _check_size(named, 4 * len(position) * (4 * len(names) + len(channels)))
            shutil.copyfile(named, temporary)
        finally:
            named.unlink(missing_ok=True)


def check_frames(name: str | os.PathLike[str], frames: int, rate_hz: float) -> None:
    """Refuse what is too long for the format."""
    if frames > MOST_FRAMES:
        slower = np.floor(100 * rate_hz * MOST_FRAMES / frames) / 100
        raise UnoccludeError(
            f"{name}: a C3D file contains at most {MOST_FRAMES} frames and this would have {frames};"
            f" give --rate {slower:g} or less, or export to trc or parquet"
        )


def _check_size(path: Path, of_data: int) -> None:
    """ezc3d reports no error when the disk is full; a file that was cut short is not to be delivered."""
    content = path.read_bytes() if path.exists() else b""
    start = (int.from_bytes(content[16:18], "little") - 1) * _BLOCK if len(content) >= _BLOCK else 0
    if len(content) < start + of_data or start <= 0:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


#: Before a joint's name, what the camera said of it.
BEFORE = "camera_"
#: Residuals in a C3D file.
MEASURED, COMPUTED, NONE = 1.0, 0.0, -1.0
_RESIDUALS = (
    "Residual of shoulder, elbow, wrist, hand, imu: 1 = the camera saw the forearm, 0 = recovered while "
    "occluded, -1 = no answer. Of camera_*: 1 = tracked, 0 = guessed by the camera (inferred), -1 = nothing."
)
_CHANNELS = (
    "occluded, trusted, usable: 0 or 1 (trusted is missing if there is no verdict)."
    " sigma_*: one standard deviation per axis, -1 = unknown."
)


def prepare_markers(
    recovery: Recovery,
    format_name: str,
    frame: str,
    rate_hz: float | None,
    level_down: FloatArray | None,  # (3,)
    version: str,
    origin: str,
) -> Export:
    """Markers before and after with a constant time step, as a TRC or C3D file."""
    grid = constant_step(recovery, rate_hz)
    after = {joint: recovery.joints[joint] for joint in JOINTS[:-1] if joint in recovery.joints}
    after["imu"] = recovery.position
    near = nearest(recovery.t_s, grid.t_s)
    places = [at_grid(recovery.t_s, values, grid) for values in after.values()]
    residuals = [np.where(recovery.occluded[near], COMPUTED, MEASURED)] * len(places)
    names, arm = list(after), recovery.arm
    for joint, state, position in zip(JOINTS, arm.state.T, arm.position.transpose(1, 0, 2), strict=True):
        has = (state != JointState.NOT_TRACKED) & np.isfinite(position).all(axis=1)
        if has.any():
            tracked = (state == JointState.TRACKED).astype(float)
            columns = at_grid(arm.t_s, np.column_stack([position, tracked]), grid, has)
            names.append(BEFORE + joint)
            places.append(columns[:, :3])
            # Between a tracked and a guessed frame it is half a guess.
            residuals.append(np.where(columns[:, 3] >= 1.0 - 1e-9, MEASURED, COMPUTED))
    whole, residual = np.stack(places, axis=1), np.stack(residuals, axis=1)
    residual[~np.isfinite(whole).all(axis=2)] = NONE
    whole[residual == NONE] = np.nan
    if origin == "shoulder":
        whole -= shoulder_place(recovery)
    if frame == "opensim":
        whole = whole @ opensim_axes(recovery, level_down)
    notes = level_note(recovery) if frame == "opensim" else ()
    rows, rate = len(grid.t_s), grid.rate_hz
    if format_name == "trc":
        return Export(
            rows, lambda path, force: write_trc(path, names, grid.t_s, whole, rate, force), rate, frame, notes
        )
    check_frames(recovery.name, rows, rate)
    about = _about(recovery, grid, names, frame, version) | {"residual": residual}
    return Export(
        rows, lambda path, force: write_c3d(path, names, whole, rate, force, **about), rate, frame, notes
    )


def level_note(recovery: Recovery) -> tuple[str, ...]:
    """A note where OpenSim's axes are those of a camera that is taken to stand level."""
    if np.isfinite(recovery.gravity_direction).all():
        return ()
    return (f"the method '{recovery.method}' found no gravity: the camera is assumed level.",)


def shoulder_place(recovery: Recovery) -> FloatArray:
    """The shoulder's median place (3,) in the camera's axes, m."""
    places = recovery.joints.get("shoulder", np.empty((0, 3)))
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        raise UnoccludeError(f"{recovery.name}: it has no shoulder for the origin; leave out --origin")
    return np.asarray(np.median(places, axis=0))


def opensim_axes(
    recovery: Recovery,
    level_down: FloatArray | None = None,  # (3,)
) -> FloatArray:  # (3, 3)
    """`R_K_O` (3, 3): OpenSim's axes (y up) in the camera's; a row vector of {K} times it is in {O}."""
    known = np.isfinite(recovery.gravity_direction).all()
    down = recovery.gravity_direction if known else level_down
    if down is None:
        raise UnoccludeError(
            f"{recovery.name}: the method '{recovery.method}' found no gravity, so that OpenSim's y-up"
            " axes are not known; give --frame camera"
        )
    return torso_axes(down)


def _about(recovery: Recovery, grid: Grid, names: Sequence[str], frame: str, version: str) -> dict[str, Any]:
    """What `write_c3d` writes besides: trust and sigmas as channels, gaps as events, and what is known."""
    answers = [name for name in names if not name.startswith(BEFORE)]
    near = nearest(recovery.t_s, grid.t_s)
    channels = {name: (mark[near].astype(float), "1") for name, mark in marks_of(recovery).items()}
    for name in answers:
        spread = recovery.pose_covariance[:, :3, :3] if name == "imu" else recovery.joint_covariance.get(name)
        variance = np.full(len(recovery), np.nan) if spread is None else np.einsum("nii->n", spread) / 3
        sigma = np.sqrt(variance)[near]  # root mean square over the axes
        channels[f"sigma_{name}"] = (np.where(np.isfinite(sigma), 1000.0 * sigma, -1.0), "mm")
    start, end = grid.t_s[0], grid.t_s[-1]
    events = [
        (label, float(np.clip(at, start, end) - start))
        for gap in recovery.gaps
        if gap.end_s >= start and gap.start_s <= end
        for label, at in (("gap start", gap.start_s), ("gap end", gap.end_s))
    ]
    return {
        "descriptions": ["recovered"] * len(answers)
        + ["as the camera delivered it"] * (len(names) - len(answers)),
        "channels": channels,
        "events": events,
        "context": recovery.side.capitalize() or "General",
        "parameters": {
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
            "CHANNELS": [_CHANNELS],
            "NOTES": list(recovery.notes) or ["none"],
        },
    }
