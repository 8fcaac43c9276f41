"""The mocap's clock against the IMU's, and its frame {E} against the camera's {K}.

t_imu = t_mocap (1 + skew) + offset. What turns with the forearm turns at the same speed in every frame: the
angular speeds of the answer (the gyroscope's, on the IMU's own stamps) and of the mocap's plate are
correlated over all offsets, then offset, skew and the plate's rotation in the IMU are solved by least squares
on turns over 0.2 s. Without a plate the speeds of the joint centres while the camera sees them serve instead.

p_K = R_K_E p_E + t_K_E, from a calibration, or solved from what the camera saw. A calibration states it for
the camera's optical axes {C} (x right, y down, z forward); recordings may have other axes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...array_types import FloatArray, IntArray
from ...errors import CalibrationError, RecordingError
from ...linalg import masked_correlation, nearest_rotation, robust_sigma
from ...recording import CameraFrame
from ...result import Recovery
from ..metrics import orientation_at, position_at
from ..words import said
from .motion import MocapMotion, numbers

#: A turn or a way is taken over this time, s: the camera's noise is small against the way.
STEP_S = 0.2
#: Grid of the correlation, Hz.
GRID_HZ = 50.0
#: The two must share this much motion, s, or a third of the shorter one.
LEAST_OVERLAP_S = 3.0
#: Less than this is too little in any case, s.
SHORTEST_S = 1.0
#: What clocks may disagree by, one standard deviation (parts).
SKEW_SIGMA = 3e-4
#: Another offset that correlates nearly as well makes the answer doubtful (share of the best score).
RIVAL = 0.97
#: Neighbouring samples are not independent: sigmas are taken from sums over times of this length, s.
INDEPENDENT_S = 1.0


@dataclass(frozen=True)
class MocapClock:
    """What was found."""

    offset_s: float  # `t_imu = t_mocap (1 + skew) + offset`; times count from the recording's origin
    sigma_s: float
    skew: float  # Parts (1e-6 = 1 ppm)
    skew_sigma: float
    correlation: float  # Of the speeds at that offset, -1 to 1
    by: str  # What was compared
    R_A_P: FloatArray | None = None  # (3, 3): the plate's rotation in the IMU where it was solved
    mount_sigma_rad: float = float("nan")  # Its sigma; nan where it was not
    notes: tuple[str, ...] = ()  # Notes on it, one sentence each

    def to_imu(self, t_mocap: FloatArray) -> FloatArray:
        """Mocap times on the IMU's clock, s."""
        return np.asarray(t_mocap * (1.0 + self.skew) + self.offset_s)

    def to_mocap(self, t_imu: FloatArray) -> FloatArray:
        """IMU times on the mocap's clock, s."""
        return np.asarray((t_imu - self.offset_s) / (1.0 + self.skew))


def align_clock(recovery: Recovery, motion: MocapMotion) -> MocapClock:
    """Find the mocap's clock."""
    if len(recovery) < 2 or len(motion.t_s) < 2:
        raise RecordingError(
            "the answer or the truth contains fewer than two samples, so no clock can be aligned"
        )
    shorter_s = float(min(np.ptp(recovery.t_s), np.ptp(motion.t_s)))
    least_s = max(min(LEAST_OVERLAP_S, shorter_s / 3.0), SHORTEST_S)
    signals = _signals(recovery, motion)
    lag, correlation, rivals = _coarse(signals, recovery.t_s, motion.t_s, least_s)
    if not np.isfinite(correlation):
        raise RecordingError(
            f"{motion.source}: its clock could not be aligned: the {signals.by} is known for less than"
            f" {least_s:.1f} s together; check that it is of the same recording, and the marker map"
        )
    if not correlation >= signals.least_correlation:
        raise RecordingError(
            f"{motion.source}: its clock could not be aligned: the {signals.by} of truth and answer agree"
            f" nowhere (best correlation {correlation:.2f}, {signals.least_correlation} is needed); check"
            " that it is of the same recording, and the marker map"
        )
    clock = _refine(signals, recovery.t_s, motion.t_s, lag, correlation)
    if rivals:
        text = ", ".join(f"{1000 * (other - lag):+.0f} ms" for other in rivals)
        return replace(clock, notes=(said("reference", "repeats", offsets=text),))
    return clock


