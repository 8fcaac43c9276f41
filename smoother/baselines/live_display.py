"""What could be shown live without this program: baselines that see only what has arrived.

They answer for the present from frames that arrive a latency late: Feng's autoregressive predictor (thesis,
Glasgow 2014, section 4.3) and a display that lets the last velocity go on.
"""

from __future__ import annotations

import numpy as np

from ..linalg import interpolate
from .gaussian_process import likeliest, measurements, predict
from .scene import Path, Scene, no_answer

#: The camera's latency where nobody says otherwise, s (Feng's Kinect).
LATENCY_S = 0.1
#: Frames that the predictor looks back (L = 5), and the display's velocity is taken over.
FRAMES = 5
#: The predictor answers at this rate, and is interpolated between, Hz.
RATE_HZ = 30.0
#: What a hand's velocity may change, m/s/sqrt(s): the sigma of the display.
VELOCITY_WALK = 1.0


def autoregressive(scene: Scene, latency_s: float = LATENCY_S) -> Path:
    """Feng's online predictor: the last frames that have arrived, and the accelerations up to now.

    The hyper-parameters are the likeliest over the whole segment, and the orientation behind the
    accelerations is the offline filter's: better than a live predictor would have them.

    Parameters
    ----------
    scene : Scene
        One segment.
    latency_s : float, s
        Of the camera.

    Returns
    -------
    path : Path
        Position and its covariance.
    """
    if scene.visible.sum() < 2:
        return no_answer(scene)
    data = measurements(scene)
    kernel = likeliest(scene, data)
    coarse = np.linspace(scene.t[0], scene.t[-1], int((scene.t[-1] - scene.t[0]) * RATE_HZ) + 2)
    mean, sigma = predict(kernel, data, coarse, latency_s, FRAMES)
    variance = np.interp(scene.t, coarse, sigma**2)
    return Path(interpolate(coarse, mean, scene.t), covariance=variance[:, None, None] * np.eye(3))


def constant_velocity(scene: Scene, latency_s: float = LATENCY_S) -> Path:
    """The last positions that have arrived, and the velocity of the last `FRAMES` of them, going on.

    Parameters
    ----------
    scene : Scene
        One segment.
    latency_s : float, s
        Of the camera.

    Returns
    -------
    path : Path
        Position and its covariance, as if the velocity wandered by `VELOCITY_WALK`.
    """
    frame_t, point = scene.visible_points
    if len(frame_t) < 2:
        return no_answer(scene)
    arrived = np.searchsorted(frame_t + latency_s, scene.t, side="right")
    position = np.full((len(scene.t), 3), np.nan)
    variance = np.full(len(scene.t), np.nan)
    for last in np.unique(arrived[arrived >= 2]):
        rows = np.flatnonzero(arrived == last)
        frames = slice(max(int(last) - FRAMES, 0), int(last))
        t, origin = frame_t[frames], frame_t[last - 1]
        line = np.polynomial.polynomial.polyfit(t - origin, point[frames], 1)
        ahead = scene.t[rows] - origin
        position[rows] = line[0] + ahead[:, None] * line[1]
        spread = max(float(np.sum((t - t.mean()) ** 2)), 1e-6)
        noise = scene.point_sigma_m**2 * (1.0 / len(t) + (scene.t[rows] - t.mean()) ** 2 / spread)
        variance[rows] = noise + VELOCITY_WALK**2 * ahead**3 / 3.0
    return Path(position, covariance=variance[:, None, None] * np.eye(3))
