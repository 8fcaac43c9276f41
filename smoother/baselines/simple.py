"""The baselines `hold`, `pchip` and `camera-only`: what needs no more than the camera's points."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from ..array_types import FloatArray
from ..measurements.alignment import lever_of
from ..recording import FOREARM_JOINTS, JOINTS
from .scene import Path, Scene, between, finite_rows


def hold(scene: Scene) -> Path:
    """The pose of the last visible frame until the forearm is visible again; while it is visible, its own.

    Last observation carried forward (LOCF; Little and Rubin, Statistical Analysis with Missing Data, 2002),
    which is what a live display shows. Before the first visible frame: that frame's. Position is
    the camera's point, linear between frames; orientation is the filter's, held through a gap with the
    position, so that the joints stand still too.

    Order: without noise and gaps, linear between frames: off by acceleration x (frame period)^2 / 8 and by
    the filter's orientation over the lever arms.

    Parameters
    ----------
    scene : Scene
        One segment.

    Returns
    -------
    path : Path
        Position and orientation, without covariance.
    """
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
    """Piecewise cubic Hermite interpolation of the visible positions.

    Fritsch and Carlson, SIAM J. Numerical Analysis 17:238-246 (1980), by `scipy.interpolate`. Position:
    through the camera's points at visible frames. Joints: each through its own accepted samples, as one fills
    the tracks of a skeleton. Orientation: the filter's, which is at hand, and far better over a gap than to
    turn evenly from the last visible orientation to the next. Beyond the first and last visible frame the
    value is held: a cubic that goes on is no answer.

    Order: without noise and gaps exact at the frames; between them third order where the path is monotone
    and second where it turns: below acceleration x (frame period)^2 / 8.

    Parameters
    ----------
    scene : Scene
        One segment.

    Returns
    -------
    path : Path
        Position and joints, without covariance.
    """
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
    """The IMU's position interpolated between the camera's elbow and wrist, `inferred` ones included.

    Jatesiktat and Ang, EMBC 2017, eq 16: D = L + d_se / (d_sw + d_se) (T - L), with d_se and d_sw the strap's
    distances from elbow L and wrist T along the forearm. The point lies on the forearm's axis, as
    published, so it is off by the sensor's distance from that axis (some centimetres). Where the camera
    states nothing, the last and the next statement are joined by a straight line. A recording with a
    `strap` alone has the strap itself; with a wrist alone, the wrist. No orientation is given: elbow and
    wrist do not tell how the forearm is rolled.

    Order: without noise exact at the frames but for the distance from the axis; between frames linear,
    off by acceleration x (frame period)^2 / 8.

    Parameters
    ----------
    scene : Scene
        One segment.

    Returns
    -------
    path : Path
        Position and joints, without orientation or covariance.
    """
    tracks = {name: scene.camera_joints[:, JOINTS.index(name)] for name in JOINTS}
    joints = {name: between(scene.frame_t, track, scene.t) for name, track in tracks.items()}
    no_orientation = np.full((len(scene.t), 3, 3), np.nan)
    position = between(scene.frame_t, _position(scene, tracks), scene.t)
    return Path(position=position, R_K_A=no_orientation, joints=joints)


def _position(scene: Scene, tracks: dict[str, FloatArray]) -> FloatArray:
    """The IMU's position (f, 3) m at the frames, from whichever joints the recording has."""
    share = _share(scene)
    if share is not None and np.isfinite(tracks["elbow"]).any():
        return tracks["elbow"] + share * (tracks["wrist"] - tracks["elbow"])
    return tracks["strap"] if np.isfinite(tracks["strap"]).any() else tracks["wrist"]


def _share(scene: Scene) -> float | None:
    """d_se / (d_sw + d_se): where between elbow (0) and wrist (1) the IMU sits; None without lever arms."""
    along = scene.calibration.forearm_direction
    elbow, wrist = lever_of(scene.calibration, "elbow"), lever_of(scene.calibration, "wrist")
    if along is None or elbow is None or wrist is None:
        return None
    return float(-(elbow @ along) / ((wrist - elbow) @ along))
