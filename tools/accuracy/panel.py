"""Calibrations with the panel: `panel` and `world`.

`panel [rendered|real]`: `rendered` draws panels, finds the camera by them and compares with the truth: one
pose a trial, eight poses, and eight with a wrong depth and a bright distractor. `real` needs the folder of
data sets in UNOCCLUDE_DATASETS (`kinect_calib`: a real panel in real Kinect depth, with a published
calibration). `world`: camera from base IMU, tilt, mounting and their sigmas on rendered sessions.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from calib.images import view
from calib.intrinsics import Intrinsics
from calib.panel import PanelCalibration, accuracy, calibrate_panel, principal
from calib.plane import Frame, Panel, Plane, fit_plane
from calib.world import WorldCalibration, calibrate_world, view_panel, world_poses
from smoother.errors import UnoccludeError
from smoother.simulation.panel import PanelSimulation, SimulatedPanel, simulate_panel
from tools.accuracy.check import CHANGES, changes, check, datasets, option, parts_option, seeds_option

#: Pixels left out along the real panel's outline.
RIM_PX = 3
NEAR_M = 2.0


# Rendered panels


def show_rendered(options: argparse.Namespace) -> Iterator[str]:
    """Rendered panels: one pose a trial; for a fifth of the seeds eight poses, and eight with errors."""
    wrong = {"depth_offset_m": 0.005, "distractors": 1}
    few = options.seeds[: -(-len(options.seeds) // 5)]
    yield ("errors of camera from mocap, the place taken at the middle of the panel's places")
    for title, seeds, settings in (
        ("one pose", options.seeds, {"poses": 1}),
        ("eight poses", few, {"poses": 8}),
        ("eight poses, depth 5 mm too long, a distractor", few, {"poses": 8, **wrong}),
    ):
        config = PanelSimulation(**(settings | changes(options)))
        rows = [trial(config, seed) for seed in seeds]
        yield f"{title}: {len(rows)} trials"
        yield from (f"  seed {row['seed']} refused: {row['refused']}" for row in rows if "refused" in row)
        yield from _figures([row for row in rows if "ours" in row])


def trial(config: PanelSimulation, seed: int) -> dict[str, Any]:
    """Errors of one simulated session, or why it was refused."""
    truth = simulate_panel(config, seed)
    try:
        found = calibrated(truth)
    except UnoccludeError as error:
        return {"seed": seed, "refused": str(error)}
    ours = errors(found.solution.camera_from_mocap, truth, found)
    theirs = errors(found.published, truth, found) if found.published is not None else (np.nan, np.nan)
    sigma = accuracy(found)
    spread = np.concatenate([np.radians(sigma.rotation_deg), sigma.at_panel_m])
    return {
        "seed": seed,
        "ours": ours[:2],
        "published": theirs[:2],
        "inside": np.abs(ours[2]) <= 2 * spread,
        "squared": (ours[2] / spread) ** 2,
        "offset": found.solution.depth_offset_m,
    }


def calibrated(truth: SimulatedPanel) -> PanelCalibration:
    """`calibrate_panel` on a simulated session."""
    config, lens = truth.config, truth.lens
    height = config.marker_height_m if config.marker_shape == "sphere" else 0.0
    panel = Panel(np.array(config.markers), np.array(config.extent), height)
    return calibrate_panel(
        [view(pose.depth, pose.infrared, f"pose {number}") for number, pose in enumerate(truth.poses, 1)],
        [dict(zip(pose.marker_names, pose.markers, strict=True)) for pose in truth.poses],
        panel,
        Intrinsics(lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, lens.distortion),
    )


def errors(frame: Frame, truth: SimulatedPanel, found: PanelCalibration) -> tuple[float, float, np.ndarray]:
    """Degrees, mm at the middle of the panel's places, and both as one vector (rad, m)."""
    turn = Rotation.from_matrix(frame.R @ truth.R_K_E.T).as_rotvec()
    middle = np.mean(np.concatenate(found.markers_E), axis=0)
    shift = frame.R @ middle + frame.origin - truth.R_K_E @ middle - truth.t_K_E
    vector = np.concatenate([turn, shift])
    return float(np.degrees(np.linalg.norm(turn))), float(1e3 * np.linalg.norm(shift)), vector


