"""How IMUs and arms of a file move together, and what a person reads of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...array_types import FloatArray, IntArray
from ...errors import RecordingError
from ...matching import ImuMatch, Limb, limbs_of, match_imus
from ...recording import JOINTS, ImuStream, JointState, JointTracks
from ...runtime.store import Store, batches
from ...selfcal.pairing import shifted_agreement
from ..mcap.messages import seconds
from .clean import clean_arm, clean_imu
from .streams import ArmFrames, ImuSamples, RecordingFile

_MOTION_S = 0.3
_LAG_S = 1.0
#: Clocks may be this far apart, s.
_FAR_S = 600.0
_MOTION_FRAMES = 20_000
#: Where no two joints tell a direction, the one seen most; of equals the first.
_POINTS = ("wrist", "strap", "hand", "elbow")


def motion_agreement(imu: ImuSamples, arm: ArmFrames) -> float:
    """How well an IMU's turning agrees with what the camera sees of an arm."""
    at, moved = _arm_motion(arm)
    if len(at) < 20:
        return 0.0
    stamp, gyro, _ = _samples_until(imu, int(at.max() + 1e9 * (_LAG_S + 2 * _MOTION_S)))
    if len(stamp) < 20:
        return 0.0
    zero = int(stamp[0])
    t = (stamp - zero) / 1e9
    steps = 0.5 * (gyro[1:] + gyro[:-1]) * np.diff(t)[:, None]
    turned = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    first = (at - zero) / 1e9
    best = 0.0
    for lag in np.arange(-_LAG_S, _LAG_S + 1e-9, 0.04):
        start, stop = first + lag, first + lag + _MOTION_S
        inside = (start >= t[0]) & (stop <= t[-1])
        if inside.sum() < 20:
            continue
        turn = np.stack([np.interp(stop, t, c) - np.interp(start, t, c) for c in turned.T], axis=1)
        angle = np.linalg.norm(turn, axis=1)[inside]
        shift = moved[inside]
        if angle.std() > 1e-6 and shift.std() > 1e-9:
            best = max(best, float(np.corrcoef(angle, shift)[0, 1]))
    return best


def agreement_far_apart(imu: ImuSamples, arm: ArmFrames) -> tuple[float, float, bool]:
    """`shifted_agreement` of an IMU and an arm's first frames."""
    order = np.argsort(arm.stamp_ns, kind="stable")[:_MOTION_FRAMES]
    if not len(order):
        return 0.0, 0.0, False
    stamp, gyro, acc = _samples_until(imu, int(arm.stamp_ns[order].max() + 1e9 * _FAR_S))
    stamp, first = np.unique(stamp, return_index=True)
    if len(stamp) < 2:
        return 0.0, 0.0, False
    zero = int(stamp[0])
    stream = ImuStream(imu.topic, (stamp - zero) / 1e9, acc[first], gyro[first])
    t_s = (arm.stamp_ns[order] - zero) / 1e9
    tracks = JointTracks(arm.topic, t_s, arm.position[order], arm.state[order])
    return shifted_agreement(stream, tracks, _LAG_S)


def _samples_until(imu: ImuSamples, stamp_ns: int) -> tuple[IntArray, FloatArray, FloatArray]:
    """Stamps, rates and accelerations of finite samples in order, up to the first after a time."""
    stamp, gyro, acc = imu.stamp_ns, imu.gyro, imu.acc
    if (stamp[1:] >= stamp[:-1]).all():
        stop = int(np.searchsorted(stamp, stamp_ns, "right")) + 1
        stamp, gyro, acc = stamp[:stop], gyro[:stop], acc[:stop]
    else:
        order = np.argsort(stamp, kind="stable")
        stamp, gyro, acc = stamp[order], gyro[order], acc[order]
    finite = np.isfinite(gyro).all(axis=1) & np.isfinite(acc).all(axis=1)
    return stamp[finite], gyro[finite], acc[finite]


