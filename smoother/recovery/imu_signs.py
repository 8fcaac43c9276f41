"""Signs in the IMU's samples that an answer cannot be trusted, whatever the set-up.

They say little: rate, zeros, plateaus, jumps, pauses, and a specific force that is not gravity's where
nothing else acts.

Or some were lost, and stamps hide it: a logger that numbers its samples, or a program that spreads them
evenly, hides what a radio lost, and from that moment on the IMU is ahead of its stamps. The forearm's
direction shows it without any trajectory: how the camera sees it turn, and how the gyroscope feels it turn,
agree at one offset before and at another one after.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..filters import gaussian_smoothed
from ..linalg import interpolate, runs, unit
from ..measurements.segment import Timeline
from ..measurements.segment import spikes as jumps
from ..measurements.timestamps import PAUSE_SAMPLES, synthetic_stamps
from ..measurements.visibility import Rejection
from ..recording import JOINTS, ImuStream, Recording
from ..result import Recovery
from ..result.verdict import EVER, Finding, finding
from ..rotation import Rotation, chained
from ..units import STANDARD_GRAVITY

#: An IMU slower than this, Hz, says too little; one slower than the second is used with care.
TOO_SLOW_HZ, SLOW_HZ = 15.0, 38.0
#: Samples that are looked at for being interpolated, and how many have to turn faster than this, rad/s. A
#: gyroscope's second differences are 0.3 to 0.5 of their largest in the median; those of a line nothing.
MOST_LOOKED_AT, LEAST_LOOKED_AT, MOVING_RATE, STRAIGHT = 20_000, 200, 0.3, 0.02
#: A range's end is a plateau: this many samples of one axis at its largest value, this many of them in a row.
PLATEAU_SAMPLES, PLATEAU_IN_A_ROW = 12, 3
#: Where a larger share of the samples is at a range's end, the IMU missed too much.
PLATEAU_SHARE = 0.02
#: This many samples in a row without any force are no measurement.
SILENT_SAMPLES = 3
#: So much of a gap, s, within a pause of the IMU is motion that nothing measured.
UNSEEN_S = 0.3
#: The accelerometer's scale is off where specific force differs from gravity by a larger part: used with
#: care, and not to be trusted.
SCALE_CARE, SCALE_WRONG = 0.05, 0.15
#: And by this many of its sigmas: sound simulated recordings of 10 minutes reached 2.9.
SCALE_SIGMAS = 3.0
#: Specific force is averaged over this time, s, or over a shorter recording of at least this, s; at most this
#: many times in a recording.
FORCE_S, LEAST_FORCE_S, MOST_FORCES = 4.0, 1.5, 300
#: By how much velocity differs between two moments, m/s; the bias of an accelerometer, m/s^2 per axis: one of
#: 0.1 g along one axis is known of sound recordings.
VELOCITY_CHANGE, ACCELEROMETER_BIAS = 0.7, 0.05 * STANDARD_GRAVITY
#: The least sigma of such an average, m/s^2, and the length of a residual, in sigmas, that counts in full.
FORCE_SIGMA, HUBER = 0.05, 1.5
#: How much of what turning takes of a plain mean a wrong gyroscope may leave out: all of it.
GYROSCOPE_FAULT = 1.0
#: A gyroscope that makes the means smaller than the plain ones, by this part, contradicts the accelerometer.
CONTRADICTION = 0.98
#: A range that was taken as another one is off by one of these factors, within this part.
RANGES, RANGE_TOLERANCE = (0.25, 0.5, 2.0, 4.0), 0.1


def input_faults(recording: Recording) -> Iterator[str]:
    """What makes the IMU's samples worth little, whatever the set-up: a sentence each."""
    yield from rate(recording.imu, SLOW_HZ)
    yield from zeros(recording.imu)
    yield from clipped(recording.imu, 0.0)


def rate(imu: ImuStream, least_hz: float) -> Iterator[str]:
    """Fewer samples per second than needed, or fewer that were measured."""
    if imu.rate_hz < least_hz:
        yield f"the IMU has {imu.rate_hz:.2g} samples per second, where 40 are needed and 80 are better"
    elif (measured_hz := measured_rate_hz(imu)) < least_hz:
        yield (
            f"the IMU's {imu.rate_hz:.2g} samples per second were interpolated from about {measured_hz:.2g},"
            " where 40 are needed and 80 are better: export them as they were measured"
        )


