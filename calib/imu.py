"""`calibrate imu`, `magnetometer`: offset, scale, cross-axis and noise of a sensor that rests or is turned.

Accelerometer: from rest poses (Frosio et al., as in Le et al.). Magnetometer: the samples of a sensor that
was turned about all its axes lie on an ellipsoid (Jatesiktat and Ang, section II-E.1, eq 3; Petrov 2009): its
nine coefficients by linear least squares, then the same nine parameters by geometric least squares, so that
noise does not shrink it. A rotation of the sensor's axes cannot be seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import binary_dilation, uniform_filter1d
from scipy.optimize import least_squares, nnls
from scipy.signal import lfilter
from scipy.spatial import cKDTree

from smoother.array_types import BoolArray, FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import robust_sigma, runs, sphere, unit
from smoother.recording import ImuStream
from smoother.units import GRAVITY, STANDARD_GRAVITY

from .file import CalibrationFile
from .protocol import Answer, Verdict
from .sensor import sensor_name

#: Directions that the sphere is looked at; neighbours are some 4 degrees apart.
_GRID = 2000
#: Cells that a sphere's coverage is counted in; each is some 20 degrees across.
_CELLS = 100


@dataclass(frozen=True)
class Coverage:
    """What was covered of the sphere."""

    hole_rad: float  # Radius of the largest cap without a direction in it
    towards: FloatArray  # (3,): unit vector, the middle of that cap
    share: float  # Part of the sphere's 100 cells that contain a direction, 0 to 1


def cover(direction: FloatArray) -> Coverage:
    """Coverage by unit vectors (N, 3)."""
    grid = sphere(_GRID)
    apart, _ = cKDTree(direction).query(grid)
    worst = int(np.argmax(apart))
    _, cell = cKDTree(sphere(_CELLS)).query(direction)
    return Coverage(
        hole_rad=2.0 * float(np.arcsin(min(apart[worst] / 2.0, 1.0))),
        towards=grid[worst],
        share=len(np.unique(cell)) / _CELLS,
    )


def axis_words(direction: FloatArray) -> str:
    """A direction in the sensor's axes in words: "+z", or "between +x and -z"."""
    order = np.argsort(-np.abs(direction))
    parts = [f"{'+' if direction[i] > 0 else '-'}{'xyz'[i]}" for i in order]
    if abs(direction[order[0]]) > np.cos(np.radians(25.0)):
        return parts[0]
    if abs(direction[order[2]]) < np.sin(np.radians(20.0)):
        return f"between {parts[0]} and {parts[1]}"
    return f"between {parts[0]}, {parts[1]} and {parts[2]}"


#: Stillness is judged over this time, s, and a rest lasts at least this long, s.
LOOK_S = 0.5
SHORTEST_S = 0.8
#: Still is what varies less than this many times the quietest part of the recording ..
TIMES_QUIETEST = 3.0
QUIETEST_PERCENT = 2.0
#: .. or less than this in any case (m/s^2, rad/s), so that a sensor without noise has rests too ..
STILL_ACC, STILL_GYRO = 0.04, 0.015
#: .. and never more than this: so much is motion in any sensor.
MOVING_ACC, MOVING_GYRO = 1.0, 0.15
#: A slow turn: the means of a look's two halves differ by more than their noise and this.
CREEP_ACC, CREEP_GYRO = 0.03, 0.01
#: A rest that an impact interrupts goes on if the acceleration is the same after it, m/s^2.
KNOCKED_ACC = 0.2
#: A rest that goes on in the same direction is the same pose, rad.
SAME_POSE_RAD = np.radians(8.0)


