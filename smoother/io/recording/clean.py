"""What no sensor measured is dropped: zeros, frozen values, ends of the range, lone spikes; units settled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray, IntArray
from ...errors import RecordingError
from ...linalg import runs
from ...measurements.timestamps import clock_resets, even_times, in_packets, increasing
from ...recording import JOINTS, JointState
from ...runtime.store import batches, by_rows, sampled
from ...units import STANDARD_GRAVITY
from ..mcap.messages import nanoseconds, seconds
from ..tables.imu import GYRO_LIMIT, in_shown_units, rest_size, with_halves_joined
from .streams import ArmFrames, ImuSamples, PoseSamples, RecordingFile, kept, rows_of, without_outlying

#: Names of two causes.
ZERO, FROZEN = "all zero", "frozen"
#: No accelerometer of a body-worn sensor reads beyond this, m/s^2 per axis.
ACC_LIMIT = 500.0
#: A value that repeats to the last bit for this long, s and samples, is frozen, if the sensor turns ..
_FROZEN_S, _FROZEN_SAMPLES = 0.25, 8
#: .. this fast, rad/s, or is moved this much, m/s^2.
_TURNS, _MOVES = 0.2, 2.0
#: Of a sensor at rest it is, if the sensor is noisy elsewhere: by this much from sample to sample, rad/s.
_FROZEN_AT_REST_S, _NOISE = 1.0, 1e-3
#: An extreme value in this many samples in a row is the end of the range; the smallest ranges, rad/s and
#: m/s^2.
_PLATEAU, _SMALLEST_GYRO, _SMALLEST_ACC = 3, 4.0, 19.0
#: A sample off both its neighbours, which agree: by this much, and so well, rad/s and m/s^2.
_SPIKE_GYRO, _SPIKE_ACC = (5.0, 1.0), (100.0, 10.0)
#: At lower rates a peak may last one sample, Hz.
_SPIKE_RATE_HZ = 50.0


def unusable_samples(
    stamp_ns: IntArray,  # int (N,) ns
    acc: FloatArray,  # (N, 3) m/s^2 and rad/s
    gyro: FloatArray,  # (N, 3) m/s^2 and rad/s
) -> dict[str, BoolArray]:  # bool (N,)
    """Which samples cannot have been measured, by why; each sample under one cause at most."""
    count = len(stamp_ns)
    zero, beyond, same, spike = (np.zeros(count, bool) for _ in range(4))
    step = np.diff(stamp_ns[: min(count, 100_000)])
    rate = 1e9 / float(np.median(step)) if len(step) and np.median(step) > 0 else np.nan
    highest = np.zeros((2, 3))
    with np.errstate(invalid="ignore", over="ignore"):
        for part in batches(count):
            rows = slice(max(part.start - 1, 0), min(part.stop + 1, count))
            # with the samples in a row, what is taken over three axes takes a tenth of the time
            a, g = np.ascontiguousarray(acc[rows].T), np.ascontiguousarray(gyro[rows].T)
            mine = slice(part.start - rows.start, part.stop - rows.start)
            zero[part] = np.all((a[:, mine] == 0) & (g[:, mine] == 0), axis=0)
            beyond[part] = np.any((abs(a[:, mine]) > ACC_LIMIT) | (abs(g[:, mine]) > GYRO_LIMIT), axis=0)
            for sensor, values in enumerate((a, g)):
                inside = np.where(abs(values) <= (ACC_LIMIT, GYRO_LIMIT)[sensor], abs(values), 0.0)
                highest[sensor] = np.maximum(highest[sensor], inside.max(axis=1, initial=0.0))
            if rows.stop - rows.start > 1:
                equal = ((a[:, 1:] == a[:, :-1]) & (g[:, 1:] == g[:, :-1])).all(axis=0)
                same[rows.start + 1 : rows.stop] = equal
            if rows.stop - rows.start > 2 and rate >= _SPIKE_RATE_HZ:
                lone = _spikes(a, *_SPIKE_ACC) | _spikes(g, *_SPIKE_GYRO)
                spike[rows.start + 1 : rows.stop - 1] |= lone
    causes = {
        ZERO: zero,
        "beyond any sensor's range": beyond,
        FROZEN: _frozen(same, acc, gyro, rate) if same.any() else same,
        "at the end of the range": _plateaus(acc, gyro, highest),
        "lone spikes": spike,
    }
    taken = np.zeros(count, bool)
    for mask in causes.values():
        mask &= ~taken
        taken |= mask
    return {cause: mask for cause, mask in causes.items() if mask.any()}


def _spikes(values: FloatArray, off: float, agree: float) -> BoolArray:
    """Inner samples (n - 2,) of three axes (3, n) off both neighbours, which agree."""
    before, after = values[:, :-2], values[:, 2:]
    apart = abs(after - before).max(axis=0)
    lone: BoolArray = (abs(values[:, 1:-1] - 0.5 * (after + before)).max(axis=0) > off) & (apart < agree)
    return lone


def _frozen(same: BoolArray, acc: FloatArray, gyro: FloatArray, rate: float) -> BoolArray:
    """Runs of equal samples in motion; at rest too where the sensor is noisy otherwise."""
    frozen = np.zeros(len(same), bool)
    if not rate > 0:
        return frozen
    is_noisy: bool | None = None
    for rows in runs(same):
        length = rows.stop - rows.start
        if length < max(_FROZEN_SAMPLES, _FROZEN_S * rate):
            continue
        force = abs(float(np.linalg.norm(acc[rows.start])) - STANDARD_GRAVITY)
        moves = float(abs(gyro[rows.start]).max()) > _TURNS or force > _MOVES
        if not moves and length >= _FROZEN_AT_REST_S * rate and is_noisy is None:
            is_noisy = _is_noisy(same, gyro)
        if moves or (is_noisy and length >= _FROZEN_AT_REST_S * rate):
            frozen[rows] = True
    return frozen


def _is_noisy(same: BoolArray, gyro: FloatArray) -> bool:
    """Whether a sensor's values vary from sample to sample also where it is quiet."""
    for part in batches(len(same)):
        g = np.asarray(gyro[part])
        varied = ~same[part][2:] & ~same[part][1:-1]
        change = abs(g[2:] - 2 * g[1:-1] + g[:-2]).max(axis=1, initial=0.0)[varied]
        if len(change) > 100:
            return bool(np.percentile(change[np.isfinite(change)], 10) > _NOISE)
    return False