@dataclass(frozen=True)
class _Signals:
    """What answer and truth do over a step, at any times."""

    by: str  # In words
    answer: Callable[[FloatArray], FloatArray]
    truth: Callable[[FloatArray], FloatArray]
    least_correlation: float  # Below this the two do not show the same motion
    is_turns: bool  # Rotation vectors in the body's own axes; lengths of ways else
    mount: FloatArray | None = None  # The plate's rotation in the IMU where it is known

    def speed(self, values: FloatArray) -> FloatArray:
        """Of the answer's or the truth's values."""
        if self.is_turns:
            return np.asarray(np.linalg.norm(values, axis=1) / STEP_S)
        return np.asarray(values.mean(axis=1) / STEP_S)


def _signals(recovery: Recovery, motion: MocapMotion) -> _Signals:
    """Turns of IMU and plate; without them ways of joint centres while the camera sees the arm."""
    if motion.R_E_P is not None and np.isfinite(recovery.quaternion).all(axis=1).any():
        answer = partial(turns_rad, recovery.t_s, recovery.quaternion)
        truth = partial(turns_rad, motion.t_s, motion.quaternion)
        # another trial of a protocol reaches a correlation of 0.7
        return _Signals("angular velocity of IMU and plate", answer, truth, 0.8, True, motion.R_A_P)
    pairs = shared_places(recovery, motion)
    if not pairs:
        raise RecordingError(
            f"{motion.source}: the answer has none of its joints"
            f" ({', '.join(motion.joints) or 'none'}), so there is nothing to align its clock by"
        )
    visible = ~recovery.occluded[:, None]
    seen = [np.where(visible, mine, np.nan) for mine, _ in pairs]

    def ways(t_known: FloatArray, places: list[FloatArray], t: FloatArray) -> FloatArray:
        return np.column_stack([way_m(t_known, place, t) for place in places])

    by = "speed of the joint centres" if motion.p_E_P is None else "speed of the IMU's position"
    answer = partial(ways, recovery.t_s, seen)
    truth = partial(ways, motion.t_s, [other for _, other in pairs])
    return _Signals(by, answer, truth, 0.7, False)  # the answer of a poor camera is noisy


def shared_places(recovery: Recovery, motion: MocapMotion) -> list[tuple[FloatArray, FloatArray]]:
    """Places that answer and mocap have, each at its own times: joints, and the IMU with its plate."""
    names = [name for name in motion.joints if name in recovery.joints]
    pairs = [(recovery.joints[name], motion.joints[name]) for name in names]
    return pairs if motion.p_E_P is None else [*pairs, (recovery.position, motion.p_E_P)]


def turns_rad(t_known: FloatArray, quaternion: FloatArray, t: FloatArray) -> FloatArray:
    """Rotation vectors (N, 3) rad from t - step/2 to t + step/2, in the body's axes; nan where unknown."""
    before = orientation_at(t_known, quaternion, t - 0.5 * STEP_S)
    after = orientation_at(t_known, quaternion, t + 0.5 * STEP_S)
    known = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    result = np.full((len(t), 3), np.nan)
    first, last = (Rotation.from_quat(each[known], scalar_first=True) for each in (before, after))
    result[known] = (first.inv() * last).as_rotvec()
    return result


def way_m(t_known: FloatArray, position: FloatArray, t: FloatArray) -> FloatArray:
    """Length (N,) m of the way from t - step/2 to t + step/2; nan where unknown."""
    before = position_at(t_known, position, t - 0.5 * STEP_S)
    return np.asarray(np.linalg.norm(position_at(t_known, position, t + 0.5 * STEP_S) - before, axis=1))


