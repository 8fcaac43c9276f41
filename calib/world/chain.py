"""The chain of rotations from the camera to the world and back over the panel, pose by still pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import skew
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
    """Means over a time in which an IMU rests."""

    t_s: float  # The pose's time
    acc: FloatArray  # (3,) m/s^2: mean, about +9.81 upwards
    acc_sigma: FloatArray  # (3,) m/s^2: of that mean
    gyro: FloatArray  # (3,) rad/s: the gyroscope's bias
    mag: FloatArray | None  # (3,): in the sensor's unit, or None
    length_s: float  # How long it rested


@dataclass(frozen=True)
class Turn:
    """A rotation from one pose to the next by the gyroscope."""

    R: FloatArray  # (3, 3): maps the later axes of the IMU to the earlier ones
    sigma_rad: float  # An axis


def rest_at(imu: ImuStream, t_s: float, pose: str, what: str) -> Rest:
    """Mean readings of an IMU while a pose is held."""
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


#: Sigma of a rotation of which nothing is known, rad.
FREE_RAD = 2.0
#: What scale and cross-axis errors of an accelerometer leave of a direction, rad.
TILT_RAD = np.radians(0.05)
#: Bias of an accelerometer as its maker calibrated it, and of one calibrated by rest poses, m/s^2 per axis.
BIAS_M_S2, CORRECTED_M_S2 = 0.03, 0.012
#: Magnetometers: iron on the sensor (a share of the field), and iron in the room, which differs from place to
#: place, rad.
IRON, ROOM_RAD = 0.05, np.radians(2.0)
#: Magnetic dip is not asked for: any from the equator to the pole, rad.
DIP_RAD = 3.0
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class WorldPose:
    """One pose of the panel, as camera and IMUs know it."""

    name: str  # For messages
    R_K_P: FloatArray  # (3, 3): the panel in the camera, from its images
    covariance: FloatArray  # (3, 3): of its rotation vector, rad^2 in {K}
    panel: Rest  # The IMUs at rest
    base: Rest  # The IMUs at rest
    panel_turn: Turn | None = None  # Their rotation since the pose before, or None
    base_turn: Turn | None = None  # Their rotation since the pose before, or None

    @property
    def has_north(self) -> bool:
        """Both IMUs have a magnetometer."""
        return self.panel.mag is not None and self.base.mag is not None


@dataclass(frozen=True)
class Attitudes:
    """The unknowns."""

    R_K_B: Rotation  # Camera from base IMU, panel from its IMU
    R_P_I: Rotation  # Camera from base IMU, panel from its IMU
    R_W_B: Rotation  # The IMUs in the world (z up), one per pose
    R_W_I: Rotation  # The IMUs in the world (z up), one per pose
    rest: FloatArray  # (14,): biases

    def moved(self, step: FloatArray) -> Attitudes:
        """Rotated by small angles: `R_K_B` in {K}, the others in their own axes."""
        n = len(self.R_W_B)
        turns = Rotation.from_rotvec(step[: 6 + 6 * n].reshape(-1, 3))
        return Attitudes(
            turns[0] * self.R_K_B,
            self.R_P_I * turns[1],
            self.R_W_B * turns[2 : 2 + n],
            self.R_W_I * turns[2 + n :],
            self.rest + step[6 + 6 * n :],
        )


class Problem:
    """Residuals over their sigmas, and their derivatives, at any attitudes."""

    def __init__(
        self,
        poses: list[WorldPose],
        start: Attitudes,
        mounting_sigma_rad: float | None,
        bias_m_s2: float = BIAS_M_S2,
    ):
        self._poses, self._start, self._mounting = poses, start, mounting_sigma_rad
        self._bias_sigma = np.array([bias_m_s2] * 6 + [IRON] * 6 + [DIP_RAD] * 2)
        self._weight = [np.linalg.inv(np.linalg.cholesky(pose.covariance)) for pose in poses]
        self._north = all(pose.has_north for pose in poses)
        self._bias = 6 + 6 * len(poses)
        self._size = self._bias + len(start.rest)

    def linearise(self, at: Attitudes) -> tuple[FloatArray, FloatArray]:
        """Residuals (r,) and derivatives (r, c) at some attitudes."""
        rows = _Rows(self._size)
        for i in range(len(self._poses)):
            self._camera(rows, at, i)
            for imu in (0, 1):
                self._gravity(rows, at, i, imu)
        for i in range(len(self._poses)):
            for imu in (0, 1):
                if self._north:
                    self._field(rows, at, i, imu)
                self._turn(rows, at, i, imu)
        self._beforehand(rows, at)
        return np.concatenate(rows.values), np.vstack(rows.slopes)

    def camera_left(self, at: Attitudes) -> FloatArray:
        """What is left (n, 3) of the panel's rotation in the camera, rad in {K}."""
        seen = Rotation.from_matrix([pose.R_K_P for pose in self._poses])
        return np.asarray((at.R_K_B * at.R_W_B.inv() * at.R_W_I * at.R_P_I.inv() * seen.inv()).as_rotvec())

    def spread(self, misfit: FloatArray) -> float:
        """Mean square residual over what is expected; 1 where less: a few poses may fit by luck."""
        empty = (4 if self._north else 2) * len(self._poses)  # three rows of a direction have two degrees
        spare = len(misfit) - empty - self._size
        return max(1.0, float(misfit @ misfit) / spare) if spare > 0 else 1.0

    def _attitude(self, i: int, imu: int) -> int:
        """First column of an IMU's attitude in a pose; 0 is the base IMU, 1 the panel's."""
        return 6 + 3 * (imu * len(self._poses) + i)

    def _camera(self, rows: _Rows, at: Attitudes, i: int) -> None:
        R_K_I = at.R_K_B * at.R_W_B[i].inv() * at.R_W_I[i]
        seen = Rotation.from_matrix(self._poses[i].R_K_P)
        error = (R_K_I * at.R_P_I.inv() * seen.inv()).as_rotvec()
        turned = self._weight[i] @ _left_inverse(error)
        on_I = turned @ R_K_I.as_matrix()
        rows.add(
            self._weight[i] @ error,
            {
                0: turned,
                3: -on_I,
                self._attitude(i, 0): -turned @ at.R_K_B.as_matrix(),
                self._attitude(i, 1): on_I,
            },
        )

    def _gravity(self, rows: _Rows, at: Attitudes, i: int, imu: int) -> None:
        """Angle between what an accelerometer feels as up and what its attitude says."""
        rest, R = self._imu(at, i, imu)
        bias = slice(3 * imu, 3 * imu + 3)
        up, by_force = _direction(rest.acc - at.rest[bias])
        noise = rest.acc_sigma.mean() / np.linalg.norm(rest.acc)
        level = skew(_UP) / np.hypot(noise, TILT_RAD)
        rows.add(
            -level @ R @ up,
            {self._attitude(i, imu): level @ R @ skew(up), self._bias + 3 * imu: -level @ R @ by_force},
        )

    def _field(self, rows: _Rows, at: Attitudes, i: int, imu: int) -> None:
        """Difference of unit fields in {W}, whose x axis is magnetic north."""
        rest, R = self._imu(at, i, imu)
        assert rest.mag is not None
        iron, dip = slice(6 + 3 * imu, 9 + 3 * imu), at.rest[12 + imu]
        field, by_field = _direction(rest.mag / np.linalg.norm(rest.mag) - at.rest[iron])
        rows.add(
            (R @ field - [np.cos(dip), 0.0, -np.sin(dip)]) / ROOM_RAD,
            {
                self._attitude(i, imu): -R @ skew(field) / ROOM_RAD,
                self._bias + 6 + 3 * imu: R @ by_field / ROOM_RAD,
                self._bias + 12 + imu: np.array([[np.sin(dip)], [0.0], [np.cos(dip)]]) / ROOM_RAD,
            },
        )

    def _turn(self, rows: _Rows, at: Attitudes, i: int, imu: int) -> None:
        """The gyroscope's turn since the pose before against that of the attitudes."""
        turn = (self._poses[i].base_turn, self._poses[i].panel_turn)[imu]
        if turn is None or i == 0:
            return
        R_W = (at.R_W_B, at.R_W_I)[imu]
        between = R_W[i - 1].inv() * R_W[i]
        error = (Rotation.from_matrix(turn.R).inv() * between).as_rotvec()
        later = _left_inverse(-error) / turn.sigma_rad  # the right Jacobian's inverse
        rows.add(
            error / turn.sigma_rad,
            {
                self._attitude(i, imu): later,
                self._attitude(i - 1, imu): -later @ between.as_matrix().T,
            },
        )

    def _beforehand(self, rows: _Rows, at: Attitudes) -> None:
        """Every rotation is free, or nearly; biases are small; the mounting may have been lined up by eye."""
        start = self._start
        rows.near(0, at.R_K_B, start.R_K_B, FREE_RAD, on_left=True)
        rows.near(3, at.R_P_I, start.R_P_I, FREE_RAD)
        for i in range(len(self._poses)):
            rows.near(self._attitude(i, 0), at.R_W_B[i], start.R_W_B[i], FREE_RAD)
            rows.near(self._attitude(i, 1), at.R_W_I[i], start.R_W_I[i], FREE_RAD)
        if self._mounting is not None:
            rows.near(3, at.R_P_I, Rotation.identity(), self._mounting)
        sigma = self._bias_sigma
        rows.add((at.rest - start.rest) / sigma, {self._bias: np.diag(1 / sigma)})

    def _imu(self, at: Attitudes, i: int, imu: int) -> tuple[Rest, FloatArray]:
        pose, R_W = self._poses[i], (at.R_W_B, at.R_W_I)[imu]
        return (pose.base, pose.panel)[imu], R_W[i].as_matrix()


