"""What recordings showed that a calibration from motion can rest on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.array_types import BoolArray, FloatArray
from smoother.measurements.segment import Segment
from smoother.recording import JOINTS
from smoother.result import Recovery

#: Turning about the forearm's axis is measured within so much time: the gyro's sum drifts, s.
AXIAL_S = 10.0


@dataclass(frozen=True)
class Evidence:
    """What the camera saw, and how the forearm moved meanwhile.

    Attributes
    ----------
    visible_s : float, s
        Time with the forearm visible.
    frames : dict of str to int
        Accepted samples by joint; `upper_arm` counts frames with shoulder and elbow.
    turning_rad_s : float, rad/s
        Rms of the IMU's angular velocity in that time; nan without any.
    axial_rad : float, rad
        How far the forearm turned about its own axis within 10 s of it, at best; nan where its direction
        is not known.
    """

    visible_s: float
    frames: dict[str, int]
    turning_rad_s: float
    axial_rad: float


@dataclass(frozen=True)
class ClockOffset:
    """A recording's clock offset, t_imu = t_camera + offset; it belongs to that recording alone.

    Attributes
    ----------
    recording : str
        Its name.
    offset_s, sigma_s : float, s
        Mean offset and its standard deviation; nan where the recording told nothing.
    drift_s : float, s
        How far the offset wandered.
    """

    recording: str
    offset_s: float = float("nan")
    sigma_s: float = float("nan")
    drift_s: float = float("nan")


def gather(segments: Sequence[Segment], direction: FloatArray | None) -> Evidence:
    """The evidence of the segments of one or several recordings.

    Parameters
    ----------
    direction : ndarray, shape (3,), optional
        Unit vector elbow to wrist in {A}, or None where it is not known.

    Returns
    -------
    Evidence
    """
    frames = {joint: sum(_count(segment, joint) for segment in segments) for joint in JOINTS}
    frames["upper_arm"] = sum(_count(segment, "shoulder", "elbow") for segment in segments)
    square, time, axial = 0.0, 0.0, 0.0
    for segment in segments:
        t, rates = _rates(segment)
        dt = np.diff(t)
        seen = _visible(segment, 0.5 * (t[1:] + t[:-1]))
        square += float(np.sum(dt[seen] * np.sum(rates[seen] ** 2, axis=1)))
        time += float(dt[seen].sum())
        if direction is not None:
            axial = max(axial, _axial(t, np.append(0.0, np.cumsum(dt * (rates @ direction))), seen))
    return Evidence(
        visible_s=time,
        frames=frames,
        turning_rad_s=float(np.sqrt(square / time)) if time > 0 else float("nan"),
        axial_rad=float("nan") if direction is None else axial,
    )


def gather_from(recovery: Recovery) -> Evidence:
    """The evidence of one recovered recording: how its answer turned while the camera saw the forearm."""
    known = recovery.calibration
    direction = None if known is None else known.forearm_direction
    frames = _frames_of(recovery)
    if len(recovery) < 2:
        return Evidence(0.0, frames, float("nan"), float("nan"))
    square, time = 0.0, 0.0
    angle, visible = np.zeros(len(recovery)), np.zeros(len(recovery) - 1, bool)
    at = 0
    for batch in recovery.batches(overlap=1):
        turn, seen = _turns(batch)
        dt = np.diff(batch.t_s)
        square += float(np.sum(turn[seen] ** 2 / dt[seen, None]))
        time += float(dt[seen].sum())
        visible[at : at + len(dt)] = seen
        if direction is not None:
            angle[at + 1 : at + 1 + len(dt)] = turn @ direction
        at += len(dt)
    axial = float("nan")
    if direction is not None:
        axial = _axial(recovery.t_s, np.cumsum(angle, out=angle), visible)
    return Evidence(time, frames, float(np.sqrt(square / time)) if time > 0 else float("nan"), axial)


def _turns(recovery: Recovery) -> tuple[FloatArray, BoolArray]:
    """Rotation vectors (N - 1, 3) in {A} from sample to sample, zero without an answer; which were seen."""
    q = recovery.quaternion
    good: BoolArray = np.all(np.isfinite(q), axis=1)
    both = good[1:] & good[:-1] & (np.diff(recovery.t_s) > 0)
    turn = np.zeros((len(both), 3))
    turn[both] = _turn_between(q[:-1][both], q[1:][both])
    return turn, both & ~(recovery.occluded[1:] | recovery.occluded[:-1])


def _turn_between(before: FloatArray, after: FloatArray) -> FloatArray:
    """Rotation vectors (n, 3) of conj(before) * after, quaternions (n, 4) with qw first.

    A fifth of the time that scipy's `Rotation` takes for it, which counts where every sample is asked.
    """
    w0, w1, v0, v1 = before[:, 0], after[:, 0], before[:, 1:], after[:, 1:]
    w = w0 * w1 + np.einsum("ni,ni->n", v0, v1)
    v = w0[:, None] * v1 - w1[:, None] * v0 - np.cross(v0, v1)
    sine = np.linalg.norm(v, axis=1)
    angle = 2.0 * np.arctan2(sine, np.abs(w)) * np.where(w < 0, -1.0, 1.0)
    return v * np.divide(angle, sine, out=2.0 / w, where=sine > 0)[:, None]


def _frames_of(recovery: Recovery) -> dict[str, int]:
    """Camera samples by joint that took part; those tracked where the method keeps no residuals."""
    if recovery.residuals is not None:
        parts = (batch.used for batch in recovery.residuals.batches())
    else:
        parts = (np.stack([f.tracked(joint) for joint in JOINTS], axis=1) for f in recovery.frame_batches())
    counts, both = np.zeros(len(JOINTS), np.int64), 0
    for used in parts:
        counts += np.count_nonzero(used, axis=0)
        both += int(used[:, [JOINTS.index("shoulder"), JOINTS.index("elbow")]].all(axis=1).sum())
    return dict(zip(JOINTS, counts.tolist(), strict=True)) | {"upper_arm": both}


def _count(segment: Segment, *joints: str) -> int:
    columns = [JOINTS.index(joint) for joint in joints]
    return int(segment.accepted[:, columns].all(axis=1).sum())


def _rates(segment: Segment) -> tuple[FloatArray, FloatArray]:
    """Edges (n + 1,) every 20 ms or so, and the mean angular velocity (n, 3) between them, rad/s in {A}."""
    count = max(int((segment.end_s - segment.start_s) / 0.02), 2)
    t = np.linspace(segment.start_s, segment.end_s, count + 1)
    return t, segment.signal.mean(t[:-1], t[1:])[:, 3:] - segment.attitude.gyroscope_bias


def _visible(segment: Segment, t: FloatArray) -> BoolArray:
    """(n,) whether the frame next to each time shows the forearm; clock offsets are too small to matter."""
    seen = segment.accepted[:, 1:].sum(axis=1) >= segment.needed
    after = np.clip(np.searchsorted(segment.frame_t_camera, t), 1, len(segment.frame_t_camera) - 1)
    before = after - 1
    nearer = t - segment.frame_t_camera[before] < segment.frame_t_camera[after] - t
    nearest = np.where(nearer, before, after)
    return seen[nearest] & (np.abs(segment.frame_t_camera[nearest] - t) < 0.1)


def _axial(t: FloatArray, angle: FloatArray, seen: BoolArray) -> float:
    """Largest range of an angle (n + 1,) over visible intervals (n,) within `AXIAL_S`, rad."""
    best = 0.0
    for start in np.arange(t[0], t[-1], 0.5 * AXIAL_S):
        end = start + AXIAL_S
        first, last = np.searchsorted(t, start) - 1, np.searchsorted(t, end) + 1
        near = slice(max(int(first), 0), int(last))  # an interval more on either side
        when = 0.5 * (t[near][1:] + t[near][:-1])
        middle = 0.5 * (angle[near][1:] + angle[near][:-1])
        inside = seen[near.start : near.start + len(when)] & (when >= start) & (when < end)
        if inside.any():
            best = max(best, float(np.ptp(middle[inside])))
    return best
