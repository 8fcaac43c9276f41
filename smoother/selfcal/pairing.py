"""Whether skeleton and IMU belong together, and by how much their clocks are apart: proved by the motion.

What must be proved depends on what is known. Streams of one recorder share a clock: an offset near zero is
expected, and they are a pair unless a recording that is long enough shows no agreement. Streams whose clocks
are unrelated have to prove themselves. An offset that the user states is used as it is.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..errors import CalibrationError
from ..measurements.clock import LARGEST_OFFSET_S, Clock
from ..measurements.segment import Timeline
from ..recording import Recording
from ..result.verdict import Pairing
from ..runtime.pool import Pool
from .agreement import CHANCE_SCALE, KNOWN_SCALE, MotionAgreement, OffsetLine, agreement

#: Less likely by chance than this is proof; a clock is moved, or drift believed, from the second on.
PROVED, LIKELY = 1e-3, 1e-2
#: Evidence by which an offset out of reach has to exceed one near zero, where one recorder stamped both: as
#: many times less likely before the motion is seen as e to this.
RECORDER_PRIOR = 7.0
#: An offset that the user gave is contradicted where another has this much more evidence.
GIVEN_PRIOR = 20.0
#: Another offset whose evidence is within this of the best one's is as likely.
AMBIGUOUS = 5.0
#: A sound recording explains at least this part of the camera's turning, its error aside. Where that would be
#: evidence of the first of these, and there is no proof, the pairing is contradicted; from the second
#: on, where there is less than a part of it.
SOUND_EXPLAINED, TELLING, LESS_TELLING, HARDLY_ANY = 0.55, 14.0, 6.0, 0.25
#: A recording longer than this is not too short to tell, s.
ENOUGH_S = 25.0
#: The fine search finds what is left over where the line of offsets is below this everywhere, s.
SMALL_S = 0.15


def find_pairing(
    recording: Recording,
    timeline: Timeline | None = None,
    given: Clock | None = None,
    workers: Pool | None = None,
    along: FloatArray | None = None,
) -> tuple[Pairing | None, Clock | None]:
    """Whether camera and IMU are of one motion, and the clock by which the camera's stamps are to be
    moved.
    """
    return decided(agreement(recording, timeline, workers, along), recording, given)


def decided(
    found: MotionAgreement | None, recording: Recording, given: Clock | None = None
) -> tuple[Pairing | None, Clock | None]:
    """`find_pairing` where the agreement is there already."""
    demanded = recording.clocks_unrelated and given is None
    if found is None:
        return (Pairing(False, 1.0, 0.0, reason=_TOO_SHORT) if demanded else None), None
    if given is not None:
        return _with_given(found, given), None
    line = chosen(found, demanded)
    is_far = line is not found.near
    chance = line.chance
    if is_far:  # another offset that fits about as well is a wrong clock
        scale = KNOWN_SCALE if found.is_mounted else CHANCE_SCALE
        chance = min(1.0, max(chance, float(np.exp(-max(line.evidence - found.rival, 0.0) / scale))))
    proved = chance < PROVED
    reason, caution = "", ""
    seen_s = float(recording.arm.t_s[-1] - recording.arm.t_s[0])
    if not proved:
        if demanded and is_ambiguous(found, line):
            reason = _SEVERAL_OFFSETS
        elif demanded:
            reason = _UNLIKE if is_telling(found, line) and seen_s > ENOUGH_S else _TOO_SHORT
        elif is_telling(found, line):
            reason = _CONTRADICTED
        else:
            caution = _NOT_PROVED
    pairing = Pairing(proved, chance, line.evidence, line.offset_s, reason, caution)
    return pairing, _clock(found, line, recording, demanded)


def chosen(found: MotionAgreement, is_unrelated: bool) -> OffsetLine:
    """The line of offsets to use: the best, or the one near zero where one recorder stamped both."""
    if is_unrelated:
        return found.best
    is_better = found.best.evidence > found.near.evidence + RECORDER_PRIOR
    return found.best if is_better and found.best.chance < LIKELY else found.near


def is_ambiguous(found: MotionAgreement, line: OffsetLine) -> bool:
    """Other offsets fit about as well as one that is evident and not near zero."""
    return line is not found.near and line.chance < LIKELY and line.evidence - found.rival < AMBIGUOUS


def is_telling(found: MotionAgreement, line: OffsetLine) -> bool:
    """A sound pair would have shown itself by more than this line has."""
    explained = SOUND_EXPLAINED * (1.0 - found.noise_share)
    expected = -found.freedom * float(np.log1p(-explained))
    return expected > TELLING or (expected > LESS_TELLING and line.evidence < HARDLY_ANY * expected)


def _with_given(found: MotionAgreement, given: Clock) -> Pairing:
    """The user's offset is honoured; strong evidence against it is stated."""
    reason = ""
    apart_s = found.best.offset_s - found.near.offset_s
    is_better = found.best.evidence > found.near.evidence + GIVEN_PRIOR and found.best.chance < PROVED
    if is_better and abs(apart_s) > LARGEST_OFFSET_S + 3.0 * given.sigma_s:
        reason = (
            f"the motion fits a clock offset {apart_s:+.1f} s from the one given: it is likely to be of"
            " another session; run again without --clock-offset and without [clock] in the calibration"
        )
    near = found.near
    return Pairing(not reason, near.chance, near.evidence, given.mean_s + near.offset_s, reason)


