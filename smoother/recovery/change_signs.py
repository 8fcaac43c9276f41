"""Signs that something changed while the recording ran: the strap slipped, the camera was pushed.

Both leave an answer that looks well on either side of the change. Down, as the IMU feels it, shows them: a
sensor that sits otherwise from one moment to the next feels down elsewhere without having turned, and a
camera that was pushed has down elsewhere in its frame from then on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..array_types import BoolArray, FloatArray
from ..filters import gaussian_smoothed
from ..linalg import runs, unit
from ..measurements.segment import without_spikes
from ..measurements.timestamps import PAUSE_SAMPLES
from ..measurements.visibility import Rejection
from ..recording import JOINTS, ImuStream, JointState, Recording
from ..result import Recovery
from ..result.verdict import EVER, Sign
from ..rotation import Rotation, chained

#: Length of the stretches and step between them, s.
OVER_S, STEP_S = 4.0, 0.5
#: Scale errors of a gyroscope's axes, and what is left of such a turn of the answer without any, degrees.
SCALE_SIGMA, DRIFT_NOISE_DEG = 0.02, 2.0


@dataclass(frozen=True)
class GyroscopeDrift:
    """Turns of the answer that the gyroscope did not feel."""

    at_s: FloatArray  # (n,) s: middles of the times looked at, `OVER_S` each
    angle_deg: FloatArray  # (n,) degrees: how far the answer turned against the gyroscope
    sigma_deg: FloatArray  # (n,) degrees: of the orientations at both ends
    turn: FloatArray  # (n, 3) degrees: the same as `angle_deg` as rotation vectors in {K}
    turned_deg: FloatArray  # (n,) degrees: how far the gyroscope turned in that time, to and fro added up


def gyroscope_drift(
    recovery: Recovery,
    imu: ImuStream,
    gyroscope_bias: FloatArray,  # (3,) rad/s
) -> GyroscopeDrift:
    """Compare the answer's turning with the gyroscope's, added up in the camera's frame."""
    t = np.asarray(recovery.t_s)
    at = np.arange(t[0], t[-1], STEP_S) if len(t) > 1 else np.zeros(0)
    usual = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    # columns of the sums: what the gyroscope did not feel, what it felt by axis, and how far it turned
    total, sums, sigma = np.zeros((3, 5)), np.full((len(at), 3, 5), np.nan), np.full(len(at), np.nan)
    row = 0
    for batch in recovery.batches(overlap=1):
        first = max(row - 1, 0)
        rows = slice(first, first + len(batch))
        row = rows.stop
        times = t[rows]
        rate = without_spikes(imu.select(rows)).gyro - gyroscope_bias
        steps = _unfelt(batch, np.asarray(rate), usual)
        added = total + np.concatenate([np.zeros((1, 3, 5)), np.cumsum(steps, axis=0)])
        total = added[-1]
        mine = np.flatnonzero((at >= times[0]) & (at <= times[-1]))
        nearest = np.searchsorted(times, at[mine])
        sums[mine] = added[nearest]
        spread = np.einsum("nii->n", batch.pose_covariance[nearest, 3:, 3:])
        sigma[mine] = np.degrees(np.sqrt(np.maximum(spread, 0.0)))
    apart = round(OVER_S / STEP_S)
    both = sums[apart:] - sums[:-apart]
    turn, felt = np.degrees(both[:, :, 0]), np.degrees(both[:, :, 1:4])
    turn = turn - felt @ _scale_error(turn, felt)
    angle, spread = np.linalg.norm(turn, axis=1), np.hypot(sigma[apart:], sigma[:-apart])
    return GyroscopeDrift(
        at[apart:] - 0.5 * OVER_S, angle, spread, turn, np.degrees(np.linalg.norm(both[:, :, 4], axis=1))
    )