class _Rows:
    """Rows of residuals and of their derivatives, gathered one after the other."""

    def __init__(self, size: int):
        self._size = size
        self.values: list[FloatArray] = []
        self.slopes: list[FloatArray] = []

    def add(self, value: FloatArray, parts: dict[int, FloatArray]) -> None:
        """Add rows; `parts` by their first column."""
        slope = np.zeros((len(value), self._size))
        for column, part in parts.items():
            slope[:, column : column + part.shape[1]] = part
        self.values.append(value)
        self.slopes.append(slope)

    def near(self, column: int, R: Rotation, known: Rotation, sigma: float, on_left: bool = False) -> None:
        """A rotation is known to `sigma` rad; its small angles count on the left or on the right."""
        error = (R * known.inv() if on_left else known.inv() * R).as_rotvec()
        self.add(error / sigma, {column: _left_inverse(error if on_left else -error) / sigma})


def _direction(vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The unit vector, and its derivative (3, 3) by what is taken off the vector."""
    size = np.linalg.norm(vector)
    unit = vector / size
    return unit, -(np.eye(3) - np.outer(unit, unit)) / size


def _left_inverse(phi: FloatArray) -> FloatArray:
    """Inverse left Jacobian of the rotation group: how log(Exp(d) Exp(phi)) grows with d."""
    angle = float(np.linalg.norm(phi))
    cross = skew(phi)
    if angle < 1e-4:
        return np.eye(3) - 0.5 * cross + cross @ cross / 12
    share = 1 / angle**2 - (1 + np.cos(angle)) / (2 * angle * np.sin(angle))
    return np.asarray(np.eye(3) - 0.5 * cross + share * cross @ cross)
