"""Advice for the next recording, from the figures of this one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from calib.motion import (
    LITTLE_AXIAL_RAD,
    LITTLE_TURNING_RAD_S,
    LITTLE_VISIBLE_S,
    ROLL_SIGMA_RAD,
    ArmEstimates,
    beyond,
    is_point,
    known_to,
)

from ..array_types import BoolArray, FloatArray
from ..linalg import unit
from ..measurements.timestamps import pauses
from ..measurements.visibility import occluded_at
from ..recording import JOINTS
from ..result import Recovery
from .summary import GapSummary, gap_summaries


def rejected(recovery: Recovery) -> list[dict[str, Any]]:
    """Rejected samples by reason and joint, the most frequent reason first, joints from the shoulder down.

    `reason` and the same in words (`why`), `joint`, `count`, `share` of the joint's tracked samples, and
    the times of the first and the last, on the IMU's clock.
    """
    residuals = recovery.residuals
    if residuals is None:
        return []
    times: dict[tuple[int, int], tuple[int, float, float]] = {}  # count, first and last by reason and joint
    tracked = np.zeros(len(JOINTS), np.int64)
    for batch in residuals.batches():
        tracked += np.count_nonzero(batch.used | (batch.reason != 0), axis=0)
        for code in np.unique(batch.reason[batch.reason != 0]).tolist():
            for column in np.flatnonzero((batch.reason == code).any(axis=0)).tolist():
                t_s = batch.t_s[batch.reason[:, column] == code]
                count, first_s, _ = times.get((code, column), (0, float(t_s[0]), 0.0))
                times[code, column] = count + len(t_s), first_s, float(t_s[-1])
    totals = {code: sum(row[0] for (other, _), row in times.items() if other == code) for code, _ in times}
    return [
        {"reason": residuals.reasons[code].label, "why": residuals.reasons[code].words}
        | {"joint": JOINTS[column], "count": count, "share": count / int(tracked[column])}
        | {"first_s": first_s, "last_s": last_s}
        for (code, column), (count, first_s, last_s) in sorted(
            times.items(), key=lambda row: (-totals[row[0][0]], residuals.reasons[row[0][0]], row[0][1])
        )
    ]


#: From here on a figure of a recording is worth a sentence.
LEVER_SIGMA_M = CAMERA_SIGMA_M = JOINT_BIAS_M = 0.015
CLOCK_SIGMA_S, CLOCK_DRIFT_S = 0.010, 0.020
LONG_GAP_S, WEAK_M = 3.0, 0.05
FREEZES = JUMPS = RAY_REJECTED = 0.02
RAY_DEG, RAY_SHARE = 20.0, 0.15
SHOULDER_SHARE = 0.5
SLOW_IMU_HZ, SLOW_CAMERA_HZ = 40.0, 14.0

#: More reasons than these are counted.
_MOST_REASONS = 4

NOTHING = "No changes recommended: record the next one in the same way."


def advice(recovery: Recovery, estimates: ArmEstimates | None) -> list[str]:
    """What to do better next time, one sentence each, what helps most first."""
    found = recovery.estimates
    if found.trusted is False:  # its cause where it is known, else every sign of it
        what = found.cause or "; ".join(found.reasons) or "the cause is not known"
        named = [remedy for remedy in found.remedies if remedy not in what]
        again = [f"Run `unocclude smooth` again with {' or '.join(named)}."] if named else []
        return [f"Correct the set-up first: {what}.", *again]
    reasons = list(dict.fromkeys(why for each in found.untrusted for why in each.reasons))
    more = f"; and {len(reasons) - _MOST_REASONS} more" if len(reasons) > _MOST_REASONS else ""
    rows = [
        (
            bool(reasons),
            "Avoid the causes of the parts that are not to be trusted:"
            f" {'; '.join(reasons[:_MOST_REASONS])}{more}.",
        ),
        *_motion(estimates),
        *_gaps([each for each in gap_summaries(recovery) if each.trusted is not False]),
        *_clock(estimates),
        *_view(recovery),
        *_camera(recovery, estimates),
        *_rates(recovery),
    ]
    return [sentence for applies, sentence in rows if applies] or [NOTHING]


#: Whether a sentence applies, and the sentence.
_Rows = Iterator[tuple[bool, str]]


def _motion(estimates: ArmEstimates | None) -> _Rows:
    if estimates is None or estimates.all_given:
        return
    evidence, frame, little = estimates.evidence, estimates.frame, little_motion(estimates)
    what = "bend and stretch the elbow and raise the arm"
    if is_point(evidence):
        what = "turn and move the sensor"
    turning_deg_s = np.degrees(np.nan_to_num(evidence.turning_rad_s))
    yield (
        little,
        f"Begin with 20 s of lively motion in view ({what}): this recording showed"
        f" {evidence.visible_s:.0f} s, turning {turning_deg_s:.0f} degrees/s on average.",
    )
    if little or is_point(evidence):
        return
    if frame is not None:
        is_rolled = frame.roll_sigma_rad > ROLL_SIGMA_RAD and not evidence.axial_rad > LITTLE_AXIAL_RAD
        yield (
            is_rolled and estimates.calibration.R_F_A is None,
            "Turn the forearm about its own axis, palm up and palm down, three times in view: on which side"
            f" of the forearm the sensor sits is {known_to(frame.roll_sigma_rad)}.",
        )
    sigmas = {
        joint: float(np.max(beyond(lever.sigma_m, estimates.joint_bias_sigma_m)))
        for joint, lever in estimates.calibration.lever_arms.items()
        if joint not in estimates.given
    }
    rough = [joint for joint, sigma in sigmas.items() if sigma > LEVER_SIGMA_M]
    yield (
        bool(rough),
        f"Move the arm about more than one axis in view, sideways too: where the {listed(rough)}"
        f" {'lies' if len(rough) == 1 else 'lie'} as seen from the sensor is known to"
        f" {100 * max(sigmas.values(), default=0.0):.1f} cm only.",
    )


def little_motion(estimates: ArmEstimates | None) -> bool:
    """Whether too little was seen to learn the arm and the clock from."""
    if estimates is None:
        return False
    evidence = estimates.evidence
    return evidence.visible_s < LITTLE_VISIBLE_S or not evidence.turning_rad_s >= LITTLE_TURNING_RAD_S


def _gaps(gaps: list[GapSummary]) -> _Rows:
    early = [each for each in gaps if each.gap.open_start]
    late = [each for each in gaps if each.gap.open_end]
    sides = [(early, "before the first movement out of view"), (late, "after the last one")]
    yield (
        bool(early or late),
        f"Keep the forearm in view for at least 1.5 s {' and '.join(words for some, words in sides if some)}:"
        f" the gap{_times([*early, *late])} {'was' if len(early) + len(late) == 1 else 'were'} seen from one"
        " side only.",
    )
    weak = [each for each in gaps if not each.one_sided and each.is_weaker_than(WEAK_M)]
    long = [each for each in weak if each.gap.length_s > LONG_GAP_S]
    yield (
        bool(long),
        f"Bring the forearm into view for a moment every {LONG_GAP_S:.0f} s: in the gap{_times(long)} the"
        f" position is known to {100 * max((each.sigma_max_m or 0.0 for each in long), default=0):.0f} cm"
        " only.",
    )


def _times(gaps: list[GapSummary]) -> str:
    starts = [f"{each.gap.start_s:.1f} s" for each in gaps]
    if len(starts) > 4:
        starts = [*starts[:3], f"{len(starts) - 3} more"]
    return f"{'s' if len(gaps) > 1 else ''} at {listed(starts)}"


def _clock(estimates: ArmEstimates | None) -> _Rows:
    for each in estimates.offsets if estimates is not None else ():
        yield (
            each.sigma_s > CLOCK_SIGMA_S,
            "Move briskly at the start, in view: the clocks of sensor and camera were matched to"
            f" {1000 * each.sigma_s:.0f} ms only.",
        )
        yield (
            each.drift_s > CLOCK_DRIFT_S,
            "Keep the time stamps that the devices measure, not those of arrival or made up later: the"
            f" clocks moved against each other by {1000 * each.drift_s:.0f} ms.",
        )


def _view(recovery: Recovery) -> _Rows:
    """The shoulder in view; the forearm not along the viewing ray."""
    shoulder, hidden = _tracked(recovery, "shoulder"), occluded_at(recovery.arm.t_s, recovery.gaps)
    seen = shoulder[hidden].mean() if hidden.any() else 1.0
    yield (
        not shoulder.any() and bool(recovery.gaps) and bool(_tracked(recovery, "elbow").any()),
        "Keep the shoulder in view: it and the upper arm's length limit how far away the elbow can be.",
    )
    yield (
        bool(shoulder.any()) and hidden.sum() >= 5 and seen < SHOULDER_SHARE,
        f"Keep the shoulder in view while the forearm is hidden: it was seen in {100 * seen:.0f} % of those"
        " frames, and it limits where the elbow can be.",
    )
    if not {"elbow", "wrist"} <= recovery.joints.keys():
        return
    visible = along = 0
    for batch in recovery.batches():
        pointing = towards_the_camera(batch.joints["elbow"], batch.joints["wrist"])
        pointing = pointing[~batch.occluded & np.isfinite(pointing)]
        visible, along = visible + len(pointing), along + int((pointing < RAY_DEG).sum())
    share, tracked = along / max(visible, 1), int(_tracked(recovery, "wrist").sum())
    rows = rejected(recovery)
    lost = sum(row["count"] for row in rows if (row["reason"], row["joint"]) == ("viewing ray", "wrist"))
    yield (
        share >= RAY_SHARE or lost >= RAY_REJECTED * max(tracked, 1),
        "Stand a little sideways to the camera, or put it higher: the forearm pointed at it"
        f" {100 * share:.0f} % of the time, when a depth camera sees it worst.",
    )


def _tracked(recovery: Recovery, joint: str) -> BoolArray:
    """(F,) frames in which a joint is tracked."""
    parts = [frames.tracked(joint) for frames in recovery.frame_batches()]
    return np.concatenate(parts) if parts else np.zeros(0, bool)


def towards_the_camera(elbow: FloatArray, wrist: FloatArray) -> FloatArray:
    """Angle (N,) between the forearm's line and the viewing ray, degrees, 0 to 90; nan without an answer."""
    cosine = np.abs(np.sum(unit(wrist - elbow) * unit(wrist + elbow), axis=1))
    return np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))