def _scale_error(
    turn: FloatArray,  # (n, 3) degrees
    felt: FloatArray,  # (n, 3, 3) degrees
) -> FloatArray:
    """Scale errors (3,) of the gyroscope's axes that explain most of what it did not feel."""
    known = np.isfinite(turn).all(axis=1) & np.isfinite(felt).all(axis=(1, 2))
    A = np.vstack([felt[known].reshape(-1, 3) / DRIFT_NOISE_DEG, np.eye(3) / SCALE_SIGMA])
    b = np.concatenate([turn[known].ravel() / DRIFT_NOISE_DEG, np.zeros(3)])
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0])


def _unfelt(batch: Recovery, rate: FloatArray, usual_s: float) -> FloatArray:
    """Of each step, rad, in {K}: what the gyroscope did not feel, what its axes felt, how far it turned."""
    step = np.diff(np.asarray(batch.t_s))
    known = np.asarray(np.isfinite(batch.quaternion).all(axis=1))
    R_K_A = Rotation.from_quat(
        np.where(known[:, None], batch.quaternion, [1.0, 0.0, 0.0, 0.0]), scalar_first=True
    )
    felt = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * step[:, None])
    steps = np.zeros((len(step), 3, 5))
    steps[:, :, 0] = (R_K_A[1:] * felt.inv() * R_K_A[:-1].inv()).as_rotvec()
    turned = felt.as_rotvec()
    steps[:, :, 1:4] = R_K_A[:-1].as_matrix() * turned[:, None, :]
    steps[:, 0, 4] = np.linalg.norm(turned, axis=1)
    steps[~(known[1:] & known[:-1]) | (step > PAUSE_SAMPLES * usual_s)] = 0.0
    return steps


#: Down before and after a moment is averaged over these times, s; both must show the jump.
BEFORE_AFTER_S = (3.0, 5.0)
STEP_S = 0.5
#: A jump of down is one from here on, degrees, and this many times what is usual in the recording: simulated
#: arms and BROAD's fast trials stay below 9, a strap that slips by 15 shows 9 to 18.
JUMP_DEG, JUMP_TIMES_USUAL = 9.0, 3.0
#: What is usual is taken from moments farther from the largest jump than this, s; where there are fewer
#: than this many of them nothing is usual, and 9 degrees are a jump.
ELSEWHERE_S, FEW_ELSEWHERE = 4.0, 4
#: The answer leaves its gyroscope where it turns by this many degrees, sigmas, and as a share of all turning
#: within `OVER_S`, and where it turns by less while down jumps by this many degrees at about that time, s. Of
#: 280 sound simulated recordings, with gyroscopes of 3 % scale error among them, the largest turn is 6.2
#: degrees, and 2.1 where down jumps by more than 4; straps that slip by 15 show 3.3 to 17 degrees. At rest
#: heading is not determined, which sigma shows.
LEFT_DEG, LEFT_SIGMAS, LEFT_SHARE = 9.0, 1.0, 0.009
SMALL_LEFT_DEG, SMALL_SIGMAS, SMALL_SHARE = 3.2, 0.5, 0.0055
SMALL_JUMP_DEG, TOGETHER_S = 4.5, 4.0
#: The IMU is looked at in batches of this length, s.
BATCH_S = 60.0
#: Down in the camera's frame is averaged over this time, s; a change needs two such means on both sides.
MEAN_S = 6.0
#: A change of it is one from here on, degrees and sigmas; sound recordings stay below 0.7 degrees.
PUSHED_DEG, PUSHED_SIGMAS = 1.5, 4.0
#: The least sigma of one such mean, degrees.
MEAN_SIGMA_DEG = 0.4
#: A turn of all that the camera sees about the vertical counts from here on, degrees, sigmas, and as a share
#: of the whole turn that the gyroscope did not measure: sound simulated arms stay below 2 degrees, a camera
#: that is turned by 15 shows 6 to 8.
TURNED_DEG, TURNED_SIGMAS, TURNED_SHARE = 4.5, 3.5, 0.7
#: Fewer filled samples are not worth a word.
FEW_FILLED = 5
#: An IMU that turns by less than this, rad/s (mean over a time, s), for this long, s, is at rest. The forearm
#: turns where more than a share of at least this many frames is this far from their median direction: noise
#: of 3 cm on a forearm is 7 degrees.
STILL_RAD_S, STILL_MEAN_S, STILL_S = 0.03, 0.1, 3.0
STILL_TURN_DEG, STILL_SHARE, STILL_FRAMES = 20.0, 0.2, 30


