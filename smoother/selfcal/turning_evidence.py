"""How much of a forearm's turning, as the camera saw it, an IMU's attitude explains at every clock offset.

The relation of `measurements.rigid` holds for derivatives after any filter along time, too: of the forearm's
direction, x, and of the IMU's attitude, Y.

Where a is known, from other recordings with the same strap, Q alone is free, and seconds of motion tell.

What lies outside the overlap is treated as unexplained: an offset cannot win by leaving most of the data out.
A mirrored skeleton, or elbow and wrist exchanged, fits as well as the true one if Q is free (a and Q turn).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..array_types import BoolArray, FloatArray, IntArray
from ..filters import gaussian_smoothed
from ..linalg import unit, upright
from ..measurements.inertial import InertialSignal, inertial_attitude
from ..measurements.rigid import GRID_HZ, SMOOTH_S, best_fits, correlation, fits_along, known_at
from ..measurements.segment import FEWEST_SAMPLES, without_spikes
from ..measurements.timestamps import dejitter
from ..recording import ImuStream, JointTracks

#: Beside a gap the filter's reach is left out, s.
BESIDE_GAP_S = 0.24
#: A forearm whose length in a frame is outside this range of its median is not a forearm there.
LENGTHS = (0.5, 1.6)
#: An offset is tried where this part of the shorter one is in common, but no more than this is asked for, s.
OVERLAP_SHARE, OVERLAP_S = 0.35, 8.0
#: Nothing shorter than this is looked at, s.
SHORTEST_S = 1.0
#: What is left unexplained grows with speed: a sample weighs 1 / (this + the power about it, over this long,
#: against the mean power), so that one burst does not dominate the whole recording.
WEIGHT_FLOOR, WEIGHT_S = 0.3, 0.25
#: Autocorrelation is summed up to this, s; no offset explains more than this part.
CORRELATED_S, MOST_EXPLAINED = 4.0, 0.999
#: Of the offsets every this many are tried first; then all where this part of the best is reached.
COARSE, LOOKED_AT = 3, 0.5


@dataclass(frozen=True)
class CameraTurning:
    """Derivative of the forearm's direction in {K} on an even grid."""

    first: int  # Number of the first grid point: its time is `first / GRID_HZ` after the grid's origin
    rate: FloatArray  # (n, 3) 1/s: zero where the camera saw no forearm
    known: BoolArray  # bool (n,): Where it did
    stretching: FloatArray  # (n,) 1/s: derivative of the logarithm of the forearm's length

    @cached_property
    def weight(self) -> FloatArray:
        """Of each grid point, (n,); see `WEIGHT_FLOOR`."""
        known = self.known.astype(float)
        power = (self.rate**2).sum(axis=1)
        about = gaussian_smoothed(np.stack([power, known], axis=1), WEIGHT_S * GRID_HZ)
        mean = max(float(power.sum() / max(known.sum(), 1.0)), 1e-12)
        return known / (WEIGHT_FLOOR + about[:, 0] / np.maximum(about[:, 1], 1e-3) / mean)

    @cached_property
    def power(self) -> float:
        """Weighted sum of squares of all that is known."""
        return float(self.weight @ (self.rate**2).sum(axis=1))

    @cached_property
    def noise_share(self) -> float:
        """Part of `power` that is the camera's error, 0 to 1: across the forearm as along it."""
        return min(2.0 * float(self.weight @ self.stretching**2) / max(self.power, 1e-12), 1.0)

    @cached_property
    def effective_samples(self) -> float:
        """How many independent samples it is worth, by its autocorrelation (Bartlett, 1946)."""
        known, weighted = self.known[:, None].astype(float), self.rate * np.sqrt(self.weight)[:, None]
        zero = len(known) - 1
        count = correlation(known, known)[zero:, 0, 0]
        product = np.sum(
            [correlation(axis[:, None], axis[:, None])[zero:, 0, 0] for axis in weighted.T], axis=0
        )
        lags = np.arange(min(len(known), int(CORRELATED_S * GRID_HZ)))
        rho = np.where(count[lags] > 0.1 * count[0], product[lags] / np.maximum(count[lags], 1.0), 0.0)
        rho /= max(float(rho[0]), 1e-300)
        return float(self.known.sum() / max(2.0 * (rho**2).sum() - 1.0, 1.0))

    def part(self, start: int, stop: int) -> CameraTurning:
        """Some consecutive grid points."""
        rows = slice(start, stop)
        return CameraTurning(self.first + start, self.rate[rows], self.known[rows], self.stretching[rows])


