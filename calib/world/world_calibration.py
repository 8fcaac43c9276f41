"""Camera from base IMU from poses of the panel (JA II-F.2, many poses): first guess, fit, and the method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import nearest_rotation, skew, unit
from smoother.recording import ImuStream

from .chain import BIAS_M_S2, Attitudes, Problem, WorldPose, rest_at, turn_between

#: Rounds of Wahba's problem for one and the other rotation.
_GUESS_ROUNDS = 25
#: Answers nearer than this are one; this many are followed up.
_APART_RAD, _MOST = 0.3, 4
#: Mean square (rad^2 per pose) by which a guess may fit worse than the best and still lead to the answer.
_HOPELESS = 0.01
#: A turn between poses is treated as a direction where it is larger than this, rad.
_TURN_RAD = 0.1
_DIP_RAD = 0.8


def first_guesses(poses: list[WorldPose], lined_up: bool) -> list[Attitudes]:
    """Start values, the likeliest first; the right one is good to some degrees."""
    pairs = _Pairs(poses)
    if lined_up:
        return [_attitudes(poses, pairs, np.eye(3))]
    starts = Rotation.create_group("O").as_matrix()
    tried = sorted((pairs.in_turn(R_P_I, _GUESS_ROUNDS) for R_P_I in starts), key=lambda item: item[0])
    chosen: list[FloatArray] = []
    for loss, R_P_I in tried:
        if loss > tried[0][0] + _HOPELESS * len(poses):
            break
        apart = [Rotation.from_matrix(R_P_I.T @ other).magnitude() for other in chosen]
        if not apart or min(apart) > _APART_RAD:
            chosen.append(R_P_I)
    return [_attitudes(poses, pairs, R_P_I) for R_P_I in chosen[:_MOST]]


def _attitudes(poses: list[WorldPose], pairs: _Pairs, R_P_I: FloatArray) -> Attitudes:
    R_K_B = Rotation.from_matrix(pairs.camera_from_base(R_P_I)[0])
    R_W_B = _world_from_base(poses)
    on_panel = Rotation.from_matrix(pairs.R_K_P @ R_P_I)
    rest = np.r_[np.zeros(12), _DIP_RAD, _DIP_RAD]
    return Attitudes(R_K_B, Rotation.from_matrix(R_P_I), R_W_B, R_W_B * R_K_B.inv() * on_panel, rest)


class _Pairs:
    """Directions that both IMUs know: up, the field, and the axes of the camera's own turns."""

    def __init__(self, poses: list[WorldPose]):
        self.R_K_P = np.array([pose.R_K_P for pose in poses])
        base, panel = [[p.base.acc for p in poses]], [[p.panel.acc for p in poses]]
        if all(pose.has_north for pose in poses):
            base.append([np.asarray(pose.base.mag) for pose in poses])
            panel.append([np.asarray(pose.panel.mag) for pose in poses])
        # (kinds, n, 3) unit vectors
        self._in_B, self._in_I = unit(np.array(base)), unit(np.array(panel))
        linked = [
            i for i, p in enumerate(poses) if i and p.base_turn is not None and p.panel_turn is not None
        ]
        self._linked = np.array(linked, dtype=int)
        turns = [(poses[i].base_turn, poses[i].panel_turn) for i in linked]
        self._turn_B = np.array([b.R for b, _ in turns if b is not None]).reshape(-1, 3, 3)
        self._turn_I = np.array([i.R for _, i in turns if i is not None]).reshape(-1, 3, 3)

    def in_turn(self, R_P_I: FloatArray, rounds: int) -> tuple[float, FloatArray]:
        """Improve the mounting; its loss, and the mounting."""
        R_K_B, loss = self.camera_from_base(R_P_I)
        for _ in range(rounds):
            in_P = np.einsum("nji,jk,mnk->mni", self.R_K_P, R_K_B, self._in_B)
            R_P_I, _ = _wahba(in_P.reshape(-1, 3), self._in_I.reshape(-1, 3))
            R_K_B, loss = self.camera_from_base(R_P_I)
        return loss, R_P_I

    def camera_from_base(self, R_P_I: FloatArray) -> tuple[FloatArray, float]:
        """`R_K_B` for a mounting, and the sum of squares that is left."""
        in_K = np.einsum("nij,jk,mnk->mni", self.R_K_P, R_P_I, self._in_I).reshape(-1, 3)
        in_B = self._in_B.reshape(-1, 3)
        if len(self._linked):
            # X D_B X' = Z_a Y D_I Y' Z_b': the camera's own turn, seen in {B} and in {K}
            turned = R_P_I @ self._turn_I @ R_P_I.T
            a, b = self.R_K_P[self._linked - 1], self.R_K_P[self._linked]
            of_K = Rotation.from_matrix(a @ turned @ np.swapaxes(b, 1, 2)).as_rotvec()
            of_B = Rotation.from_matrix(self._turn_B).as_rotvec()
            far = np.minimum(np.linalg.norm(of_K, axis=1), np.linalg.norm(of_B, axis=1)) > _TURN_RAD
            in_K, in_B = np.vstack([in_K, unit(of_K[far])]), np.vstack([in_B, unit(of_B[far])])
        return _wahba(in_K, in_B)


