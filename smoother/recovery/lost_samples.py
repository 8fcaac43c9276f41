"""A step of the clock between camera and IMU: samples that were lost, and stamps that hide it.

A logger that numbers its samples, or a program that spreads them evenly, hides what a radio lost: from that
moment on the IMU is ahead of its stamps. The forearm's direction shows it without any trajectory: how the
camera sees it turn, and how the gyroscope feels it turn, agree at one offset before and at another one after.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..filters import gaussian_smoothed
from ..linalg import interpolate, runs, unit
from ..measurements.timestamps import synthetic_stamps
from ..measurements.visibility import Rejection
from ..recording import JOINTS, Recording
from ..result import Recovery
from ..result.verdict import UntrustedInterval
from ..rotation import Rotation

#: Both directions' speeds are smoothed by a Gaussian of this sigma, s, on a grid of this step, s.
SMOOTHED_S, GRID_S = 0.12, 0.02
#: Frames farther apart than this, s, are not interpolated between; so much at both ends is not compared, s.
APART_S, EDGE_S = 0.12, 0.2
#: Offsets that are tried on both sides, beyond the one that was estimated, s.
OFFSETS_S = 0.6
#: Costs are summed over so long, s; each side needs so much time in view, s.
BLOCK_S, LEAST_S = 0.5, 4.0
#: A step is one from so much log-likelihood and this size on, s: sound simulated arms stay below a gain of 1,
#: those that lost 0.1 s have 4 to 24. Synthetic stamps of a camera hide frames that were dropped: there it
#: takes more, s.
STEP_GAIN, STEP_S, STEP_SYNTHETIC_S = 4.0, 0.035, 0.25
#: From this size on, s, no side of a step has its clock; below, only what is so near, s, to it is in doubt.
LARGE_STEP_S, NEAR_S = 0.09, 4.0
#: Long recordings are looked at in parts of this length, s, which share so much with the next.
PART_S, SHARED_S = 300.0, 60.0


@dataclass(frozen=True)
class ClockStep:
    """The likeliest moment at which the offset between camera and IMU changed.

    Attributes
    ----------
    at_s : float, s
        On the IMU's clock.
    step_s : float, s
        By how much; negative where the IMU is ahead of its stamps from then on.
    gain : float
        Log-likelihood that it adds to one offset throughout.
    """

    at_s: float
    step_s: float
    gain: float

    @property
    def sentence(self) -> str:
        """What happened, and when."""
        what = "samples of the IMU" if self.step_s < 0.0 else "frames of the camera"
        return (
            f"at about {self.at_s:.0f} s the camera's clock steps against the IMU's by"
            f" {1e3 * abs(self.step_s):.0f} ms: {what} were lost there, and the stamps hide it; export with"
            " the device's own times or its packet counter"
        )


@dataclass(frozen=True)
class LostSamples:
    """What a step of the clock leaves in doubt.

    Attributes
    ----------
    reasons : tuple of str
        Why nothing of the recording is to be trusted.
    untrusted : tuple of UntrustedInterval
        What is not, where the rest is.
    """

    reasons: tuple[str, ...] = ()
    untrusted: tuple[UntrustedInterval, ...] = ()


def lost_samples(recovery: Recovery, recording: Recording) -> LostSamples:
    """Samples or frames that were lost behind stamps that go on as if nothing were; as `clock_steps`."""
    least_s = STEP_SYNTHETIC_S if synthetic_stamps(np.asarray(recording.arm.t_s)) else STEP_S
    steps = [
        step
        for step in clock_steps(recovery, recording)
        if step.gain >= STEP_GAIN and abs(step.step_s) >= least_s
    ]
    if not steps:
        return LostSamples()
    largest = max(steps, key=lambda step: abs(step.step_s))
    if abs(largest.step_s) >= LARGE_STEP_S:
        return LostSamples(reasons=(largest.sentence,))
    return LostSamples(
        untrusted=tuple(
            UntrustedInterval(step.at_s - NEAR_S, step.at_s + NEAR_S, (step.sentence,)) for step in steps
        )
    )


def clock_steps(recovery: Recovery, recording: Recording) -> list[ClockStep]:
    """The likeliest step of the clock in every part of a recording that can tell.

    Parameters
    ----------
    recovery : Recovery
        Its orientation turns what the gyroscope feels into the camera's frame, its residuals hold the frames'
        times.
    recording : Recording
        What it was made of.
    """
    if len(recovery) != len(recording.imu) or len(recovery) < 3:
        return []
    first_s, end_s = float(recovery.t_s[0]), float(recovery.t_s[-1])
    starts = np.arange(first_s, max(end_s - SHARED_S, first_s + 1.0), PART_S - SHARED_S)
    steps = (_step_between(recovery, recording, start, start + PART_S) for start in starts.tolist())
    return [step for step in steps if step is not None]


def _step_between(recovery: Recovery, recording: Recording, start_s: float, end_s: float) -> ClockStep | None:
    compared = _turning(recovery, recording, start_s, end_s)
    if compared is None:
        return None
    grid, seen, felt, valid = compared
    reach = round(OFFSETS_S / GRID_S)
    rows = np.flatnonzero(valid)
    rows = rows[(rows >= reach) & (rows < len(grid) - reach)]
    if len(rows) * GRID_S < 2.0 * LEAST_S:
        return None
    block = ((grid[rows] - grid[rows[0]]) / BLOCK_S).astype(int)
    _, block = np.unique(block, return_inverse=True)
    shifts = np.arange(-reach, reach + 1)
    cost = np.empty((block[-1] + 1, len(shifts)))
    for column, shift in enumerate(shifts):
        left = seen[rows] - felt[rows + shift]
        cost[:, column] = np.bincount(block, weights=np.einsum("ni,ni->n", left, left))
    samples = np.cumsum(np.bincount(block))
    before = np.cumsum(cost, axis=0)
    after = before[-1] - before
    two = before.min(axis=1) + after.min(axis=1)
    enough = (samples * GRID_S >= LEAST_S) & ((samples[-1] - samples) * GRID_S >= LEAST_S)
    if not enough.any():
        return None
    two[~enough] = np.inf
    last = int(np.argmin(two))
    first_shift, second_shift = int(np.argmin(before[last])), int(np.argmin(after[last]))
    split = int(np.searchsorted(block, last, side="right"))
    residual = seen[rows] - felt[rows + np.where(block <= last, shifts[first_shift], shifts[second_shift])]
    independent = len(rows) / _memory(residual)
    gain = 0.5 * independent * float(np.log(before[-1].min() / two[last]))
    at_s = 0.5 * float(grid[rows[split - 1]] + grid[rows[min(split, len(rows) - 1)]])
    return ClockStep(at_s, float(shifts[second_shift] - shifts[first_shift]) * GRID_S, gain)


def _memory(residual: FloatArray) -> float:
    """Samples (N, 3) that say as much as one: 2 sum rho^2 - 1 of their autocorrelation."""
    power = float(np.sum(residual**2))
    lags = min(round(2.0 / GRID_S), len(residual) - 1)
    rho = [float(np.sum(residual[lag:] * residual[: len(residual) - lag])) / power for lag in range(1, lags)]
    return 1.0 + 2.0 * float(np.sum(np.square(rho)))


def _turning(
    recovery: Recovery, recording: Recording, start_s: float, end_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray] | None:
    """Times (n,), the change of the forearm's direction seen and felt (n, 3) in {K}, and where both are."""
    residuals, arm = recovery.residuals, recovery.calibration
    if residuals is None or arm is None or not {"elbow", "wrist"} <= set(arm.lever_arms):
        return None
    rows = slice(*np.searchsorted(recovery.t_s, [start_s, end_s]).tolist())
    frames = slice(*np.searchsorted(residuals.t_s, [start_s, end_s]).tolist())
    t, part = np.asarray(recovery.t_s[rows]), residuals.rows(frames)
    columns = [JOINTS.index("elbow"), JOINTS.index("wrist")]
    position = np.asarray(recording.arm.position[frames])
    direction = position[:, columns[1]] - position[:, columns[0]]
    tracked = (part.used | (part.reason != Rejection.NONE))[:, columns].all(axis=1)
    tracked &= np.isfinite(direction).all(axis=1)
    frame_t = np.asarray(part.t_s)[tracked]
    if len(frame_t) < 3 or len(t) < 3:
        return None
    grid = np.arange(t[0], t[-1], GRID_S)
    seen = interpolate(frame_t, unit(direction[tracked]), grid)
    seen = gaussian_smoothed(seen, SMOOTHED_S / GRID_S, derivative=True) / GRID_S
    along = unit(arm.lever_arms["wrist"].position_m - arm.lever_arms["elbow"].position_m)
    bias = np.array(recovery.estimates.gyroscope_bias or (0.0, 0.0, 0.0))
    quaternion = np.asarray(recovery.quaternion[rows])
    known = np.asarray(np.isfinite(quaternion).all(axis=1))
    R_K_A = Rotation.from_quat(np.where(known[:, None], quaternion, [1.0, 0.0, 0.0, 0.0]), scalar_first=True)
    speed = R_K_A.apply(np.cross(np.asarray(recording.imu.gyro[rows]) - bias, along))
    felt = gaussian_smoothed(interpolate(t, speed, grid), SMOOTHED_S / GRID_S)
    after = np.clip(np.searchsorted(frame_t, grid), 1, len(frame_t) - 1)
    near = (frame_t[after] - frame_t[after - 1] <= APART_S) & (grid >= frame_t[0]) & (grid <= frame_t[-1])
    near &= known[np.clip(np.searchsorted(t, grid), 0, len(t) - 1)]
    edge, valid = round(EDGE_S / GRID_S), np.zeros(len(grid), bool)
    for run in runs(near):
        valid[run.start + edge : max(run.stop - edge, run.start + edge)] = True
    return grid, np.asarray(seen), np.asarray(felt), valid