@dataclass(frozen=True)
class Rests:
    """Times in which a sensor lay still."""

    ranges: np.ndarray  # (n, 2): first sample of each, and the one after the last
    acc: FloatArray  # (n, 3): means, m/s^2 and rad/s
    gyro: FloatArray  # (n, 3): means, m/s^2 and rad/s
    acc_sigma: FloatArray  # (3,): standard deviation of a sample at rest
    gyro_sigma: FloatArray  # (3,): standard deviation of a sample at rest
    pose: np.ndarray  # (n,): number of the pose; rests in the same direction share one

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def poses(self) -> int:
        """How many different directions gravity was seen from."""
        return len(np.unique(self.pose))

    @property
    def samples(self) -> int:
        """Still samples in all."""
        return int(np.sum(self.ranges[:, 1] - self.ranges[:, 0])) if len(self) else 0

    def longest(self) -> slice:
        """Samples of the longest rest."""
        k = int(np.argmax(self.ranges[:, 1] - self.ranges[:, 0]))
        return slice(int(self.ranges[k, 0]), int(self.ranges[k, 1]))


_NO = np.zeros((0, 3))
NO_RESTS = Rests(np.zeros((0, 2), int), _NO, _NO, np.zeros(3), np.zeros(3), np.zeros(0, int))


