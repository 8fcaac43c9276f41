"""Calibrations of the rig: `panel`, `world` and `clock`.

`panel [rendered|real]`: `rendered` draws panels, finds the camera by them and compares with the truth: one
pose a trial, eight poses, and eight with a wrong depth and a bright distractor. `real` needs the folder of
data sets in UNOCCLUDE_DATASETS (`kinect_calib`: a real panel in real Kinect depth, with a published
calibration). `world`: camera from base IMU, tilt, mounting and their sigmas on rendered sessions.

`clock [sound|broadcast|motion|skew]`: beeps in rooms with a voice, broadcasts with missing and late
receptions (steps of 0.3125 ms), the realistic arm, and 15 minutes of it with a clock that runs 390 ppm fast.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from calib import world as base
from calib.clock import clock_from_motion, solve_clocks
from calib.images import Frame, Panel, Plane, fit_plane, view
from calib.intrinsics import Intrinsics
from calib.panel import PanelCalibration, accuracy, calibrate_panel, principal
from calib.sound import find_beeps
from smoother.errors import UnoccludeError
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.panel import PanelSimulation, SimulatedPanel, simulate_panel
from smoother.simulation.rig import beep, broadcast
from tools.accuracy.check import (
    CHANGES,
    ONE_PROCESS,
    changes,
    check,
    datasets,
    error_table,
    option,
    parts_option,
    seeds_option,
    table,
)

#: Pixels left out along the real panel's outline.
RIM_PX = 3
NEAR_M = 2.0


def _quantiles(found: list[dict[str, float]]) -> Iterator[str]:
    """Median, 95 % and worst of each error."""
    for name in found[0] if found else ():
        median, most, worst = np.nanpercentile(np.abs([row[name] for row in found]), [50, 95, 100])
        yield f"  {name:20} median {median:6.3f}  95 % {most:6.3f}  worst {worst:6.3f}"


def rendered(options: argparse.Namespace) -> Iterator[str]:
    """Rendered panels: one pose a trial; for a fifth of the seeds eight poses, and eight with errors."""
    wrong = {"depth_offset_m": 0.005, "distractors": 1}
    few = options.seeds[: -(-len(options.seeds) // 5)]
    yield "errors of camera from mocap (deg; mm at the middle of the panel's places)"
    for title, seeds, settings in (
        ("one pose", options.seeds, {"poses": 1}),
        ("eight poses", few, {"poses": 8}),
        ("eight poses, depth 5 mm too long, a distractor", few, {"poses": 8, **wrong}),
    ):
        rows = []
        for seed in seeds:
            try:
                rows.append(trial(PanelSimulation(**(settings | changes(options))), seed))
            except UnoccludeError as error:
                yield f"  seed {seed} refused: {error}"
        yield f"{title}: {len(rows)} trials"
        if rows:
            names = [(name, column) for name in ("ours", "published") for column in (0, 1)]
            yield from _quantiles(
                [{f"{name}, {('deg', 'mm')[at]}": row[name][at] for name, at in names} for row in rows]
            )
            squared = np.concatenate([row["squared"] for row in rows])
            inside, nees = 100 * np.mean(squared <= 4), squared.mean()
            yield f"  inside 2 sigma, per axis: {inside:.0f} %; squared error / sigma^2 {nees:.2f}"


def trial(config: PanelSimulation, seed: int) -> dict[str, Any]:
    """Errors of `calibrate_panel` on one simulated session."""
    truth = simulate_panel(config, seed)
    height = config.marker_height_m if config.marker_shape == "sphere" else 0.0
    found = calibrate_panel(
        [view(pose.depth, pose.infrared, f"pose {number}") for number, pose in enumerate(truth.poses, 1)],
        [dict(zip(pose.marker_names, pose.markers, strict=True)) for pose in truth.poses],
        Panel(np.array(config.markers), np.array(config.extent), height),
        truth.lens,
    )
    degrees, mm, vector = errors(found.solution.camera_from_mocap, truth, found)
    theirs = errors(found.published, truth, found) if found.published is not None else (np.nan, np.nan)
    sigma = accuracy(found)
    spread = np.concatenate([np.radians(sigma.rotation_deg), sigma.at_panel_m])
    return {
        "ours": (degrees, mm),
        "published": theirs[:2],
        "squared": (vector / spread) ** 2,
        "offset": found.solution.depth_offset_m,
    }


def errors(frame: Frame, truth: SimulatedPanel, found: PanelCalibration) -> tuple[float, float, np.ndarray]:
    """Degrees, mm at the middle of the panel's places, and both as one vector (rad, m)."""
    turn = Rotation.from_matrix(frame.R @ truth.R_K_E.T).as_rotvec()
    middle = np.mean(np.concatenate(found.markers_E), axis=0)
    shift = frame.R @ middle + frame.origin - truth.R_K_E @ middle - truth.t_K_E
    vector = np.concatenate([turn, shift])
    return float(np.degrees(np.linalg.norm(turn))), float(1e3 * np.linalg.norm(shift)), vector


