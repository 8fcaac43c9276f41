"""What an IMU says in a pose that is held still, and how far it turned from one pose to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.recording import ImuStream

#: Samples this far from a pose's time may count to it, s.
REACH_S = 1.0
#: An IMU rests where 0.2 s means of its rate, less the slowest, stay below this, rad/s.
STILL_RAD_S = 0.06
#: and where those of its specific force stay this near to their median, m/s^2.
STILL_M_S2 = 0.3
#: Rest that is shorter than this is none, s.
SHORTEST_S = 0.3
_BATCH_S = 0.1
#: What a gyroscope's scale, axes and bias add to a turn: a share of it, and rad a second.
GYRO_SCALE, GYRO_DRIFT_RAD_S = 0.003, 2e-4
#: A pause of an IMU that breaks the link between two poses, s.
_PAUSE_S = 0.1


@dataclass(frozen=True)
class Rest:
    """Means over a time in which an IMU rests.

    Attributes
    ----------
    t_s : float, s
        The pose's time.
    acc : ndarray, shape (3,), m/s^2
        Mean, about +9.81 upwards.
    acc_sigma : ndarray, shape (3,), m/s^2
        Of that mean.
    gyro : ndarray, shape (3,), rad/s
        The gyroscope's bias.
    mag : ndarray, shape (3,), optional
        In the sensor's unit, or None.
    length_s : float, s
        How long it rested.
    """

    t_s: float
    acc: FloatArray
    acc_sigma: FloatArray
    gyro: FloatArray
    mag: FloatArray | None
    length_s: float


@dataclass(frozen=True)
class Turn:
    """A rotation from one pose to the next by the gyroscope.

    Attributes
    ----------
    R : ndarray, shape (3, 3)
        Maps the later axes of the IMU to the earlier ones.
    sigma_rad : float, rad
        An axis.
    """

    R: FloatArray
    sigma_rad: float


def rest_at(imu: ImuStream, t_s: float, pose: str, what: str) -> Rest:
    """Mean readings of an IMU while a pose is held.

    Parameters
    ----------
    imu : ImuStream
        Its samples; the whole session, or those of the pose.
    t_s : float, s
        Time of the pose's images on the IMU's clock (to some tenths of a second).
    pose, what : str
        Names of the pose and of the IMU for messages.

    Returns
    -------
    Rest

    Raises
    ------
    CalibrationError
        The IMU has no samples there, or moves.
    """
    near = np.flatnonzero(np.abs(imu.t_s - t_s) <= REACH_S)
    if len(near) < 5:
        raise CalibrationError(
            f"{pose}: the IMU {what} has no samples at {t_s:.2f} s; record it while the panel is held still."
        )
    batch = np.floor((imu.t_s[near] - t_s) / _BATCH_S).astype(int)
    numbers = np.unique(batch)
    gyro, acc = (
        np.array([values[near][batch == k].mean(axis=0) for k in numbers]) for values in (imu.gyro, imu.acc)
    )
    # A bias is not a motion: rates count from their median, which is a rest's own in any pose worth taking.
    rate = np.linalg.norm(_smooth(gyro) - np.median(gyro, axis=0), axis=1)
    force = np.linalg.norm(_smooth(acc) - np.median(acc, axis=0), axis=1)
    still = numbers[(rate < STILL_RAD_S) & (force < STILL_M_S2)]
    run = _run_about(still)
    rows = near[np.isin(batch, run)]
    if len(run) * _BATCH_S < SHORTEST_S or np.linalg.norm(np.median(gyro, axis=0)) > 10 * STILL_RAD_S:
        raise CalibrationError(
            f"{pose}: the IMU {what} moves at {t_s:.2f} s; hold the panel still for two seconds in each pose."
        )
    means = acc[np.isin(numbers, run)]
    spread = means.std(axis=0, ddof=1) if len(means) > 2 else np.full(3, 0.05)
    mag = None if imu.mag is None else imu.mag[rows].mean(axis=0)
    return Rest(
        t_s=t_s,
        acc=imu.acc[rows].mean(axis=0),
        acc_sigma=spread / np.sqrt(len(means)),
        gyro=imu.gyro[rows].mean(axis=0),
        mag=mag,
        length_s=len(run) * _BATCH_S,
    )


def turn_between(imu: ImuStream, first: Rest, last: Rest) -> Turn | None:
    """The gyroscope's rotation from one rest to the next; None where the IMU paused between them."""
    rows = np.flatnonzero((imu.t_s >= first.t_s) & (imu.t_s <= last.t_s))
    if len(rows) < 5:
        return None
    t = imu.t_s[rows]
    if max(np.diff(t).max(), t[0] - first.t_s, last.t_s - t[-1]) > _PAUSE_S:
        return None
    share = ((t - t[0]) / (t[-1] - t[0]))[:, None]
    rate = imu.gyro[rows] - ((1 - share) * first.gyro + share * last.gyro)
    middle = 0.5 * (t[1:] + t[:-1])
    edges = np.concatenate([[first.t_s], middle, [last.t_s]])
    step = rate * np.diff(edges)[:, None]
    way = float(np.linalg.norm(step, axis=1).sum())
    sigma = np.hypot(GYRO_SCALE * way, GYRO_DRIFT_RAD_S * (last.t_s - first.t_s)) + 5e-4
    return Turn(_product(Rotation.from_rotvec(step)).as_matrix(), float(sigma))


def _product(steps: Rotation) -> Rotation:
    """The rotations one after the other, in pairs."""
    while len(steps) > 1:
        if len(steps) % 2:
            steps = Rotation.concatenate([steps, Rotation.identity(1)])
        steps = steps[0::2] * steps[1::2]
    return steps[0]


def _smooth(means: FloatArray) -> FloatArray:
    """Means of each batch with its next."""
    return means if len(means) < 2 else 0.5 * (means + np.vstack([means[1:], means[-1:]]))


def _run_about(still: np.ndarray) -> np.ndarray:
    """The run of consecutive numbers that lies nearest to zero."""
    if len(still) == 0:
        return still
    runs = np.split(still, np.flatnonzero(np.diff(still) > 1) + 1)
    return min(runs, key=lambda run: (np.abs(run + 0.5).min(), -len(run)))