def _arm_motion(arm: ArmFrames) -> tuple[FloatArray, FloatArray]:
    """Start times (ns) of steps of 0.3 s, and how far the forearm turned (rad) or moved (m) in them."""
    tracked = arm.state == JointState.TRACKED
    for part in batches(len(tracked)):
        tracked[part] &= np.isfinite(arm.position[part]).all(axis=2)
    elbow, wrist = JOINTS.index("elbow"), JOINTS.index("wrist")
    both = tracked[:, elbow] & tracked[:, wrist]
    is_pair = bool(both.sum() >= 20)
    point = max((JOINTS.index(joint) for joint in _POINTS), key=lambda index: tracked[:, index].sum())
    rows = np.flatnonzero(both if is_pair else tracked[:, point])
    rows = rows[np.argsort(arm.stamp_ns[rows], kind="stable")[:_MOTION_FRAMES]]
    stamp, seen = arm.stamp_ns[rows], arm.position[rows]
    along = seen[:, point]
    if is_pair:
        along = seen[:, wrist] - seen[:, elbow]
        along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-6)
    if len(stamp) < 2:
        return np.empty(0), np.empty(0)
    later = np.searchsorted(stamp, stamp + int(_MOTION_S * 1e9))
    usable = later < len(stamp)
    later = np.minimum(later, len(stamp) - 1)
    step = (stamp[later] - stamp) / 1e9
    usable &= step < 1.5 * _MOTION_S
    moved = np.linalg.norm(along[later] - along, axis=1) * _MOTION_S / np.maximum(step, 1e-6)
    return stamp[usable].astype(float), moved[usable]


#: Clocks may be this far apart, s.
REACH_S = 5.0


def match_streams(
    file: RecordingFile,
    imus: Sequence[ImuSamples],
    arms: Sequence[ArmFrames],
    *,
    method: str = "motion",
    reach_s: float = REACH_S,
    store: Store | None = None,
    may_be: Callable[[int, Limb], bool] | None = None,
) -> tuple[list[ImuMatch], list[str]]:
    """Match some IMUs of a file to some of its arms, by motion alone."""
    store, source = store or Store(), str(file.path)
    notes: list[str] = []
    stamps = [*(imu.stamp_ns for imu in imus), *(arm.stamp_ns for arm in arms)]
    origin = min((int(stamp[0]) for stamp in stamps if len(stamp)), default=0)
    limbs: list[Limb] = []
    for arm in arms:
        if arm.tracked:
            frames, dropped = clean_arm(arm, source, store)
            notes += dropped
            t_s = seconds(frames.stamp_ns, origin, store)
            tracks = JointTracks(arm.topic, t_s, frames.position, frames.state)
            limbs += limbs_of(tracks, arm.body, arm.side, arm.topic)
    streams: list[ImuStream] = []
    for imu in imus:
        try:
            samples, dropped = clean_imu(imu, source, store)
        except RecordingError as error:
            # one broken sensor of a box does not keep the others from being matched
            notes.append(f"{imu.topic} cannot be matched: {error}")
            streams.append(ImuStream(imu.topic, np.empty(0), np.empty((0, 3)), np.empty((0, 3))))
            continue
        notes += dropped
        streams.append(
            ImuStream(imu.topic, seconds(samples.stamp_ns, origin, store), samples.acc, samples.gyro)
        )
    allowed = None
    if may_be is not None:
        allowed = np.array([[may_be(i, limb) for limb in limbs] for i in range(len(streams))], bool)
    try:
        matches = match_imus(streams, limbs, down_of(file, arms), method, reach_s, allowed)
    except RecordingError as error:
        raise RecordingError(f"{source}: {error}.") from None
    return matches, notes + _left_open(streams, limbs, matches, reach_s)


def down_of(file: RecordingFile, arms: Sequence[ArmFrames]) -> FloatArray | None:
    """Rough direction of gravity in {K} as the file states it; None where it does not."""
    if file.gravity_hint is not None:
        return file.gravity_hint
    frames = [file.camera_frame, *(arm.camera_frame for arm in arms)]
    return next((frame.down for frame in frames if frame is not None), None)


def _left_open(
    imus: Sequence[ImuStream], limbs: Sequence[Limb], matches: Sequence[ImuMatch], reach_s: float
) -> list[str]:
    notes = []
    start = min((float(limb.tracks.t_s[0]) for limb in limbs), default=0.0)
    end = max((float(limb.tracks.t_s[-1]) for limb in limbs), default=0.0)
    for imu, match in zip(imus, matches, strict=True):
        if len(imu) and (imu.t_s[0] - reach_s > end or imu.t_s[-1] + reach_s < start):
            notes.append(
                f"{imu.name} and the camera have no time in common, so it cannot be matched; set the clocks "
                f"to within {reach_s:g} s of each other."
            )
        elif len(imu) and not match.is_known:
            best = " or ".join(f"{where} ({p:.0%})" for where, p in match.others[:2])
            notes.append(
                f"{imu.name} may be on {best}: the motion does not settle it; record some seconds in which "
                "this limb moves and the others do something else."
            )
    return notes
