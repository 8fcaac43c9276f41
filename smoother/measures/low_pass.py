"""A recovery on an even grid, without what is faster than the arm's own motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..linalg import interpolate, median_rate_hz, runs
from ..result import Recovery
from .settings import Smoothing

#: Samples further apart than this, in periods, do not belong to one run.
APART_PERIODS = 4.0
#: A run shorter than this is not measured: a filter of 6 Hz needs a few periods, s.
SHORTEST_RUN_S = 0.5


@dataclass(frozen=True)
class TimeGrid:
    """Even times in runs that have an answer throughout.

    Attributes
    ----------
    t_s : ndarray, shape (n,), s
        Increasing; even within a run.
    rate_hz : float, Hz
        Of the grid.
    runs : tuple of slice
        Rows without a pause between them.
    """

    t_s: FloatArray
    rate_hz: float
    runs: tuple[slice, ...]


def grid_of(recovery: Recovery, settings: Smoothing) -> TimeGrid:
    """The even times at which a recovery is measured.

    Parameters
    ----------
    recovery : Recovery
        Of N samples.
    settings : Smoothing
        Decides the rate where the recording is faster.

    Returns
    -------
    grid : TimeGrid
        Empty where there is no answer.
    """
    rate = min(median_rate_hz(recovery.t_s), settings.most_rate_hz)
    known = recovery.answered
    times, places, count = [], [], 0
    if len(recovery) > 1 and known.any():
        rows = np.flatnonzero(known)
        apart = np.diff(recovery.t_s[rows]) > APART_PERIODS / median_rate_hz(recovery.t_s)
        for some in np.split(rows, np.flatnonzero(apart) + 1):
            start, end = recovery.t_s[some[0]], recovery.t_s[some[-1]]
            if end - start < SHORTEST_RUN_S:
                continue
            times.append(start + np.arange(int((end - start) * rate) + 1) / rate)
            places.append(slice(count, count + len(times[-1])))
            count += len(times[-1])
    return TimeGrid(np.concatenate(times) if times else np.empty(0), rate, tuple(places))


def on_grid(recovery: Recovery, grid: TimeGrid, cutoff_hz: float) -> Recovery:
    """The recovery at a grid's times, low-passed; its covariances are left out.

    A second-order Butterworth filter run forth and back, so without delay (Winter, Biomechanics and Motor
    Control of Human Movement, 2009, section 2.2.4.4). Quaternions are filtered by component, with one sign
    all along, and brought back to length one.

    Parameters
    ----------
    recovery : Recovery
        Of N samples.
    grid : TimeGrid
        Of n times.
    cutoff_hz : float, Hz
        Where a single run of the filter lets half the power through.

    Returns
    -------
    recovery : Recovery
        Of n samples.
    """

    def filtered(values: FloatArray) -> FloatArray:
        return low_passed(interpolate(recovery.t_s, values, grid.t_s), grid, cutoff_hz)

    def turned(quaternion: FloatArray) -> FloatArray:
        even = filtered(one_sign(quaternion))
        with np.errstate(invalid="ignore"):
            return np.asarray(even / np.linalg.norm(even, axis=1, keepdims=True))

    n = len(grid.t_s)
    occluded = recovery.occluded[nearest_rows(recovery.t_s, grid.t_s)]
    upper, trunk = recovery.upper, recovery.trunk
    if upper is not None:
        upper = replace(
            upper,
            position=filtered(upper.position),
            quaternion=turned(upper.quaternion),
            pose_covariance=_zeros(n, 6, 6),
        )
    if trunk is not None:
        trunk = replace(trunk, quaternion=turned(trunk.quaternion), covariance=_zeros(n, 3, 3))
    return replace(
        recovery,
        t_s=grid.t_s,
        occluded=occluded,
        position=filtered(recovery.position),
        quaternion=turned(recovery.quaternion),
        velocity=interpolate(recovery.t_s, recovery.velocity, grid.t_s),
        pose_covariance=_zeros(n, 6, 6),
        velocity_covariance=_zeros(n, 3, 3),
        joints={joint: filtered(position) for joint, position in recovery.joints.items()},
        joint_covariance={joint: _zeros(n, 3, 3) for joint in recovery.joint_covariance},
        upper=upper,
        trunk=trunk,
        draws=None,
    )


def low_passed(values: FloatArray, grid: TimeGrid, cutoff_hz: float) -> FloatArray:
    """Values (n, k) on a grid without what is faster than the cut-off; runs that are too short stay."""
    from scipy.signal import butter, sosfiltfilt  # where something is measured only

    smooth = values.copy()
    if cutoff_hz >= 0.45 * grid.rate_hz:
        return smooth
    sections = butter(2, cutoff_hz, fs=grid.rate_hz, output="sos")
    pad = round(grid.rate_hz / cutoff_hz)
    for run in grid.runs:
        known = np.asarray(np.isfinite(values[run]).all(axis=1))
        for inner in runs(known):
            rows = slice(run.start + inner.start, run.start + inner.stop)
            if inner.stop - inner.start > 2 * pad:
                smooth[rows] = sosfiltfilt(sections, values[rows], axis=0, padlen=pad)
    return smooth


def slope(values: FloatArray, grid: TimeGrid) -> FloatArray:
    """Derivative by time of values (n, ...) on a grid, by central differences within each run."""
    change = np.full_like(values, np.nan)
    for run in grid.runs:
        if run.stop - run.start > 1:
            change[run] = np.gradient(values[run], 1.0 / grid.rate_hz, axis=0)
    return change


def one_sign(quaternion: FloatArray) -> FloatArray:
    """Quaternions (n, 4) that do not jump to their negative; nan where there is none."""
    even = quaternion.copy()
    known = np.flatnonzero(np.isfinite(quaternion).all(axis=1))
    turns = np.where((even[known][1:] * even[known][:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    even[known[1:]] *= np.cumprod(turns)[:, None]
    return even


def nearest_rows(t_s: FloatArray, at: FloatArray) -> np.ndarray:
    """Index (k,) of the sample nearest to each time."""
    right = np.clip(np.searchsorted(t_s, at), 1, max(len(t_s) - 1, 1))
    return np.where(at - t_s[right - 1] <= t_s[np.minimum(right, len(t_s) - 1)] - at, right - 1, right)


def is_within(t_s: FloatArray, start_s: float, end_s: float) -> BoolArray:
    """(n,) whether times lie between two others, both included."""
    return np.asarray((t_s >= start_s) & (t_s <= end_s))


def _zeros(*shape: int) -> FloatArray:
    """Zeros of that shape, which take no memory."""
    return np.broadcast_to(np.zeros(()), shape)