def changes(
    recovery: Recovery,
    recording: Recording,
    gyroscope_bias: FloatArray,  # (3,) rad/s
) -> Iterator[str]:
    """What changed while the recording ran, so that no answer holds before and after it."""
    jumps = _all_jumps(recording.imu, gyroscope_bias)
    found = list(strap_slipped(jumps))
    if len(recovery) == len(recording.imu):
        drift = gyroscope_drift(recovery, recording.imu, gyroscope_bias)
        if recording.base_imu is None:
            found += camera_turned(drift, recovery.gravity_direction)
        found = found or list(gyroscope_left(drift, jumps))
    yield from found


def strap_slipped(jumps: FloatArray) -> Iterator[str]:  # jumps (n, 3)
    """The IMU's down jumps although the gyroscope felt no turn."""
    sure = jumps[jumps[:, 2] == len(BEFORE_AFTER_S)]
    if not len(sure):
        return
    at_s, angle_deg, _ = sure[int(np.argmax(sure[:, 1]))]
    elsewhere = sure[np.abs(sure[:, 0] - at_s) > ELSEWHERE_S, 1]
    usual_deg = float(np.median(elsewhere)) if len(elsewhere) >= FEW_ELSEWHERE else 0.0
    if angle_deg > max(JUMP_DEG, JUMP_TIMES_USUAL * usual_deg):
        yield (
            f"at about {at_s:.0f} s the IMU's sense of down jumps by {angle_deg:.0f} degrees without a"
            " rotation measured by its gyroscope: the strap slipped, the sensor was taken off, or samples"
            " are missing"
        )


def gyroscope_left(drift: GyroscopeDrift, jumps: FloatArray) -> Iterator[str]:  # jumps (n, 3)
    """The answer turns, and the gyroscope did not feel it."""

    def beyond(angle_deg: float, sigmas: float, share: float) -> BoolArray:
        least = np.maximum(sigmas * drift.sigma_deg, share * drift.turned_deg)
        return np.asarray((drift.angle_deg > angle_deg) & (drift.angle_deg > least))

    large = np.sort(jumps[jumps[:, 1] > SMALL_JUMP_DEG, 0])
    first = np.searchsorted(large, drift.at_s - TOGETHER_S, "left")
    near = first < np.searchsorted(large, drift.at_s + TOGETHER_S, "right")
    counts = beyond(LEFT_DEG, LEFT_SIGMAS, LEFT_SHARE)
    counts |= near & beyond(SMALL_LEFT_DEG, SMALL_SIGMAS, SMALL_SHARE)
    if counts.any():
        most = int(np.argmax(np.where(counts, drift.angle_deg / drift.sigma_deg, 0.0)))
        yield (
            f"at about {drift.at_s[most]:.0f} s the arm would have turned by {drift.angle_deg[most]:.0f}"
            " degrees that the gyroscope did not measure: the strap slipped, the sensor was taken off, the"
            " camera was moved, or samples are missing"
        )


def _all_jumps(imu: ImuStream, gyroscope_bias: FloatArray) -> FloatArray:
    """The jumps of all batches, (n, 3)."""
    found = [down_jumps(imu.select(slice(first, last)), gyroscope_bias) for first, last in _batches(imu)]
    return np.concatenate([np.zeros((0, 3)), *found])


