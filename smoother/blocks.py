"""Which parts of a recording its self-calibration looks at: those that tell most, spread over the whole."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import TypeVar

import numpy as np

from .clock import LARGEST_OFFSET_S
from .occlusion import enough_joints, joints_needed
from .pieces import Piece, make_piece, take_apart, traits_of
from .recording import FloatArray, JointState, Recording
from .timing import split_at_pauses, steady

#: Blocks that the calibration looks at: so long each, and so much in all, s.
BLOCK_S = 20.0
BLOCKS_S = 80.0
#: The inertial filter runs over so much more on both sides of a block, s.
CONTEXT_S = 12.0
#: Turning is judged over so long, s.
TURN_S = 0.1

Block = TypeVar("Block")


def blocks_of(recording: Recording) -> list[Piece]:
    """The blocks of a recording as pieces; all of it where it is short.

    Of a long recording only the blocks are read (and what the inertial filter needs around them).
    """
    parts = split_at_pauses(recording.imu)
    t = recording.imu.t_s
    if sum(t[part.stop - 1] - t[part.start] for part in parts) <= 1.5 * BLOCKS_S:
        return take_apart(recording, LARGEST_OFFSET_S)
    needed = joints_needed(recording.arm)
    seen_t = recording.arm.t_s[enough_joints(recording.arm.state == JointState.TRACKED, needed)]
    blocks = [(part, a, b) for part in parts for a, b in _even(float(t[part.start]), float(t[part.stop - 1]))]

    def worth(block: tuple[slice, float, float]) -> float:
        _, a, b = block
        rows = slice(*np.searchsorted(t, [a, b]).tolist())
        inside = seen_t[slice(*np.searchsorted(seen_t, [a, b]).tolist())]
        return _worth(inside, _turning(t[rows], recording.imu.gyro[rows]))

    pieces = [_load(recording, *block) for block in _best(blocks, worth)]
    return [piece for piece in pieces if piece is not None]


def _load(recording: Recording, part: slice, start_s: float, end_s: float) -> Piece | None:
    """The piece that looks at one block of the samples `part`."""
    t = recording.imu.t_s[part]
    first, last = np.searchsorted(t, [start_s - CONTEXT_S, end_s + CONTEXT_S])
    samples = slice(part.start + int(first), part.start + int(last))
    imu = recording.imu.select(samples)
    reach = LARGEST_OFFSET_S + CONTEXT_S
    rows = np.searchsorted(recording.arm.t_s, [start_s - reach, end_s + reach])
    frames = slice(int(rows[0]), int(rows[1]))
    piece = make_piece(imu, steady(imu.t_s), recording.arm.select(frames), frames, traits_of(recording))
    return None if piece is None else piece.between(start_s, end_s)


def choose_blocks(pieces: list[Piece]) -> list[Piece]:
    """Parts of pieces that tell most: forearm visible and turning, spread over the whole."""
    total = sum(piece.end_s - piece.start_s for piece in pieces)
    if total <= 1.5 * BLOCKS_S:
        return pieces
    blocks = [piece.between(a, b) for piece in pieces for a, b in _even(piece.start_s, piece.end_s)]
    return _best(blocks, _worth_of)


def _even(start_s: float, end_s: float) -> Iterator[tuple[float, float]]:
    """Blocks of equal length, from start to end."""
    return pairwise(np.linspace(start_s, end_s, max(round((end_s - start_s) / BLOCK_S), 1) + 1).tolist())


def _best(blocks: Sequence[Block], worth: Callable[[Block], float]) -> list[Block]:
    """Of as many parts of the whole as blocks are wanted the best block each."""
    wanted = max(int(BLOCKS_S / BLOCK_S), 1)
    groups = np.array_split(np.arange(len(blocks)), min(wanted, len(blocks)))
    worths = [worth(block) for block in blocks]
    return [blocks[max(group.tolist(), key=lambda k: worths[k])] for group in groups]


def _worth_of(piece: Piece) -> float:
    inside = (piece.frame_t >= piece.start_s) & (piece.frame_t <= piece.end_s)
    edges = np.arange(piece.start_s, piece.end_s, TURN_S)
    turning = np.linalg.norm(piece.signal.mean(edges[:-1], edges[1:])[:, 3:], axis=1)
    return _worth(piece.frame_t[enough_joints(piece.accepted, piece.needed) & inside], turning)


def _worth(seen_t: FloatArray, turning: FloatArray) -> float:
    """Visible time (s) times how much the sensor turns (rad/s, up to 1)."""
    if len(seen_t) < 3 or not len(turning):
        return 0.0
    return float(len(seen_t) * np.median(np.diff(seen_t)) * np.minimum(turning, 1.0).mean())


def _turning(t: FloatArray, gyro: FloatArray) -> FloatArray:
    """Size of the mean angular rate over each `TURN_S`, rad/s."""
    if not len(t):
        return np.zeros(0)
    start = np.flatnonzero(np.diff(np.floor((t - t[0]) / TURN_S), prepend=-1.0) > 0)
    mean = np.add.reduceat(np.asarray(gyro), start, axis=0) / np.diff(np.append(start, len(t)))[:, None]
    return np.linalg.norm(mean, axis=1)