def _coarse(
    signals: _Signals, t_answer: FloatArray, t_truth: FloatArray, least_s: float
) -> tuple[float, float, list[float]]:
    """Offset on the grid, s, its correlation, and other offsets that do nearly as well."""
    grids = [np.arange(t[0], t[-1], 1.0 / GRID_HZ) for t in (t_answer, t_truth)]
    a, b = (
        signals.speed(read(grid)) for read, grid in zip((signals.answer, signals.truth), grids, strict=True)
    )
    r, count = masked_correlation(a, b, least_variance=1e-3)
    score = np.where(
        count >= least_s * GRID_HZ, np.arctanh(np.clip(r, -0.9999, 0.9999)) * np.sqrt(count), -np.inf
    )
    if not np.isfinite(score).any():
        return 0.0, float("nan"), []
    lags = (np.arange(len(r)) - (len(b) - 1)) / GRID_HZ + grids[0][0] - grids[1][0]
    best = int(np.argmax(score))
    peaks = np.flatnonzero((score[1:-1] >= score[:-2]) & (score[1:-1] > score[2:])) + 1
    rivals = [
        float(lags[k]) for k in peaks if abs(lags[k] - lags[best]) > 0.5 and score[k] > RIVAL * score[best]
    ]
    return float(lags[best]), float(r[best]), rivals[:3]


def _refine(
    signals: _Signals, t_answer: FloatArray, t_truth: FloatArray, lag: float, correlation: float
) -> MocapClock:
    """Least squares with Cauchy's loss over offset, skew and how the plate's turns show in the IMU."""
    t = t_answer[:: max(1, int(0.02 / max(np.median(np.diff(t_answer)), 1e-6)))]
    measured = signals.answer(t)
    inside = (t - lag >= t_truth[0]) & (t - lag <= t_truth[-1]) & np.isfinite(measured).any(axis=1)
    t, measured = t[inside], measured[inside]
    centre = float(np.mean(t - lag))  # on the mocap's clock: offset and skew hang together least there
    offset, skew = lag, 0.0
    mount = signals.mount
    solves_mount = signals.is_turns and mount is None
    if solves_mount:  # Kabsch without centring
        plate = signals.truth(t - lag)
        good = np.isfinite(measured).all(axis=1) & np.isfinite(plate).all(axis=1)
        mount = nearest_rotation(measured[good].T @ plate[good])

    def mounted(values: FloatArray) -> FloatArray:
        return values if mount is None else values @ mount.T

    size = 2 if mount is None else 11
    information, gradient_covariance = np.eye(size), np.eye(size)
    for _ in range(12):
        at = centre + (t - offset - centre) / (1.0 + skew)
        model, ahead, behind = (signals.truth(at + shift) for shift in (0.0, 0.004, -0.004))
        rate = (ahead - behind) / 0.008
        residual = measured - mounted(model)
        good = np.isfinite(residual) & np.isfinite(rate)
        by_offset = np.where(good, mounted(rate), 0.0)
        columns = [by_offset, by_offset * (at - centre)[:, None]]
        if mount is not None:
            turned = np.where(good, mounted(model), 0.0)
            columns += [-np.eye(3)[i] * turned[:, j, None] for i in range(3) for j in range(3)]
        residual = np.where(good, residual, 0.0)
        spread = float(robust_sigma(residual[good])) if good.any() else 1.0
        weight = good / (1.0 + (residual / max(spread, 1e-9)) ** 2)
        # the derivative of the residual is + rate by the offset, - turned_j in row i by entry ij of a
        # matrix that is put before the mount
        design = np.stack(columns, axis=2)
        information = np.einsum("nd,ndi,ndj->ij", weight, design, design)
        gradient = np.einsum("ndi,nd->ni", design, weight * residual)
        variance = float((weight * residual**2).sum() / max(weight.sum(), 1.0))
        information[1, 1] += max(variance, 1e-18) / SKEW_SIGMA**2
        pull = gradient.sum(axis=0)
        pull[1] += max(variance, 1e-18) / SKEW_SIGMA**2 * skew
        step = -np.linalg.solve(information + 1e-15 * np.trace(information) * np.eye(size), pull)
        offset += float(np.clip(step[0], -0.1, 0.1))
        skew += float(step[1])
        if mount is not None:
            mount = (np.eye(3) + step[2:].reshape(3, 3)) @ mount
        gradient_covariance = summed_covariance(t - t[0], gradient)
        if abs(step[0]) < 1e-8 and abs(step[1]) < 1e-9:
            break
    inverse = np.linalg.pinv(information)
    covariance = inverse @ gradient_covariance @ inverse
    to_zero = np.array([1.0, -centre])  # the offset at the mocap's zero
    sigma = float(np.sqrt(max(to_zero @ covariance[:2, :2] @ to_zero, 0.0)))
    return MocapClock(
        offset_s=offset - skew * centre,
        sigma_s=sigma,
        skew=skew,
        skew_sigma=float(np.sqrt(max(covariance[1, 1], 0.0))),
        correlation=correlation,
        by=signals.by,
        R_A_P=nearest_rotation(mount) if solves_mount and mount is not None else None,
        mount_sigma_rad=_turn_sigma(covariance[2:, 2:]) if solves_mount else float("nan"),
    )


