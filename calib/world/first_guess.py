"""First guess of camera from base IMU and of the panel's IMU on the panel: pairs of directions, in turn."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.linalg import nearest_rotation, unit

from .chain import Attitudes, WorldPose

#: Rounds of Wahba's problem for one and the other rotation.
_ROUNDS = 25
#: Answers nearer than this are one; so many are followed up.
_APART_RAD, _MOST = 0.3, 4
#: Mean square (rad^2 a pose) by which a guess may fit worse than the best and still lead to the answer.
_HOPELESS = 0.01
#: A turn between poses counts as a direction where it is larger than this, rad.
_TURN_RAD = 0.1
_DIP_RAD = 0.8


def first_guesses(poses: list[WorldPose], lined_up: bool) -> list[Attitudes]:
    """Start values, the likeliest first; the right one is good to some degrees.

    Gravity (and the magnetic field) is one direction seen in {B} and, through the panel, in {I}: given the
    mounting, Wahba's problem gives `R_K_B`; given that, another gives the mounting. In turn, from every way
    that an IMU can be lined up with a panel. Few poses may have several answers: all that differ are given.

    Parameters
    ----------
    lined_up : bool
        The panel's IMU was lined up with the panel's axes, so that only that start is tried.

    Returns
    -------
    list of Attitudes
    """
    pairs = _Pairs(poses)
    if lined_up:
        return [_attitudes(poses, pairs, np.eye(3))]
    starts = Rotation.create_group("O").as_matrix()
    tried = sorted((pairs.in_turn(R_P_I, _ROUNDS) for R_P_I in starts), key=lambda item: item[0])
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
