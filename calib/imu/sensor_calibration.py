"""`calibrate imu` on one page: noise, gyroscope, and all of a sensor from its rests."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import nnls

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.recording import ImuStream
from smoother.units import GRAVITY

from .accelerometer import AccelerometerCalibration, Rests, calibrate_accelerometer, find_rests

#: Shortest rest that gives the white noise, and shortest that can give what is slower, s.
WHITE_S = 20.0
SLOW_S = 300.0
#: Averaging times a decade, and how often the longest fits into the rest.
_A_DECADE = 8
_LONGEST_SHARE = 9
#: Averaging times over which white noise is read, s: longer than filters, shorter than drift.
_WHITE_TAU_S = (0.1, 2.0)
_FLICKER = 2.0 * np.log(2.0) / np.pi
#: A part that makes up less of the variance than this wherever one looks was not seen.
_SEEN = 0.25


@dataclass(frozen=True)
class SensorNoise:
    """One triaxial sensor at rest; per axis (3,), in SI: x is m/s^2 or rad/s."""

    tau_s: FloatArray  # (k,) s: averaging times
    deviation: FloatArray  # (k, 3): allan deviation, x
    density: FloatArray  # (3,): white noise N, x/sqrt(Hz)
    instability: FloatArray  # (3,): bias instability B, x; nan where the rest was too short to show it
    walk: FloatArray  # (3,): random walk K, x/sqrt(s); nan likewise
    duration_s: float  # Of the rest


def allan_noise(samples: FloatArray, rate_hz: float) -> SensorNoise | None:
    """Noise figures of a sensor's samples at rest (N, 3); None where they last less than 20 s."""
    duration = len(samples) / rate_hz
    if duration < WHITE_S:
        return None
    tau, deviation = allan_deviation(samples, rate_hz)
    # independent averages at each time: the relative variance of the Allan variance is one over half of them
    weight = np.sqrt(np.maximum(duration / tau - 1.0, 1.0))
    white = (tau >= max(_WHITE_TAU_S[0], 1.0 / rate_hz)) & (tau <= _WHITE_TAU_S[1])
    density, instability, walk = np.full(3, np.nan), np.full(3, np.nan), np.full(3, np.nan)
    for axis in range(3):
        variance = deviation[:, axis] ** 2
        if not (variance > 0).all():
            density[axis] = 0.0
            continue
        density[axis] = np.exp(np.average(np.log(variance * tau)[white], weights=weight[white] ** 2) / 2.0)
        if duration < SLOW_S:
            continue
        long = tau >= _WHITE_TAU_S[0]
        parts = np.stack([1.0 / tau, np.full(len(tau), _FLICKER), tau / 3.0], axis=1)[long]
        scale = weight[long] / variance[long]
        power, _ = nnls(parts * scale[:, None], weight[long])
        share = parts * power / (parts @ power)[:, None]
        density[axis] = np.sqrt(power[0]) if power[0] > 0 else density[axis]
        if share[:, 1].max() > _SEEN:
            instability[axis] = np.sqrt(power[1])
        if share[:, 2].max() > _SEEN:
            walk[axis] = np.sqrt(power[2])
    return SensorNoise(tau, deviation, density, instability, walk, duration)