def measured_rate_hz(imu: ImuStream) -> float:
    """Samples per second that were measured: others lie on straight lines between them, or repeat them."""
    first = max((len(imu) - MOST_LOOKED_AT) // 2, 0)
    rate = np.asarray(imu.gyro[first : first + MOST_LOOKED_AT])
    bend = np.abs(np.diff(rate, 2, axis=0)).sum(axis=1)
    moves = np.linalg.norm(rate[1:-1], axis=1) > MOVING_RATE
    if moves.sum() < LEAST_LOOKED_AT:
        return imu.rate_hz
    usual, large = np.quantile(bend[moves], [0.5, 0.95])
    if usual > STRAIGHT * large:
        return imu.rate_hz
    bent = bend > 0.5 * STRAIGHT * large
    starts = bent & ~np.concatenate([[False], bent[:-1]])
    return float(imu.rate_hz * starts[moves].sum() / moves.sum())


def zeros(imu: ImuStream) -> Iterator[str]:
    """Samples without any force: a sensor that falls freely is a sensor that sends nothing."""
    if len(imu) and not np.asarray(imu.gyro).any():
        yield "the gyroscope sends zeros: check that it is switched on and exported"
    silent = [
        rows
        for rows in runs(np.asarray(~np.asarray(imu.acc).any(axis=1)))
        if rows.stop - rows.start >= SILENT_SAMPLES
    ]
    if silent:
        count, first_s = sum(rows.stop - rows.start for rows in silent), float(imu.t_s[silent[0].start])
        yield f"the IMU sends zeros ({count} samples, from {first_s:.1f} s on): remove them"


def paused_in_gaps(recording: Recording) -> Iterator[str]:
    """Pauses of the IMU while the camera did not see the forearm: nothing at all was measured then."""
    timeline = Timeline.of(recording)
    t, frame_t = recording.imu.t_s, recording.arm.t_s
    unseen = []
    for before, after in pairwise(timeline.segments):
        inside = (frame_t > t[before.stop - 1]) & (frame_t < t[after.start])
        hidden = [(frame_t[run.start], frame_t[run.stop - 1]) for run in runs(inside & ~timeline.visible)]
        unseen += [(start_s, end_s) for start_s, end_s in hidden if end_s - start_s > UNSEEN_S]
    if unseen:
        times = ", ".join(f"{start_s:.1f} to {end_s:.1f} s" for start_s, end_s in unseen[:3])
        more = f" and {len(unseen) - 3} times more" if len(unseen) > 3 else ""
        yield f"the IMU paused while the arm was hidden ({times}{more}): nothing is recovered there"


def clipped(imu: ImuStream, least_share: float) -> Iterator[str]:
    """Plateaus at the end of a sensor's range, where a larger share of the samples stands on them."""
    for name, values, si_unit in (("accelerometer", imu.acc, "m/s^2"), ("gyroscope", imu.gyro, "rad/s")):
        at_end, limits = _at_a_ranges_end(values)
        if limits and at_end.mean() > least_share:
            share = f" in {100 * at_end.mean():.0f} % of its samples" if least_share else ""
            what = "set a wider range" if least_share else "fast movement is less certain"
            yield f"the {name} was clipped at about {max(limits):.0f} {si_unit}{share}: {what}"


def _at_a_ranges_end(values: FloatArray) -> tuple[BoolArray, list[float]]:
    """Samples (N,) of a sensor (N, 3) that are at the end of its range, and where that is."""
    limits, at_end = [], np.zeros(len(values), dtype=bool)
    for axis in np.asarray(values).T:
        for limit in _plateaus(axis):
            limits.append(limit)
            at_end |= np.abs(axis) == limit
    return at_end, limits


def spikes(imu: ImuStream) -> Iterator[str]:
    """Single samples of the gyroscope that jumped away and back."""
    count = int(np.count_nonzero(jumps(np.asarray(imu.gyro))))
    if count:
        samples, were = ("1 sample", "was") if count == 1 else (f"{count} samples", "were")
        yield f"{samples} of the gyroscope jumped away and back and {were} replaced"


@dataclass(frozen=True)
class ForceScale:
    """How large specific force is where gravity alone acts."""

    ratio: float  # Of its size to gravity's; 1 for a sound accelerometer, whatever its bias
    sigma: float  # Standard deviation of the ratio, what a bias may explain included

    @property
    def is_wrong(self) -> bool:
        """Whether it differs from 1 so far that nothing is to be trusted."""
        return abs(self.ratio - 1.0) > max(SCALE_WRONG, SCALE_SIGMAS * self.sigma)

    @property
    def is_doubtful(self) -> bool:
        """Whether it differs from 1 by less than that, and by more than its sigma allows."""
        return not self.is_wrong and abs(self.ratio - 1.0) > max(SCALE_CARE, SCALE_SIGMAS * self.sigma)


def force_scale(imu: ImuStream, gyroscope_bias: FloatArray) -> ForceScale | None:  # gyroscope_bias (3,) rad/s
    """The accelerometer's scale by gravity, without a moment of rest; None where the recording cannot
    tell.
    """
    at_end, _ = _at_a_ranges_end(imu.gyro)
    whole = (window for window in _windows(imu) if at_end[window].mean() <= PLATEAU_SHARE)
    rows = [row for window in whole if (row := _mean_force(imu, window, gyroscope_bias)) is not None]
    if not rows:
        return None
    size, up, sigma, lost, plain = (np.array([row[k] for row in rows]) for k in range(5))
    if np.average(size, weights=sigma**-2) < CONTRADICTION * np.average(plain, weights=sigma**-2):
        return None  # a gyroscope of the other sign, say: not the accelerometer's fault
    basis = np.column_stack([np.full(len(size), STANDARD_GRAVITY), up, -STANDARD_GRAVITY * lost])
    prior = np.diag([1e-9, *[ACCELEROMETER_BIAS**-2] * 3, GYROSCOPE_FAULT**-2])
    weight = sigma**-2
    for _ in range(10):  # Huber's: a jolt or a knock is not gravity
        normal = basis.T @ (weight[:, None] * basis) + prior
        found = np.linalg.solve(normal, basis.T @ (weight * size))
        far = np.abs(size - basis @ found) / sigma / HUBER
        weight = sigma**-2 / np.maximum(far, 1.0)
    return ForceScale(float(found[0]), float(np.sqrt(np.linalg.inv(normal)[0, 0])))


def wrong_scale(scale: ForceScale | None) -> Iterator[str]:
    """A specific force that is far from gravity: a unit, a range or a scale that is wrong."""
    if scale is None or not scale.is_wrong:
        return
    factor = min(RANGES, key=lambda each: abs(scale.ratio / each - 1.0))
    close = abs(scale.ratio / factor - 1.0) < RANGE_TOLERANCE
    cause = f"as if its range were {factor:g} times as wide" if close else "its unit or its scale is wrong"
    yield (
        f"the accelerometer reads {scale.ratio * STANDARD_GRAVITY:.1f} m/s^2 where gravity alone acts (9.8):"
        f" {cause}; check the unit and range of the export, or calibrate it"
        " (`unocclude calibrate imu`)"
    )


def doubtful_scale(scale: ForceScale | None) -> Iterator[str]:
    """A specific force that is somewhat off gravity."""
    if scale is not None and scale.is_doubtful:
        what = "much" if scale.ratio > 1.0 else "little"
        yield (
            f"the accelerometer reads {100 * abs(scale.ratio - 1.0):.0f} % too {what} where gravity alone"
            " acts: calibrate it (`unocclude calibrate imu`)"
        )


def _windows(imu: ImuStream) -> Iterator[slice]:
    """Rows of times of `FORCE_S`, or the whole of a shorter recording, without a pause in them."""
    t = np.asarray(imu.t_s)
    if len(t) < SILENT_SAMPLES or t[-1] - t[0] < LEAST_FORCE_S:
        return
    usual = float(np.median(np.diff(t)))
    length_s = min(FORCE_S, float(t[-1] - t[0]))
    count = int(np.clip((t[-1] - t[0]) // (0.5 * length_s), 1, MOST_FORCES))
    for start_s in np.linspace(t[0], t[-1] - length_s, count):
        first, last = np.searchsorted(t, [start_s, start_s + length_s + 0.5 * usual])
        if last - first > SILENT_SAMPLES and np.diff(t[first:last]).max() <= PAUSE_SAMPLES * usual:
            yield slice(int(first), int(last))


def _mean_force(
    imu: ImuStream, window: slice, gyroscope_bias: FloatArray
) -> tuple[float, FloatArray, float, float, float] | None:
    """Size, up in the sensor's axes (3,), sigma of the size; the plain mean's loss by turning, its size."""
    t, force = np.asarray(imu.t_s[window]), np.asarray(imu.acc[window])
    rate = np.asarray(imu.gyro[window]) - gyroscope_bias
    length = np.linalg.norm(force, axis=1)
    if not (length > 0.0).all():
        return None
    step = 0.5 * (rate[1:] + rate[:-1]) * np.diff(t)[:, None]
    R = chained(Rotation.from_rotvec(step).as_matrix())
    mean = np.einsum("nij,nj->i", R, force) / len(t)
    size = float(np.linalg.norm(mean))
    if size == 0.0:
        return None
    scatter = min(VELOCITY_CHANGE / float(t[-1] - t[0]), float(length.std()))
    lost = 1.0 - float(np.linalg.norm((force / length[:, None]).mean(axis=0)))
    plain = float(np.linalg.norm(force.mean(axis=0)))
    return size, R.mean(axis=0).T @ mean / size, float(np.hypot(FORCE_SIGMA, scatter)), lost, plain


def _plateaus(axis: FloatArray) -> list[float]:
    """Sizes of the largest and the smallest value of each axis (N,), where the sensor stood at it."""
    return [
        abs(float(end))
        for end in (axis.max(initial=0.0), axis.min(initial=0.0))
        if np.count_nonzero(axis == end) >= PLATEAU_SAMPLES
        and max((row.stop - row.start for row in runs(axis == end)), default=0) >= PLATEAU_IN_A_ROW
        and end != 0.0
    ]


#: Both directions' speeds are smoothed by a Gaussian of this sigma, s, on a grid of this step, s.
SMOOTHED_S, GRID_S = 0.12, 0.02
#: Frames farther apart than this, s, are not interpolated between; so much at both ends is not compared, s.
APART_S, EDGE_S = 0.12, 0.2
#: Offsets that are tried on both sides, beyond the one that was estimated, s.
OFFSETS_S = 0.6
#: Costs are summed over this long, s; each side needs this much time in view, s.
BLOCK_S, LEAST_S = 0.5, 4.0
#: A step is one from this much log-likelihood and this size on, s: sound simulated arms stay below a gain of
#: 1, those that lost 0.1 s have 4 to 24. Synthetic stamps of a camera hide frames that were dropped: there it
#: takes more, s.
STEP_GAIN, STEP_S, STEP_SYNTHETIC_S = 4.0, 0.035, 0.25
#: From this size on, s, no side of a step has its clock; below, only what is so near, s, to it is in doubt.
LARGE_STEP_S, NEAR_S = 0.09, 4.0
#: Long recordings are looked at in parts of this length, s, which share this much with the next.
PART_S, SHARED_S = 300.0, 60.0


@dataclass(frozen=True)
class ClockStep:
    """The likeliest moment at which the offset between camera and IMU changed."""

    at_s: float  # On the IMU's clock
    step_s: float  # By how much; negative where the IMU is ahead of its stamps from then on
    gain: float  # Log-likelihood that it adds to one offset throughout

    @property
    def sentence(self) -> str:
        """What happened, and when."""
        what = "samples of the IMU" if self.step_s < 0.0 else "frames of the camera"
        return (
            f"at about {self.at_s:.0f} s the camera's clock steps against the IMU's by"
            f" {1e3 * abs(self.step_s):.0f} ms: {what} were lost there, and the stamps hide it; export with"
            " the device's own times or its packet counter"
        )


def lost_samples(recovery: Recovery, recording: Recording) -> Iterator[Finding]:
    """Samples or frames that were lost behind stamps that go on as if nothing were; as `clock_steps`."""
    least_s = STEP_SYNTHETIC_S if synthetic_stamps(np.asarray(recording.arm.t_s)) else STEP_S
    steps = [
        step
        for step in clock_steps(recovery, recording)
        if step.gain >= STEP_GAIN and abs(step.step_s) >= least_s
    ]
    large = max(steps, key=lambda step: abs(step.step_s), default=None)
    if large is not None and abs(large.step_s) >= LARGE_STEP_S:
        yield finding("samples-lost", large.sentence, EVER)
        return
    for step in steps:
        yield finding("samples-lost", step.sentence, (step.at_s - NEAR_S, step.at_s + NEAR_S))


def clock_steps(recovery: Recovery, recording: Recording) -> list[ClockStep]:
    """The likeliest step of the clock in every part of a recording that can tell."""
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
    _, starts, block = np.unique(block, return_index=True, return_inverse=True)
    shifts = np.arange(-reach, reach + 1)
    cost = np.empty((len(starts), len(shifts)))
    within = seen[reach : len(grid) - reach]
    for column in range(len(shifts)):
        left = within - felt[column : column + len(within)]  # all rows in one piece, then those that count
        cost[:, column] = np.add.reduceat(np.einsum("ni,ni->n", left, left)[rows - reach], starts)
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
    flat = residual.ravel()
    rho = [float(flat[3 * lag :] @ flat[: len(flat) - 3 * lag]) / power for lag in range(1, lags)]
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
