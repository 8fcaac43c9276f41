"""`calibrate imu` on one page: rests, accelerometer, gyroscope, noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from smoother.array_types import FloatArray
from smoother.recording import ImuStream
from smoother.units import GRAVITY

from .accelerometer import AccelerometerCalibration, calibrate_accelerometer
from .allan import SensorNoise, allan_noise
from .gyroscope import GyroscopeCalibration, calibrate_gyroscope
from .rests import Rests, find_rests

#: Of a recording that rests for so much of its time and so long without a pause, noise is all that is asked.
_MOSTLY = 0.8
LONG_REST_S = 20.0


@dataclass(frozen=True)
class ImuCalibration:
    """What a recording gave of accelerometer and gyroscope.

    Attributes
    ----------
    name : str
        Of the stream.
    rests : Rests
        Where the sensor lay still.
    gyroscope : GyroscopeCalibration
        Its bias.
    accelerometer : AccelerometerCalibration, optional
        None where the recording is one long rest, which gives the noise only.
    accelerometer_noise, gyroscope_noise : SensorNoise, optional
        From the longest rest; None where it is too short.
    gravity : float, m/s^2
        That the accelerometer was fitted to.
    """

    name: str
    rests: Rests
    gyroscope: GyroscopeCalibration
    accelerometer: AccelerometerCalibration | None
    accelerometer_noise: SensorNoise | None
    gyroscope_noise: SensorNoise | None
    gravity: float = GRAVITY

    def tables(self) -> dict[str, dict[str, Any]]:
        """The sensor's tables for the calibration file; plain values."""
        gyro: dict[str, Any] = {
            "offset": self.gyroscope.offset.tolist(),
            "offset_sigma": self.gyroscope.sigma.tolist(),
        }
        gyro |= _noise_table(self.gyroscope_noise)
        tables = {"gyroscope": gyro}
        acc = _noise_table(self.accelerometer_noise)
        if self.accelerometer is not None:
            found = self.accelerometer
            sigma = np.sqrt(np.diag(found.covariance))
            acc = {
                "offset": found.offset.tolist(),
                "matrix": found.matrix.tolist(),
                "offset_sigma": sigma[:3].tolist(),
                "matrix_sigma": sigma[3:].tolist(),
                "poses": found.poses,
                "residual_rms": found.rms,
                "sigma": found.sigma,
                "worst_sigma": found.worst_sigma,
                **acc,
            }
        return tables | ({"accelerometer": acc} if acc else {})


def calibrate_imu(imu: ImuStream, gravity: float = GRAVITY) -> ImuCalibration:
    """Calibrate accelerometer and gyroscope from a recording of rest poses, or of one long rest.

    Parameters
    ----------
    imu : ImuStream
        As recorded.
    gravity : float, m/s^2
        Where the recording was made.

    Returns
    -------
    found : ImuCalibration
        See `imu_answer` for what belongs into a file.

    Raises
    ------
    CalibrationError
        The recording tells neither; the text says what to record.
    """
    rests = find_rests(imu)
    noise: tuple[SensorNoise | None, SensorNoise | None] = (None, None)
    long_rest = False
    if len(rests):
        rest = rests.longest()
        noise = allan_noise(imu.acc[rest], imu.rate_hz), allan_noise(imu.gyro[rest], imu.rate_hz)
        lasts = (rest.stop - rest.start) / imu.rate_hz
        long_rest = lasts >= LONG_REST_S and rest.stop - rest.start >= _MOSTLY * len(imu)
    accelerometer = None
    if not (long_rest and rests.poses < 3):
        accelerometer = calibrate_accelerometer(rests, gravity)
    return ImuCalibration(
        imu.name, rests, calibrate_gyroscope(imu, rests), accelerometer, noise[0], noise[1], gravity
    )


def _noise_table(noise: SensorNoise | None) -> dict[str, Any]:
    """Noise for the file: the axes' root mean square, as `smooth` takes one number a sensor."""
    if noise is None:
        return {}
    found = {
        "noise_density": _rms(noise.density),
        "bias_instability": _rms(noise.instability),
        "random_walk": _rms(noise.walk),
        "noise_rest_s": noise.duration_s,
    }
    return {name: value for name, value in found.items() if np.isfinite(value) and value > 0}


def _rms(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else float("nan")
