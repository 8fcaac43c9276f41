"""A clock offset of any size, roughly: before the smoother looks for it within its own reach.

The forearm's direction turns as fast in the camera's frame as in any other, and never faster than the
gyroscope says. So the two speeds are correlated over all shifts that leave enough of both; the shift whose
correlation is the least likely to be chance is where the fine search starts.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import correlate

from smoother.errors import CalibrationError
from smoother.recording import FloatArray, Recording

#: Both speeds are taken on this grid, Hz, smoothed with this sigma, s: what joints' noise leaves of them.
GRID_HZ, SMOOTH_S = 50.0, 0.12
#: Frames farther apart are not bridged, s.
HOLE_S = 0.25
#: Both must share so much, s, at a shift that is tried.
OVERLAP_S = 8.0
#: A shift is believed from this correlation on; another peak as good as this part of it makes it doubtful.
BELIEVED, RIVAL, PEAK_S = 0.6, 0.9, 1.0


def coarse_offset(recording: Recording, reach_s: float) -> float:
    """t_imu - t_camera to some tens of milliseconds; 0 where the fine search reaches it by itself.

    Parameters
    ----------
    recording : one arm with elbow and wrist, and its IMU; with `strap` alone nothing is looked for.
    reach_s : the fine search finds offsets up to this.

    Raises
    ------
    CalibrationError
        The clocks are farther apart than the fine search reaches, and the motion does not tell how far.
    """
    camera_t, camera = _camera_speed(recording)
    imu_t, imu = _imu_speed(recording)
    if len(camera) < OVERLAP_S * GRID_HZ or len(imu) < OVERLAP_S * GRID_HZ:
        return 0.0
    r, count = _correlation(imu, camera)
    lag = (np.arange(len(r)) - (len(camera) - 1)) / GRID_HZ + imu_t[0] - camera_t[0]
    score = np.arctanh(np.clip(r, -0.999, 0.999)) * np.sqrt(count)
    score[count < OVERLAP_S * GRID_HZ] = -np.inf
    if not np.isfinite(score).any():
        return 0.0
    best = int(np.argmax(score))
    if abs(lag[best]) <= reach_s:
        return 0.0
    near = np.abs(lag) <= reach_s
    others = np.abs(lag - lag[best]) > PEAK_S
    rival = float(score[others].max(initial=-np.inf))
    if r[best] >= BELIEVED and rival < RIVAL * score[best]:
        return float(lag[best])
    if near.any() and float(score[near].max()) >= RIVAL * score[best]:
        return 0.0  # the small offset explains the motion about as well
    if float(r[best]) < BELIEVED:
        return 0.0  # no shift stands out; what the fine search finds carries its own sigma
    raise CalibrationError(
        f"{recording.name}: the camera's clock and the IMU's seem {abs(lag[best]):.1f} s apart, but"
        " repeated motion fits other offsets as well; record 20 s of irregular motion in view"
    )


def _camera_speed(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Grid and angular speed of the elbow-wrist direction, rad/s; nan where the camera saw neither."""
    arm = recording.arm
    seen = arm.tracked("elbow") & arm.tracked("wrist")
    along = (arm.joint("wrist") - arm.joint("elbow"))[seen]
    length = np.linalg.norm(along, axis=1)
    t = arm.t_s[seen][length > 0]
    if len(t) < 3:
        return np.empty(0), np.empty(0)
    grid = np.arange(t[0], t[-1], 1 / GRID_HZ)
    unit = along[length > 0] / length[length > 0, None]
    on_grid = np.stack([np.interp(grid, t, axis) for axis in unit.T], axis=1)
    rate = gaussian_filter1d(on_grid, SMOOTH_S * GRID_HZ, axis=0, order=1) * GRID_HZ
    after = np.clip(np.searchsorted(t, grid, side="right"), 1, len(t) - 1)
    hole = t[after] - t[after - 1] > HOLE_S
    return grid, np.where(hole, np.nan, np.linalg.norm(rate, axis=1))


def _imu_speed(recording: Recording) -> tuple[FloatArray, FloatArray]:
    """Grid and the gyroscope's speed, rad/s, smoothed as the camera's; nan in holes of the stream."""
    t = recording.imu.t_s
    if len(t) < 3:
        return np.empty(0), np.empty(0)
    grid = np.arange(t[0], t[-1], 1 / GRID_HZ)
    rate = recording.imu.gyro - np.median(recording.imu.gyro, axis=0)
    on_grid = np.stack([np.interp(grid, t, axis) for axis in rate.T], axis=1)
    after = np.clip(np.searchsorted(t, grid, side="right"), 1, len(t) - 1)
    hole = t[after] - t[after - 1] > HOLE_S
    speed = np.linalg.norm(gaussian_filter1d(on_grid, SMOOTH_S * GRID_HZ, axis=0), axis=1)
    return grid, np.where(hole, np.nan, speed)


def _correlation(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pearson's correlation at every shift over what both have, and how many samples that is."""
    known_a, known_b = np.isfinite(a).astype(float), np.isfinite(b).astype(float)
    a, b = np.where(known_a > 0, a, 0.0), np.where(known_b > 0, b, 0.0)
    a, b = a / max(float(a.std()), 1e-12), b / max(float(b.std()), 1e-12)

    def shifted(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(correlate(x, y, mode="full", method="fft"))

    n = np.maximum(np.round(shifted(known_a, known_b)), 1.0)
    sum_a, sum_b = shifted(a, known_b), shifted(known_a, b)
    spread_a = shifted(a * a, known_b) / n - (sum_a / n) ** 2
    spread_b = shifted(known_a, b * b) / n - (sum_b / n) ** 2
    still = (spread_a < 1e-2) | (spread_b < 1e-2)  # rest has no correlation to speak of
    together = shifted(a, b) / n - sum_a * sum_b / n**2
    r = together / np.sqrt(np.where(still, 1.0, spread_a * spread_b))
    return np.where(still, 0.0, np.clip(r, -1.0, 1.0)), n