def _figures(good: list[dict[str, Any]]) -> Iterator[str]:
    if not good:
        return
    for name in ("ours", "published"):
        values = np.array([row[name] for row in good])
        for column, unit in enumerate(("deg", "mm")):
            median, most, worst = np.nanpercentile(values[:, column], [50, 95, 100])
            yield (f"  {name:9} {unit:3}  median {median:6.3f}  95 % {most:6.3f}  worst {worst:6.3f}")
    inside, squared = (np.mean([row[key] for row in good]) for key in ("inside", "squared"))
    yield (f"  inside 2 sigma, per axis: {100 * inside:.0f} %; squared error / sigma^2 {squared:.2f}")


# A real panel


def real(options: argparse.Namespace) -> Iterator[str]:
    """A real panel in real Kinect depth, against its published calibration."""
    for corrected in (False, True):
        rows = real_planes(datasets("kinect_calib"), corrected)
        yield (f"disparity distortion {'taken off' if corrected else 'left in'}")
        yield ("  image          z, m  angle, deg  distance, mm  sigma, deg  depth noise, mm")
        for name, (z, angle, distance, sigma, noise) in rows.items():
            yield (f"  {name}  {z:6.2f}  {angle:10.2f}  {distance:12.2f}  {sigma:10.2f}  {noise:15.1f}")
        table = np.abs(np.array(list(rows.values())))
        for title, chosen in (("nearer than 2 m", table[:, 0] < NEAR_M), ("all", table[:, 0] > 0)):
            middle, worst = np.median(table[chosen, 1:3], axis=0), table[chosen, 1:3].max(axis=0)
            yield (
                f"  {title} ({chosen.sum()}): median {middle[0]:.2f} deg {middle[1]:.2f} mm,"
                f" worst {worst[0]:.2f} deg {worst[1]:.2f} mm"
            )


def real_planes(folder: Path, corrected: bool) -> dict[str, tuple[float, float, float, float, float]]:
    """By image: depth (m), angle (deg) and distance (mm) to the published plane, sigma (deg), noise (mm)."""
    data = loadmat(folder / "full_set.mat", squeeze_me=True, struct_as_record=False)
    published = data["final_calib"]
    k1, k2, p1, p2, k3 = published.dkc
    K = published.dK
    lens = Intrinsics(640, 480, K[0, 0], K[1, 1], K[0, 2], K[1, 2], (k1, k2, p1, p2, k3))
    rows = {}
    for number, name in enumerate(data["dfiles"]):
        if not np.size(name) or not (folder / str(name)).exists():
            continue
        outline = np.asarray(data["depth_plane_poly"][number], float).T
        plane, points = real_plane(_depth(folder / str(name), published, corrected), outline, lens)
        # the published pose of the panel, from the colour camera to the depth camera
        R = published.dR.T @ published.Rext[number]
        t = published.dR.T @ (published.text[number] - published.dt)
        centre, axes = principal(points)
        normal = R[:, 2] * np.sign(R[:, 2] @ t)
        angle = np.degrees(np.arccos(min(abs(axes[:, 2] @ normal), 1.0)))
        rows[str(name)] = (
            float(centre[2]),
            float(angle),
            float(1e3 * normal @ (centre - t)),
            normal_sigma_deg(plane),
            1e3 * plane.noise_m,
        )
    return rows


def real_plane(depth_m: np.ndarray, outline: np.ndarray, lens: Intrinsics) -> tuple[Plane, np.ndarray]:
    """The plane within an outline (n, 2) pixels, and the points (N, 3) that were used."""
    import cv2

    mask = np.zeros((depth_m.shape[0] + 2, depth_m.shape[1] + 2), np.uint8)
    cv2.fillPoly(mask, [np.rint(outline + 1).astype(np.int32)], 1)
    mask[[0, -1]] = mask[:, [0, -1]] = 0
    inner = cv2.erode(mask, np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), np.uint8))[1:-1, 1:-1]
    v, u = np.nonzero((inner > 0) & np.isfinite(depth_m))
    rays = lens.ray_image()[v, u]
    plane = fit_plane(np.column_stack([u, v]).astype(float), rays, depth_m[v, u])
    points = np.column_stack([rays, np.ones(len(rays))]) * depth_m[v, u, None]
    return plane, points[plane.inliers]


def normal_sigma_deg(plane: Plane) -> float:
    """Standard deviation of the plane's normal: square root of the trace, degrees."""
    size = np.linalg.norm(plane.theta)
    normal = plane.theta / size
    across = (np.eye(3) - np.outer(normal, normal)) / size
    return float(np.degrees(np.sqrt(np.trace(across @ plane.covariance @ across.T))))


