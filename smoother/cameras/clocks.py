"""Two cameras' clocks against each other, by what is the same from everywhere: speeds and distances."""

from __future__ import annotations

import numpy as np

from ..array_types import FloatArray
from ..linalg import masked_correlation, peaks
from ..recording import JOINTS, JointTracks

#: Signals are compared on this grid, s, and smoothed over this time, s.
STEP_S, SMOOTH_S = 0.04, 0.12
#: Frames farther apart than this leave a hole in a signal, s.
HOLE_S = 0.12
#: Shifts that leave less in common are not looked at: s, and as a share of the shorter signal.
LEAST_S, LEAST_SHARE = 8.0, 0.3
#: So much of a long recording is read, s.
READ_S = 1200.0
#: This many offsets are tried.
CANDIDATES = 6


def candidate_offsets(first: JointTracks, other: JointTracks) -> list[float]:
    """Offsets (first camera's clock less the other's) that the motion allows, the likeliest first."""
    start, signals = _signals(first)
    other_start, other_signals = _signals(other)
    total, weight = None, None
    for mine, theirs in zip(signals, other_signals, strict=True):
        if not np.isfinite(mine).any() or not np.isfinite(theirs).any():
            continue
        correlation, count = masked_correlation(mine, theirs, 1e-4)
        total = correlation * count if total is None else total + correlation * count
        weight = count if weight is None else weight + count
    if total is None or weight is None:
        return [0.0]
    signal = np.isfinite(signals).any(axis=0).sum(), np.isfinite(other_signals).any(axis=0).sum()
    needed = max(LEAST_S / STEP_S, LEAST_SHARE * min(signal)) * len(signals) * 0.5
    score = np.where(weight >= needed, total / np.maximum(weight, 1.0), 0.0)
    best = peaks(score, 0.2, round(0.3 / STEP_S), CANDIDATES)
    shifts = (best - (len(other_signals[0]) - 1)) * STEP_S + start - other_start
    ordered = [float(shift) for shift in shifts[np.argsort(-score[best], kind="stable")]]
    return [*ordered, 0.0] if all(abs(shift) > 0.5 * STEP_S for shift in ordered) else ordered


def _signals(arm: JointTracks) -> tuple[float, FloatArray]:
    """Start, s, and signals (3, n) on an even grid, nan where the camera saw too little."""
    t = np.asarray(arm.t_s)
    if len(t) < 3:
        return 0.0, np.full((3, 1), np.nan)
    inside = t <= t[0] + READ_S
    t = t[inside]
    grid = np.arange(t[0], t[-1], STEP_S)
    at = {joint: _on_grid(arm, joint, t, grid) for joint in ("shoulder", "elbow", "wrist")}
    reach = np.linalg.norm(at["wrist"] - at["shoulder"], axis=1)
    speeds = [np.linalg.norm(np.gradient(at[joint], STEP_S, axis=0), axis=1) for joint in ("elbow", "wrist")]
    if len(grid) < 3:
        return float(t[0]), np.full((3, max(len(grid), 1)), np.nan)
    return float(t[0]), np.stack([reach, *speeds])


def _on_grid(arm: JointTracks, joint: str, t: FloatArray, grid: FloatArray) -> FloatArray:
    """A joint's smoothed positions (n, 3) on the grid; nan in holes."""
    seen = arm.tracked(joint)[: len(t)]
    if seen.sum() < 3:
        return np.full((len(grid), 3), np.nan)
    known_t = t[seen]
    position = np.asarray(arm.position[: len(t), JOINTS.index(joint)])[seen]
    smooth = np.stack([np.interp(grid, known_t, position[:, k]) for k in range(3)], axis=1)
    width = max(round(SMOOTH_S / STEP_S), 1)
    kernel = np.ones(width) / width
    smooth = np.stack([np.convolve(smooth[:, k], kernel, "same") for k in range(3)], axis=1)
    after = np.clip(np.searchsorted(known_t, grid), 1, len(known_t) - 1)
    hole = known_t[after] - known_t[after - 1] > HOLE_S
    edge = (grid < known_t[0] + SMOOTH_S) | (grid > known_t[-1] - SMOOTH_S)
    smooth[hole | edge] = np.nan
    return smooth
