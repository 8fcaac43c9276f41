"""Camera samples that call themselves tracked and are not to be believed: found, set aside, reason kept.

By what the camera alone says (frozen, jump, bone length), by what the inertial attitude says (Jatesiktat
and Ang 2017, II-J: direction, viewing ray, strap), and by what a first solution leaves (residual).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from ..recording import JOINTS, BoolArray, FloatArray
from ..selfcal.camera_noise import JointNoise
from .alignment import Alignment
from .segment import Piece

FROZEN = "frozen: the value stands still while the sensor moves"
JUMP = "jump: far from its neighbours in time"
BONE = "bone length: elbow and wrist are too near or too far"
DIRECTION = "direction: forearm more than 30 degrees off the inertial one"
RAY = "viewing ray: the forearm points at the camera and is misjudged"
STRAP = "strap: off the elbow-wrist line or nearer the elbow"
RESIDUAL = "residual: does not agree with the recovered motion"
#: All of them by their code (`Piece.reason`); nothing was wrong with 0.
REASONS = ("", FROZEN, JUMP, BONE, DIRECTION, RAY, STRAP, RESIDUAL)

#: A value that repeats exactly so often is frozen, if the sensor turns or is moved meanwhile.
FROZEN_REPEATS = 2
FROZEN_RATE = 0.15
FROZEN_FORCE = 0.5
#: Farther than this from the median of seven neighbours is a jump, m.
JUMP_M = 0.15
JUMP_FRAMES = 7
BONE_PART = 0.30
DIRECTION_DEG = 30.0
RAY_DEG = 15.0
RAY_BONE_PART = 0.15
RAY_DIRECTION_DEG = 15.0
STRAP_M = 0.05
#: A residual longer than this (m, and in deviations of a sample) is set aside.
RESIDUAL_M = 0.05
RESIDUAL_SIGMAS = 5.0

ELBOW, WRIST, HAND, STRAP_COLUMN = (JOINTS.index(joint) for joint in ("elbow", "wrist", "hand", "strap"))
_FOREARM = [ELBOW, WRIST, HAND]


def by_camera(piece: Piece) -> Piece:
    """Set aside what the camera's samples show by themselves."""
    for column in range(len(JOINTS)):
        piece = _set_aside(piece, _only(_frozen(piece, column), column), FROZEN)
    for column in range(len(JOINTS)):
        piece = _set_aside(piece, _only(_jumps(piece, column), column), JUMP)
    both = piece.accepted[:, ELBOW] & piece.accepted[:, WRIST]
    if both.sum() >= 10:
        length = np.linalg.norm(piece.position[:, WRIST] - piece.position[:, ELBOW], axis=1)
        usual = float(np.median(length[both]))
        wrong = both & (np.abs(length - usual) > BONE_PART * usual)
        piece = _set_aside(piece, _only(wrong, ELBOW, WRIST), BONE)
    strap = both & piece.accepted[:, STRAP_COLUMN]
    return _set_aside(piece, _only(strap & _strap_off(piece), STRAP_COLUMN), STRAP)


def by_attitude(piece: Piece, frame_t: FloatArray, alignment: Alignment, along_A: FloatArray) -> Piece:
    """Set aside frames whose forearm does not point where the inertial attitude says.

    Parameters
    ----------
    frame_t : (f,) frames on the IMU's clock, s.
    along_A : (3,) unit vector elbow to wrist in {A}.
    """
    both = piece.accepted[:, ELBOW] & piece.accepted[:, WRIST]
    if not both.any():
        return piece
    inertial = (alignment.at(frame_t) * piece.attitude.at(frame_t)).apply(along_A)
    seen = _unit(piece.position[:, WRIST] - piece.position[:, ELBOW])
    ray = _unit(piece.position[:, WRIST] + piece.position[:, ELBOW])
    off = both & (np.sum(seen * inertial, axis=1) < np.cos(np.radians(DIRECTION_DEG)))
    piece = _set_aside(piece, _only(off, *_FOREARM), DIRECTION)
    # a forearm that points at the camera is no reason by itself: it must also look wrong
    pointing = both & (np.abs(np.sum(ray * inertial, axis=1)) > np.cos(np.radians(RAY_DEG)))
    length = np.linalg.norm(piece.position[:, WRIST] - piece.position[:, ELBOW], axis=1)
    usual = float(np.median(length[both]))
    short = np.abs(length - usual) > RAY_BONE_PART * usual
    turned = np.sum(seen * inertial, axis=1) < np.cos(np.radians(RAY_DIRECTION_DEG))
    pointing &= short | turned
    return _set_aside(piece, _only(pointing, *_FOREARM), RAY)