def _batches(imu: ImuStream) -> Iterator[tuple[int, int]]:
    """Rows of batches without a pause, each reaching into the next by what the longest mean needs."""
    t = np.asarray(imu.t_s)
    if len(t) < 3:
        return
    distance = np.diff(t)
    for run in runs(np.asarray(distance <= PAUSE_SAMPLES * np.median(distance))):
        first, end = run.start, run.stop + 1
        while first < end:
            last = int(np.searchsorted(t[:end], t[first] + BATCH_S))
            yield first, last
            if last >= end:
                break
            first = int(np.searchsorted(t, t[last - 1] - 2.0 * max(BEFORE_AFTER_S)))


def down_jumps(imu: ImuStream, gyroscope_bias: FloatArray) -> FloatArray:  # -> (n, 3)
    """Angles between down before and after moments of a batch."""
    t, turning = np.asarray(imu.t_s), without_spikes(imu).gyro - gyroscope_bias
    step = np.diff(t)[:, None]
    R = chained(Rotation.from_rotvec(0.5 * (turning[1:] + turning[:-1]) * step).as_matrix())
    force = np.einsum("nij,nj->ni", R, imu.acc)
    total = np.vstack([np.zeros(3), np.cumsum(0.5 * (force[1:] + force[:-1]) * step, axis=0)])
    at = np.arange(t[0] + min(BEFORE_AFTER_S), t[-1] - min(BEFORE_AFTER_S), STEP_S)
    middle = np.searchsorted(t, at)
    smallest, lengths = np.full(len(at), np.inf), np.zeros(len(at))
    for length_s in BEFORE_AFTER_S:
        first, last = np.searchsorted(t, at - length_s), np.searchsorted(t, at + length_s)
        fits = (at - length_s >= t[0]) & (at + length_s < t[-1])
        before = unit(total[middle[fits]] - total[first[fits]])
        after = unit(total[last[fits]] - total[middle[fits]])
        cosine = np.clip(np.einsum("ni,ni->n", before, after), -1.0, 1.0)
        smallest[fits] = np.minimum(smallest[fits], np.degrees(np.arccos(cosine)))
        lengths += fits
    return np.column_stack([at, smallest, lengths])[lengths > 0]


def camera_pushed(recovery: Recovery, recording: Recording) -> Iterator[Sign]:
    """Down in the camera's frame is another one from some moment on."""
    if recording.base_imu is not None or len(recovery) != len(recording.imu):
        return
    at_s, down = _down_in_camera(recovery, recording.imu)
    count = len(at_s)
    if count < 4:
        return
    best = (0.0, 0.0, 0.0)
    for k in range(2, count - 1):
        before, after = down[:k], down[k:]
        spread = [np.sum((part - part.mean(axis=0)) ** 2) / (len(part) - 1) for part in (before, after)]
        variance = [max(value, np.radians(MEAN_SIGMA_DEG) ** 2) for value in spread]
        sigma_deg = np.degrees(np.sqrt(variance[0] / len(before) + variance[1] / len(after)))
        cosine = float(unit(before.mean(axis=0)) @ unit(after.mean(axis=0)))
        angle_deg = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
        best = max(best, (angle_deg / sigma_deg, angle_deg, 0.5 * (at_s[k - 1] + at_s[k])))
    sigmas, angle_deg, changed_s = best
    if angle_deg > PUSHED_DEG and sigmas > PUSHED_SIGMAS:
        yield Sign(
            f"from about {changed_s:.0f} s on, down points {angle_deg:.1f} degrees in another direction of"
            " the camera's frame: was the camera pushed, or the sensor turned on the arm?",
            EVER if angle_deg > TURNED_DEG else (changed_s - MEAN_S, changed_s + MEAN_S),
        )


