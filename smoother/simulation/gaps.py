"""Occlusions: which frames they cover, and how a skeleton tracker behaves in them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_closing, binary_opening

from ..array_types import BoolArray, FloatArray
from ..linalg import runs
from ..recording import FOREARM_JOINTS, JOINTS, JointState
from .camera import Footage, correlated_noise
from .config import ArmSimulation

_FOREARM = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
_ELBOW, _SHOULDER = JOINTS.index("elbow"), JOINTS.index("shoulder")


def debounce(hidden: BoolArray, rate_hz: float) -> BoolArray:
    """The mask (F,) without runs under 0.2 s, of either kind: no tracker loses or gets a limb so fast."""
    size = np.ones(max(round(0.2 * rate_hz), 1), dtype=bool)
    padded = np.pad(hidden, len(size))
    settled = binary_opening(binary_closing(padded, size), size)
    return np.asarray(settled[len(size) : -len(size)])


def random_gaps(
    t_s: FloatArray, lengths_s: tuple[float, ...], every_s: float, begin_s: float, rng: np.random.Generator
) -> BoolArray:
    """(F,) True in occlusions of the given lengths, one in about `every_s`, at least 2 s visible between."""
    hidden = np.zeros(len(t_s), dtype=bool)
    if not lengths_s or len(t_s) == 0:
        return hidden
    count = int(np.ceil(t_s[-1] / every_s)) + 1
    length = rng.choice(lengths_s, count)
    wait = np.maximum(every_s - length, 2.0) * rng.uniform(0.7, 1.3, count)
    begin = begin_s + np.cumsum(np.maximum(wait, 2.0) + np.concatenate([[0.0], length[:-1]]))
    inside = begin + length < t_s[-1] - 2.0  # never at the end: both sides of a gap are seen
    for a, b in zip(begin[inside], (begin + length)[inside], strict=True):
        hidden[(t_s >= a) & (t_s < b)] = True
    return hidden


def lose_forearm(
    footage: Footage, hidden: BoolArray, true: FloatArray, config: ArmSimulation, rng: np.random.Generator
) -> None:
    """Set the forearm's joints to the configured state in the hidden frames (F,); `true` as in `Footage`."""
    lag = rng.uniform(0, config.elbow_lag_s * config.frame_rate_hz, len(runs(hidden)) + 1).round().astype(int)
    lost = np.repeat(hidden[:, None], len(_FOREARM), axis=1)
    for gap, frames in zip(runs(hidden), lag, strict=False):
        # The lag never eats a gap up: a third of it is the most.
        lost[gap.start : gap.start + min(int(frames), (gap.stop - gap.start) // 3), 0] = False
    _set_state(footage, lost, true, JointState[config.occluded_state.upper()], config, rng)
    blind = hidden & (rng.uniform(size=len(hidden)) < config.shoulder_lost)
    footage.state[blind, _SHOULDER] = JointState.NOT_TRACKED


def degrade_before_trunk(
    footage: Footage,
    before_belly: BoolArray,
    true: FloatArray,
    config: ArmSimulation,
    rng: np.random.Generator,
) -> None:
    """Apply the configured state in the frames (F,) with the forearm before the belly."""
    lost = np.repeat(before_belly[:, None], len(_FOREARM), axis=1)
    _set_state(footage, lost, true, JointState[config.belly.upper()], config, rng)


def _set_state(
    footage: Footage,
    lost: BoolArray,
    true: FloatArray,
    state: JointState,
    config: ArmSimulation,
    rng: np.random.Generator,
) -> None:
    """Set the state of forearm joints where `lost` (F, 4); an inferred joint gets a wandering wrong guess."""
    if state is JointState.TRACKED:
        return
    guess = true[:, _FOREARM] + correlated_noise(
        len(lost), 3 * len(_FOREARM), config.inferred_error_m, 0.5, 1 / config.frame_rate_hz, rng
    ).reshape(len(lost), len(_FOREARM), 3)
    for column, joint in enumerate(_FOREARM):
        where = lost[:, column] & (footage.state[:, joint] != JointState.NOT_TRACKED)
        footage.state[where, joint] = state
        footage.position[where, joint] = guess[where, column]


def add_false_tracks(
    footage: Footage, hidden: BoolArray, other: FloatArray, config: ArmSimulation, rng: np.random.Generator
) -> dict[str, list[tuple[float, float]]]:
    """Make some occlusions look tracked: joints that stand still, or the other arm's (F, 5, 3) m in {K}.

    Returns the begin and end of those gaps, s, by what happened.
    """
    deceptions: dict[str, list[tuple[float, float]]] = {"frozen": [], "swapped": []}
    for gap in runs(hidden):
        draw = rng.uniform()
        from_to = (float(footage.t_s[gap.start]), float(footage.t_s[gap.stop - 1]))
        noise = config.noise_m * rng.normal(size=(gap.stop - gap.start, len(_FOREARM), 3))
        if draw < config.frozen_gaps:
            last = footage.position[max(gap.start - 1, 0), _FOREARM]
            footage.position[gap, _FOREARM] = last  # bit for bit the same, as trackers do
            deceptions["frozen"].append(from_to)
        elif draw < config.frozen_gaps + config.swapped_gaps:
            footage.position[gap, _FOREARM] = other[gap][:, _FOREARM] + noise
            deceptions["swapped"].append(from_to)
        else:
            continue
        seen = np.isfinite(footage.position[gap][:, _FOREARM]).all(axis=2)
        footage.state[gap, _FOREARM] = np.where(seen, JointState.TRACKED, JointState.NOT_TRACKED)
    return deceptions
