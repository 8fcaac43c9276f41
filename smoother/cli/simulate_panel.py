"""`unocclude simulate panel`: images, markers and IMU samples of a panel session, with the answer."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import UnoccludeError
from .options import Force, Json, Seed
from .output import check_outputs, print_table, say_written, write_json

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from ..simulation.panel import PanelSimulation, SimulatedPanel

Folder = Annotated[
    Path, typer.Option("-o", "--output", metavar="FOLDER", help="Folder to make.", show_default=False)
]
Recording = Annotated[
    Path | None,
    typer.Option("--mcap", metavar="REC.mcap", help="Also write the session as a recording."),
]
PanelFile = Annotated[
    Path | None,
    typer.Option("--panel", metavar="PANEL.toml", help="Markers and extent of the panel to simulate."),
]


def panel(
    output: Folder,
    mcap: Recording = None,
    panel_file: PanelFile = None,
    seed: Seed = 0,
    json_file: Json = None,
    force: Force = False,
    **settings: Any,
) -> None:
    """Simulate a marker panel before a depth camera, with motion capture and IMUs, and the answer.

    Writes depth and infrared images, mocap markers and IMU samples of each pose, intrinsics.toml, panel.toml
    and truth.toml: what `calibrate panel` and `calibrate world` take, and what they should find.
    """
    from ..io.media.panel_writing import check_folder, write_panel_folder, write_panel_recording
    from ..simulation.panel import simulate_panel

    config = _configured(panel_file, {name: value for name, value in settings.items() if value is not None})
    check_folder(output, force)
    check_outputs(force, [mcap, json_file], [panel_file])
    try:
        simulated = simulate_panel(config, seed)
    except ValueError as error:
        raise UnoccludeError(f"{error}.") from error
    shots, lens = _shots(simulated), simulated.lens.to_toml()
    imus = [simulated.imu_panel, simulated.imu_base]
    truth = answer(simulated)
    tables = {"intrinsics.toml": lens, "panel.toml": _definition(config), "truth.toml": truth}
    if mcap is not None:
        write_panel_recording(mcap, shots, imus, lens, force=force)
    write_panel_folder(output, shots, imus, config.hold_s / 2, tables, force=force)
    write_json(json_file, {"seed": seed, "config": config.model_dump(mode="json"), "truth": truth}, force)
    rows = [
        (name, f"{values['distance_m']:.2f}", f"{values['tilt_deg']:.0f}")
        for name, values in truth["pose"].items()
    ]
    print_table(str(output), ("pose", "distance, m", "tilt, deg"), rows)
    say_written(output, mcap, json_file)


def settings() -> dict[str, FieldInfo]:
    """The simulation's settings that are options."""
    from ..simulation.panel import PanelSimulation

    hidden = ("markers", "extent")  # in the panel's own file
    return {name: field for name, field in PanelSimulation.model_fields.items() if name not in hidden}


def answer(simulated: SimulatedPanel) -> dict[str, Any]:
    """What the calibrations should find, as plain values; quaternions are qw, qx, qy, qz."""
    import numpy as np

    poses = {}
    for number, pose in enumerate(simulated.poses, 1):
        middle = np.append(np.mean(simulated.config.extent, axis=0), 0.0)
        centre = pose.R_K_P @ middle + pose.p_K_P
        distance = float(np.linalg.norm(centre))
        poses[f"{number:02d}"] = {
            "t_s": pose.t_s,
            "rotation": _quaternion(pose.R_K_P),
            "translation": pose.p_K_P.tolist(),
            "distance_m": distance,
            "tilt_deg": float(np.degrees(np.arccos(np.clip(-pose.R_K_P[:, 2] @ centre / distance, -1, 1)))),
            "down": (-pose.R_W_K[2]).tolist(),
            "marker_pixels": pose.marker_pixels.tolist(),
            "marker_order": pose.marker_order.tolist(),
        }
    return {
        "camera_from_mocap": {
            "rotation": _quaternion(simulated.R_K_E),
            "translation": simulated.t_K_E.tolist(),
        },
        "camera_from_base": {"rotation": _quaternion(simulated.R_K_B)},
        "panel_from_imu": {"rotation": _quaternion(simulated.R_P_I)},
        "depth_offset_m": simulated.config.depth_offset_m,
        "pose": poses,
    }


def _quaternion(R: Any) -> list[float]:
    from scipy.spatial.transform import Rotation

    quaternion: list[float] = Rotation.from_matrix(R).as_quat(canonical=True, scalar_first=True).tolist()
    return quaternion


def _configured(panel_file: Path | None, changes: dict[str, Any]) -> PanelSimulation:
    from pydantic import ValidationError

    from ..simulation.panel import PanelSimulation
    from .config_file import describe

    if panel_file is not None:
        from calib.panel.definition import read_panel

        known = read_panel(panel_file)
        changes["markers"], changes["extent"] = known.markers_P.tolist(), known.extent_P.tolist()
        if known.height_m:
            changes |= {"marker_height_m": known.height_m, "marker_shape": "sphere"}
    for name, value in changes.items():
        if isinstance(value, str) and isinstance(PanelSimulation.model_fields[name].get_default(), tuple):
            changes[name] = _numbers(name, value)
    try:
        return PanelSimulation(**changes)
    except ValidationError as error:
        raise typer.BadParameter(f"setting {describe(error)}") from error


def _numbers(name: str, text: str) -> tuple[Any, ...]:
    """Numbers with commas between them; points (`--extra-markers`) with semicolons between them."""
    kind = int if name == "hidden_markers" else float
    try:
        if name == "extra_markers":
            return tuple(tuple(float(x) for x in point.split(",")) for point in text.split(";"))
        return tuple(kind(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise typer.BadParameter(
            f"--{name.replace('_', '-')} takes numbers, as 1.2,1.9; not '{text}'"
        ) from None


def _definition(config: PanelSimulation) -> dict[str, Any]:
    panel: dict[str, Any] = {"markers": [list(m) for m in config.markers]}
    panel["extent"] = [list(corner) for corner in config.extent]
    if config.marker_shape == "sphere" and config.marker_height_m > 0:
        panel["marker_height"] = config.marker_height_m
    return {"panel": panel}


def _shots(simulated: SimulatedPanel) -> list[Any]:
    import numpy as np

    from ..io.media.panel_writing import PanelShot

    return [
        PanelShot(
            pose.t_s,
            np.rint(pose.depth).astype(np.uint16),
            pose.infrared,
            pose.marker_names,
            pose.markers,
        )
        for pose in simulated.poses
    ]
