"""`calibrate world` on rendered sessions, camera from base IMU, tilt, mounting, sigmas: `world`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from calib.intrinsics import Intrinsics
from calib.panel.definition import Panel
from calib.panel.images import view
from calib.world.panel_view import view_panel
from calib.world.world_calibration import WorldCalibration, calibrate_world, world_poses
from smoother.errors import UnoccludeError
from smoother.simulation.panel import PanelSimulation, SimulatedPanel, simulate_panel
from tools.accuracy.check import Check, option, seeds_option

#: Sessions: what they are called, and their settings.
SESSIONS = {
    "camera turned between poses": {"camera_tilt_deg": 30.0, "tilt_deg": (15.0, 38.0)},
    "camera stands still": {"tilt_deg": (15.0, 38.0)},
    "camera stands still, magnetometers": {"magnetometer": True, "tilt_deg": (15.0, 38.0)},
}
LIMIT_DEG = 0.3


def calibrated(panel: SimulatedPanel) -> WorldCalibration:
    """The whole method on images and samples, as the command does it from a recording."""
    config, lens = panel.config, panel.lens
    known = Panel(np.array(config.markers), np.array(config.extent))
    camera = Intrinsics(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, lens.distortion)
    seen = [
        view_panel(view(pose.depth, pose.infrared, f"pose {number}"), pose.t_s, known, camera)
        for number, pose in enumerate(panel.poses, 1)
    ]
    count = len(seen)
    return calibrate_world(*world_poses(seen, [panel.imu_panel] * count, [panel.imu_base] * count))


def errors(panel: SimulatedPanel, found: WorldCalibration) -> dict[str, float]:
    """Degrees: camera from base IMU, its tilt, the mounting; and the tilt's error in sigmas."""
    from calib.world.world_table import accuracy

    error = Rotation.from_matrix(found.R_K_B @ panel.R_K_B.T).as_rotvec()
    mounting = Rotation.from_matrix(found.R_P_I.T @ panel.R_P_I).magnitude()
    tilts = []
    for pose, row in zip(panel.poses, found.poses, strict=True):
        up = row.base.acc - found.solution.at.rest[:3]
        tilts.append(np.linalg.norm(np.cross(found.R_K_B @ up / np.linalg.norm(up), pose.R_W_K[2])))
    sigma = accuracy(found)
    return {
        "rotation": float(np.degrees(np.linalg.norm(error))),
        "tilt": float(np.degrees(max(tilts))),
        "mounting": float(np.degrees(mounting)),
        "tilt_sigma": sigma.tilt_deg,
        "nees": float(error @ np.linalg.solve(found.solution.covariance[:3, :3], error) / 3),
    }


def world(options: argparse.Namespace) -> Iterator[str]:
    """Camera from base IMU, its tilt and the mounting on rendered sessions; ends with 1 above the limit."""
    yield (
        f"{options.poses} poses, an ordinary phone's IMUs, panel IMU 3 degrees off; degrees, median / worst"
    )
    missed = False
    for name, settings in SESSIONS.items():
        rows = []
        for seed in options.seeds:
            panel = simulate_panel(PanelSimulation(poses=options.poses, **settings), seed)
            try:
                rows.append(errors(panel, calibrated(panel)))
            except UnoccludeError as error:
                yield (f"  {name}, seed {seed}: {error}")
                missed = True
        if not rows:
            continue
        columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}
        shown = ("rotation", "tilt", "mounting") if "turned" in name else ("tilt", "mounting")
        shown = (*shown, "rotation") if "magnet" in name else shown
        words = ", ".join(f"{key} {np.median(columns[key]):.2f} / {columns[key].max():.2f}" for key in shown)
        inside = np.mean(columns["tilt"] <= 2 * np.sqrt(2) * columns["tilt_sigma"])
        yield (
            f"  {name}: {words}; tilt within 2 sigma {100 * inside:.0f} %, NEES/3"
            f" {columns['nees'].mean():.2f}"
        )
        if "turned" in name:
            missed |= bool(columns["rotation"].max() > LIMIT_DEG)
    if missed:
        raise SystemExit(1)


CHECKS = (Check("world", world, (seeds_option("100:120"), option("--poses", type=int, default=6))),)
