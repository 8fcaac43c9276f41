"""`linear-drift`: double integration over the gap, its error spread linearly (Jatesiktat and Ang 2017)."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid

from ..array_types import FloatArray
from ..linalg import interpolate
from ..measurements.alignment import lever_of
from ..measurements.visibility import Gap
from .scene import Path, Scene, between

#: Visible time beside the gap through which the boundary lines are fitted, s (II-K.1).
BOUNDARY_S = 0.5

#: Position (3,) m and velocity (3,) m/s at a gap's end.
Boundary = tuple[FloatArray, FloatArray]


def linear_drift(scene: Scene, boundary_s: float = BOUNDARY_S) -> Path:
    """Recover every gap as published (Jatesiktat and Ang, EMBC 2017, II-K, II-L, eq 11-13).

    Lines through the visible points of `boundary_s` on both sides give position and velocity at the ends;
    the net acceleration is integrated to velocities, whose error at the far end is spread linearly in time;
    these to positions, likewise; at last each position is moved radially onto the sphere on which the elbow
    is an upper arm's length from the shoulder. The paper's r, d_se and R_F_A are one lever arm here. A
    gap that is open on one side is integrated from the side that there is, without what the other side
    would correct. Outside the gaps: the camera's point, linear between frames.

    Order: without noise, in the gap off by the boundary lines' error, acceleration x boundary_s^2 / 12 in
    position and acceleration x boundary_s / 2 in velocity; outside by acceleration x (frame period)^2 / 8.

    Parameters
    ----------
    scene : Scene
        One segment.
    boundary_s : float, s
        What the lines are fitted through.

    Returns
    -------
    path : Path
        Position, without covariance.
    """
    t, point = scene.visible_points
    position = between(t, point, scene.t)
    for gap in scene.gaps:
        before = None if gap.open_start else boundary(t, point, gap.start_s - boundary_s, gap.start_s)
        after = None if gap.open_end else boundary(t, point, gap.end_s, gap.end_s + boundary_s, at_end=False)
        inside = np.flatnonzero((scene.t >= gap.start_s) & (scene.t <= gap.end_s))
        if len(inside):
            position[inside] = _through(scene, gap, inside, before, after)
    inside = np.flatnonzero(scene.occluded)
    position[inside] = snapped(scene, inside, position[inside])
    return Path(position=position, notes=_notes(scene))


def boundary(
    t: FloatArray, point: FloatArray, start_s: float, end_s: float, at_end: bool = True
) -> Boundary | None:
    """Position and velocity at the later (or earlier) of two times, by a line through what lies between.

    One visible point alone gives no velocity: zero stands for it. None without any point.

    Parameters
    ----------
    t : ndarray, shape (v,), s
        Times of the visible frames.
    point : ndarray, shape (v, 3), m
        The IMU's positions there.
    start_s, end_s : float, s
        The two times.
    at_end : bool
        At the later time.

    Returns
    -------
    boundary : Boundary or None
    """
    rows = slice(*np.searchsorted(t, [start_s - 1e-9, end_s + 1e-9]))
    u, x = t[rows] - (end_s if at_end else start_s), point[rows]
    if not len(u):
        return None
    if len(u) == 1:
        return x[0], np.zeros(3)
    line = np.polynomial.polynomial.polyfit(u, x, 1)
    return line[0], line[1]


def _through(
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


def integrated(t: FloatArray, acceleration: FloatArray, start: Boundary, end: Boundary | None) -> FloatArray:
    """Integrate twice, by trapezoids, and spread each integration's error at the end linearly (II-L.1-2).

    Parameters
    ----------
    t : ndarray, shape (n,), s
        From the gap's start to its end.
    acceleration : ndarray, shape (n, 3), m/s^2
        Without gravity, in {K}.
    start : Boundary
        Position and velocity at the start.
    end : Boundary or None
        At the end; without it nothing is spread.

    Returns
    -------
    position : ndarray, shape (n, 3), m
        In {K}.
    """
    share = ((t - t[0]) / (t[-1] - t[0]))[:, None]
    velocity = start[1] + cumulative_trapezoid(acceleration, t, axis=0, initial=0)
    if end is not None:
        velocity += (end[1] - velocity[-1]) * share
    position = start[0] + cumulative_trapezoid(velocity, t, axis=0, initial=0)
    if end is not None:
        position += (end[0] - position[-1]) * share
    return np.asarray(position)


def snapped(scene: Scene, rows: np.ndarray, position: FloatArray) -> FloatArray:
    """Positions (k, 3) m of rows, moved radially to the sphere of the upper arm's length about C (eq 13).

    C = S - R_K_A lever_elbow: where the IMU would be with its elbow on the shoulder. Unchanged where the
    shoulder, the upper arm's length or the elbow's lever arm is not known.
    """
    elbow, upper_arm = lever_of(scene.calibration, "elbow"), scene.calibration.upper_arm
    if elbow is None or upper_arm is None:
        return position
    centre = scene.shoulder[rows] - scene.R_K_A[rows] @ elbow
    away = position - centre
    length = np.linalg.norm(away, axis=1)[:, None]
    good = np.isfinite(length) & (length > 1e-6)
    return np.where(good, centre + upper_arm.value_m * away / np.where(good, length, 1.0), position)


def _notes(scene: Scene) -> tuple[str, ...]:
    if not scene.gaps:
        return ()
    known = scene.calibration.upper_arm is not None and lever_of(scene.calibration, "elbow") is not None
    if known and np.isfinite(scene.shoulder).all():
        return ()
    return ("shoulder and upper arm are not known: gaps are recovered without the shoulder's constraint",)