def _wahba(target: FloatArray, source: FloatArray) -> tuple[FloatArray, float]:
    """The rotation (3, 3) that takes source directions (n, 3) nearest to target ones; the sum of squares."""
    M = target.T @ source
    R = nearest_rotation(M)
    return R, float(2 * (len(target) - np.sum(R * M)))


def _world_from_base(poses: list[WorldPose]) -> Rotation:
    """Level attitudes of the base IMU; north by its magnetometer, else the gyroscope's from pose to pose."""
    found: list[Rotation] = []
    for pose in poses:
        if pose.has_north:
            assert pose.base.mag is not None
            up = unit(pose.base.acc)
            east = unit(np.cross(pose.base.mag, up))  # field points north and down
            found.append(Rotation.from_matrix(np.stack([np.cross(up, east), -east, up])))
            continue
        up, level = unit(pose.base.acc), np.array([0.0, 0.0, 1.0])
        before = found[-1] if found else Rotation.identity()
        if found and pose.base_turn is not None:
            before = found[-1] * Rotation.from_matrix(pose.base_turn.R)
        tip = Rotation.align_vectors([level], [before.apply(up)])[0]
        found.append(tip * before)
    return Rotation.concatenate(found)


_ROUNDS = 60
#: A gain smaller than this share of the sum of squares ends the iteration.
_SMALL = 1e-8


@dataclass(frozen=True)
class WorldSolution:
    """Attitudes and how well they are known."""

    at: Attitudes  # The solution
    # (9, 9): Of `R_K_B` in {K} (rad), the base accelerometer's bias (m/s^2), `R_P_I` in {I} (rad)
    covariance: FloatArray
    camera_rad: FloatArray  # (n, 3) rad: what is left of `R_K_P`, in {K}
    worst_sigma: FloatArray  # (n,): the largest misfit of a pose in sigmas
    cost: float  # Sum of squares of all misfits


def solve(
    poses: list[WorldPose],
    start: Attitudes,
    mounting_sigma_rad: float | None,
    bias_m_s2: float = BIAS_M_S2,  # m/s^2
) -> WorldSolution:
    """Solve the chain over all poses, by Gauss and Newton with Levenberg's damping."""
    problem = Problem(poses, start, mounting_sigma_rad, bias_m_s2)
    at, damping = start, 1e-6
    misfit, jacobian = problem.linearise(at)
    for _ in range(_ROUNDS):
        normal = jacobian.T @ jacobian
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), jacobian.T @ misfit)
        trial = at.moved(np.asarray(step, dtype=np.float64))
        tried, slope = problem.linearise(trial)
        gain = float(misfit @ misfit - tried @ tried)
        if gain >= 0:
            at, misfit, jacobian, damping = trial, tried, slope, damping / 10
            if gain < _SMALL * (1 + tried @ tried):
                break
        else:
            damping = max(damping, 1e-8) * 10
    covariance = np.linalg.inv(jacobian.T @ jacobian) * problem.spread(misfit)
    bias = 6 + 6 * len(poses)
    kept = np.r_[0:3, bias : bias + 3, 3:6]
    by_pose = np.linalg.norm(misfit[: 9 * len(poses)].reshape(len(poses), 3, 3), axis=2)
    left, cost = problem.camera_left(at), float(misfit @ misfit)
    return WorldSolution(at, covariance[np.ix_(kept, kept)], left, by_pose.max(axis=1), cost)


#: An IMU that was lined up with the panel by eye is off by this, per axis.
BY_EYE_RAD = np.radians(3.0)
#: Poses whose residuals exceed this many sigmas contradict the others and are left out.
CONTRADICTS_SIGMA = 5.0
#: Another answer that costs less than this more is as likely (two degrees of freedom, 99 %).
AS_LIKELY = 9.2
#: This many poses must remain.
FEWEST = 3


@dataclass(frozen=True)
class WorldCalibration:
    """Camera from base IMU, and the data it is based on."""

    solution: WorldSolution  # Rotations with covariance
    poses: tuple[WorldPose, ...]  # Those that were used
    by_eye: bool  # The poses did not give the mounting of the panel's IMU: it was taken as lined up by eye
    notes: tuple[str, ...]  # What was left out, and why
    # The base IMU's accelerometer was corrected by a calibration of its own before
    accelerometer_corrected: bool = False

    @property
    def R_K_B(self) -> FloatArray:
        """(3, 3) base IMU axes to camera axes."""
        return np.asarray(self.solution.at.R_K_B.as_matrix())

    @property
    def R_P_I(self) -> FloatArray:
        """(3, 3) axes of the panel's IMU to panel axes."""
        return np.asarray(self.solution.at.R_P_I.as_matrix())