@dataclass(frozen=True)
class ImuTurning:
    """Derivative of the IMU's attitude in {E} on an even grid, over a run of samples without a pause."""

    first: int  # Number of the first grid point, as `CameraTurning` has it, from the IMU's own origin
    rate: FloatArray  # (m, 3, 3) 1/s: of `R_E_A`


def camera_turning(arm: JointTracks, origin_s: float, tip: str) -> CameraTurning | None:
    """The derivative of the forearm's direction; None where there is less than `SHORTEST_S` of it."""
    visible = arm.tracked("elbow") & arm.tracked(tip)
    along = (arm.joint(tip) - arm.joint("elbow"))[visible]
    t = np.asarray(arm.t_s)[visible] - origin_s
    length = np.linalg.norm(along, axis=1)
    relative = length / max(float(np.median(length)), 1e-9) if len(t) else length
    keep = (relative > LENGTHS[0]) & (relative < LENGTHS[1])
    t = t[keep]
    grid, first = _grid(t)
    if len(grid) < SHORTEST_S * GRID_HZ:
        return None
    seen = np.hstack([unit(along[keep]), np.log(length[keep, None])])
    on_grid = np.stack([np.interp(grid, t, axis) for axis in seen.T], axis=1)
    rate = gaussian_smoothed(on_grid, SMOOTH_S * GRID_HZ, derivative=True) * GRID_HZ
    known = known_at(grid, t, BESIDE_GAP_S)
    if known.sum() < SHORTEST_S * GRID_HZ:
        return None
    rate = np.where(known[:, None], rate, 0.0)
    return CameraTurning(first, rate[:, :3], known, rate[:, 3])


def imu_turning(imu: ImuStream, origin_s: float) -> ImuTurning | None:
    """The derivative of an IMU's attitude; None where there is less than `SHORTEST_S` of it."""
    if len(imu) < FEWEST_SAMPLES or not imu.t_s[-1] - imu.t_s[0] > SHORTEST_S:
        return None
    t_s = dejitter(np.asarray(imu.t_s)) - origin_s
    signal = InertialSignal(without_spikes(replace(imu, t_s=t_s)))
    attitude = inertial_attitude(signal, imu.rate_hz)
    grid, first = _grid(attitude.t)
    if len(grid) < SHORTEST_S * GRID_HZ:
        return None
    matrix = attitude.at(grid).as_matrix().reshape(-1, 9)
    rate = gaussian_smoothed(matrix, SMOOTH_S * GRID_HZ, derivative=True) * GRID_HZ
    return ImuTurning(first, rate.reshape(-1, 3, 3))


def _grid(t: FloatArray) -> tuple[FloatArray, int]:
    """Points of the grid between the first and the last time, and the number of the first."""
    if len(t) < 3:
        return np.empty(0), 0
    numbers = np.arange(int(np.ceil(t[0] * GRID_HZ)), int(np.floor(t[-1] * GRID_HZ)) + 1)
    return numbers / GRID_HZ, int(numbers[0]) if len(numbers) else 0


@dataclass(frozen=True)
class EvidenceCurve:
    """What speaks for each clock offset."""

    first: int  # The first offset, in steps of the grid: IMU's number less camera's
    evidence: FloatArray  # (k,): by offset
    searched: int  # Offsets at which enough was in common; the evidence of the others is zero
    freedom: float  # Independent samples of the camera's turning beyond the unknowns