def by_residual(piece: Piece, residual: FloatArray, noise: dict[str, JointNoise]) -> Piece:
    """Set aside samples far from a first solution.

    Parameters
    ----------
    residual : (f, 5, 3) camera minus answer, m; nan where there is none.
    noise : of the joints, from `residuals.joint_noise`.
    """
    length = np.linalg.norm(residual, axis=2)
    limit = np.array(
        [
            max(RESIDUAL_M, RESIDUAL_SIGMAS * noise[joint].sample_m) if joint in noise else np.inf
            for joint in JOINTS
        ]
    )
    with np.errstate(invalid="ignore"):
        return _set_aside(piece, length > limit, RESIDUAL)


def _set_aside(piece: Piece, wrong: BoolArray, why: str) -> Piece:
    """The piece without the wrong samples (f, 5), the reason kept for those that were accepted."""
    wrong = wrong & piece.accepted
    if not wrong.any():
        return piece
    reason = np.where(wrong, np.uint8(REASONS.index(why)), piece.reason)
    return replace(piece, accepted=piece.accepted & ~wrong, reason=reason)


def _only(frames: BoolArray, *columns: int) -> BoolArray:
    wrong = np.zeros((len(frames), len(JOINTS)), dtype=bool)
    for column in columns:
        wrong[:, column] = frames
    return wrong


def _unit(v: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        return v / np.linalg.norm(v, axis=1)[:, None]


def _frozen(piece: Piece, column: int) -> BoolArray:
    """Frames that repeat the one before, in runs of repeats during which the sensor moved."""
    x, accepted = piece.position[:, column], piece.accepted[:, column]
    same = np.zeros(len(x), dtype=bool)
    same[1:] = accepted[1:] & accepted[:-1] & (x[1:] == x[:-1]).all(axis=1)
    frozen = np.zeros(len(x), dtype=bool)
    edges = np.flatnonzero(np.diff(np.concatenate(([0], same.view(np.int8), [0]))))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        if b - a >= FROZEN_REPEATS and _moved(piece, piece.frame_t[a - 1], piece.frame_t[b - 1]):
            frozen[a:b] = True
    return frozen


def _moved(piece: Piece, start_s: float, end_s: float) -> bool:
    """Whether the sensor turned or was moved between two times."""
    edges = np.linspace(start_s, max(end_s, start_s + 0.05), 12)
    rate = piece.signal.mean(edges[:-1], edges[1:])
    turning = float(np.linalg.norm(rate[:, 3:] - piece.attitude.gyroscope_bias, axis=1).max())
    return turning > FROZEN_RATE or float(np.ptp(np.linalg.norm(rate[:, :3], axis=1))) > FROZEN_FORCE


def _jumps(piece: Piece, column: int) -> BoolArray:
    """Samples far from the running median of the accepted ones, near in time."""
    rows = np.flatnonzero(piece.accepted[:, column])
    wrong = np.zeros(len(piece.accepted), dtype=bool)
    if len(rows) < JUMP_FRAMES:
        return wrong
    x = piece.position[rows, column]
    middle = median_filter(x, size=(JUMP_FRAMES, 1), mode="nearest")
    half = JUMP_FRAMES // 2
    t = piece.frame_t[rows]
    spread = np.full(len(rows), np.inf)
    spread[half:-half] = t[2 * half :] - t[: -2 * half]
    usual = float(np.median(np.diff(t))) * (JUMP_FRAMES - 1)
    wrong[rows] = (np.linalg.norm(x - middle, axis=1) > JUMP_M) & (spread < 1.7 * usual)
    return wrong


def _strap_off(piece: Piece) -> BoolArray:
    """Strap more than 5 cm off the elbow-wrist line, or nearer the elbow."""
    elbow, wrist, strap = (piece.position[:, column] for column in (ELBOW, WRIST, STRAP_COLUMN))
    along = _unit(wrist - elbow)
    at = np.sum((strap - elbow) * along, axis=1)
    distance = np.linalg.norm(strap - elbow - at[:, None] * along, axis=1)
    nearer_elbow = at < 0.5 * np.linalg.norm(wrist - elbow, axis=1)
    return (distance > STRAP_M) | nearer_elbow
