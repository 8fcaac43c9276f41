"""Samples that cannot be used, and units that cannot be: one place for all readers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray, IntArray
from ...errors import RecordingError
from ...recording import JOINTS, JointState
from ...runtime.store import Store, batches, sampled
from ...units import STANDARD_GRAVITY
from .clock_resets import clock_resets
from .streams import ArmFrames, ImuSamples, PoseSamples
from .unusable import FROZEN, GYRO_LIMIT, ZERO, unusable_samples

#: A stream that loses more of its samples than this is refused.
_LIMIT = 0.05
#: A sensor that sends zeros, or the same over and over, for a larger share of the time was not recorded.
_MOST_PAUSED = 0.5
#: Elbow and wrist are farther apart than this, m an axis.
_ONE_POINT_M = 1e-5
_ELBOW, _WRIST = JOINTS.index("elbow"), JOINTS.index("wrist")
#: No depth camera sees a person farther away, m an axis.
_FARTHEST_M = 20.0
#: No forearm is as long in cm, and none as short in mm.
_FOREARM_CM = 70.0
#: Median rest |acc| to the unit that it looks like.
_ACC_UNITS = ((0.7, 1.4, "g"), (700, 1400, "milli-g or cm/s^2"), (7000, 14000, "mm/s^2"))


def increasing(stamp_ns: IntArray) -> BoolArray:
    """Samples (N,) to keep so that stamps increase strictly.

    A stamp that jumps back makes the later sample the wrong one, a stamp that jumps ahead the
    earlier: whichever reading drops fewer samples is taken.
    """
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return np.ones(len(stamp_ns), bool)
    after_all = np.ones(len(stamp_ns), bool)
    after_all[1:] = stamp_ns[1:] > np.maximum.accumulate(stamp_ns)[:-1]
    before_all = np.ones(len(stamp_ns), bool)
    before_all[:-1] = stamp_ns[:-1] < np.minimum.accumulate(stamp_ns[::-1])[::-1][1:]
    return after_all if after_all.sum() >= before_all.sum() else before_all


def clean_imu(stream: ImuSamples, source: str, store: Store | None = None) -> tuple[ImuSamples, list[str]]:
    """Drop what cannot be used of an IMU, and check its units.

    Nothing is copied where nothing is dropped.

    Parameters
    ----------
    stream : ImuSamples
        Samples as recorded.
    source : str
        The file, for messages.
    store : Store, optional
        Where what is kept is to lie; None = in memory.

    Returns
    -------
    stream : ImuSamples
        With finite samples and increasing stamps.
    notes : list of str
        What was dropped, one sentence each.

    Raises
    ------
    RecordingError
        More than 5 % of the samples would be dropped, the clock was set back, or a unit cannot be.
    """
    store = store or Store()
    _refuse_set_back(stream.stamp_ns, stream.acc, stream.topic, source, "samples")
    finite = _finite(stream.acc) & _finite(stream.gyro)
    causes = unusable_samples(stream.stamp_ns, stream.acc, stream.gyro)
    usable = finite.copy()
    for cause in (FROZEN, ZERO):
        if cause in causes:
            usable &= ~causes[cause]
    _check_units(stream, usable, source)  # values beyond any range may tell of a unit
    keep, notes = _keep(stream.stamp_ns, finite, causes, stream.topic, source, "samples")
    cleaned = replace(
        stream,
        stamp_ns=kept(stream.stamp_ns, keep, store),
        acc=kept(stream.acc, keep, store),
        gyro=kept(stream.gyro, keep, store),
        mag=None if stream.mag is None else kept(stream.mag, keep, store),
    )
    if len(cleaned.stamp_ns) < 2:
        raise RecordingError(
            f"{source}: {stream.topic} has {len(cleaned.stamp_ns)} usable samples; record it again."
        )
    return cleaned, notes


def clean_arm(arm: ArmFrames, source: str, store: Store | None = None) -> tuple[ArmFrames, list[str]]:
    """Drop frames with repeated or backward stamps, and tracked joints without a position.

    Parameters, returns, raises : as `clean_imu`.
    """
    store = store or Store()
    _refuse_set_back(arm.stamp_ns, arm.position[:, _WRIST], arm.label, source, "frames")
    keep, notes = _keep(arm.stamp_ns, np.ones(len(arm.stamp_ns), bool), {}, arm.label, source, "frames")
    position, state = kept(arm.position, keep, store), arm.state[keep]
    claimed = state != JointState.NOT_TRACKED
    there, far = np.empty(claimed.shape, bool), np.zeros(claimed.shape, bool)
    for part in batches(len(position)):
        there[part] = np.isfinite(position[part]).all(axis=2)
        with np.errstate(invalid="ignore"):
            far[part] = claimed[part] & (abs(position[part]) > _FARTHEST_M).any(axis=2) & there[part]
    broken = claimed & ~there
    if broken.any():
        if broken.sum() > _LIMIT * claimed.sum():
            raise RecordingError(
                f"{source}: {broken.sum()} of {claimed.sum()} joint positions of {arm.label} are not "
                "numbers, which is too many to drop; check the recorder."
            )
        notes.append(f"{arm.label}: {broken.sum()} joint positions are not numbers and count as not tracked.")
        state[broken] = JointState.NOT_TRACKED
    if far.any():
        _check_metres(position, state, arm.label, source)
        if far.sum() > _LIMIT * claimed.sum():
            raise RecordingError(
                f"{source}: {far.sum()} of {claimed.sum()} joint positions of {arm.label} are farther than "
                f"{_FARTHEST_M:.0f} m from the camera, which is too many to drop; check the unit."
            )
        notes.append(
            f"{arm.label}: {far.sum()} joint positions are farther than {_FARTHEST_M:.0f} m from the camera "
            "and count as not tracked."
        )
        state[far] = JointState.NOT_TRACKED
    notes += _drop_points(position, state, arm.label, source)
    position = _without(position, state == JointState.NOT_TRACKED, store)
    return replace(arm, stamp_ns=kept(arm.stamp_ns, keep, store), position=position, state=state), notes


def _drop_points(position: FloatArray, state: NDArray[np.int8], label: str, source: str) -> list[str]:
    """Joints of frames in which elbow and wrist lie in one point become not tracked; a note says how many."""
    claimed = (state[:, _ELBOW] != JointState.NOT_TRACKED) & (state[:, _WRIST] != JointState.NOT_TRACKED)
    same = np.zeros(len(state), bool)
    for part in batches(len(state)):
        apart = abs(position[part, _ELBOW] - position[part, _WRIST]).max(axis=1)
        same[part] = claimed[part] & (apart < _ONE_POINT_M)
    if not same.any():
        return []
    if same.sum() > _LIMIT * claimed.sum():
        raise RecordingError(
            f"{source}: elbow and wrist of {label} coincide in {same.sum()} of {claimed.sum()} frames,"
            " which is too many to drop; check the body tracking."
        )
    state[same] = JointState.NOT_TRACKED
    return [f"{label}: elbow and wrist coincide in {same.sum()} frames, which count as not tracked."]


def clean_poses(poses: PoseSamples, store: Store | None = None) -> tuple[PoseSamples, list[str]]:
    """Drop poses with repeated or backward stamps; those that are not finite stay as nan."""
    store = store or Store()
    keep = increasing(poses.stamp_ns)
    dropped = int((~keep).sum())
    notes = [f"{poses.topic}: {dropped} poses with repeated or backward stamps dropped."] if dropped else []
    score = None if poses.score is None else poses.score[keep]
    position, quaternion = kept(poses.position, keep, store), kept(poses.quaternion, keep, store)
    turned = np.empty(len(quaternion), bool)
    for part in batches(len(quaternion)):
        length = np.linalg.norm(quaternion[part], axis=1)
        turned[part] = np.isfinite(length) & (length > 0.5)
    return (
        replace(
            poses,
            stamp_ns=kept(poses.stamp_ns, keep, store),
            position=_without(position, ~_finite(position), store),
            quaternion=_without(quaternion, ~turned, store),
            score=score,
            joints={name: kept(values, keep, store) for name, values in poses.joints.items()},
        ),
        notes,
    )


def _finite(values: FloatArray) -> BoolArray:
    """Rows (N,) of finite numbers."""
    finite = np.empty(len(values), bool)
    for part in batches(len(values)):
        finite[part] = np.isfinite(values[part]).all(axis=1)
    return finite


def kept(values: NDArray, keep: BoolArray, store: Store) -> NDArray:
    """The rows to keep (n,) of a column (N, ...); the same array where that is all."""
    count = int(keep.sum())
    if count == len(values):
        return values
    rest, filled = store.array((count, *values.shape[1:]), 0, values.dtype), 0
    for part in batches(len(values)):
        rows = values[part][keep[part]]
        rest[filled : filled + len(rows)] = rows
        filled += len(rows)
    return rest


def _without(values: FloatArray, gone: BoolArray, store: Store) -> FloatArray:
    """A copy with nan where values are to go; the same array where they are nan already."""
    if all(np.isnan(values[part][gone[part]]).all() for part in batches(len(values))):
        return values
    out = store.array(values.shape, 0.0)
    for part in batches(len(values)):
        out[part] = values[part]
        out[part][gone[part]] = np.nan
    return out


def _check_metres(position: FloatArray, state: NDArray[np.int8], label: str, source: str) -> None:
    """Judged by an even sub-sample of a long recording's frames."""
    tracked = sampled(state) == JointState.TRACKED
    if not tracked.any():
        return
    places = sampled(position)
    far = float(np.median(np.linalg.norm(places[tracked], axis=1)))
    if far <= _FARTHEST_M:
        return
    both = tracked[:, _ELBOW] & tracked[:, _WRIST]
    forearm = np.linalg.norm(places[both, _ELBOW] - places[both, _WRIST], axis=1)
    # A forearm tells both units apart at any distance; a single joint does so by where people stand.
    is_mm = np.median(forearm) > _FOREARM_CM if len(forearm) else far > 1000
    raise RecordingError(
        f"{source}: the joints of {label} lie about {far:.0f} from the camera, which looks like "
        f"{'millimetres' if is_mm else 'centimetres'}; convert them to metres (position_unit ="
        f' "{"mm" if is_mm else "cm"}" in a recording.toml).'
    )


