"""`calibrate imu`, `magnetometer`: offset, scale, cross-axis and noise of a sensor that rests or is turned.

Accelerometer: from rest poses (Frosio et al., as in Le et al.). Magnetometer: the samples of a sensor that
was turned about all its axes lie on an ellipsoid (Jatesiktat and Ang, section II-E.1, eq 3; Petrov 2009): its
nine coefficients by linear least squares, then the same nine parameters by geometric least squares, so that
noise does not shrink it. A rotation of the sensor's axes cannot be seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation, uniform_filter1d
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.spatial import cKDTree

from smoother.array_types import BoolArray, FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import robust_sigma, runs, sphere, unit
from smoother.recording import ImuStream
from smoother.units import GRAVITY

from .file import CalibrationFile, sensor_name
from .protocol import Answer, Check

#: Directions that the sphere is looked at, some 4 degrees apart; cells to count coverage in, some 20.
_GRID, _CELLS = 2000, 100


class Coverage(NamedTuple):
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
    hole = 2.0 * float(np.arcsin(min(apart[worst] / 2.0, 1.0)))
    return Coverage(hole, grid[worst], len(np.unique(cell)) / _CELLS)


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
    acc: FloatArray  # (n, 3) m/s^2: means
    gyro: FloatArray  # (n, 3) rad/s: means
    acc_sigma: FloatArray  # (3,) m/s^2: standard deviation of a sample at rest
    gyro_sigma: FloatArray  # (3,) rad/s: standard deviation of a sample at rest
    pose: np.ndarray  # (n,): number of the pose; rests in the same direction share one

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def poses(self) -> int:
        """How many different directions gravity was seen from."""
        return len(np.unique(self.pose))

    @property
    def length(self) -> FloatArray:
        """(n,) samples of each."""
        return np.diff(self.ranges, axis=1)[:, 0].astype(float)


def find_rests(imu: ImuStream, slack: float = 1.0) -> Rests:
    """All rests of a stream; `slack` times as much motion passes as in a sensor that lies, as in a hand."""
    rate = imu.rate_hz
    width = max(round(LOOK_S * rate), 5) | 1
    ranges: list[tuple[int, int]] = []
    if len(imu) >= 2 * width:
        still = _still(imu.acc, width, slack * STILL_ACC, MOVING_ACC, slack * CREEP_ACC)
        still &= _still(imu.gyro, width, slack * STILL_GYRO, MOVING_GYRO, slack * CREEP_GYRO)
        # less than half a look, so that two rests with nothing but a jump between them stay two
        still = binary_dilation(still, iterations=width // 2 - max(width // 6, 1))
        gaps = np.flatnonzero(np.diff(imu.t_s) > max(5.0 / rate, 0.1)) + 1
        ranges = [
            (a, b)
            for first, last in _joined(runs(still), imu.acc, width // 2)
            for a, b in pairwise([first, *gaps[(gaps > first) & (gaps < last)].tolist(), last])
            if imu.t_s[b - 1] - imu.t_s[a] >= SHORTEST_S
        ]
    if not ranges:
        none = np.zeros((0, 3))
        return Rests(np.zeros((0, 2), int), none, none, np.zeros(3), np.zeros(3), np.zeros(0, int))
    acc, gyro = (np.array([x[a:b].mean(axis=0) for a, b in ranges]) for x in (imu.acc, imu.gyro))
    acc_sigma, gyro_sigma = (
        np.sqrt(np.average([x[a:b].var(axis=0) for a, b in ranges], axis=0, weights=np.diff(ranges)[:, 0]))
        for x in (imu.acc, imu.gyro)
    )
    first: list[int] = []
    pose, up = np.zeros(len(acc), int), unit(acc)
    for k, direction in enumerate(up):  # one within `SAME_POSE_RAD` of an earlier one has its number
        angle = np.arccos(np.clip(up[first] @ direction, -1.0, 1.0)) if first else np.full(1, np.inf)
        pose[k] = int(np.argmin(angle)) if angle.min() < SAME_POSE_RAD else len(first)
        if pose[k] == len(first):
            first.append(k)
    return Rests(np.array(ranges), acc, gyro, acc_sigma, gyro_sigma, pose)


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


def _joined(still: list[slice], acc: FloatArray, half: int) -> list[tuple[int, int]]:
    """Neighbours as one where an impact parts them and the pose is the same after it."""
    found: list[tuple[int, int]] = []
    for first, last in ((rows.start, rows.stop) for rows in still):
        if found and first - (end := found[-1][1]) <= half:
            before, after = (
                np.median(acc[a:b], axis=0) for a, b in ((end - half, end), (first, first + half))
            )
            if float(np.linalg.norm(after - before)) <= KNOCKED_ACC:
                found[-1] = found[-1][0], last
                continue
        found.append((first, last))
    return found


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

    @property
    def rms(self) -> float:
        """Root mean square of the residuals, m/s^2."""
        return float(np.sqrt(np.mean(self.residual**2)))


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
    sampling = float(np.sqrt(np.mean(rests.acc_sigma**2) * np.mean(1.0 / rests.length)))
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
    worst = float(sigma.max())
    if worst > REFUSED_SIGMA:
        raise CalibrationError(
            f"the {rests.poses} rest poses leave the sensor's {axis_words(weak)} undetermined; add rests"
            " in which it points up, and others in which it points down, until all six sides and some"
            " edges have been up."
        )
    rms = float(np.sqrt(np.mean(sigma**2)))
    return AccelerometerCalibration(offset, matrix, covariance, rests.poses, residual, rms, worst, weak)


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


#: Shortest rest that gives the white noise, s.
WHITE_S = 20.0
#: Averaging times over which it is read, s: longer than filters, shorter than drift; how many of them.
_WHITE_TAU_S, _TAUS = (0.1, 2.0), 11


def noise_density(samples: FloatArray, rate_hz: float) -> FloatArray | None:  # samples (N, 3) -> (3,)
    """White noise of a sensor at rest, unit/sqrt(Hz), by its Allan deviation; None for less than 20 s."""
    if len(samples) < WHITE_S * rate_hz:
        return None
    tau = np.geomspace(*_WHITE_TAU_S, _TAUS)
    counts = np.unique(np.maximum(np.round(tau * rate_hz), 1).astype(int))
    variance = np.array([allan_deviation(samples, count) ** 2 * count / rate_hz for count in counts])
    # each averaging time weighs by how often it fits into the rest
    return np.sqrt(np.average(variance, axis=0, weights=len(samples) / counts - 1.0))


def allan_deviation(samples: FloatArray, count: int) -> FloatArray:
    """Overlapping Allan deviation (3,) of samples (N, 3) in groups of `count`."""
    sums = np.vstack([np.zeros(samples.shape[1]), np.cumsum(samples - samples.mean(axis=0), axis=0)])
    second = sums[2 * count :] - 2.0 * sums[count:-count] + sums[: -2 * count]
    return np.sqrt(np.mean(second**2, axis=0) / (2.0 * count**2))


#: Still samples that a mean needs (Le et al. take the first 200).
STILL_SAMPLES = 200
#: Neighbours that differ by less than this on every axis are treated as stable (Jatesiktat and Ang, II-E.2).
STABLE_RAD_S = np.radians(3.0)
#: The running mean forgets over this many stable samples.
RUNNING_SAMPLES = 500
#: Largest bias that a turning sensor's running mean counts, rad/s.
_LARGEST_BIAS = np.radians(15.0)


class GyroscopeCalibration(NamedTuple):
    """corrected = raw - offset, rad/s."""

    offset: FloatArray  # (3,) rad/s
    sigma: FloatArray  # (3,): its standard deviation, rad/s
    samples: int  # How many it is the mean of
    rule: str  # "rest" (mean of still samples) or "running" (mean of stable pairs: some tenths of a degree/s)


def calibrate_gyroscope(imu: ImuStream, rests: Rests) -> GyroscopeCalibration:
    """The mean of the still samples (Le et al.); without 200 of them the running rule (`running_bias`)."""
    length = rests.length
    still = int(length.sum())
    if still >= STILL_SAMPLES:
        offset = np.average(rests.gyro, axis=0, weights=length)
        # rests differ by more than their noise where the bias wandered
        effective = still**2 / np.sum(length**2)
        between = np.average((rests.gyro - offset) ** 2, axis=0, weights=length) / effective
        sigma = np.sqrt(np.maximum(rests.gyro_sigma**2 / still, between if len(rests) > 1 else 0.0))
        return GyroscopeCalibration(offset, sigma, still, "rest")
    path, stable = running_bias(imu.gyro)
    if stable.sum() < STILL_SAMPLES or np.abs(path[-1]).max() > _LARGEST_BIAS:
        raise CalibrationError(
            f"the gyroscope was still for {still} samples only, and its bias needs {STILL_SAMPLES};"
            " leave the sensor lying for some seconds while it records."
        )
    used = imu.gyro[1:][stable]
    sigma = np.std(used, axis=0) / np.sqrt(len(used) / max(imu.rate_hz, 1.0))  # one per second is independent
    return GyroscopeCalibration(path[-1], sigma, int(stable.sum()), "running")


def running_bias(gyro: FloatArray) -> tuple[FloatArray, np.ndarray]:  # -> path (k, 3), stable (N - 1,)
    """The slow running mean of Jatesiktat and Ang (II-E.2) after each stable sample."""
    stable = np.asarray((np.abs(np.diff(gyro, axis=0)) < STABLE_RAD_S).all(axis=1))
    values = gyro[1:][stable]
    # a plain mean until there are enough samples to forget with
    path = np.cumsum(values, axis=0) / np.arange(1, len(values) + 1)[:, None]
    if len(values) > RUNNING_SAMPLES:
        keep, later = 1.0 - 1.0 / RUNNING_SAMPLES, values[RUNNING_SAMPLES:]
        start = keep * path[RUNNING_SAMPLES - 1 : RUNNING_SAMPLES]
        path[RUNNING_SAMPLES:], _ = lfilter([1.0 - keep], [1.0, -keep], later, axis=0, zi=start)
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
    noise_rest_s: float  # Length of the longest rest
    densities: dict[str, float]  # White noise by sensor, per sqrt(Hz), rms of the axes; empty of a short rest
    gravity: float = GRAVITY  # m/s^2: that the accelerometer was fitted to


def calibrate_imu(imu: ImuStream, gravity: float = GRAVITY) -> ImuCalibration:
    """Calibrate accelerometer and gyroscope from a recording of rest poses, or of one long rest."""
    rests = find_rests(imu)
    densities, rest_s, noise_only = {}, 0.0, False
    if len(rests):
        rest = slice(*rests.ranges[int(np.argmax(rests.length))].tolist())
        rest_s = (rest.stop - rest.start) / imu.rate_hz
        for name, samples in (("accelerometer", imu.acc), ("gyroscope", imu.gyro)):
            if (density := noise_density(samples[rest], imu.rate_hz)) is not None:
                densities[name] = float(np.sqrt(np.mean(density**2)))
        is_long = rest_s >= LONG_REST_S and rest.stop - rest.start >= _MOSTLY * len(imu)
        noise_only = is_long and rests.poses < 3
    accelerometer = None if noise_only else calibrate_accelerometer(rests, gravity)
    gyroscope = calibrate_gyroscope(imu, rests)
    return ImuCalibration(imu.name, rests, gyroscope, accelerometer, rest_s, densities, gravity)


POSES = "twelve rest poses of three seconds each, the sensor on its six sides and on six edges between them"


def imu_answer(calibration: ImuCalibration) -> Answer:
    """What was found of accelerometer and gyroscope, whether it serves, and what to record next."""
    acc, gyro = calibration.accelerometer, calibration.gyroscope
    tables: dict[str, dict[str, Any]] = {
        "gyroscope": {"offset": gyro.offset.tolist(), "offset_sigma": gyro.sigma.tolist()},
        "accelerometer": {},
    }
    more: dict[str, Any] = {}  # of the accelerometer, for programs
    checks = [
        Check("still samples of the gyroscope", gyro.samples * (gyro.rule == "rest"), STILL_SAMPLES, "",
                "for the gyroscope's bias: leave the sensor lying for five seconds while it records", True),
        Check("longest rest, for the noise", calibration.noise_rest_s, WHITE_S, "s",
                f"for the noise: one rest of {WHITE_S:.0f} s at least", True),
    ]  # fmt: skip
    grade, sentence = "usable", "this is one long rest: it gives the noise and the gyroscope's bias"
    if acc is None:
        checks.insert(0, Check("offset, scale and cross-axis", remedy=f"record {POSES}", is_open=True))
    else:
        sigma = np.sqrt(np.diag(acc.covariance))
        tables["accelerometer"] = {
            "offset": acc.offset.tolist(),
            "matrix": acc.matrix.tolist(),
            "offset_sigma": sigma[:3].tolist(),
            "matrix_sigma": sigma[3:].tolist(),
            "poses": acc.poses,
            "residual_rms": acc.rms,
            "sigma": acc.sigma,
            "worst_sigma": acc.worst_sigma,
        }
        more = {name: getattr(acc, name) for name in ("covariance", "worst_direction", "residual")}
        off = np.linalg.norm(calibration.rests.acc, axis=1) - calibration.gravity
        sentence = (
            f"{acc.poses} rest poses determine the accelerometer: corrected, gravity's length is known to"
            f" {acc.sigma:.4f} m/s^2 on average; at rest it was off by {np.sqrt(np.mean(off**2)):.3f} m/s^2"
            f" (root mean square) before the correction, and by {acc.rms:.4f} now"
        )
        axis = axis_words(acc.worst_direction)
        worst = int(np.argmax(np.abs(acc.residual)))
        grade = "good" if acc.worst_sigma < DOUBTED_SIGMA else "usable"
        checks += [
            Check(f"sigma with the sensor's {axis} up", acc.worst_sigma, DOUBTED_SIGMA, "m/s^2",
                    f"add rests with the sensor's {axis} up, and with it down", is_open=True),
            Check(f"rest {worst + 1} off gravity", abs(float(acc.residual[worst])), LARGE_RESIDUAL, "m/s^2",
                    "lay the sensor on something firm, and leave it quite still"),
        ]  # fmt: skip
    for name, density in calibration.densities.items():
        tables[name] |= {"noise_density": density, "noise_rest_s": calibration.noise_rest_s}
    figures: dict[str, Any] = {
        "imu": calibration.name,
        "rests": len(calibration.rests),
        "poses": calibration.rests.poses,
        "gravity": calibration.gravity,
        "accelerometer": tables["accelerometer"] | more,
        "gyroscope": tables["gyroscope"] | {"rule": gyro.rule, "samples": gyro.samples},
    }
    written = {name: table for name, table in tables.items() if table}
    file = CalibrationFile().with_table("imu", {sensor_name(calibration.name): written})
    return Answer(grade, sentence, checks, file, figures)


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
    strays: float = 0.0  # Share of the samples that lie far off the rest: a magnet came near


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
    offset, matrix = fit_ellipsoid(even)
    rough = np.linalg.norm((even - offset) @ matrix, axis=1) - 1.0
    _check_residual(0.5 * float(np.sqrt(np.mean(rough**2))))  # a magnet that passed may have pulled it

    def off_sphere(p: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm((even - p[:3]) @ symmetric(p[3:]), axis=1) - 1.0)

    start = np.concatenate([offset, matrix[_ROWS, _COLUMNS]])
    far = max(_FAR * float(robust_sigma(off_sphere(start))), 1e-6)  # from here samples (a magnet) pull less
    refined = least_squares(off_sphere, start, loss="soft_l1", f_scale=far, x_scale="jac", max_nfev=40)
    offset, matrix = refined.x[:3], symmetric(refined.x[3:])
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
    off = np.abs(length - 1.0)
    strays = float(np.mean(off > max(_STRAY * float(robust_sigma(length - 1.0)), LARGE_MAG_RESIDUAL)))
    return MagnetometerCalibration(
        middle + scale * offset, matrix / scale, residual, radii, len(samples), coverage, strays
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


def _check_residual(residual: float) -> None:
    if residual > LARGEST_RESIDUAL:
        raise CalibrationError(
            f"the magnetometer's samples lie {100 * residual:.0f} % off their ellipsoid (root mean square):"
            " the field changed while it was recorded; record again on one spot, away from iron and"
            " electronics."
        )


def magnetometer_answer(calibration: MagnetometerCalibration, imu_name: str) -> Answer:
    """Hard and soft iron, whether they serve, and what to record next."""
    radii, coverage, residual = calibration.radii, calibration.coverage, calibration.residual
    on_one_spot = "turn the sensor on one spot, half a metre from iron, loudspeakers and telephones"
    hole_deg, towards = float(np.degrees(coverage.hole_rad)), axis_words(coverage.towards)
    checks = [
        Check(f"hole in the coverage, around the sensor's {towards}", hole_deg,
                float(np.degrees(LARGE_HOLE_RAD)), "degrees", "continue turning until it is filled"),
        Check("samples off the ellipsoid (rms)", residual, LARGE_MAG_RESIDUAL, "of the field", on_one_spot),
        Check("samples far off the rest", calibration.strays, STRAY_SHARE, "of all", on_one_spot),
    ]  # fmt: skip
    grade = "good" if all(row.is_good for row in checks) else "usable"
    table = {
        "offset": calibration.offset.tolist(),
        "matrix": calibration.matrix.tolist(),
        "residual_rms": residual,
        "samples": calibration.samples,
    }
    figures = table | {
        "radii": radii,
        "largest_hole_rad": coverage.hole_rad,
        "covered_share": coverage.share,
        "hard_iron_share": float(np.linalg.norm(calibration.offset) / np.mean(radii)),
        "soft_iron_share": float(radii[2] / radii[0] - 1.0),
    }
    sentence = (
        f"{calibration.samples} samples determine the magnetometer: they lie {100 * residual:.1f} % off the"
        " ellipsoid (root mean square); iron on the sensor moves the field: calibrate again when battery,"
        " case or buckle change"
    )
    file = CalibrationFile().with_table("imu", {sensor_name(imu_name): {"magnetometer": table}})
    return Answer(grade, sentence, checks, file, {"imu": imu_name, "magnetometer": figures})