def _clock(
    found: MotionAgreement, line: OffsetLine, recording: Recording, is_unrelated: bool
) -> Clock | None:
    """The clock of a line of offsets, None where the fine search reaches it or it is not believed."""
    t = recording.arm.t_s
    ends = np.array([float(t[0]), float(t[-1])])
    if not line.evidence > 0.0 or (not is_unrelated and not line.chance < LIKELY):
        return None
    offsets = line.offset_s + line.skew * (ends - found.middle_s)
    if line.skew and np.ptp(offsets) > SMALL_S:
        return Clock(ends, offsets, SMALL_S, skew=line.skew)
    if abs(line.offset_s) <= LARGEST_OFFSET_S and (
        not line.skew or np.abs(offsets).max() <= LARGEST_OFFSET_S
    ):
        return None
    return Clock(ends[:1], np.array([line.offset_s]), SMALL_S)


_TOO_SHORT = (
    "the clocks of camera and IMU are unrelated, and the motion is too short to decide whether these"
    " files belong together; record 30 s, give a folder of trials with the same strap with --session, or the"
    " offset with --clock-offset"
)
_UNLIKE = (
    "the clocks of camera and IMU are unrelated, and the motion does not show that these files belong"
    " together; check that they are of the same session and arm, or give the offset with --clock-offset"
)
_SEVERAL_OFFSETS = (
    "the clocks of camera and IMU are unrelated, and repeated motion fits several offsets; record 20 s of"
    " irregular motion in view, or give the offset with --clock-offset"
)
_CONTRADICTED = (
    "the IMU does not turn with this forearm: they agree no better than recordings of two sessions do; check"
    " that skeleton and IMU are of the same session and arm"
)
_NOT_PROVED = "the motion in view is too short or too slow to prove that skeleton and IMU belong together"


def pair(
    recording: Recording,
    timeline: Timeline | None = None,
    given: Clock | None = None,
    workers: Pool | None = None,
    along: FloatArray | None = None,
) -> tuple[Recording, Clock | None, Pairing | None]:
    """Whether camera and IMU belong together; their clocks brought to where the fine search reaches.

    `along` (3,) is the forearm's direction in the sensor, where a calibration has it.
    """
    if given is not None:
        recording, timeline = moved(recording, given), None
    pairing, clock = find_pairing(recording, timeline, given, workers, along)
    return (recording if clock is None else moved(recording, clock)), given or clock, pairing


def coarse_offset(recording: Recording, reach_s: float) -> float:
    """t_imu - t_camera to some tens of milliseconds; 0 where the fine search reaches it by itself."""
    found = agreement(recording)
    if found is None:
        return 0.0
    line = chosen(found, recording.clocks_unrelated)
    if is_ambiguous(found, line):
        raise CalibrationError(
            f"{recording.name}: the camera's clock and the IMU's seem {abs(line.offset_s):.1f} s apart, but"
            " repeated motion fits other offsets as well; record 20 s of irregular motion in view"
        )
    is_believed = recording.clocks_unrelated or line.chance < LIKELY
    return line.offset_s if is_believed and abs(line.offset_s) > reach_s else 0.0


def moved(recording: Recording, clock: Clock) -> Recording:
    """The recording with the camera's stamps on the IMU's clock."""
    return replace(recording, arm=replace(recording.arm, t_s=clock.to_imu(recording.arm.t_s)))
