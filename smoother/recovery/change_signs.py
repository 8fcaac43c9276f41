"""Signs that something changed while the recording ran: the camera moved, the strap slipped or was taken off.

An answer looks well on either side of such a change. Steps of what all samples share are tested in the
linearised problem (`graph.steps`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..array_types import FloatArray
from ..filters import gaussian_smoothed
from ..graph.optimise import chi_square_tail
from ..linalg import runs, unit
from ..measurements.timestamps import PAUSE_SAMPLES
from ..measurements.visibility import Rejection
from ..recording import JOINTS, ImuStream, JointState, Recording
from ..result import Recovery
from ..result.verdict import EVER, Finding, finding
from ..window.solution import Step

#: A step is one where chance, over all kinds and moments that were tried, gives as much so rarely by the
#: model; none of some 300 sound recordings, simulated and real, came to less than 0.2: from there on the gap
#: with it is not to be trusted.
FALSE_ALARM, DOUBTFUL = 0.05, 0.2
#: .. and where, without blocks that the rest contradicts, one within this time, s, is still this rare.
LEFT_CHANCE, LEFT_WITHIN_S = 0.05, 4.0
#: .. else this long on both sides, s, and the gaps there are not to be trusted: a path bends so far away.
BESIDE_S = 1.0
#: The IMU is looked at in batches of this length, s, each reaching so far into the next.
BATCH_S, OVERLAP_S = 60.0, 10.0
#: Fewer filled samples are not worth a word.
FEW_FILLED = 5
#: An IMU that turns by less than this, rad/s (mean over a time, s), for this long, s, is at rest. The forearm
#: turns where more than a share of at least this many frames is this far from their median direction: noise
#: of 3 cm on a forearm is 7 degrees.
STILL_RAD_S, STILL_MEAN_S, STILL_S = 0.03, 0.1, 3.0
STILL_TURN_DEG, STILL_SHARE, STILL_FRAMES = 20.0, 0.2, 30


def changed_for_good(steps: Sequence[Step], left: Sequence[Step]) -> Iterator[Finding]:
    """The most significant step of all: no answer holds before and after it.

    `left` are those without the camera's blocks that the rest contradicts: another body for a while is no
    step, and what is left of a step after a part of one side was taken for such a block still shows it.
    Where it does not, or chance is not that rare, the gap there is not to be trusted. A step that is rare
    without those blocks is one, wherever it is.
    """
    significant = [step for step in steps if _chance(step) * len(steps) < DOUBTFUL]
    if not significant:
        return
    step = max(significant, key=lambda each: each.squared)
    if step.kind == "clock":
        what = f"the clocks of camera and IMU jump by {1e3 * abs(float(step.size[0])):.0f} ms"
        code, cause = "clock-stepped", "samples were lost, or a clock was set"
    else:
        turned_deg, moved_cm = (
            np.degrees(np.linalg.norm(step.size[:-3])),
            100 * np.linalg.norm(step.size[-3:]),
        )
        of = "the sensor on the arm" if step.kind == "mounting" else "all that the camera sees"
        what = f"{of} turns by {turned_deg:.0f} degrees and moves by {moved_cm:.0f} cm, unfelt by the IMU"
        code, cause = "moved-or-slipped", "the camera was moved, or the strap slipped"
    stays = any(_chance(each) * len(left) < FALSE_ALARM for each in left)
    shows_still = [each.at_s for each in left if _chance(each) < LEFT_CHANCE]
    is_rare = _chance(step) * len(steps) < FALSE_ALARM
    if not stays and not (is_rare and any(abs(step.at_s - at_s) < LEFT_WITHIN_S for at_s in shows_still)):
        seems = "" if is_rare else "it seems that "
        yield finding(
            code,
            f"at about {step.at_s:.0f} s {seems}{what}: {cause}, or another body was seen beside it",
            (step.at_s - BESIDE_S, step.at_s + BESIDE_S),
        )
        return
    yield finding(
        code,
        f"at about {step.at_s:.0f} s {what}: {cause}; positions before and after are not in one frame:"
        " cut the recording there (`unocclude cut`) and smooth both parts",
        EVER,
    )


def _chance(step: Step) -> float:
    """Probability that a sound recording shows as much at one moment."""
    return chi_square_tail(0.5 * step.squared, len(step.size))


def imu_lies_still(
    recovery: Recovery,
    recording: Recording,
    gyroscope_bias: FloatArray,  # (3,) rad/s
) -> Iterator[Finding]:
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
            yield finding(
                "imu-taken-off",
                f"from {start_s:.1f} to {end_s:.1f} s the IMU is still while the camera sees the"
                " forearm turn: it was taken off, or the skeleton is another person's",
                (start_s, end_s),
            )


def _batches(imu: ImuStream) -> Iterator[tuple[int, int]]:
    """Rows of batches without a pause, each reaching into the next."""
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
            first = int(np.searchsorted(t, t[last - 1] - OVERLAP_S))


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
