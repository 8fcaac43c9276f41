"""What an orientation filter gets: evenly spaced samples, and an attitude to start from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ...measurements.inertial import InertialSignal
from ...recording import FloatArray, ImuStream

#: The start's tilt is averaged over so much time, s.
START_SPAN_S = 4.0
#: A magnetometer is of use where the field's strength keeps this near to its median, as a part of it.
FIELD_SPREAD = 0.1


@dataclass(frozen=True)
class EvenSamples:
    """Samples of a sensor, spread evenly.

    Attributes
    ----------
    t : (n,) ends of the samples' intervals, s; a filter answers there.
    step_s : their distance.
    acc : (n, 3) mean specific force of the interval, m/s^2 in {A}.
    gyro : (n, 3) mean angular rate of the interval, its bias taken off, rad/s in {A}.
    mag : (n, 3) direction of the magnetic field in {A}, nan where it is disturbed; None without a
        magnetometer that can be used.
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
    gyroscope_bias : (3,) rad/s, taken off.
    imu : the samples that the signal was made from, for their magnetometer.
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
        steady = np.abs(strength / usual - 1.0) < FIELD_SPREAD
    if steady.mean() < 0.9:
        return None
    field = np.stack([np.interp(t, imu.t_s[steady], imu.mag[steady, k]) for k in range(3)], axis=1)
    nearest = np.clip(np.searchsorted(0.5 * (imu.t_s[1:] + imu.t_s[:-1]), t), 0, len(imu) - 1)
    field[~steady[nearest]] = np.nan
    return np.asarray(field / np.linalg.norm(field, axis=1)[:, None])


def start_attitude(samples: EvenSamples) -> Rotation:
    """`R_E_A` at the end of the first interval: its tilt from the force of the first seconds, x ahead.

    The gyroscope carries the first seconds' force into the axes at the start, where its mean is nearly
    gravity's alone also when the arm moves.
    """
    count = min(len(samples), max(int(START_SPAN_S / samples.step_s), 1))
    turns = Rotation.from_rotvec(samples.gyro[1:count] * samples.step_s)
    here = Rotation.identity()
    total = samples.acc[0].copy()
    for k in range(count - 1):
        here = here * turns[k]
        total += here.apply(samples.acc[k + 1])
    return tilted(total)


def tilted(up_A: FloatArray) -> Rotation:
    """The rotation `R_E_A` with the shortest turn that takes a direction (3,) in {A} to z of {E}."""
    up = up_A / np.linalg.norm(up_A)
    axis = np.cross(up, [0.0, 0.0, 1.0])
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return Rotation.identity() if up[2] > 0 else Rotation.from_rotvec([np.pi, 0.0, 0.0])
    return Rotation.from_rotvec(axis / length * np.arctan2(length, up[2]))