def find_rests(imu: ImuStream) -> Rests:
    """All rests of a stream."""
    rate = imu.rate_hz
    width = max(round(LOOK_S * rate), 5) | 1
    if len(imu) < 2 * width:
        return NO_RESTS
    still = _still(imu.acc, width, STILL_ACC, MOVING_ACC, CREEP_ACC)
    still &= _still(imu.gyro, width, STILL_GYRO, MOVING_GYRO, CREEP_GYRO)
    # less than half a look, so that two rests with nothing but a jump between them stay two
    let_go = max(width // 6, 1)
    still = binary_dilation(still, iterations=width // 2 - let_go)
    edges = np.array([(rows.start, rows.stop) for rows in runs(still)], dtype=int).reshape(-1, 2)
    edges = _joined(edges, imu.acc, width // 2)
    gaps = np.flatnonzero(np.diff(imu.t_s) > max(5.0 / rate, 0.1)) + 1
    ranges = [
        (a, b)
        for first, last in edges.tolist()
        for a, b in pairwise([first, *gaps[(gaps > first) & (gaps < last)].tolist(), last])
        if imu.t_s[b - 1] - imu.t_s[a] >= SHORTEST_S
    ]
    if not ranges:
        return NO_RESTS
    length = np.diff(ranges)[:, 0].astype(float)
    acc, gyro = (np.array([x[a:b].mean(axis=0) for a, b in ranges]) for x in (imu.acc, imu.gyro))
    acc_sigma, gyro_sigma = (
        np.sqrt(np.average([x[a:b].var(axis=0) for a, b in ranges], axis=0, weights=length))
        for x in (imu.acc, imu.gyro)
    )
    return Rests(np.array(ranges), acc, gyro, acc_sigma, gyro_sigma, _poses(acc))


def _still(values: FloatArray, width: int, floor: float, moving: float, creep: float) -> BoolArray:
    """Samples (N,) about which a signal (N, 3) varies as little as anywhere in the recording."""
    centred = values - values.mean(axis=0)
    mean = uniform_filter1d(centred, width, axis=0, mode="nearest")
    square = uniform_filter1d(centred**2, width, axis=0, mode="nearest")
    deviation = np.sqrt(np.maximum(square - mean**2, 0.0).sum(axis=1) / 3.0)
    quietest = float(np.percentile(deviation, QUIETEST_PERCENT))
    limit = min(max(TIMES_QUIETEST * quietest, floor), moving)
    # the second half of the look against the first
    half, quarter = width // 2, width // 4
    part = uniform_filter1d(centred, half, axis=0, mode="nearest")
    ahead, behind = np.roll(part, -quarter, axis=0), np.roll(part, quarter, axis=0)
    ahead[-quarter:], behind[:quarter] = part[-1], part[0]
    drift = np.linalg.norm(ahead - behind, axis=1)
    noise = min(quietest, moving) * np.sqrt(6.0 / half)
    return np.asarray((deviation <= limit) & (drift <= creep + 3.0 * noise))


def _joined(ranges: np.ndarray, acc: FloatArray, half: int) -> np.ndarray:
    """Ranges (n, 2), neighbours as one where an impact parts them and the pose is the same after it."""
    if len(ranges) < 2:
        return ranges
    apart = []
    for last, first in zip(ranges[:-1, 1].tolist(), ranges[1:, 0].tolist(), strict=True):
        before, after = (np.median(acc[a:b], axis=0) for a, b in ((last - half, last), (first, first + half)))
        apart.append(first - last > half or float(np.linalg.norm(after - before)) > KNOCKED_ACC)
    return np.column_stack([ranges[np.r_[True, apart], 0], ranges[np.r_[apart, True], 1]])


def _poses(acc: FloatArray) -> np.ndarray:
    """Number the directions (n, 3): one within `SAME_POSE_RAD` of an earlier one has its number."""
    up = unit(acc)
    first: list[int] = []
    pose = np.zeros(len(acc), int)
    for k, direction in enumerate(up):
        angle = np.arccos(np.clip(up[first] @ direction, -1.0, 1.0)) if first else np.empty(0)
        if len(angle) and angle.min() < SAME_POSE_RAD:
            pose[k] = int(np.argmin(angle))
        else:
            pose[k] = len(first)
            first.append(k)
    return pose


#: Unknowns, and this many different poses at least.
FEWEST_POSES = 9
#: What a pose's mean is worth at best, m/s^2: a table that gives, a breath of air.
POSE_SIGMA = 0.002
#: What is less certain than this in some direction is refused, or deserves a word, m/s^2.
REFUSED_SIGMA = 0.15
DOUBTED_SIGMA = 0.02
#: Poses that miss gravity by more than this are worth a word, m/s^2.
LARGE_RESIDUAL = 0.03
#: Directions in which the certainty is looked at.
_DIRECTIONS = 400


@dataclass(frozen=True)
class AccelerometerCalibration:
    """corrected = matrix @ (raw - offset), m/s^2."""

    offset: FloatArray  # (3,) m/s^2
    matrix: FloatArray  # (3, 3): symmetric
    covariance: FloatArray  # (9, 9): of offset and the matrix' upper triangle (xx, xy, xz, yy, yz, zz)
    poses: int  # Different directions that gravity was seen from
    residual: FloatArray  # (n,) m/s^2: corrected length less gravity, a rest each
    sigma: float  # m/s^2: root mean square over all directions of the corrected length's standard deviation
    worst_sigma: float  # m/s^2: its largest
    worst_direction: FloatArray  # (3,): Where that is
    remarks: tuple[str, ...] = ()  # What is worth a word, one sentence each

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, m/s^2."""
        return float(np.sqrt(np.mean(self.residual**2)))

    def apply(self, raw: FloatArray) -> FloatArray:
        """Corrected samples (N, 3) of raw ones (N, 3), m/s^2."""
        return (raw - self.offset) @ self.matrix.T


def calibrate_accelerometer(rests: Rests, gravity: float) -> AccelerometerCalibration:
    """Fit offset and matrix to the rests' means."""
    if rests.poses < FEWEST_POSES:
        found = "the sensor was never still"
        if len(rests):
            same = f" in {len(rests)} rests" if len(rests) > rests.poses else ""
            plural = "s" * (rests.poses != 1)
            found = f"the recording contains {rests.poses} different rest pose{plural}{same}"
        raise CalibrationError(
            f"{found}; at least {FEWEST_POSES} poses are needed, better twelve: lay the sensor still for"
            " three seconds on each of its six sides and on six edges between them."
        )
    answer = least_squares(
        lambda p: np.sum(_mapped(p, rests.acc)[0] ** 2, axis=1) - gravity**2,
        np.concatenate([np.zeros(3), np.eye(3)[_ROWS, _COLUMNS]]),
        jac=lambda p: 2.0 * _mapped(p, rests.acc)[1],
        x_scale="jac",
    )
    offset, matrix = answer.x[:3], symmetric(answer.x[3:])
    if not np.linalg.eigvalsh(matrix).min() > 0:
        raise CalibrationError(
            "the rest poses do not fit an accelerometer; lay the sensor on its six sides and on six"
            " edges between them."
        )
    residual = np.linalg.norm((rests.acc - offset) @ matrix, axis=1) - gravity
    freedom = max(len(rests) - 9, 1)
    length = (rests.ranges[:, 1] - rests.ranges[:, 0]).astype(float)
    sampling = float(np.sqrt(np.mean(rests.acc_sigma**2) * np.mean(1.0 / length)))
    pose_sigma = max(float(np.sqrt(np.sum(residual**2) / freedom)), float(np.hypot(sampling, POSE_SIGMA)))
    # |S(V-O)|^2 - g^2 over 2g is the length's own error
    design = _mapped(answer.x, rests.acc)[1] / gravity
    covariance = np.asarray(np.linalg.pinv(design.T @ design, rcond=1e-14) * pose_sigma**2, float)
    directions = sphere(_DIRECTIONS)
    raw = gravity * np.linalg.solve(matrix, directions.T).T + offset
    rows = _mapped(answer.x, raw)[1] / gravity
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", rows, covariance, rows))
    if np.linalg.matrix_rank(design / np.linalg.norm(design, axis=0), tol=1e-4) < 9:
        sigma = np.full(len(directions), np.inf)
        weak = np.linalg.svd(unit(rests.acc))[2][2]
    else:
        weak = directions[int(np.argmax(sigma))]
    worst, remarks = float(sigma.max()), []
    if worst > REFUSED_SIGMA:
        raise CalibrationError(
            f"the {rests.poses} rest poses leave the sensor's {axis_words(weak)} undetermined; add rests"
            " in which it points up, and others in which it points down, until all six sides and some"
            " edges have been up."
        )
    if worst > DOUBTED_SIGMA:
        remarks.append(
            f"with the sensor's {axis_words(weak)} up the result is known to {worst:.3f} m/s^2 only; "
            "add rests in that direction and in the opposite one"
        )
    if np.abs(residual).max() > LARGE_RESIDUAL:
        k = int(np.argmax(np.abs(residual)))
        remarks.append(
            f"rest {k + 1} is off gravity by {abs(residual[k]):.3f} m/s^2: it was not quite still, or"
            " the sensor is not linear; lay it on something firm"
        )
    return AccelerometerCalibration(
        offset=offset,
        matrix=matrix,
        covariance=covariance,
        poses=rests.poses,
        residual=residual,
        sigma=float(np.sqrt(np.mean(sigma**2))),
        worst_sigma=worst,
        worst_direction=weak,
        remarks=tuple(remarks),
    )


_ROWS, _COLUMNS = np.triu_indices(3)


def symmetric(upper: FloatArray) -> FloatArray:
    """The symmetric matrix (3, 3) of an upper triangle (6,): xx, xy, xz, yy, yz, zz."""
    matrix = np.zeros((3, 3))
    matrix[_ROWS, _COLUMNS] = matrix[_COLUMNS, _ROWS] = upper
    return matrix


def _mapped(p: FloatArray, raw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """S (v - o) (n, 3) of raw samples, and derivatives (n, 9) of half its squared length by o and S."""
    S, v = symmetric(p[3:]), raw - p[:3]
    mapped = v @ S
    by_matrix = mapped[:, _ROWS] * v[:, _COLUMNS]
    by_matrix += np.where(_ROWS == _COLUMNS, 0.0, mapped[:, _COLUMNS] * v[:, _ROWS])
    return mapped, np.hstack([-mapped @ S, by_matrix])


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

    @property
    def noises(self) -> dict[str, SensorNoise]:
        """Noise by sensor, where the longest rest gave it."""
        pairs = {"accelerometer": self.accelerometer_noise, "gyroscope": self.gyroscope_noise}
        return {name: noise for name, noise in pairs.items() if noise is not None}

    def tables(self) -> dict[str, dict[str, Any]]:
        """The sensor's tables for the calibration file; plain values.

        Of noise the axes' root mean square, as `smooth` takes one number a sensor.
        """
        acc: dict[str, Any] = {}
        gyro = {"offset": self.gyroscope.offset.tolist(), "offset_sigma": self.gyroscope.sigma.tolist()}
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
            }
        tables = {"gyroscope": gyro, "accelerometer": acc}
        for name, noise in self.noises.items():
            for key, values in (
                ("noise_density", noise.density),
                ("bias_instability", noise.instability),
                ("random_walk", noise.walk),
            ):
                known = values[np.isfinite(values)]
                if known.any():
                    tables[name][key] = float(np.sqrt(np.mean(known**2)))
            tables[name]["noise_rest_s"] = noise.duration_s
        return {name: table for name, table in tables.items() if table}


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


#: A better calibration than this is wasted on a wrist: half a milliradian of gravity, m/s^2.
GOOD_SIGMA = 0.005
#: Noise figures in a datasheet's units: sensor, name and unit, attribute, factor.
_DATASHEET = (
    ("accelerometer", "noise density, µg/√Hz", "density", 1e6 / STANDARD_GRAVITY),
    ("accelerometer", "bias instability, µg", "instability", 1e6 / STANDARD_GRAVITY),
    ("accelerometer", "random walk, µg/√s", "walk", 1e6 / STANDARD_GRAVITY),
    ("gyroscope", "noise density, degrees/s/√Hz", "density", np.degrees(1.0)),
    ("gyroscope", "angle random walk, degrees/√h", "density", 60.0 * np.degrees(1.0)),
    ("gyroscope", "bias instability, degrees/h", "instability", 3600.0 * np.degrees(1.0)),
    ("gyroscope", "random walk, degrees/s/√s", "walk", np.degrees(1.0)),
)


def imu_answer(calibration: ImuCalibration) -> Answer:
    """What was found of accelerometer and gyroscope, whether it serves, and what to record next."""
    acc, gyro, tables = calibration.accelerometer, calibration.gyroscope, calibration.tables()
    said, advice, remarks = [], [], acc.remarks if acc is not None else ()
    if acc is not None:
        word = "well" if acc.worst_sigma < DOUBTED_SIGMA else "roughly"
        said.append(
            f"{acc.poses} rest poses determine the accelerometer"
            f" {'very well' if acc.worst_sigma < GOOD_SIGMA else word}: corrected, gravity's length is known"
            f" to {acc.sigma:.4f} m/s^2 on average and {acc.worst_sigma:.4f} in the worst direction"
        )
        off = np.linalg.norm(calibration.rests.acc, axis=1) - calibration.gravity
        said.append(
            f"gravity at rest was off by {np.sqrt(np.mean(off**2)):.3f} m/s^2 (root mean square) before the"
            f" correction, and by {acc.rms:.4f} now"
        )
    else:
        said.append(
            "this is one long rest: it gives the noise and the gyroscope's bias, not the accelerometer"
        )
        advice.append(
            "for offset, scale and cross-axis: twelve rest poses of three seconds each, the sensor on its six"
            " sides and on six edges between them"
        )
    source = f"the mean of {gyro.samples} still samples"
    if gyro.rule == "running":
        source = f"the running mean of {gyro.samples} stable samples, as the sensor never lay still for long"
        advice.append("for the gyroscope's bias: leave the sensor lying for five seconds while it records")
    bias = ", ".join(f"{value:+.3f}" for value in np.degrees(gyro.offset))
    said.append(f"the gyroscope's bias is {bias} degrees/s, {source}")
    noise = calibration.gyroscope_noise
    if noise is None:
        advice.append(
            f"for the noise: one rest of {WHITE_S:.0f} s at least; bias instability takes an hour or more"
        )
    elif noise.duration_s < SLOW_S:
        advice.append(
            f"for bias instability and random walk: one rest of an hour or more (the longest was"
            f" {noise.duration_s:.0f} s)"
        )
    elif np.isnan(noise.instability).all() or np.isnan(noise.walk).all():
        advice.append(
            f"bias instability or random walk did not show in {noise.duration_s / 60.0:.0f} minutes; a longer"
            " rest at an even temperature may show them"
        )
    figures: dict[str, Any] = {
        "imu": calibration.name,
        "rests": len(calibration.rests),
        "poses": calibration.rests.poses,
        "gravity": calibration.gravity,
        "accelerometer": {**tables.get("accelerometer", {})},
        "gyroscope": {**tables["gyroscope"], "rule": gyro.rule, "samples": gyro.samples},
        "noise": [
            {"sensor": sensor, "figure": name, "x, y, z": factor * getattr(own, attribute)}
            for sensor, name, attribute, factor in _DATASHEET
            if (own := calibration.noises.get(sensor)) is not None
        ],
    }
    if acc is not None:
        shown = ("covariance", "worst_direction", "residual", "remarks")
        figures["accelerometer"] |= {name: getattr(acc, name) for name in shown}
    for name, own in calibration.noises.items():
        figures[name]["allan"] = {
            "tau_s": own.tau_s,
            "deviation": own.deviation,
            "noise_density": own.density,
            "bias_instability": own.instability,
            "random_walk": own.walk,
        }
    good = acc is not None and acc.worst_sigma < DOUBTED_SIGMA
    return Answer(
        Verdict("good" if good else "usable", said[0], tuple(said[1:]), tuple(advice)),
        tuple(remarks),
        CalibrationFile().with_table("imu", {sensor_name(calibration.name): tables}),
        figures,
    )


#: Fewer samples than this are not taken for a calibration.
FEWEST_SAMPLES = 200
#: Samples beyond this many add nothing; evenly spread ones are taken.
MOST_SAMPLES = 20_000
#: A hole in the coverage that refuses, and one that is worth a word.
LARGEST_HOLE_RAD = np.radians(60.0)
LARGE_HOLE_RAD = np.radians(35.0)
#: Spread across the flattest direction, as a part of the widest: below it all samples lie in a plane.
FLATTEST = 0.2
#: Longest to shortest radius: beyond it the ellipsoid was made of noise, or of a magnet.
LONGEST_RATIO = 3.0
#: Residuals (of a radius of 1) that refuse, and that are worth a word.
LARGEST_RESIDUAL = 0.15
LARGE_MAG_RESIDUAL = 0.04
#: Residuals farther off than this many scaled median deviations pull no more than one there.
_FAR = 3.0
#: Samples this many scaled median deviations off are strays, and so large a share of them is worth a word.
_STRAY = 6.0
STRAY_SHARE = 0.005


@dataclass(frozen=True)
class MagnetometerCalibration:
    """corrected = matrix @ (raw - offset), of length 1 where the field is the local one."""

    offset: FloatArray  # (3,): hard iron, in the sensor's unit
    matrix: FloatArray  # (3, 3): symmetric, one over the sensor's unit
    residual: float  # Root mean square departure of the corrected length from 1
    radii: FloatArray  # (3,): the ellipsoid's radii, in the sensor's unit, ascending
    samples: int  # How many were used
    coverage: Coverage  # Of the sphere by the corrected samples
    remarks: tuple[str, ...] = ()  # What is worth a word, one sentence each

    def apply(self, raw: FloatArray) -> FloatArray:
        """Corrected samples (N, 3) of raw ones (N, 3)."""
        return (raw - self.offset) @ self.matrix.T


def calibrate_magnetometer(raw: FloatArray) -> MagnetometerCalibration:
    """Fit the ellipsoid to raw samples (N, 3), in any unit."""
    samples = raw[np.isfinite(raw).all(axis=1)]
    if len(samples) < FEWEST_SAMPLES:
        raise CalibrationError(
            f"there are {len(samples)} magnetometer samples and {FEWEST_SAMPLES} are needed at least; turn "
            "the sensor slowly about all its axes for a minute."
        )
    samples = samples[:: -(-len(samples) // MOST_SAMPLES)]
    # about the middle and in units of the spread, so that the equations are well scaled
    middle, scale = samples.mean(axis=0), float(np.sqrt(np.mean(np.var(samples, axis=0)) * 3.0))
    _, spread, axes = np.linalg.svd(samples - middle, full_matrices=False)
    if not spread[0] > 0.0:
        raise CalibrationError("the magnetometer always reads the same; check that it is switched on.")
    if spread[2] < FLATTEST * spread[0]:
        about = axis_words(axes[2]).replace("+", "").replace("-", "")
        raise CalibrationError(
            "the magnetometer's samples lie in a plane: the sensor was turned about one axis only (its"
            f" {about} axis); turn it about the other two as well, until every side has pointed in every"
            " direction."
        )
    even = (samples - middle) / scale
    first = fit_ellipsoid(even)
    rough = np.linalg.norm((even - first[0]) @ first[1], axis=1) - 1.0
    _check_residual(0.5 * float(np.sqrt(np.mean(rough**2))))  # a magnet that passed may have pulled it
    offset, matrix = _refine(even, *first)
    radii, corrected = np.sort(scale / np.linalg.eigvalsh(matrix)), (even - offset) @ matrix
    length = np.linalg.norm(corrected, axis=1)
    residual = float(np.sqrt(np.mean((length - 1.0) ** 2)))
    coverage = cover(corrected / length[:, None])
    hole_deg, towards = np.degrees(coverage.hole_rad), axis_words(coverage.towards)
    if coverage.hole_rad > LARGEST_HOLE_RAD:
        raise CalibrationError(
            f"the magnetometer's samples leave {hole_deg:.0f} degrees of the sphere open around the sensor's"
            f" {towards}; continue turning until the field has come from there as well."
        )
    if radii[2] > LONGEST_RATIO * radii[0]:
        raise CalibrationError(
            f"the magnetometer's ellipsoid is {radii[2] / radii[0]:.1f} times as long as it is wide, which"
            " soft iron does not do; turn the sensor about all its axes, away from magnets."
        )
    _check_residual(residual)
    remarks, off = [], np.abs(length - 1.0)
    stray = float(np.mean(off > max(_STRAY * float(robust_sigma(length - 1.0)), LARGE_MAG_RESIDUAL)))
    if stray > STRAY_SHARE:
        remarks.append(
            f"{100 * stray:.1f} % of the samples lie far off the rest and hardly counted: a magnetic"
            " object came near for a while"
        )
    if coverage.hole_rad > LARGE_HOLE_RAD:
        remarks.append(
            f"{hole_deg:.0f} degrees of the sphere around the sensor's {towards} were not covered; the next"
            " recording should fill them"
        )
    if residual > LARGE_MAG_RESIDUAL:
        remarks.append(
            f"the samples lie {100 * residual:.1f} % off the ellipsoid (root mean square): the field was"
            " not homogeneous; record on one spot, half a metre from iron and electronics"
        )
    return MagnetometerCalibration(
        middle + scale * offset, matrix / scale, residual, radii, len(samples), coverage, tuple(remarks)
    )


def fit_ellipsoid(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centre (3,) and symmetric matrix (3, 3) that takes the ellipsoid to the unit sphere.

    Linear least squares on the nine coefficients of
    a x^2 + b y^2 + c z^2 + 2 d yz + 2 e xz + 2 f xy + 2 g x + 2 h y + 2 i z = 1 (Petrov 2009).
    """
    x, y, z = points.T
    design = np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y, 2 * x, 2 * y, 2 * z], axis=1)
    a, b, c, d, e, f, g, h, i = np.linalg.lstsq(design, np.ones(len(points)), rcond=None)[0]
    quadric = np.array([[a, f, e], [f, b, d], [e, d, c]])
    linear = np.array([g, h, i])
    values, axes = np.linalg.eigh(quadric)
    if not values.min() > 1e-6 * abs(values.max()):
        raise CalibrationError(
            "the magnetometer's samples do not lie on an ellipsoid; turn the sensor slowly about all its"
            " axes, away from iron and electronics."
        )
    centre = -np.linalg.solve(quadric, linear)
    level = 1.0 + centre @ quadric @ centre
    return centre, (axes * np.sqrt(values / level)) @ axes.T


def _refine(points: FloatArray, centre: FloatArray, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same by least squares on the distance to the unit sphere; far samples (a magnet) pull less."""

    def residual(p: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(_mapped(p, points)[0], axis=1) - 1.0)

    def jacobian(p: FloatArray) -> FloatArray:
        mapped, slope = _mapped(p, points)
        return slope / np.linalg.norm(mapped, axis=1)[:, None]

    start = np.concatenate([centre, matrix[_ROWS, _COLUMNS]])
    spread = float(robust_sigma(residual(start)))
    answer = least_squares(
        residual,
        start,
        jacobian,
        loss="soft_l1",
        f_scale=max(_FAR * spread, 1e-6),
        x_scale="jac",
        max_nfev=40,
    )
    return answer.x[:3], symmetric(answer.x[3:])


def _check_residual(residual: float) -> None:
    if residual > LARGEST_RESIDUAL:
        raise CalibrationError(
            f"the magnetometer's samples lie {100 * residual:.0f} % off their ellipsoid (root mean square):"
            " the field changed while it was recorded; record again on one spot, away from iron and"
            " electronics."
        )


def magnetometer_answer(calibration: MagnetometerCalibration, imu_name: str) -> Answer:
    """Hard and soft iron, whether they serve, and what to record next."""
    radii, coverage, remarks = calibration.radii, calibration.coverage, calibration.remarks
    shift = float(np.linalg.norm(calibration.offset)) / float(np.mean(radii))
    findings = (
        f"hard iron shifts the field by {100 * shift:.0f} % of its strength, soft iron makes it"
        f" {100 * (radii[2] / radii[0] - 1.0):.0f} % longer in one direction than in another",
        f"{100 * coverage.share:.0f} % of the sphere's cells were covered, the largest hole reaches"
        f" {np.degrees(coverage.hole_rad):.0f} degrees",
    )
    advice = [
        "calibrate again when the sensor's battery, case or strap buckle changes: iron on it moves the field"
    ]
    if calibration.residual > 0.5 * LARGE_MAG_RESIDUAL:
        advice.insert(
            0,
            "turn the sensor on one spot rather than carrying it about, half a metre from iron, loudspeakers"
            " and telephones",
        )
    table = {
        "offset": calibration.offset.tolist(),
        "matrix": calibration.matrix.tolist(),
        "residual_rms": calibration.residual,
        "samples": calibration.samples,
    }
    figures = {
        **table,
        "radii": radii,
        "largest_hole_rad": coverage.hole_rad,
        "covered_share": coverage.share,
        "remarks": remarks,
    }
    sentence = (
        f"{calibration.samples} samples determine the magnetometer {'roughly' if remarks else 'well'}:"
        f" they lie {100 * calibration.residual:.1f} % off the ellipsoid (root mean square)"
    )
    return Answer(
        Verdict("usable" if remarks else "good", sentence, findings, tuple(advice)),
        remarks,
        CalibrationFile().with_table("imu", {sensor_name(imu_name): {"magnetometer": table}}),
        {"imu": imu_name, "magnetometer": figures},
    )