def _camera(recovery: Recovery, estimates: ArmEstimates | None) -> _Rows:
    rows, tracked = rejected(recovery), 0
    if recovery.residuals is not None:
        batches = recovery.residuals.batches()
        tracked = sum(int(np.count_nonzero(batch.used | (batch.reason != 0))) for batch in batches)

    def share(*reasons: str) -> float:
        """Part of all tracked samples."""
        return sum(row["count"] for row in rows if row["reason"] in reasons) / max(tracked, 1)

    yield (
        share("frozen") > FREEZES,
        f"Check the skeleton tracker's load and settings: {100 * share('frozen'):.0f} % of its samples"
        " repeated the one before while the arm moved.",
    )
    # what contradicts a motion that was hardly there says little of the camera
    jumping = share("jump", "bone length", *(() if little_motion(estimates) else ("direction", "residual")))
    yield (
        jumping > JUMPS,
        "Clear the view of other people and of things near the arm, and avoid bright light behind:"
        f" {100 * jumping:.0f} % of the tracked samples were not on the arm.",
    )
    if estimates is None:
        return
    noise = {joint: each.sample_m for joint, each in estimates.camera.items()}
    loud = [joint for joint, sigma in noise.items() if sigma > CAMERA_SIGMA_M]
    yield (
        bool(loud),
        "Move closer to the camera (1.5 to 3 m), with even light and without loose sleeves: the"
        f" {listed(loud)} jittered by {100 * max(noise.values(), default=0.0):.1f} cm.",
    )
    yield (
        estimates.joint_bias_sigma_m > JOINT_BIAS_M,
        "Let the camera see the arm from the front and without wide sleeves: it places the joints"
        f" {100 * estimates.joint_bias_sigma_m:.1f} cm off, always in the same way.",
    )


def _rates(recovery: Recovery) -> _Rows:
    t_s = recovery.t_s
    rate = float(1.0 / np.median(np.diff(t_s), overwrite_input=True)) if len(recovery) > 1 else np.inf
    camera_hz = recovery.arm.rate_hz
    slow = rate < 0.97 * SLOW_IMU_HZ
    yield slow, f"Set the sensor to 80 samples per second or more: it gave {rate:.0f}."
    yield camera_hz < SLOW_CAMERA_HZ, f"Let the camera run at 30 frames per second: it gave {camera_hz:.0f}."
    after = pauses(t_s)  # of the IMU, in which nothing is recovered
    times = "once" if len(after) == 1 else f"{len(after)} times"
    yield (
        bool(len(after)),
        f"The IMU paused {times}, for {(t_s[after] - t_s[after - 1]).sum():.1f} s in all, and nothing is"
        " recovered there: check its battery, and keep its receiver near.",
    )


def listed(names: Iterable[str]) -> str:
    """Names in a sentence, as "a, b and c"."""
    *first, last = list(names) or [""]
    return f"{', '.join(first)} and {last}" if first else last