def real(_: argparse.Namespace) -> Iterator[str]:
    """A real panel in real Kinect depth, against its published calibration."""
    columns = ("z, m", "angle, deg", "distance, mm", "sigma, deg", "depth noise, mm")
    for corrected in (False, True):
        rows = real_planes(datasets("kinect_calib"), corrected)
        found = [{"image": name} | dict(zip(columns, row, strict=True)) for name, row in rows.items()]
        yield f"disparity distortion {'taken off' if corrected else 'left in'}"
        yield from table("select * from found", found)
        for title, most_m in (("nearer than 2 m", NEAR_M), ("all", np.inf)):
            yield title
            chosen = [row for row in found if row["z, m"] < most_m]
            yield from _quantiles([{name: row[name] for name in columns[1:3]} for row in chosen])


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
        angle = float(np.degrees(np.arccos(min(abs(axes[:, 2] @ normal), 1.0))))
        # of the plane's normal: square root of the trace
        size = np.linalg.norm(plane.theta)
        across = (np.eye(3) - np.outer(plane.theta, plane.theta) / size**2) / size
        sigma = float(np.degrees(np.sqrt(np.trace(across @ plane.covariance @ across.T))))
        distance_mm = float(1e3 * normal @ (centre - t))
        rows[str(name)] = (float(centre[2]), angle, distance_mm, sigma, 1e3 * plane.noise_m)
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


def _depth(path: Path, published: Any, corrected: bool) -> np.ndarray:
    """Depth (480, 640) m of a raw disparity image; nan where it has none."""
    raw = np.frombuffer(path.read_bytes()[-2 * 640 * 480 :], ">u2").reshape(480, 640).astype(float)
    disparity = raw
    if corrected:
        a0, a1 = published.dc_alpha
        disparity = raw + published.dc_beta * np.exp(a0 - a1 * raw)
    depth = 1 / (published.dc[0] + published.dc[1] * disparity)
    return np.where((raw < 2047) & (depth > 0.3) & (depth < 8.0), depth, np.nan)


PARTS = {"rendered": rendered, "real": real}


@check(
    parts_option(*PARTS),
    seeds_option("1000:1100", "of one pose; a fifth of them also of eight"),
    CHANGES,
)
def panel(options: argparse.Namespace) -> Iterator[str]:
    """`calibrate panel` on rendered panels, or on a real panel in real Kinect depth."""
    for part in options.parts or PARTS:
        yield from PARTS[part](options)


def world_errors(made: SimulatedPanel) -> dict[str, float]:
    """Degrees: camera from base IMU, its tilt, the mounting; the tilt's sigma, and the camera's NEES."""
    known = Panel(np.array(made.config.markers), np.array(made.config.extent))
    seen = [
        base.view_panel(view(pose.depth, pose.infrared, f"pose {number}"), pose.t_s, known, made.lens)
        for number, pose in enumerate(made.poses, 1)
    ]
    imus = [made.imu_panel] * len(seen), [made.imu_base] * len(seen)
    found = base.calibrate_world(*base.world_poses(seen, *imus))
    error = Rotation.from_matrix(found.R_K_B @ made.R_K_B.T).as_rotvec()
    tilts = []
    for pose, row in zip(made.poses, found.poses, strict=True):
        up = row.base.acc - found.bias
        tilts.append(np.linalg.norm(np.cross(found.R_K_B @ up / np.linalg.norm(up), pose.R_W_K[2])))
    sigma = base.accuracy(found).tilt_deg
    return {
        "rotation": float(np.degrees(np.linalg.norm(error))),
        "tilt": float(np.degrees(max(tilts))),
        "mounting": float(np.degrees(Rotation.from_matrix(found.R_P_I.T @ made.R_P_I).magnitude())),
        "tilt in 2 sigmas": float(np.degrees(max(tilts))) / (2 * np.sqrt(2) * sigma),
        "NEES": float(error @ np.linalg.solve(found.covariance[:3, :3], error) / 3),
    }