def _plateaus(acc: FloatArray, gyro: FloatArray, highest: FloatArray) -> BoolArray:
    """Samples in runs of the largest value of an axis, where that may be the end of a range."""
    clipped = np.zeros(len(acc), bool)
    for sensor, (values, least) in enumerate(((acc, _SMALLEST_ACC), (gyro, _SMALLEST_GYRO))):
        for axis in np.flatnonzero(highest[sensor] > least).tolist():
            at_end = np.zeros(len(values), bool)
            for part in batches(len(values)):
                at_end[part] = abs(values[part, axis]) == highest[sensor, axis]
            for rows in runs(at_end):
                if rows.stop - rows.start >= _PLATEAU:
                    clipped[rows] = True
    return clipped


#: A stream that loses more of its samples than this is refused.
_LIMIT = 0.05
#: A sensor that sends zeros, or the same over and over, for a larger share of the time was not recorded.
_MOST_PAUSED = 0.5
#: Elbow and wrist are farther apart than this, m per axis.
_ONE_POINT_M = 1e-5
_ELBOW, _WRIST = JOINTS.index("elbow"), JOINTS.index("wrist")
#: No depth camera sees a person farther away, m per axis.
_FARTHEST_M = 20.0
#: No forearm is as long in cm, and none as short in mm.
_FOREARM_CM = 70.0


def clean_imu(stream: ImuSamples, source: str) -> tuple[ImuSamples, list[str]]:
    """Drop what cannot be used of an IMU, and check its units."""
    stream, packets = _out_of_packets(stream)
    acc, gyro = stream.vectors
    _refuse_set_back(stream.stamp_ns, acc, stream.topic, source, "samples")
    finite = _finite(acc) & _finite(gyro)
    causes = unusable_samples(stream.stamp_ns, acc, gyro)
    usable = finite.copy()
    for cause in (FROZEN, ZERO):
        if cause in causes:
            usable &= ~causes[cause]
    _check_units(stream, usable, source)  # values beyond any range may be due to a wrong unit
    keep, notes = _keep(stream.stamp_ns, finite, causes, stream.topic, source, "samples")
    cleaned = rows_of(stream, keep)
    if len(cleaned.stamp_ns) < 2:
        raise RecordingError(
            f"{source}: {stream.topic} has {len(cleaned.stamp_ns)} usable samples, too few; record it again."
        )
    return cleaned, packets + notes