def _turn_sigma(covariance: FloatArray) -> float:
    """Sigma of the turn, rad, of a matrix near one whose entries have this covariance (9, 9)."""
    turn = np.zeros((3, 9))
    for axis, (i, j) in enumerate(((2, 1), (0, 2), (1, 0))):
        turn[axis, 3 * i + j], turn[axis, 3 * j + i] = 0.5, -0.5
    return float(np.sqrt(max(np.trace(turn @ covariance @ turn.T), 0.0)))


def summed_covariance(t: FloatArray, gradient: FloatArray) -> FloatArray:
    """Covariance (d, d) of the summed gradient (n, d), its sums over each second taken as independent."""
    _, second = np.unique(np.floor(t / INDEPENDENT_S), return_inverse=True)
    sums = np.zeros((second.max() + 1, gradient.shape[1]))
    np.add.at(sums, second, gradient)
    return np.asarray(sums.T @ sums)


#: `R_K_C`: optical axes to those of a recording. `zup` is taken as ROS has it: x forward, y left, z up.
FROM_OPTICAL = {
    CameraFrame.OPTICAL: np.eye(3),
    CameraFrame.KINECT: np.diag([-1.0, -1.0, 1.0]),
    CameraFrame.ZUP: np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
}
TABLE = "camera_from_mocap"
#: The joint centres must spread this far in two directions, m (rms), for a transform to be solved.
LEAST_SPREAD_M = 0.02


