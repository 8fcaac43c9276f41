"""Signs that the IMU's samples say little, whatever the set-up: rate, zeros, plateaus, jumps, pauses."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from ..array_types import FloatArray
from ..linalg import runs
from ..measurements.segment import spikes as jumps
from ..measurements.timeline import Timeline
from ..recording import ImuStream, Recording

#: An IMU slower than this, Hz, says too little; one slower than the second is used with care.
TOO_SLOW_HZ, SLOW_HZ = 15.0, 38.0
#: A range's end is a plateau: so many samples of an axis at its largest value, so many of them in a row.
PLATEAU_SAMPLES, PLATEAU_IN_A_ROW = 12, 3
#: Where a larger share of the samples stands at a range's end, the IMU missed too much.
PLATEAU_SHARE = 0.02
#: So many samples in a row without any force are no measurement.
SILENT_SAMPLES = 3
#: So much of a gap, s, within a pause of the IMU is motion that nothing measured.
UNSEEN_S = 0.3


def input_faults(recording: Recording) -> Iterator[str]:
    """What makes the IMU's samples worth little, whatever the set-up: a sentence each."""
    yield from rate(recording.imu, SLOW_HZ)
    yield from zeros(recording.imu)
    yield from clipped(recording.imu, 0.0)


def rate(imu: ImuStream, least_hz: float) -> Iterator[str]:
    """Fewer samples a second than needed."""
    if imu.rate_hz < least_hz:
        yield f"the IMU has {imu.rate_hz:.2g} samples a second, where 40 are needed and 80 are better"


def zeros(imu: ImuStream) -> Iterator[str]:
    """Samples without any force: a sensor that falls freely is a sensor that sends nothing.

    A gyroscope without any noise sends nothing either.
    """
    if len(imu) and not np.asarray(imu.gyro).any():
        yield "the gyroscope sends zeros: look whether it is switched on and exported"
    silent = [
        rows
        for rows in runs(np.asarray(~np.asarray(imu.acc).any(axis=1)))
        if rows.stop - rows.start >= SILENT_SAMPLES
    ]
    if silent:
        count, first_s = sum(rows.stop - rows.start for rows in silent), float(imu.t_s[silent[0].start])
        yield f"the IMU sends zeros ({count} samples, from {first_s:.1f} s on): take them out"


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
    for name, values, unit in (("accelerometer", imu.acc, "m/s^2"), ("gyroscope", imu.gyro, "rad/s")):
        limits, at_end = [], np.zeros(len(imu), dtype=bool)
        for axis in np.asarray(values).T:
            for limit in _plateaus(axis):
                limits.append(limit)
                at_end |= np.abs(axis) == limit
        if limits and at_end.mean() > least_share:
            share = f" in {100 * at_end.mean():.0f} % of its samples" if least_share else ""
            what = "set a wider range" if least_share else "fast movement is less certain"
            yield f"the {name} was clipped at about {max(limits):.0f} {unit}{share}: {what}"


def spikes(imu: ImuStream) -> Iterator[str]:
    """Single samples of the gyroscope that jumped away and back."""
    count = int(np.count_nonzero(jumps(np.asarray(imu.gyro))))
    if count:
        samples, were = ("1 sample", "was") if count == 1 else (f"{count} samples", "were")
        yield f"{samples} of the gyroscope jumped away and back and {were} replaced"


def _plateaus(axis: FloatArray) -> list[float]:
    """Sizes of the largest and the smallest value of an axis (N,), where the sensor stood at it."""
    return [
        abs(float(end))
        for end in (axis.max(initial=0.0), axis.min(initial=0.0))
        if np.count_nonzero(axis == end) >= PLATEAU_SAMPLES
        and max((row.stop - row.start for row in runs(axis == end)), default=0) >= PLATEAU_IN_A_ROW
        and end != 0.0
    ]
