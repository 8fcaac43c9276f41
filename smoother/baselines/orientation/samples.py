"""What an orientation filter gets: evenly spaced samples, and an attitude to start from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...array_types import FloatArray
from ...linalg import unit
from ...measurements.inertial import InertialSignal
from ...recording import ImuStream

#: The start's tilt is averaged over so much time, s.
START_S = 4.0
#: A magnetometer is of use where the field's strength keeps this near to its median, as a part of it.
FIELD_SPREAD = 0.1


@dataclass(frozen=True)
class EvenSamples:
    """Samples of a sensor, spread evenly.

    Attributes
    ----------
    t : ndarray, shape (n,), s
        Ends of the samples' intervals; a filter answers there.
    step_s : float, s
        Their distance.
    acc : ndarray, shape (n, 3), m/s^2
        Mean specific force of the interval in {A}.
    gyro : ndarray, shape (n, 3), rad/s
        Mean angular rate of the interval in {A}, its bias taken off.
    mag : ndarray, shape (n, 3), optional
        Direction of the magnetic field in {A}, nan where it is disturbed; None without a magnetometer that
        can be used.
    """

    t: FloatArray
    step_s: float
    acc: FloatArray
    gyro: FloatArray
    mag: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.t)


def even_samples(
    signal: InertialSignal, rate_hz: float, gyroscope_bias: FloatArray, imu: ImuStream
) -> EvenSamples:
    """The signal's means over even intervals.

    Parameters
    ----------
    signal : InertialSignal
    rate_hz : float, Hz
        Of the even samples.
    gyroscope_bias : ndarray, shape (3,), rad/s
        Taken off.
    imu : ImuStream
        The samples of the signal, for their magnetometer.
    """
    count = max(int(np.floor((signal.end_s - signal.start_s) * rate_hz)), 2)
    edges = np.linspace(signal.start_s, signal.end_s, count + 1)
    mean = signal.mean(edges[:-1], edges[1:])
    return EvenSamples(
        t=edges[1:],
        step_s=float(edges[1] - edges[0]),
        acc=np.ascontiguousarray(mean[:, :3]),
        gyro=np.ascontiguousarray(mean[:, 3:] - gyroscope_bias),
        mag=_field(imu, 0.5 * (edges[1:] + edges[:-1])),
    )


def _field(imu: ImuStream, t: FloatArray) -> FloatArray | None:
    """Direction of the magnetic field at times, nan where its strength is off; None where it mostly is.

    A field whose strength changes as the sensor turns is that of an uncalibrated sensor or of iron near by.
    """
    if imu.mag is None:
        return None
    strength = np.linalg.norm(imu.mag, axis=1)
    usual = float(np.nanmedian(strength)) if np.isfinite(strength).any() else 0.0
    if not usual > 0:
        return None
    with np.errstate(invalid="ignore"):
        undisturbed = np.abs(strength / usual - 1.0) < FIELD_SPREAD
    if undisturbed.mean() < 0.9:
        return None
    field = np.stack([np.interp(t, imu.t_s[undisturbed], imu.mag[undisturbed, k]) for k in range(3)], axis=1)
    nearest = np.clip(np.searchsorted(0.5 * (imu.t_s[1:] + imu.t_s[:-1]), t), 0, len(imu) - 1)
    field[~undisturbed[nearest]] = np.nan
    return unit(field)


def start_attitude(samples: EvenSamples) -> Rotation:
    """`R_E_A` at the end of the first interval: its tilt from the force of the first seconds, x ahead.

    The gyroscope turns the first seconds' force into the axes at the start, where its mean is nearly
    gravity's alone also when the arm moves.
    """
    count = min(len(samples), max(int(START_S / samples.step_s), 1))
    turns = Rotation.from_rotvec(samples.gyro[1:count] * samples.step_s)
    here = Rotation.identity()
    total = samples.acc[0].copy()
    for k in range(count - 1):
        here = here * turns[k]
        total += here.apply(samples.acc[k + 1])
    return tilted(total)


def tilted(up_A: FloatArray) -> Rotation:
    """The rotation `R_E_A` with the shortest turn that takes a direction (3,) in {A} to z of {E}."""
    return Rotation.align_vectors([[0.0, 0.0, 1.0]], [up_A])[0]