def _depth(path: Path, published: Any, corrected: bool) -> np.ndarray:
    """Depth (480, 640) m of a raw disparity image; nan where it has none."""
    raw = np.frombuffer(path.read_bytes()[-2 * 640 * 480 :], ">u2").reshape(480, 640).astype(float)
    disparity = raw
    if corrected:
        a0, a1 = published.dc_alpha
        disparity = raw + published.dc_beta * np.exp(a0 - a1 * raw)
    depth = 1 / (published.dc[0] + published.dc[1] * disparity)
    return np.where((raw < 2047) & (depth > 0.3) & (depth < 8.0), depth, np.nan)


PARTS = {"rendered": show_rendered, "real": real}


@check(
    parts_option(*PARTS),
    seeds_option("1000:1100", "of one pose; a fifth of them also of eight"),
    CHANGES,
)
def panel(options: argparse.Namespace) -> Iterator[str]:
    """`calibrate panel` on rendered panels, or on a real panel in real Kinect depth."""
    for part in options.parts or PARTS:
        yield from PARTS[part](options)


def calibrated_world(panel: SimulatedPanel) -> WorldCalibration:
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


def world_errors(panel: SimulatedPanel, found: WorldCalibration) -> dict[str, float]:
    """Degrees: camera from base IMU, its tilt, the mounting; and the tilt's error in sigmas."""
    from calib.world import accuracy

    error = Rotation.from_matrix(found.R_K_B @ panel.R_K_B.T).as_rotvec()
    mounting = Rotation.from_matrix(found.R_P_I.T @ panel.R_P_I).magnitude()
    tilts = []
    for pose, row in zip(panel.poses, found.poses, strict=True):
        up = row.base.acc - found.at.rest[:3]
        tilts.append(np.linalg.norm(np.cross(found.R_K_B @ up / np.linalg.norm(up), pose.R_W_K[2])))
    sigma = accuracy(found)
    return {
        "rotation": float(np.degrees(np.linalg.norm(error))),
        "tilt": float(np.degrees(max(tilts))),
        "mounting": float(np.degrees(mounting)),
        "tilt_sigma": sigma.tilt_deg,
        "nees": float(error @ np.linalg.solve(found.covariance[:3, :3], error) / 3),
    }


#: Sessions: what they are called, their settings, and which errors they show.
SESSIONS: tuple[tuple[str, dict[str, Any], tuple[str, ...]], ...] = (
    ("camera turned between poses", {"camera_tilt_deg": 30.0}, ("rotation", "tilt", "mounting")),
    ("camera stands still", {}, ("tilt", "mounting")),
    ("camera stands still, magnetometers", {"magnetometer": True}, ("tilt", "mounting", "rotation")),
)
LIMIT_DEG = 0.3


@check(
    seeds_option("100:120"),
    option("--poses", type=int, default=6),
)
def world(options: argparse.Namespace) -> Iterator[str]:
    """Camera from base IMU, its tilt and the mounting on rendered sessions; ends with 1 above the limit."""
    yield f"{options.poses} poses, an ordinary phone's IMUs, panel IMU 3 degrees off; degrees, median / worst"
    missed = False
    for name, settings, shown in SESSIONS:
        rows = []
        for seed in options.seeds:
            config = PanelSimulation(poses=options.poses, tilt_deg=(15.0, 38.0), **settings)
            panel = simulate_panel(config, seed)
            try:
                rows.append(world_errors(panel, calibrated_world(panel)))
            except UnoccludeError as error:
                yield f"  {name}, seed {seed}: {error}"
                missed = True
        if not rows:
            continue
        columns = {key: np.array([row[key] for row in rows]) for key in rows[0]}
        words = ", ".join(f"{key} {np.median(columns[key]):.2f} / {columns[key].max():.2f}" for key in shown)
        inside = 100 * np.mean(columns["tilt"] <= 2 * np.sqrt(2) * columns["tilt_sigma"])
        nees = columns["nees"].mean()
        yield f"  {name}: {words}; tilt within 2 sigma {inside:.0f} %, NEES/3 {nees:.2f}"
        missed |= shown[0] == "rotation" and bool(columns["rotation"].max() > LIMIT_DEG)
    if missed:
        raise SystemExit(1)