def _out_of_packets(stream: ImuSamples) -> tuple[ImuSamples, list[str]]:
    """Samples that were stamped as their packets arrived, on the even times that those show; and a note."""
    stamp = stream.stamp_ns
    t_s = np.asarray((stamp - stamp[:1]) * 1e-9, float)
    even = even_times(t_s) if in_packets(t_s) else None
    if even is None:
        return stream, []
    return replace(stream, stamp_ns=stamp[0] + np.rint(even.t_s * 1e9).astype(np.int64)), [
        f"{stream.topic}: stamps are those of packets with several samples; the samples were counted at the"
        f" even rate of {1 / even.tick_s:.2f} Hz that they show."
    ]


def clean_arm(arm: ArmFrames, source: str) -> tuple[ArmFrames, list[str]]:
    """Drop frames with repeated or backward stamps, and tracked joints without a position."""
    _refuse_set_back(arm.stamp_ns, arm.position[:, _WRIST], arm.label, source, "frames")
    keep, notes = _keep(arm.stamp_ns, np.ones(len(arm.stamp_ns), bool), {}, arm.label, source, "frames")
    position, state = kept(arm.position, keep), arm.state[keep]
    farthest = _FARTHEST_M if arm.lens is None else np.inf  # pixels are not metres
    broken = by_rows(lambda place: ~np.isfinite(place).all(axis=2), position)
    far = ~broken & by_rows(lambda place: (abs(place) > farthest).any(axis=2), position)
    same = by_rows(
        lambda place: abs(place[:, [_ELBOW]] - place[:, [_WRIST]]).max(axis=2) < _ONE_POINT_M, position
    )
    for mask, what, remedy in (
        (broken, "joint positions are not numbers", "check the recorder"),
        (far, f"joint positions are farther than {_FARTHEST_M:.0f} m from the camera", "check the unit"),
        (same, "frames have elbow and wrist in one point", "check the body tracking"),
    ):
        claimed = state != JointState.NOT_TRACKED
        if mask is same:  # of frames, which lose all joints
            claimed &= claimed[:, [_ELBOW, _WRIST]].all(axis=1, keepdims=True)
        gone = claimed & mask
        if not gone.any():
            continue
        if mask is far:
            _check_metres(position, state, arm.label, source)
        count, total = (int((m.any(axis=1) if mask is same else m).sum()) for m in (gone, claimed))
        if count > _LIMIT * total:
            raise RecordingError(
                f"{source}: {arm.label}: {count} of {total} {what}, too many to drop; {remedy}."
            )
        notes.append(f"{arm.label}: {count} {what}; treated as not tracked.")
        state[gone] = JointState.NOT_TRACKED
    position = _without(position, state == JointState.NOT_TRACKED)
    return replace(arm, stamp_ns=kept(arm.stamp_ns, keep), position=position, state=state), notes


def clean_poses(poses: PoseSamples) -> tuple[PoseSamples, list[str]]:
    """Drop poses with repeated or backward stamps; those that are not finite stay as nan."""
    keep = increasing(poses.stamp_ns)
    dropped = int((~keep).sum())
    notes = [f"{poses.topic}: {dropped} poses with repeated or backward stamps dropped."] if dropped else []
    poses = rows_of(poses, keep)
    turned = by_rows(lambda part: np.linalg.norm(part, axis=1) > 0.5, poses.quaternion)
    turned &= _finite(poses.quaternion)
    position = _without(poses.position, ~_finite(poses.position))
    return replace(poses, position=position, quaternion=_without(poses.quaternion, ~turned)), notes


def _finite(values: FloatArray) -> BoolArray:
    """Rows (N,) of finite numbers."""
    return by_rows(lambda part: np.isfinite(part).all(axis=1), values)


def _without(values: FloatArray, gone: BoolArray) -> FloatArray:
    """A copy with nan where values are to go."""
    return by_rows(lambda part, none: np.where(none[..., None], np.nan, part), values, gone)


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
    """Dropping stamps that go back would leave all that follows at the wrong time."""
    if (stamp_ns[1:] > stamp_ns[:-1]).all():
        return
    _, steps = clock_resets((stamp_ns - stamp_ns[0]) / 1e9, values)
    if steps:
        (by, at), more = steps[0], f" (and {len(steps) - 1} more)" if len(steps) > 1 else ""
        raise RecordingError(
            f"{source}: the clock of {name} was set back by {by:.3g} s at {at:.1f} s of it{more}, so the"
            f" times of its {what} behind that are not known; cut the recording there, or import the device's"
            " own file (`unocclude import files`), whose times continue."
        )