def allan_deviation(samples: FloatArray, rate_hz: float) -> tuple[FloatArray, FloatArray]:
    """Overlapping Allan deviation of samples (N, 3): averaging times (k,) s, and deviations (k, 3)."""
    count = len(samples)
    longest = max(count // _LONGEST_SHARE, 1)
    steps = int(np.ceil(np.log10(longest) * _A_DECADE)) + 1
    m = np.unique(np.round(np.logspace(0.0, np.log10(longest), steps)).astype(int))
    sums = np.vstack([np.zeros(samples.shape[1]), np.cumsum(samples - samples.mean(axis=0), axis=0)])
    deviation = np.empty((len(m), samples.shape[1]))
    for k, n in enumerate(m):
        second = sums[2 * n :] - 2.0 * sums[n:-n] + sums[: -2 * n]
        deviation[k] = np.sqrt(np.mean(second**2, axis=0) / (2.0 * n**2))
    return m / rate_hz, deviation


#: Still samples that a mean needs (Le et al. take the first 200).
STILL_SAMPLES = 200
#: Neighbours that differ by less than this on every axis are treated as stable (Jatesiktat and Ang, II-E.2).
STABLE_RAD_S = np.radians(3.0)
#: The running mean forgets over this many stable samples.
RUNNING_SAMPLES = 500
#: Largest bias that a turning sensor's running mean counts, rad/s.
_LARGEST_BIAS = np.radians(15.0)


@dataclass(frozen=True)
class GyroscopeCalibration:
    """corrected = raw - offset, rad/s."""

    offset: FloatArray  # (3,) rad/s
    sigma: FloatArray  # (3,): its standard deviation, rad/s
    samples: int  # How many it is the mean of
    rule: str  # "rest" (mean of still samples) or "running" (mean of stable pairs: some tenths of a degree/s)

    def apply(self, raw: FloatArray) -> FloatArray:
        """Corrected samples (N, 3) of raw ones (N, 3), rad/s."""
        return raw - self.offset


def calibrate_gyroscope(imu: ImuStream, rests: Rests) -> GyroscopeCalibration:
    """The mean of the still samples (Le et al.); without 200 of them the running rule (`running_bias`)."""
    if rests.samples >= STILL_SAMPLES:
        length = (rests.ranges[:, 1] - rests.ranges[:, 0]).astype(float)
        offset = np.average(rests.gyro, axis=0, weights=length)
        # rests differ by more than their noise where the bias wandered
        effective = length.sum() ** 2 / np.sum(length**2)
        between = np.average((rests.gyro - offset) ** 2, axis=0, weights=length) / effective
        sigma = np.sqrt(np.maximum(rests.gyro_sigma**2 / length.sum(), between if len(rests) > 1 else 0.0))
        return GyroscopeCalibration(offset, sigma, int(length.sum()), "rest")
    path, stable = running_bias(imu.gyro)
    if stable.sum() < STILL_SAMPLES or np.abs(path[-1]).max() > _LARGEST_BIAS:
        raise CalibrationError(
            f"the gyroscope was still for {rests.samples} samples only, and its bias needs {STILL_SAMPLES};"
            " leave the sensor lying for some seconds while it records."
        )
    used = imu.gyro[1:][stable]
    sigma = np.std(used, axis=0) / np.sqrt(len(used) / max(imu.rate_hz, 1.0))  # one per second is independent
    return GyroscopeCalibration(path[-1], sigma, int(stable.sum()), "running")


def running_bias(gyro: FloatArray) -> tuple[FloatArray, np.ndarray]:  # -> path (k, 3), stable (N - 1,)
    """The slow running mean of Jatesiktat and Ang (II-E.2) after each stable sample."""
    stable = np.asarray((np.abs(np.diff(gyro, axis=0)) < STABLE_RAD_S).all(axis=1))
    values = gyro[1:][stable]
    if not len(values):
        return np.zeros((0, 3)), stable
    # a plain mean until there are enough samples to forget with
    count = np.arange(1, len(values) + 1)
    path = np.cumsum(values, axis=0) / count[:, None]
    if len(values) > RUNNING_SAMPLES:
        from scipy.signal import lfilter

        keep = 1.0 - 1.0 / RUNNING_SAMPLES
        start = path[RUNNING_SAMPLES - 1]
        later, _ = lfilter(
            [1.0 - keep], [1.0, -keep], values[RUNNING_SAMPLES:], axis=0, zi=keep * start[None, :]
        )
        path[RUNNING_SAMPLES:] = later
    return path, stable


#: A recording at rest for this share of its time, and this long without a pause, s, is for noise only.
_MOSTLY = 0.8
LONG_REST_S = 20.0


@dataclass(frozen=True)
class ImuCalibration:
    """What a recording gave of accelerometer and gyroscope."""

    name: str  # Of the stream
    rests: Rests  # Where the sensor lay still
    gyroscope: GyroscopeCalibration  # Its bias
    # None where the recording is one long rest, which gives the noise only
    accelerometer: AccelerometerCalibration | None
    accelerometer_noise: SensorNoise | None  # From the longest rest; None where it is too short
    gyroscope_noise: SensorNoise | None  # From the longest rest; None where it is too short
    gravity: float = GRAVITY  # m/s^2: that the accelerometer was fitted to

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
    """Calibrate accelerometer and gyroscope from a recording of rest poses, or of one long rest."""
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
