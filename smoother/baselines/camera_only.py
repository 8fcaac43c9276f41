"""`camera-only`: what the camera's own skeleton states, its guesses included."""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..measurements.alignment import lever_of
from ..recording import JOINTS
from .scene import Path, Scene, between


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
