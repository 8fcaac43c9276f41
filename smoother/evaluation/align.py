"""A reference motion read at other times: never beyond its ends, never where samples are missing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from ..array_types import BoolArray, FloatArray
from ..recording import Truth

#: Samples of a reference farther apart than this are not bridged, s.
BRIDGED_S = 0.1
#: Stamps that went through a text file are equal to this, s.
STAMP_S = 1e-6


def truth_at(truth: Truth, t_s: FloatArray) -> Truth:
    """The truth at the given times (its own clock), nan where it has none.

    Positions between samples are cubic (linear between fewer than four samples), orientations slerp.
    Nothing is extrapolated, and samples more than 0.1 s apart are not bridged. A time is
    scored where the samples on both sides of it are.
    """
    t_s = np.asarray(t_s, dtype=float)
    quaternion = np.full((len(t_s), 4), np.nan)
    if len(truth):
        quaternion = _piecewise(truth.t_s, truth.quaternion, t_s, _slerp)
    return Truth(
        t_s=t_s,
        position=position_at(truth.t_s, truth.position, t_s),
        quaternion=quaternion,
        score=_scored(truth, t_s),
        joints={name: position_at(truth.t_s, value, t_s) for name, value in truth.joints.items()},
    )


def position_at(t_known: FloatArray, position: FloatArray, t_s: FloatArray) -> FloatArray:
    """Positions (M, 3) read at other times (N, 3): cubic, nan where none is near."""
    return _piecewise(t_known, position, t_s, _cubic)


def orientation_at(t_known: FloatArray, quaternion: FloatArray, t_s: FloatArray) -> FloatArray:
    """Orientations (M, 4) read at other times (N, 4): slerp, nan where none is near."""
    return _piecewise(t_known, quaternion, t_s, _slerp)


def linear_at(t_known: FloatArray, values: FloatArray, t_s: FloatArray) -> FloatArray:
    """Values (M, D) read at other times (N, D): linear, so that variances stay positive."""
    return _piecewise(t_known, values, t_s, _linear)


def _piecewise(
    t_known: FloatArray,
    values: FloatArray,
    t_s: FloatArray,
    reader: Callable[[FloatArray, FloatArray, FloatArray], FloatArray],
) -> FloatArray:
    """Apply a reader between samples that may be bridged; other times stay nan."""
    result = np.full((len(t_s), values.shape[1]), np.nan)
    finite = np.isfinite(values).all(axis=1) & np.isfinite(t_known)
    t, v = t_known[finite], values[finite]
    order = np.argsort(t, kind="stable")
    t, v = t[order], v[order]
    fresh = np.append(True, np.diff(t) > 0) if len(t) else np.zeros(0, bool)
    t, v = t[fresh], v[fresh]
    for part in np.split(np.arange(len(t)), np.flatnonzero(np.diff(t) > BRIDGED_S + STAMP_S) + 1):
        if not len(part):
            continue
        inside = (t_s >= t[part[0]] - STAMP_S) & (t_s <= t[part[-1]] + STAMP_S)
        if inside.any():
            clipped = np.clip(t_s[inside], t[part[0]], t[part[-1]])
            result[inside] = reader(t[part], v[part], clipped)
    return result


def _cubic(t: FloatArray, v: FloatArray, at: FloatArray) -> FloatArray:
    if len(t) >= 4:
        return np.asarray(CubicSpline(t, v)(at))
    return _linear(t, v, at)


def _linear(t: FloatArray, v: FloatArray, at: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(at, t, column) for column in v.T])


def _slerp(t: FloatArray, quaternion: FloatArray, at: FloatArray) -> FloatArray:
    if len(t) == 1:
        return np.repeat(quaternion, len(at), axis=0)
    rotation = Rotation.from_quat(quaternion, scalar_first=True)
    return np.asarray(Slerp(t, rotation)(at).as_quat(scalar_first=True))


def _scored(truth: Truth, t_s: FloatArray) -> BoolArray:
    if not len(truth):
        return np.zeros(len(t_s), dtype=bool)
    after = np.searchsorted(truth.t_s, t_s - STAMP_S)  # first sample at or after
    before = np.searchsorted(truth.t_s, t_s + STAMP_S, side="right") - 1  # last at or before
    inside = (after < len(truth)) & (before >= 0)
    last = len(truth) - 1
    both = truth.score[np.clip(after, 0, last)] & truth.score[np.clip(before, 0, last)]
    return inside & both