def _refuse_set_back(stamp_ns: IntArray, values: FloatArray, name: str, source: str, what: str) -> None:
    """Dropping what goes back would leave all that follows at the wrong time."""
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return
    _, steps = clock_resets((stamp_ns - stamp_ns[0]) / 1e9, values)
    if steps:
        (by, at), more = steps[0], f" (and {len(steps) - 1} more)" if len(steps) > 1 else ""
        raise RecordingError(
            f"{source}: the clock of {name} was set back by {by:.3g} s at {at:.1f} s of it{more}, so the"
            f" times of its {what} behind that are not known; cut the recording there, or import the device's"
            " own file (`unocclude import files`), whose times then go on."
        )


def _keep(
    stamp_ns: IntArray, finite: BoolArray, unusable: dict[str, BoolArray], topic: str, source: str, what: str
) -> tuple[NDArray[np.bool_], list[str]]:
    measured = finite.copy()
    for mask in unusable.values():
        measured &= ~mask
    if measured.all():
        keep = increasing(stamp_ns)
    else:
        keep = measured.copy()
        keep[measured] = increasing(stamp_ns[measured])
    dropped, total = int((~keep).sum()), len(keep)
    if not dropped:
        return keep, []
    not_numbers = int((~finite).sum())
    causes = []
    if not_numbers:
        causes.append(f"{not_numbers} not finite")
    for cause, mask in unusable.items():
        if count := int((mask & finite).sum()):
            causes.append(f"{count} {cause}")
    if stamps := int((measured & ~keep).sum()):
        causes.append(f"{stamps} with repeated or backward stamps")
    # a sensor that sent nothing for a while paused; what is around it counts
    paused = np.zeros(total, bool)
    for cause in (FROZEN, ZERO):
        paused |= unusable.get(cause, paused)
    pauses = int(paused.sum())
    if dropped - pauses > _LIMIT * (total - pauses) or pauses > _MOST_PAUSED * total:
        raise RecordingError(
            f"{source}: {dropped} of {total} {what} of {topic} cannot be used ({', '.join(causes)}), "
            "which is too many to drop; check the recorder."
        )
    return keep, [f"{topic}: {dropped} of {total} {what} dropped ({', '.join(causes)})."]