@dataclass(frozen=True)
class CameraFromMocap:
    """The transform, p_K = R_K_E p_E + t_K_E, in the recording's own camera axes."""

    R_K_E: FloatArray  # (3, 3) and (3,) m: rotation and translation
    t_K_E: FloatArray
    by: str  # What it was taken from
    rotation_sigma_deg: float = float("nan")  # Square root of the covariance's trace
    translation_sigma_m: float = float("nan")  # Likewise, of the place where the arm was
    residual_m: float = float("nan")  # Rms distance of the joint centres that it was solved from

    def place(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) of {E} in {K}, m."""
        return np.asarray(points @ self.R_K_E.T + self.t_K_E)


def stated_frame(table: Any, frame: CameraFrame | None, source: str) -> CameraFromMocap:
    """The transform of a calibration's table `camera_from_mocap`, in the axes of a recording."""
    if not isinstance(table, dict):
        raise CalibrationError(
            f"{source} has no [{TABLE}]; make it with `unocclude calibrate panel`, or leave --calibration out"
            " to align the truth by the motion"
        )
    rotation, translation = numbers(table.get("rotation"), 4), numbers(table.get("translation"), 3)
    if rotation is None or translation is None:
        raise CalibrationError(f"{source}: {TABLE} needs rotation (4 numbers) and translation (3 numbers)")
    if abs(np.linalg.norm(rotation) - 1) > 1e-3:
        raise CalibrationError(f"{source}: {TABLE}.rotation must be a unit quaternion [qw, qx, qy, qz]")
    if frame is None:
        raise CalibrationError(
            f"the axes of the recording's camera are unknown, so [{TABLE}] of {source} cannot be used;"
            " leave --calibration out to align the truth by the motion"
        )
    R_K_C = FROM_OPTICAL[frame]
    R_C_E = Rotation.from_quat(rotation, scalar_first=True).as_matrix()
    return CameraFromMocap(R_K_C @ R_C_E, R_K_C @ translation, f"[{TABLE}] of {source}")


def solve_frame(recovery: Recovery, motion: MocapMotion, clock: MocapClock) -> CameraFromMocap:
    """The transform from joint centres, and the IMU, while the camera saw the forearm; robust."""
    rows = np.flatnonzero(~recovery.occluded)
    t = clock.to_mocap(recovery.t_s[rows])
    unknown = np.full((len(recovery), 3, 3), np.nan)
    points = [
        (recovery.joints[name], position, recovery.joint_covariance.get(name, unknown))
        for name, position in motion.joints.items()
        if name in recovery.joints
    ]
    imu = imu_in_mocap(motion)
    if imu is not None:
        points.append((recovery.position, imu, recovery.pose_covariance[:, :3, :3]))
    if not points:
        raise RecordingError(f"{motion.source}: it shares no joint with the answer, so it cannot be aligned")
    K = np.concatenate([answer[rows] for answer, _, _ in points])
    E = np.concatenate([position_at(motion.t_s, position, t) for _, position, _ in points])
    owner = np.repeat(np.arange(len(points)), len(rows))
    t_imu = np.tile(recovery.t_s[rows], len(points))
    good = np.isfinite(K).all(axis=1) & np.isfinite(E).all(axis=1)
    K, E, owner, t_imu = K[good], E[good], owner[good], t_imu[good]
    if len(K) < 10:
        raise RecordingError(
            f"{motion.source}: truth and visible answer share {len(K)} samples, too few to align them by;"
            " give --calibration with [camera_from_mocap]"
        )
    spread = np.linalg.svd(E - E.mean(axis=0), compute_uv=False) / np.sqrt(len(E))
    if spread[1] < LEAST_SPREAD_M:
        raise RecordingError(
            f"{motion.source}: what the camera saw of the joint centres lies on a line, which leaves the"
            " rotation about it undetermined; map more joints, or give --calibration with"
            " [camera_from_mocap]"
        )
    # mean variances per axis while seen; zero where none is stated
    stated = [np.trace(covariance[rows], axis1=1, axis2=2) / 3.0 for _, _, covariance in points]
    typical = [np.nanmedian(each) if np.isfinite(each).any() else 0.0 for each in stated]
    return _robust_transform(K, E, t_imu, owner, np.array(typical))


