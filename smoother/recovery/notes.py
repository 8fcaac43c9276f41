"""Notes on a result for its reader, one sentence each."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..array_types import BoolArray
from ..measurements.clock import LARGEST_OFFSET_S, Clock
from ..measurements.segment import Timeline
from ..measurements.visibility import Gap, Rejection
from ..recording import Recording
from ..result import FrameResiduals
from ..selfcal.self_calibration import SelfCalibration
from ..window.prepare import REACH_S

#: A one-sided gap longer than this deserves a sentence, s.
OPEN_GAP_S = 0.5
#: Time without any answer that deserves one, s.
UNANSWERED_S = 1.0
#: Where more of the camera's samples than this are rejected, something else is wrong.
HARDLY_AGREE = 0.3
#: A clock that drifts more than this deserves a sentence, s.
DRIFT_S = 0.005


def notes_on(
    recording: Recording,
    timeline: Timeline,
    model: SelfCalibration,
    clock: Clock,
    residuals: FrameResiduals,
    gaps: tuple[Gap, ...],
    unexplained: Sequence[Gap],
) -> tuple[str, ...]:
    """Sentences on pauses, clocks, mounting, rejected samples, open gaps and unexplained ones.

    Parameters
    ----------
    recording : Recording
    timeline : Timeline
        Of the recording.
    model : SelfCalibration
    clock : Clock
        Of the camera's stamps as they were recorded.
    residuals : FrameResiduals
    gaps : tuple of Gap
    unexplained : sequence of Gap
        Long gaps that were solved without the upper arm's length, because the motion contradicts it.
    """
    return (
        *recording.notes,
        *_pauses(recording, timeline),
        *_clock(timeline, clock),
        *_mounting(model),
        *_rejected(residuals),
        *_open_gaps(gaps, "upper_arm" in model.estimate.mountings),
        *_unanswered(recording, timeline, gaps),
        *_unexplained(unexplained),
    )


def _pauses(recording: Recording, timeline: Timeline) -> list[str]:
    t = recording.imu.t_s
    return [
        f"the IMU stream pauses from {t[a.stop - 1]:.2f} s to {t[b.start]:.2f} s: the recording is solved"
        " apart on both sides, and nothing is recovered in between"
        for a, b in pairwise(timeline.segments)
    ]


def _clock(timeline: Timeline, clock: Clock) -> list[str]:
    notes = []
    if timeline.synthetic_stamps:
        notes.append(
            "the camera's frames are spread evenly at a rate that no camera runs at: their times were made"
            " up, dropped frames are hidden, and fast movement is known less well"
        )
    if abs(clock.mean_s) > LARGEST_OFFSET_S:
        notes.append(
            f"the camera's clock and the IMU's are {abs(clock.mean_s):.2f} s apart: look whether the answer"
            " follows the camera"
        )
    if clock.drift_s > DRIFT_S:
        notes.append(f"the camera's clock drifts by {1e3 * clock.drift_s:.0f} ms over the recording")
    return notes


def _mounting(model: SelfCalibration) -> list[str]:
    if not model.mounting_unknown:
        return []
    return [
        "the forearm hardly moved in view, or turned about the vertical only: how the sensor sits on it is"
        " not known, so orientation and the sensor's own position are uncertain throughout; flex the elbow,"
        " raise the arm and turn the hand over in view, or give a calibration"
    ]


def _rejected(residuals: FrameResiduals) -> list[str]:
    count = int(np.count_nonzero(residuals.reason))
    if not count:
        return []
    tracked = count + int(np.count_nonzero(residuals.used))
    was = "was" if count == 1 else "were"
    note = f"{count} of {tracked} tracked samples of the camera {was} rejected"
    if np.count_nonzero(_contradicted(residuals)) > HARDLY_AGREE * tracked:
        note += (
            "; camera and IMU hardly agree, and the answer is not to be trusted: check that their clocks"
            " agree to a minute, and that the IMU was on this arm"
        )
    return [note]


def _contradicted(residuals: FrameResiduals) -> BoolArray:
    """Samples that were rejected, but for those that a program filled in."""
    reason = residuals.reason
    return np.asarray((reason != Rejection.NONE) & (reason != Rejection.INTERPOLATED))


def _open_gaps(gaps: tuple[Gap, ...], two_imus: bool) -> list[str]:
    why = f", by {'both IMUs' if two_imus else 'one IMU'}: its sigma gives its accuracy"
    return [
        f"the gap from {gap.start_s:.1f} s to {gap.end_s:.1f} s is open at its"
        f" {'start' if gap.open_start else 'end'}: it is recovered from one side{why}"
        for gap in gaps
        if (gap.open_start or gap.open_end) and gap.length_s > OPEN_GAP_S
    ]


def _unanswered(recording: Recording, timeline: Timeline, gaps: tuple[Gap, ...]) -> list[str]:
    """Times of the IMU that lie beyond the ends of open gaps: the answer does not reach so far."""
    beyond: list[tuple[float, float]] = []
    for segment in timeline.segments:
        start_s, end_s = recording.imu.t_s[[segment.start, segment.stop - 1]].tolist()
        here = [gap for gap in gaps if gap.end_s > start_s and gap.start_s < end_s]
        since_s: float | None = start_s
        for gap in here:
            if gap.open_start and since_s is not None:
                beyond.append((since_s, gap.start_s))
            since_s = gap.end_s if gap.open_end else None
        if here and since_s is not None:
            beyond.append((since_s, end_s))
    return [
        f"from {a:.1f} s to {b:.1f} s nothing is recovered: that is more than {REACH_S / 60.0:g} minutes from"
        " all that the camera saw of the forearm"
        for a, b in beyond
        if b - a > UNANSWERED_S
    ]


def _unexplained(gaps: Sequence[Gap]) -> list[str]:
    return [
        f"the gap from {gap.start_s:.1f} s to {gap.end_s:.1f} s: IMU, shoulder and upper arm do not fit"
        " together there; it is recovered without the upper arm's length, and its sigma covers what is open"
        for gap in gaps
    ]
