"""Gyroscope: its bias, from a rest or, where there is none, from every still pair of samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.recording import ImuStream

from .rests import Rests

#: Still samples that a mean needs (Le et al. take the first 200).
STILL_SAMPLES = 200
#: Neighbours that differ by less than this on every axis count as stable (Jatesiktat and Ang, II-E.2).
STABLE_RAD_S = np.radians(3.0)
#: The running mean forgets over so many stable samples.
RUNNING_SAMPLES = 500
#: Largest bias that a turning sensor's running mean counts, rad/s.
_LARGEST_BIAS = np.radians(15.0)


@dataclass(frozen=True)
class GyroscopeCalibration:
    """corrected = raw - offset, rad/s.

    Attributes
    ----------
    offset : ndarray, shape (3,), rad/s
    sigma : ndarray, shape (3,)
        Its standard deviation, rad/s.
    samples : int
        How many it is the mean of.
    rule : str
        "rest" (mean of still samples) or "running" (mean of stable pairs: some tenths of a degree/s).
    """

    offset: FloatArray
    sigma: FloatArray
    samples: int
    rule: str

    def apply(self, raw: FloatArray) -> FloatArray:
        """Corrected samples (N, 3) of raw ones (N, 3), rad/s."""
        return raw - self.offset


def calibrate_gyroscope(imu: ImuStream, rests: Rests) -> GyroscopeCalibration:
    """The mean of the still samples (Le et al.); without 200 of them the running rule (`running_bias`).

    Raises
    ------
    CalibrationError
        The sensor was never still.
    """
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
            f"the gyroscope was still for {rests.samples} samples only and its bias needs {STILL_SAMPLES};"
            " leave the sensor lying for some seconds while it records."
        )
    used = imu.gyro[1:][stable]
    sigma = np.std(used, axis=0) / np.sqrt(len(used) / max(imu.rate_hz, 1.0))  # one a second is independent
    return GyroscopeCalibration(path[-1], sigma, int(stable.sum()), "running")


def running_bias(gyro: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """The slow running mean of Jatesiktat and Ang (II-E.2) after each stable sample.

    Two consecutive samples that differ by less than 3 degrees/s on every axis count as a sensor that is
    considerably stable: the later one goes into the mean, which changes slowly.

    Returns
    -------
    path : ndarray, shape (k, 3)
        The mean after each stable sample, rad/s.
    stable : ndarray, shape (N - 1,)
        Which of the samples from the second on are stable.
    """
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
