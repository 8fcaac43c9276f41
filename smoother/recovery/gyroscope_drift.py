"""Where the answer's orientation departs from what the gyroscope felt.

A sensor that turns on the arm by itself feels that turn only in part, or within one sample, and the camera
does not see a turn about the forearm. The answer then follows gravity again after some seconds, against the
gyroscope.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import FloatArray
from ..measurements.segment import without_spikes
from ..measurements.timestamps import PAUSE_SAMPLES
from ..recording import ImuStream
from ..result import Recovery
from ..rotation import Rotation

#: Over so long a time, s; looked at so often, s.
OVER_S, STEP_S = 4.0, 0.5


@dataclass(frozen=True)
class GyroscopeDrift:
    """Turns of the answer that the gyroscope did not feel.

    Attributes
    ----------
    at_s : ndarray, shape (n,), s
        Middles of the times looked at, `OVER_S` each.
    angle_deg : ndarray, shape (n,), degrees
        How far the answer turned against the gyroscope.
    sigma_deg : ndarray, shape (n,), degrees
        Of the orientations at both ends.
    turn : ndarray, shape (n, 3), degrees
        The same as `angle_deg` as rotation vectors in {K}.
    """

    at_s: FloatArray
    angle_deg: FloatArray
    sigma_deg: FloatArray
    turn: FloatArray


def gyroscope_drift(recovery: Recovery, imu: ImuStream, gyroscope_bias: FloatArray) -> GyroscopeDrift:
    """Compare the answer's turning with the gyroscope's, added up in the camera's frame.

    Parameters
    ----------
    recovery : Recovery
        With an orientation at the IMU's samples.
    imu : ImuStream
        What it was made of.
    gyroscope_bias : ndarray, shape (3,), rad/s
        As it was estimated.

    Returns
    -------
    drift : GyroscopeDrift
        Empty where the recording is shorter than `OVER_S`.
    """
    t = np.asarray(recovery.t_s)
    at = np.arange(t[0], t[-1], STEP_S) if len(t) > 1 else np.zeros(0)
    usual = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    total, sums, sigma = np.zeros(3), np.full((len(at), 3), np.nan), np.full(len(at), np.nan)
    row = 0
    for batch in recovery.batches(overlap=1):
        first = max(row - 1, 0)
        rows = slice(first, first + len(batch))
        row = rows.stop
        times = t[rows]
        rate = without_spikes(imu.select(rows)).gyro - gyroscope_bias
        steps = _unfelt(batch, np.asarray(rate), usual)
        added = total + np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
        total = added[-1]
        mine = np.flatnonzero((at >= times[0]) & (at <= times[-1]))
        nearest = np.searchsorted(times, at[mine])
        sums[mine] = added[nearest]
        spread = np.einsum("nii->n", batch.pose_covariance[nearest, 3:, 3:])
        sigma[mine] = np.degrees(np.sqrt(np.maximum(spread, 0.0)))
    apart = round(OVER_S / STEP_S)
    turn = np.degrees(sums[apart:] - sums[:-apart])
    angle, spread = np.linalg.norm(turn, axis=1), np.hypot(sigma[apart:], sigma[:-apart])
    return GyroscopeDrift(at[apart:] - 0.5 * OVER_S, angle, spread, turn)


def _unfelt(batch: Recovery, rate: FloatArray, usual_s: float) -> FloatArray:
    """Rotation vectors (n - 1, 3) in {K}, rad: of each step of the answer what the gyroscope did not feel.

    Zero over a pause and where there is no orientation.
    """
    step = np.diff(np.asarray(batch.t_s))
    known = np.asarray(np.isfinite(batch.quaternion).all(axis=1))
    R_K_A = Rotation.from_quat(
        np.where(known[:, None], batch.quaternion, [1.0, 0.0, 0.0, 0.0]), scalar_first=True
    )
    felt = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * step[:, None])
    unfelt = (R_K_A[1:] * felt.inv() * R_K_A[:-1].inv()).as_rotvec()
    unfelt[~(known[1:] & known[:-1]) | (step > PAUSE_SAMPLES * usual_s)] = 0.0
    return np.asarray(unfelt)