def _check_units(stream: ImuSamples, finite: BoolArray, source: str) -> None:
    # A long recording is judged by an even sub-sample.
    usable = sampled(finite)
    acc, gyro = sampled(stream.acc)[usable], sampled(stream.gyro)[usable]
    if not len(acc):
        return
    with np.errstate(over="ignore"):
        rate = np.linalg.norm(gyro, axis=1)
    fast = float(np.percentile(rate, 99))
    if fast > GYRO_LIMIT:
        raise RecordingError(
            f"{source}: the gyroscope of {stream.topic} reads up to {fast:.0f}, which cannot be rad/s and "
            "looks like deg/s; convert it to rad/s (gyroscope_unit in a recording.toml)."
        )
    # The quietest fifth, whatever the gyroscope's unit and offset are.
    quiet = rate <= np.percentile(rate, 20)
    with np.errstate(over="ignore"):
        rest = float(np.median(np.linalg.norm(acc[quiet], axis=1)))
    if 0.5 * STANDARD_GRAVITY < rest < 2 * STANDARD_GRAVITY:
        return
    for low, high, unit in _ACC_UNITS:
        if low < rest < high:
            raise RecordingError(
                f"{source}: the accelerometer of {stream.topic} reads {rest:.4g} at rest instead of 9.81, "
                f"which looks like {unit}; convert it to m/s^2 (accelerometer_unit in a recording.toml)."
            )
    why = "gravity seems to have been taken out" if rest < 0.7 else "the unit is not known"
    raise RecordingError(
        f"{source}: the accelerometer of {stream.topic} reads {rest:.4g} at rest instead of 9.81 m/s^2 "
        f"({why}); record the raw specific force in m/s^2."
    )
