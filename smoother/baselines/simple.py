"""Baselines in a few lines: `hold`, `pchip`, `camera-only` and `linear-drift`."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import PchipInterpolator

from ..array_types import FloatArray
from ..linalg import interpolate
from ..measurements.alignment import lever_of
from ..measurements.visibility import Gap
from ..recording import FOREARM_JOINTS, JOINTS
from .scene import Path, Scene, between, finite_rows


def hold(scene: Scene) -> Path:
    """The pose of the last visible frame carried forward through each gap, as a live display shows it."""
    t, point = scene.visible_points
    position = between(t, point, scene.t)
    pose_of = np.arange(len(scene.t))
    for gap in scene.gaps:
        inside = scene.occluded & (scene.t >= gap.start_s) & (scene.t <= gap.end_s)
        last_s = gap.end_s if gap.open_start else gap.start_s
        if len(t):
            position[inside] = point[np.argmin(np.abs(t - last_s))]
        pose_of[inside] = np.argmin(np.abs(scene.t - last_s))
    return Path(position=position, R_K_A=scene.R_K_A[pose_of])


def pchip(scene: Scene) -> Path:
    """Shape-preserving cubics through visible positions, each joint's too (Fritsch and Carlson 1980)."""
    joints = {}
    for joint in ("shoulder", *(name for name in FOREARM_JOINTS if name != "strap")):
        t, position = finite_rows(scene.frame_t, scene.joints[:, JOINTS.index(joint)])
        if len(t):
            joints[joint] = _through(t, position, scene.t)
    return Path(position=_through(*scene.visible_points, scene.t), joints=joints)


def _through(t: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    """The interpolation (n, 3) through values (v, 3) at increasing times (v,), held beyond the ends."""
    if len(t) < 2:
        return np.tile(values[0] if len(t) else np.full(3, np.nan), (len(at), 1))
    return np.asarray(PchipInterpolator(t, values)(np.clip(at, t[0], t[-1])))


def camera_only(scene: Scene) -> Path:
    """The IMU between the camera's elbow and wrist, guesses included (Jatesiktat and Ang, EMBC 2017, eq 16).

    The point lies on the forearm's axis, as published: off by the sensor's distance from it. No orientation:
    elbow and wrist do not show how the forearm is rolled.
    """
    tracks = {name: scene.camera_joints[:, JOINTS.index(name)] for name in JOINTS}
    joints = {name: between(scene.frame_t, track, scene.t) for name, track in tracks.items()}
    elbow, wrist = (lever_of(scene.calibration, joint) for joint in ("elbow", "wrist"))
    along = scene.calibration.forearm_direction
    place = tracks["strap"] if np.isfinite(tracks["strap"]).any() else tracks["wrist"]
    if along is not None and elbow is not None and wrist is not None and np.isfinite(tracks["elbow"]).any():
        share = float(-(elbow @ along) / ((wrist - elbow) @ along))  # d_se / (d_sw + d_se)
        place = tracks["elbow"] + share * (tracks["wrist"] - tracks["elbow"])
    no_orientation = np.full((len(scene.t), 3, 3), np.nan)
    return Path(position=between(scene.frame_t, place, scene.t), R_K_A=no_orientation, joints=joints)


#: Visible time beside the gap through which the boundary lines are fitted, s (II-K.1).
BOUNDARY_S = 0.5

#: Position (3,) m and velocity (3,) m/s at a gap's end.
Boundary = tuple[FloatArray, FloatArray]


def linear_drift(scene: Scene, boundary_s: float = BOUNDARY_S) -> Path:
    """Recover every gap as published (Jatesiktat and Ang, EMBC 2017, II-K, II-L, eq 11-13)."""
    t, point = scene.visible_points
    position = between(t, point, scene.t)
    for gap in scene.gaps:
        before = None if gap.open_start else boundary(t, point, gap.start_s - boundary_s, gap.start_s)
        after = None if gap.open_end else boundary(t, point, gap.end_s, gap.end_s + boundary_s, at_end=False)
        inside = np.flatnonzero((scene.t >= gap.start_s) & (scene.t <= gap.end_s))
        if len(inside):
            position[inside] = _drift_through(scene, gap, inside, before, after)
    inside = np.flatnonzero(scene.occluded)
    position[inside] = snapped(scene, inside, position[inside])
    known = scene.calibration.upper_arm is not None and lever_of(scene.calibration, "elbow") is not None
    if not scene.gaps or (known and np.isfinite(scene.shoulder).all()):
        return Path(position=position)
    note = "shoulder and upper arm are not known: gaps are recovered without the shoulder's constraint"
    return Path(position=position, notes=(note,))


def boundary(
    t: FloatArray, point: FloatArray, start_s: float, end_s: float, at_end: bool = True
) -> Boundary | None:
    """Position and velocity at the later (or earlier) of two times, by a line through the samples between."""
    rows = slice(*np.searchsorted(t, [start_s - 1e-9, end_s + 1e-9]))
    u, x = t[rows] - (end_s if at_end else start_s), point[rows]
    if not len(u):
        return None
    if len(u) == 1:
        return x[0], np.zeros(3)
    line = np.polynomial.polynomial.polyfit(u, x, 1)
    return line[0], line[1]


def _drift_through(
    scene: Scene, gap: Gap, inside: np.ndarray, before: Boundary | None, after: Boundary | None
) -> FloatArray:
    """Positions (k, 3) at the samples inside a gap, before the shoulder is looked at."""
    t = np.concatenate(([gap.start_s], scene.t[inside], [gap.end_s]))
    acceleration = interpolate(scene.t, scene.acceleration, t)
    if before is None and after is None:
        return np.full((len(inside), 3), np.nan)
    if before is None:  # from the far end, time running backwards
        assert after is not None
        backwards = integrated(-t[::-1], acceleration[::-1], (after[0], -after[1]), None)
        return backwards[::-1][1:-1]
    return integrated(t, acceleration, before, after)[1:-1]


def integrated(
    t: FloatArray,  # (n,) s
    acceleration: FloatArray,  # (n, 3) m/s^2
    start: Boundary,
    end: Boundary | None,
) -> FloatArray:  # (n, 3) m
    """Integrate twice, by trapezoids, and spread each integration's error at the end linearly (II-L.1-2)."""
    share = ((t - t[0]) / (t[-1] - t[0]))[:, None]
    velocity = start[1] + cumulative_trapezoid(acceleration, t, axis=0, initial=0)
    if end is not None:
        velocity += (end[1] - velocity[-1]) * share
    position = start[0] + cumulative_trapezoid(velocity, t, axis=0, initial=0)
    if end is not None:
        position += (end[0] - position[-1]) * share
    return np.asarray(position)


def snapped(scene: Scene, rows: np.ndarray, position: FloatArray) -> FloatArray:
    """Positions (k, 3) m of rows, moved radially to the sphere of the upper arm's length about C (eq 13)."""
    elbow, upper_arm = lever_of(scene.calibration, "elbow"), scene.calibration.upper_arm
    if elbow is None or upper_arm is None:
        return position
    centre = scene.shoulder[rows] - scene.R_K_A[rows] @ elbow
    away = position - centre
    length = np.linalg.norm(away, axis=1)[:, None]
    good = np.isfinite(length) & (length > 1e-6)
    return np.where(good, centre + upper_arm.value_m * away / np.where(good, length, 1.0), position)