def _robust_transform(
    K: FloatArray, E: FloatArray, t_imu: FloatArray, owner: IntArray, variance: FloatArray
) -> CameraFromMocap:
    """The transform from pairs of points (n, 3): nearest rotation, Cauchy weights."""
    weight = np.ones(len(K))
    for _ in range(20):
        centre_K, centre_E = np.average(K, axis=0, weights=weight), np.average(E, axis=0, weights=weight)
        R = nearest_rotation((weight[:, None] * (K - centre_K)).T @ (E - centre_E))
        residual = K - centre_K - (E - centre_E) @ R.T
        size = np.linalg.norm(residual, axis=1)
        fresh = 1.0 / (1.0 + (size / max(2.0 * np.median(size), 1e-9)) ** 2)
        if np.abs(fresh - weight).max() < 1e-6:
            break
        weight = fresh
    # by the rotation (about the centre) and the translation of the centre
    turned = (E - centre_E) @ R.T
    design = np.zeros((len(K), 3, 6))
    for axis in range(3):
        design[:, :, axis] = np.cross(np.eye(3)[axis], turned)
        design[:, axis, 3 + axis] = 1.0
    information = np.einsum("n,ndi,ndj->ij", weight, design, design)
    gradient = np.einsum("n,ndi,nd->ni", weight, design, residual)
    inverse = np.linalg.inv(information)
    covariance = inverse @ summed_covariance(t_imu, gradient) @ inverse
    for point, each in enumerate(variance):
        gain = inverse @ np.einsum("n,ndi->id", weight * (owner == point), design)
        covariance += each * gain @ gain.T
    shared = 3.0 * float(np.average(variance[owner], weights=weight))
    return CameraFromMocap(
        R,
        centre_K - R @ centre_E,
        "the joint centres while the camera saw them",
        float(np.degrees(np.sqrt(np.trace(covariance[:3, :3])))),
        float(np.sqrt(np.trace(covariance[3:, 3:]) + shared)),
        float(np.sqrt(np.average(size**2, weights=weight))),
    )


def imu_in_mocap(motion: MocapMotion) -> FloatArray | None:
    """The IMU (N, 3) m in {E}; None without a plate, or where its place on the plate is not known."""
    if motion.p_E_P is None or motion.R_E_P is None or motion.p_A_P is None:
        return None
    if not motion.p_A_P.any():
        return motion.p_E_P
    if motion.R_A_P is None:
        return None
    return np.asarray(motion.p_E_P - np.einsum("nij,j->ni", motion.R_E_P, motion.R_A_P.T @ motion.p_A_P))


def far_off_m(recovery: Recovery, motion: MocapMotion, clock: MocapClock, frame: CameraFromMocap) -> float:
    """Median distance, m, of the truth's joint centres from the visible answer's; nan without any."""
    rows = np.flatnonzero(~recovery.occluded)
    t = clock.to_mocap(recovery.t_s[rows])
    away = [
        np.linalg.norm(mine[rows] - position_at(motion.t_s, frame.place(other), t), axis=1)
        for mine, other in shared_places(recovery, motion)
    ]
    known = np.concatenate(away or [np.empty(0)])
    return float(np.nanmedian(known)) if np.isfinite(known).any() else float("nan")


def solve_plate_place(
    recovery: Recovery, motion: MocapMotion, clock: MocapClock, frame: CameraFromMocap
) -> FloatArray:
    """The plate's origin in the IMU's axes, `p_A_P` (3,) m, from the answer while the camera saw the arm."""
    assert motion.R_A_P is not None and motion.p_E_P is not None
    rows = np.flatnonzero(~recovery.occluded)
    t = clock.to_mocap(recovery.t_s[rows])
    quaternion = orientation_at(motion.t_s, motion.quaternion, t)
    plate = frame.place(position_at(motion.t_s, motion.p_E_P, t))
    away = recovery.position[rows] - plate
    good = np.isfinite(away).all(axis=1) & np.isfinite(quaternion).all(axis=1)
    if good.sum() < 10:
        raise RecordingError(
            f"{motion.source}: plate and visible answer share too few samples to find the IMU on the plate;"
            " give the markers' positions in the IMU's axes in the map, [imu_plate]"
        )
    R_K_P = frame.R_K_E @ Rotation.from_quat(quaternion[good], scalar_first=True).as_matrix()
    in_plate = np.median(np.einsum("nji,nj->ni", R_K_P, away[good]), axis=0)
    return np.asarray(-motion.R_A_P @ in_plate)