#: Sessions by their settings; the heading is found in the first one alone.
SESSIONS: dict[str, dict[str, Any]] = {
    "camera turned between poses": {"camera_tilt_deg": 30.0},
    "camera stands still (rotation: its heading is free)": {},
    "camera stands still, magnetometers": {"magnetometer": True},
}


@check(
    seeds_option("100:120"),
    option("--poses", type=int, default=6),
)
def world(options: argparse.Namespace) -> Iterator[str]:
    """Camera from base IMU, its tilt and the mounting on rendered sessions, degrees."""
    yield f"{options.poses} poses, an ordinary phone's IMUs, panel IMU 3 degrees off"
    refused = 0
    for name, settings in SESSIONS.items():
        rows = []
        for seed in options.seeds:
            config = PanelSimulation(poses=options.poses, tilt_deg=(15.0, 38.0), **settings)
            try:
                rows.append(world_errors(simulate_panel(config, seed)))
            except UnoccludeError as error:
                refused += 1
                yield f"  {name}, seed {seed}: {error}"
        yield name
        yield from _quantiles(rows)
    raise SystemExit(int(refused > 0))


SKEW = 390e-6
#: What is stated of an offset: how far off it is and its sigma, s; of a clock that runs fast, ppm off.
Stated = Iterator[tuple[float, float, float]]


def beeps(seeds: range, rate_hz: int, quiet_db: float) -> Stated:
    for seed in seeds:
        samples, end, _ = beep(seed, rate_hz, quiet_db)
        nearest = min(find_beeps(samples, rate_hz), key=lambda each: abs(each.end_s - end))
        yield nearest.end_s - end, nearest.sigma_s, np.nan


def receptions(seeds: range, nodes: int, rounds: int, span_s: float) -> Stated:
    for seed in seeds:
        clocks, heard = broadcast(seed, nodes=nodes, rounds=rounds, span_s=span_s)
        for link in solve_clocks([heard]).links():
            yield clocks.error_s(link), link.sigma_s, clocks.skew_error_ppm(link)


def moved(seeds: range, fast: float, **settings: Any) -> Stated:
    """By the motion of the realistic arm; the IMU's clock runs fast."""
    for seed in seeds:
        made = simulate_arm(ArmSimulation.preset("realistic", **settings), seed)
        imu = made.recording.imu
        recording = replace(made.recording, imu=replace(imu, t_s=imu.t_s * (1 + fast)))
        link = clock_from_motion(recording, None, ONE_PROCESS).link
        at_s = link.at_s if fast else 0.0
        true = (at_s + made.parameters["clock_offset_s"]) * (1 + fast) - at_s
        yield link.offset_s - true, link.sigma_s, link.skew_ppm - 1e6 * fast if fast else np.nan


@check(parts_option("sound", "broadcast", "motion", "skew"), seeds_option("16"))
def clock(options: argparse.Namespace) -> Iterator[str]:
    """Clock offsets by a beep, by broadcasts and by motion, against the simulated ones."""
    seeds = options.seeds
    few = seeds[: max(len(seeds) // 8, 2)]
    sources = [
        (f"sound, {rate_hz} Hz, noise -{quiet_db:.0f} dB", beeps(seeds, rate_hz, quiet_db))
        for rate_hz, quiet_db in ((16000, 25.0), (44100, 25.0), (16000, 10.0))
    ]
    sources += [
        (f"broadcast, {nodes} nodes, {rounds} in {span_s:.0f} s", receptions(seeds, nodes, rounds, span_s))
        for nodes, rounds, span_s in ((2, 20, 900.0), (5, 20, 900.0), (3, 20, 5.0), (3, 8, 60.0))
    ]
    sources.append(("motion, realistic arm", moved(seeds, 0.0)))
    sources.append(("skew, 15 minutes, 390 ppm", moved(few, SKEW, protocol="random", duration_s=900.0)))
    found = []
    for name, stated in sources:
        if not options.parts or name.split(",")[0] in options.parts:
            error, sigma, skew = np.array(list(stated)).T
            found.append({"source": name, "what": "offset, ms", "off": 1e3 * error, "sigma": 1e3 * sigma})
            if np.isfinite(skew).any():
                found.append({"source": name, "what": "skew, ppm", "off": skew, "sigma": np.nan})
    yield from error_table(found, "source, what")