def _keep(
    stamp_ns: IntArray, finite: BoolArray, unusable: dict[str, BoolArray], topic: str, source: str, what: str
) -> tuple[NDArray[np.bool_], list[str]]:
    measured = finite.copy()
    for mask in unusable.values():
        measured &= ~mask
    keep = measured.copy()
    keep[measured] = increasing(stamp_ns[measured])
    dropped, total = int((~keep).sum()), len(keep)
    if not dropped:
        return keep, []
    masks = {"not finite": ~finite} | {cause: mask & finite for cause, mask in unusable.items()}
    masks["with repeated or backward stamps"] = measured & ~keep
    causes = [f"{count} {cause}" for cause, mask in masks.items() if (count := int(mask.sum()))]
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
    acc, gyro = (sampled(values)[usable] for values in stream.vectors)
    if not len(acc):
        return
    rest, fast = rest_size(acc, gyro)
    if fast > GYRO_LIMIT:
        raise RecordingError(
            f"{source}: the gyroscope of {stream.topic} reads up to {fast:.0f}, which cannot be rad/s; give"
            " gyroscope_unit in a recording.toml, or check the export."
        )
    if 0.5 * STANDARD_GRAVITY < rest < 2 * STANDARD_GRAVITY:
        return
    taken = "gravity seems to have been taken out" if rest < 0.7 else "the unit is not known"
    raise RecordingError(
        f"{source}: the accelerometer of {stream.topic} reads {rest:.4g} at rest instead of 9.81 m/s^2,"
        f" {taken}; record the raw specific force in m/s^2."
    )


#: How a note on a half ends.
LEFT_OUT = "; it was left out."
#: A half whose stamps run back for a larger share of its samples is not joined.
_MOST_BACK = 0.05
#: Fewer samples do not show a unit.
_FEWEST = 100


def settle_imus(file: RecordingFile) -> None:
    """Join the IMUs whose accelerometer and gyroscope are topics of their own, and settle all units."""
    kinds = {id(imu): _only_sensor(imu) for imu in file.imus}
    halves = [imu for imu in file.imus if kinds[id(imu)]]
    if halves:
        file.imus = [imu for imu in file.imus if not kinds[id(imu)]]
        origin = min(int(imu.stamp_ns.min()) for imu in halves)
        tables = [_half(imu, kinds[id(imu)], origin, file) for imu in halves]
        joined, alone, why = with_halves_joined(tables, str(file.path))
        file.halves = [replace(half, t_s=half.t_s + origin / 1e9) for half in alone if half.t_s is not None]
        file.notes += [f"{each}: its other sensor reads zero throughout{LEFT_OUT}" for each in why]
        for imu in joined:
            assert imu.t_s is not None
            file.notes += imu.notes
            stamp = nanoseconds(imu.t_s, origin)
            file.imus.append(replace(imu, stamp_ns=stamp, units="m/s^2, rad/s", notes=[]))
    for at, imu in enumerate(file.imus):
        imu = in_shown_units(replace(imu, t_s=seconds(imu.stamp_ns, int(imu.stamp_ns[0]))))
        file.notes += imu.notes
        file.imus[at] = replace(imu, t_s=None, notes=[])


def _only_sensor(imu: ImuSamples) -> str:
    """The one sensor that was measured where the other reads zero (or nothing) throughout; "" for both."""
    silent = {
        name: not by_rows(lambda part: np.nan_to_num(part).any(axis=1), values).any()
        for name, values in zip(("gyroscope", "accelerometer"), imu.vectors, strict=True)
    }
    if silent["gyroscope"] == silent["accelerometer"]:
        return ""
    acc, gyro = imu.vectors
    name, values = ("gyroscope", gyro) if silent["gyroscope"] else ("accelerometer", acc)
    # what does not vary either is made up, and no sensor's
    return name if len(values) >= _FEWEST and (np.ptp(sampled(values), axis=0) != 0).any() else ""


def _half(imu: ImuSamples, kind: str, origin: int, file: RecordingFile) -> ImuSamples:
    """One sensor of an IMU, with increasing times."""
    stream = without_outlying(imu, file.notes)
    keep = increasing(stream.stamp_ns)
    if (~keep).mean() > _MOST_BACK:
        raise RecordingError(
            f"{file.path}: the stamps of {imu.topic} run back, so its {kind} cannot be joined with the other"
            " sensor's topic; cut the recording there, or record both in one topic."
        )
    half = rows_of(stream, keep)
    half.t_s, half.units = seconds(half.stamp_ns, origin), ""
    if kind == "accelerometer":
        half.gyro = None
    else:
        half.acc = None
    return half
