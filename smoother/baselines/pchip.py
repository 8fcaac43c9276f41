"""`pchip`: the shape-preserving cubic through the visible points, the usual way to fill gaps in tracks."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from ..array_types import FloatArray
from ..recording import FOREARM_JOINTS, JOINTS
from .scene import Path, Scene, finite_rows


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
