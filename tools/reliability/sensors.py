"""What an IMU on a wrist measures of the second simulator's motion: ideal samples, then errors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import BoolArray, FloatArray
from smoother.recording import ImuStream

from .path import Motion

#: The motion is looked at at least so often, Hz.
FINE_HZ = 1000.0


def ideal_imu(motion: Motion, duration_s: float, rate_hz: float, *, left: bool = False) -> ImuStream:
    """Error-free samples: means over each sample's interval, stamped at its centre.

    The angular velocity of a fine step is the rotation vector over it, so that the samples add up to the turn
    exactly; the acceleration is the second difference of the position over it.

    Parameters
    ----------
    motion : Motion
        The person.
    duration_s : float, s
        Samples fill 0 to here.
    rate_hz : float, Hz
        Samples a second.
    left : bool
        The left wrist's instead of the right one's.
    """
    fine = int(np.ceil(FINE_HZ / rate_hz))
    count = int(duration_s * rate_hz)
    h = 1.0 / (rate_hz * fine)
    edges = h * np.arange(count * fine + 1, dtype=np.float64)
    middles = edges[:-1] + 0.5 * h
    R_edges, _ = motion.imu_pose(edges, left=left)
    R_K_A, _ = motion.imu_pose(middles, left=left)
    turns = Rotation.from_matrix(R_edges)
    rate = (turns[:-1].inv() * turns[1:]).as_rotvec() / h
    before, here, after = (motion.imu_pose(middles + k * 0.5 * h, left=left)[1] for k in (-1, 0, 1))
    acceleration = (after - 2 * here + before) / (0.5 * h) ** 2
    force = np.einsum("nji,nj->ni", R_K_A, acceleration - motion.camera.gravity)
    acc, gyro = (values.reshape(count, fine, 3).mean(axis=1) for values in (force, rate))
    stamps = (np.arange(count, dtype=np.float64) + 0.5) / rate_hz
    return ImuStream("simulated wrist", stamps, acc, gyro)


@dataclass(frozen=True)
class ImuErrors:
    """How large a sensor's errors are: densities and sigmas, SI units.

    Attributes
    ----------
    acc_density, gyro_density : float, m/s^2/sqrt(Hz), rad/s/sqrt(Hz)
    acc_bias, gyro_bias : float, m/s^2, rad/s
        Per axis.
    acc_walk, gyro_walk : float
        Of the biases, per sqrt(s).
    scale, misalignment : float
        Per axis, as fractions and rad.
    acc_range, gyro_range : float, m/s^2, rad/s
        Full scale, of 16 bits.
    """

    acc_density: float = 0.002
    gyro_density: float = 2e-4
    acc_bias: float = 0.05
    gyro_bias: float = 0.01
    acc_walk: float = 5e-4
    gyro_walk: float = 5e-5
    scale: float = 0.002
    misalignment: float = 0.003
    acc_range: float = 16 * 9.81
    gyro_range: float = np.radians(2000.0)
    names: tuple[str, ...] = field(default=("acc", "gyro"), repr=False)


def measured(ideal: ImuStream, errors: ImuErrors, rng: np.random.Generator) -> ImuStream:
    """The samples with a sensor's errors."""
    rate_hz, samples = ideal.rate_hz, {}
    for name in errors.names:
        density, bias, walk, full = (
            getattr(errors, f"{name}_{of}") for of in ("density", "bias", "walk", "range")
        )
        true = getattr(ideal, name)
        matrix = np.eye(3) + np.diag(rng.normal(0, errors.scale, 3))
        matrix += np.tril(rng.normal(0, errors.misalignment, (3, 3)), -1)
        drift = rng.normal(0, bias, 3) + np.cumsum(rng.normal(0, walk / np.sqrt(rate_hz), true.shape), axis=0)
        values = true @ matrix.T + drift + rng.normal(0, density * np.sqrt(rate_hz), true.shape)
        step = full / 2**15
        samples[name] = np.clip(np.round(values / step) * step, -full, full)
    return replace(ideal, acc=samples["acc"], gyro=samples["gyro"])


def evenly_restamped(imu: ImuStream, kept: BoolArray) -> ImuStream:
    """The kept samples (N,) with stamps spread evenly at the sensor's rate, as a writer counts them."""
    left = imu.select(kept)
    return replace(left, t_s=imu.t_s[0] + np.arange(len(left)) / imu.rate_hz)


def bursts_lost(
    imu: ImuStream, share: float, longest_s: float, rng: np.random.Generator, first_s: float = 2.0
) -> BoolArray:
    """(N,) False where samples are lost: bursts of up to `longest_s` until about `share` of all is gone."""
    kept, goal = np.ones(len(imu), dtype=bool), (1.0 - share) * len(imu)
    while kept.sum() > goal:
        start_s = rng.uniform(imu.t_s[0] + first_s, imu.t_s[-1] - longest_s)
        kept &= ~((imu.t_s >= start_s) & (imu.t_s < start_s + rng.uniform(0.2, 1.0) * longest_s))
    return kept


def turned_on_the_arm(imu: ImuStream, R_A_new: FloatArray, rows: BoolArray) -> ImuStream:
    """The samples of some rows (N,) in other axes: columns of `R_A_new` are the new axes in the old ones."""
    acc, gyro = imu.acc.copy(), imu.gyro.copy()
    acc[rows], gyro[rows] = acc[rows] @ R_A_new, gyro[rows] @ R_A_new
    return replace(imu, acc=acc, gyro=gyro)