@dataclass(frozen=True)
class PanelView:
    """The panel in the camera in one pose."""

    name: str  # For messages
    t_s: float  # Time of the images on the IMUs' clock
    R_K_P: FloatArray  # (3, 3): panel axes to camera axes
    covariance: FloatArray  # (3, 3) rad^2: of its rotation vector in {K}


def world_poses(
    views: Sequence[PanelView], panel: Sequence[ImuStream], base: Sequence[ImuStream]
) -> tuple[list[WorldPose], list[str]]:
    """Each pose as measured by camera and IMUs; poses in which an IMU moves are left out, with a note."""
    poses: list[WorldPose] = []
    notes: list[str] = []
    last = -1
    for i, view in enumerate(views):
        try:
            on_panel = rest_at(panel[i], view.t_s, view.name, "on the panel")
            on_base = rest_at(base[i], view.t_s, view.name, "on the camera")
        except CalibrationError as error:
            notes.append(f"{error} The pose is left out.")
            continue
        pose = WorldPose(view.name, view.R_K_P, view.covariance, on_panel, on_base)
        if poses and panel[i] is panel[last] and base[i] is base[last]:
            pose = replace(
                pose,
                panel_turn=turn_between(panel[i], poses[-1].panel, on_panel),
                base_turn=turn_between(base[i], poses[-1].base, on_base),
            )
        poses.append(pose)
        last = i
    if not poses:
        raise CalibrationError(
            notes[0].removesuffix(" The pose is left out.") if notes else "There is no pose."
        )
    return poses, notes


def calibrate_world(
    poses: Sequence[WorldPose], notes: Sequence[str] = (), bias_m_s2: float = BIAS_M_S2
) -> WorldCalibration:
    """Find `R_K_B`, and how the panel's IMU sits on the panel."""
    kept, sentences = list(poses), list(notes)
    while True:
        solution, by_eye = _solve(kept, bias_m_s2)
        worst = int(np.argmax(solution.worst_sigma))
        if solution.worst_sigma[worst] < CONTRADICTS_SIGMA or len(kept) < 2:
            return WorldCalibration(solution, tuple(kept), by_eye, tuple(sentences))
        if len(kept) <= FEWEST:
            raise CalibrationError(
                f"The poses contradict each other ({kept[worst].name} by"
                f" {solution.worst_sigma[worst]:.0f} sigmas); check that each IMU is fixed to its body"
                " and uses the camera's clock, and record more poses."
            )
        sentences.append(
            f"{kept[worst].name} contradicts the other poses by {solution.worst_sigma[worst]:.0f} sigmas "
            "and is left out."
        )
        kept.pop(worst)
        # what followed it is no longer linked to what went before
        if worst < len(kept):
            kept[worst] = replace(kept[worst], panel_turn=None, base_turn=None)


def _solve(poses: list[WorldPose], bias_m_s2: float) -> tuple[WorldSolution, bool]:
    """The solution, and whether the mounting had to be taken as lined up by eye."""
    if len(poses) >= FEWEST:
        tried = [solve(poses, start, None, bias_m_s2) for start in first_guesses(poses, lined_up=False)]
        tried.sort(key=lambda solution: solution.cost)
        best = tried[0]
        known = np.sqrt(np.linalg.eigvalsh(best.covariance[6:, 6:])[-1]) < BY_EYE_RAD
        likely = [other for other in tried[1:] if other.cost < best.cost + AS_LIKELY]
        apart = [(best.at.R_P_I.inv() * other.at.R_P_I).magnitude() for other in likely]
        if known and max(apart, default=0.0) < BY_EYE_RAD:
            return best, False
    return solve(poses, first_guesses(poses, lined_up=True)[0], BY_EYE_RAD, bias_m_s2), True


def tilt_covariance(
    R_K_B: FloatArray,  # (3, 3)
    covariance: FloatArray,  # (6, 6)
    acc: FloatArray,  # (3,) m/s^2
) -> FloatArray:  # (3, 3) rad^2
    """Covariance (3, 3) of down in {K} (rad^2 across it) for a reading of the base accelerometer."""
    size = float(np.linalg.norm(acc))
    up = acc / size
    slope = np.hstack([-skew(R_K_B @ up), -R_K_B @ (np.eye(3) - np.outer(up, up)) / size])
    return np.asarray(slope @ covariance @ slope.T)


def rotation_degrees(R: FloatArray) -> float:
    """Angle of a rotation."""
    return float(np.degrees(Rotation.from_matrix(R).magnitude()))