class TurningSums:
    """The sums over time that tell how much an IMU explains, at every offset at which enough is in common."""

    def __init__(self, camera: CameraTurning, runs: Sequence[ImuTurning], up: FloatArray | None) -> None:
        """Of what the camera saw and the IMU's runs; `up` (3,) in {K}: {E}'s heading alone is free."""
        self.camera, self.has_up = camera, up is not None
        starts = [run.first - camera.first - (len(camera.rate) - 1) for run in runs]
        self.first = min(starts)  # The first offset, in steps of the grid: IMU's number less camera's
        ends = max(run.first + len(run.rate) for run in runs)
        self.known = np.zeros(ends - camera.first - self.first)  # grid points in common, by offset
        known_s = camera.known.sum() / GRID_HZ
        imu_s = sum(len(run.rate) for run in runs) / GRID_HZ
        self.needed = GRID_HZ * max(min(OVERLAP_SHARE * min(known_s, imu_s), OVERLAP_S), SHORTEST_S)
        # by run: rows of `known` (r,), T (r, 3, 3, 3), C (r, 3, 3), and the most there is to explain (r,)
        self.runs: list[tuple[IntArray, FloatArray, FloatArray, FloatArray]] = []
        weight = camera.weight[:, None]
        power = weight * (camera.rate**2).sum(axis=1, keepdims=True)
        for run, start in zip(runs, starts, strict=True):
            m, begin = len(run.rate), start - self.first
            count = correlation(camera.known[:, None].astype(float), np.ones((m, 1)))[:, 0, 0]
            self.known[begin : begin + len(count)] += count
            rows = np.flatnonzero(count > GRID_HZ * SHORTEST_S - 0.5)
            gram = np.einsum("tij,tik->tjk", run.rate, run.rate).reshape(m, 9)
            C = correlation(weight, gram)[rows, 0].reshape(-1, 3, 3)
            T = correlation(weight * camera.rate, run.rate.reshape(m, 9))[rows].reshape(-1, 3, 3, 3)
            if up is not None:  # x in axes whose third points up, as that of {E} does
                T = np.einsum("ai,najk->nijk", upright(up), T)
            self.runs.append((begin + rows, T, C, correlation(power, np.ones((m, 1)))[rows, 0, 0]))

    def curve(self, along: FloatArray | None = None) -> EvidenceCurve:
        """The evidence at every offset; `along` (3,) is the forearm's direction in the sensor, if known."""
        evidence = self._evidence(None if along is None else along[None])[0]
        searched = int((self.known > self.needed - 0.5).sum())
        return EvidenceCurve(self.first, evidence, searched, self._freedom(along is not None))

    def best_of(self, directions: FloatArray) -> FloatArray:  # (d, 3) -> (d,)
        """The evidence of the best offset for each of some directions of the forearm in the sensor."""
        return np.asarray(self._evidence(directions).max(axis=1))

    def _freedom(self, is_known: bool) -> float:
        unknown = (1 if self.has_up else 3) + (0 if is_known else 2)
        return max(self.camera.effective_samples - 0.5 * unknown, 0.0)

    def _evidence(self, directions: FloatArray | None) -> FloatArray:
        """(d, k) for directions (d, 3) at every offset, or (1, k) for the best one at each."""
        power = np.zeros((1 if directions is None else len(directions), len(self.known)))
        for rows, T, C, most in self.runs:
            if directions is not None:
                explained = fits_along(T, C, directions, self.has_up)
            else:
                explained = _searched(T, C, self.has_up)[None] if len(rows) else np.zeros((1, 0))
            power[:, rows] += np.clip(explained, 0.0, np.maximum(most, 0.0))
        power[:, self.known <= self.needed - 0.5] = 0.0
        share = np.clip(power / max(self.camera.power, 1e-12), 0.0, MOST_EXPLAINED)
        return np.asarray(-self._freedom(directions is not None) * np.log1p(-share))


def _searched(T: FloatArray, C: FloatArray, heading_only: bool) -> FloatArray:
    """The best fits (n,): some offsets first, then all where these are good."""
    coarse = np.unique(np.append(np.arange(0, len(T), COARSE), len(T) - 1))
    answer = np.interp(np.arange(len(T)), coarse, best_fits(T[coarse], C[coarse], heading_only)[0])
    fine = np.setdiff1d(np.flatnonzero(answer > LOOKED_AT * answer.max()), coarse)
    answer[fine] = best_fits(T[fine], C[fine], heading_only)[0]
    return answer