def camera_turned(drift: GyroscopeDrift, down: FloatArray) -> Iterator[str]:  # down (3,)
    """The answer turns about the vertical, and the gyroscope did not feel it."""
    if not np.isfinite(down).all():
        return
    about_down = np.abs(drift.turn @ down)
    counts = (about_down > TURNED_DEG) & (about_down > TURNED_SIGMAS * drift.sigma_deg)
    counts &= about_down > TURNED_SHARE * drift.angle_deg
    if counts.any():
        most = int(np.argmax(np.where(counts, about_down, 0.0)))
        yield (
            f"at about {drift.at_s[most]:.0f} s all that the camera sees turns by {about_down[most]:.0f}"
            " degrees or more about the vertical, which the IMU did not measure: the camera was moved, or the"
            " sensor turned on the arm; positions before and after are not in one frame"
        )


def imu_lies_still(
    recovery: Recovery,
    recording: Recording,
    gyroscope_bias: FloatArray,  # (3,) rad/s
) -> Iterator[Sign]:
    """Times at which the IMU does not turn at all while the camera sees the forearm turn."""
    residuals, imu = recovery.residuals, recording.imu
    if residuals is None or len(imu) < 3:
        return
    slow = np.zeros(len(imu), bool)
    for first, last in _batches(imu):  # its columns may be on disk
        speed = np.linalg.norm(np.asarray(imu.gyro[first:last]) - gyroscope_bias, axis=1)
        mean = gaussian_smoothed(speed[:, None], max(STILL_MEAN_S * imu.rate_hz, 1.0))[:, 0]
        slow[first:last] = mean < STILL_RAD_S
    for still in runs(slow):
        start_s, end_s = float(imu.t_s[still.start]), float(imu.t_s[still.stop - 1])
        if end_s - start_s < STILL_S:
            continue
        frames = slice(*np.searchsorted(residuals.t_s, [start_s, end_s]).tolist())
        elbow, wrist = (JOINTS.index(joint) for joint in ("elbow", "wrist"))
        position, state = recording.arm.position[frames], recording.arm.state[frames]
        seen = (state[:, [elbow, wrist]] == JointState.TRACKED).all(axis=1)
        if seen.sum() < STILL_FRAMES:
            continue
        direction = unit(position[seen, wrist] - position[seen, elbow])
        away = direction @ unit(np.median(direction, axis=0))
        if np.mean(away < np.cos(np.radians(STILL_TURN_DEG))) > STILL_SHARE:
            yield Sign(
                f"from {start_s:.1f} to {end_s:.1f} s the IMU is still while the camera sees the"
                " forearm turn: it was taken off, or the skeleton is another person's",
                (start_s, end_s),
            )


def _down_in_camera(recovery: Recovery, imu: ImuStream) -> tuple[FloatArray, FloatArray]:
    """Times (n,) and mean directions (n, 3) of specific force in {K}, over `MEAN_S` each."""
    start_s = float(recovery.t_s[0])
    number = np.floor((np.asarray(recovery.t_s) - start_s) / MEAN_S).astype(int)
    total, samples = np.zeros((number[-1] + 1, 3)), np.zeros(number[-1] + 1)
    row = 0
    for batch in recovery.batches():
        rows = slice(row, row + len(batch))
        known = np.isfinite(batch.quaternion).all(axis=1)
        R_K_A = Rotation.from_quat(batch.quaternion[known], scalar_first=True)
        np.add.at(total, number[rows][known], R_K_A.apply(np.asarray(imu.acc[rows])[known]))
        np.add.at(samples, number[rows][known], 1.0)
        row = rows.stop
    enough = samples > 0.5 * MEAN_S * imu.rate_hz
    times = start_s + MEAN_S * (np.arange(len(samples)) + 0.5)
    directions: FloatArray = unit(total[enough])
    return np.asarray(times[enough], dtype=float), directions


def skeleton_filled(recovery: Recovery) -> Iterator[str]:
    """A program filled the skeleton's gaps and called that tracked."""
    if recovery.residuals is None:
        return
    count = int(np.count_nonzero(recovery.residuals.reason == Rejection.INTERPOLATED))
    if count > FEW_FILLED:
        yield (
            f"a program filled gaps of the skeleton and marked them as tracked ({count} samples lie on lines"
            " or cubics): treated as not seen; export the skeleton without filling and filtering"
        )
