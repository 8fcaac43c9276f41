"""Advice for the next recording, from the figures of this one. Every function is pure."""

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
from ..measurements.timestamps import pauses
from ..measurements.visibility import Gap
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
LEVER_SIGMA_M = 0.015
CLOCK_SIGMA_S = 0.010
CLOCK_DRIFT_S = 0.020
LONG_GAP_S = 3.0
WEAK_M = 0.05
CAMERA_SIGMA_M = 0.015
JOINT_BIAS_M = 0.015
FREEZES = 0.02
JUMPS = 0.02
RAY_DEG = 20.0
RAY_SHARE = 0.15
RAY_REJECTED = 0.02
SHOULDER_SHARE = 0.5
SLOW_IMU_HZ = 40.0
SLOW_CAMERA_HZ = 14.0

#: More reasons than these are counted.
_MOST_REASONS = 4

NOTHING = "No changes recommended: record the next one in the same way."


def advice(recovery: Recovery, estimates: ArmEstimates | None) -> list[str]:
    """What to do better next time, one sentence each, what helps most first."""
    if recovery.estimates.trusted is False:
        return _set_up(recovery)
    rows, sentences = rejected(recovery), list[str]()
    reasons = list(dict.fromkeys(why for each in recovery.estimates.untrusted for why in each.reasons))
    if reasons:
        more = f"; and {len(reasons) - _MOST_REASONS} more" if len(reasons) > _MOST_REASONS else ""
        named = "; ".join(reasons[:_MOST_REASONS])
        sentences.append(f"Avoid the causes of the parts that are not to be trusted: {named}{more}.")
    sentences += [
        *_motion(estimates),
        *_gaps([each for each in gap_summaries(recovery) if each.trusted is not False]),
        *_clock(estimates),
        *_shoulder(recovery),
        *_towards_the_camera(recovery, rows),
        *_camera(recovery, estimates, rows),
        *_rates(recovery),
    ]
    return sentences or [NOTHING]


def _set_up(recovery: Recovery) -> list[str]:
    """What corrects a wrong set-up: its cause where it is known, else every sign of it."""
    estimates = recovery.estimates
    what = estimates.cause or "; ".join(estimates.reasons) or "the cause is not known"
    sentences = [f"Correct the set-up first: {what}."]
    if named := [remedy for remedy in estimates.remedies if remedy not in what]:
        sentences.append(f"Run `unocclude smooth` again with {' or '.join(named)}.")
    return sentences


def _motion(estimates: ArmEstimates | None) -> Iterator[str]:
    if estimates is None or estimates.all_given:
        return
    evidence, frame = estimates.evidence, estimates.frame
    point = is_point(evidence)
    if little_motion(estimates):
        what = "turn and move the sensor" if point else "bend and stretch the elbow and raise the arm"
        turning_deg_s = np.degrees(evidence.turning_rad_s) if np.isfinite(evidence.turning_rad_s) else 0.0
        yield (
            f"Begin with 20 s of lively motion in view ({what}): this recording showed"
            f" {evidence.visible_s:.0f} s, turning {turning_deg_s:.0f} degrees/s on average."
        )
    if little_motion(estimates) or point:
        return
    is_rolled = frame is not None and frame.roll_sigma_rad > ROLL_SIGMA_RAD
    if is_rolled and not evidence.axial_rad > LITTLE_AXIAL_RAD and estimates.calibration.R_F_A is None:
        assert frame is not None
        yield (
            "Turn the forearm about its own axis, palm up and palm down, three times in view: on which side"
            f" of the forearm the sensor sits is {known_to(frame.roll_sigma_rad)}."
        )
    worst = {
        joint: float(np.max(beyond(lever.sigma_m, estimates.joint_bias_sigma_m)))
        for joint, lever in estimates.calibration.lever_arms.items()
        if joint not in estimates.given
    }
    if rough := [joint for joint, sigma in worst.items() if sigma > LEVER_SIGMA_M]:
        yield (
            f"Move the arm about more than one axis in view, sideways too: where the {_listed(rough)}"
            f" {'lies' if len(rough) == 1 else 'lie'} as seen from the sensor is known to"
            f" {100 * max(worst[joint] for joint in rough):.1f} cm only."
        )


def little_motion(estimates: ArmEstimates | None) -> bool:
    """Whether too little was seen to learn the arm and the clock from."""
    if estimates is None:
        return False
    evidence = estimates.evidence
    return evidence.visible_s < LITTLE_VISIBLE_S or not evidence.turning_rad_s >= LITTLE_TURNING_RAD_S


def _gaps(gaps: list[GapSummary]) -> Iterator[str]:
    early = [each for each in gaps if each.gap.open_start]
    late = [each for each in gaps if each.gap.open_end]
    if early or late:
        sides = [(early, "before the first movement out of view"), (late, "after the last one")]
        when = " and ".join(words for some, words in sides if some)
        was = "was" if len(early) + len(late) == 1 else "were"
        yield (
            f"Keep the forearm in view for at least 1.5 s {when}: the gap{_times([*early, *late])} {was} seen"
            " from one side only."
        )
    weak = [each for each in gaps if not each.one_sided and each.is_weaker_than(WEAK_M)]
    if long := [each for each in weak if each.gap.length_s > LONG_GAP_S]:
        yield (
            f"Bring the forearm into view for a moment every {LONG_GAP_S:.0f} s: in the gap{_times(long)} the"
            f" position is known to {100 * max(each.sigma_max_m or 0.0 for each in long):.0f} cm only."
        )


def _times(gaps: list[GapSummary]) -> str:
    starts = [f"{each.gap.start_s:.1f} s" for each in gaps]
    if len(starts) > 4:
        starts = [*starts[:3], f"{len(starts) - 3} more"]
    return f"{'s' if len(gaps) > 1 else ''} at {_listed(starts)}"


def _clock(estimates: ArmEstimates | None) -> Iterator[str]:
    for each in estimates.offsets if estimates is not None else ():
        if each.sigma_s > CLOCK_SIGMA_S:
            yield (
                "Move briskly at the start, in view: the clocks of sensor and camera were matched to"
                f" {1000 * each.sigma_s:.0f} ms only."
            )
        if each.drift_s > CLOCK_DRIFT_S:
            yield (
                "Keep the time stamps that the devices measure, not those of arrival or made up later: the"
                f" clocks moved against each other by {1000 * each.drift_s:.0f} ms."
            )


def _shoulder(recovery: Recovery) -> Iterator[str]:
    tracked, hidden = _tracked(recovery, "shoulder"), _inside(recovery.arm.t_s, recovery.gaps)
    if not tracked.any():
        if _tracked(recovery, "elbow").any() and recovery.gaps:
            yield (
                "Keep the shoulder in view: it and the upper arm's length limit how far away the elbow can"
                " be."
            )
    elif hidden.sum() >= 5 and tracked[hidden].mean() < SHOULDER_SHARE:
        yield (
            "Keep the shoulder in view while the forearm is hidden: it was seen in"
            f" {100 * tracked[hidden].mean():.0f} % of those frames, and it limits where the elbow can be."
        )


def _tracked(recovery: Recovery, joint: str) -> BoolArray:
    """(F,) frames in which a joint is tracked."""
    parts = [frames.tracked(joint) for frames in recovery.frame_batches()]
    return np.concatenate(parts) if parts else np.zeros(0, bool)


def _inside(t_s: FloatArray, gaps: Iterable[Gap]) -> BoolArray:
    """(F,) times, in rising order, inside a gap."""
    inside = np.zeros(len(t_s), bool)
    for gap in gaps:
        start, stop = np.searchsorted(t_s, gap.start_s, "right"), np.searchsorted(t_s, gap.end_s, "left")
        inside[start:stop] = True
    return inside


def _towards_the_camera(recovery: Recovery, rows: list[dict[str, Any]]) -> Iterator[str]:
    if not {"elbow", "wrist"} <= recovery.joints.keys():
        return
    visible = along = 0
    for batch in recovery.batches():
        pointing = towards_the_camera(batch.joints["elbow"], batch.joints["wrist"])
        pointing = pointing[~batch.occluded & np.isfinite(pointing)]
        visible, along = visible + len(pointing), along + int((pointing < RAY_DEG).sum())
    share = along / max(visible, 1)
    lost = sum(row["count"] for row in rows if (row["reason"], row["joint"]) == ("viewing ray", "wrist"))
    if share >= RAY_SHARE or lost >= RAY_REJECTED * max(int(_tracked(recovery, "wrist").sum()), 1):
        yield (
            "Stand a little sideways to the camera, or put it higher: the forearm pointed at it"
            f" {100 * share:.0f} % of the time, when a depth camera sees it worst."
        )


def towards_the_camera(elbow: FloatArray, wrist: FloatArray) -> FloatArray:
    """Angle (N,) between the forearm's line and the viewing ray, degrees, 0 to 90; nan without an answer."""
    along, ray = wrist - elbow, wrist + elbow
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.abs(np.sum(along * ray, axis=1)) / (
            np.linalg.norm(along, axis=1) * np.linalg.norm(ray, axis=1)
        )
        return np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))


def _camera(recovery: Recovery, estimates: ArmEstimates | None, rows: list[dict[str, Any]]) -> Iterator[str]:
    tracked = 0
    if recovery.residuals is not None:
        batches = recovery.residuals.batches()
        tracked = sum(int(np.count_nonzero(batch.used | (batch.reason != 0))) for batch in batches)

    def share(*reasons: str) -> float:
        """Part of all tracked samples."""
        return sum(row["count"] for row in rows if row["reason"] in reasons) / max(tracked, 1)

    if (frozen := share("frozen")) > FREEZES:
        yield (
            f"Check the skeleton tracker's load and settings: {100 * frozen:.0f} % of its samples repeated"
            " the one before while the arm moved."
        )
    # what contradicts a motion that was hardly there says little of the camera
    wrong = () if little_motion(estimates) else ("direction", "residual")
    if (jumping := share("jump", "bone length", *wrong)) > JUMPS:
        yield (
            "Clear the view of other people and of things near the arm, and avoid bright light behind:"
            f" {100 * jumping:.0f} % of the tracked samples were not on the arm."
        )
    if estimates is None:
        return
    noise = {joint: each.sample_m for joint, each in estimates.camera.items()}
    if loud := [joint for joint, sigma in noise.items() if sigma > CAMERA_SIGMA_M]:
        yield (
            "Move closer to the camera (1.5 to 3 m), with even light and without loose sleeves: the"
            f" {_listed(loud)} jittered by {100 * max(noise[joint] for joint in loud):.1f} cm."
        )
    if estimates.joint_bias_sigma_m > JOINT_BIAS_M:
        yield (
            "Let the camera see the arm from the front and without wide sleeves: it places the joints"
            f" {100 * estimates.joint_bias_sigma_m:.1f} cm off, always in the same way."
        )


def _rates(recovery: Recovery) -> Iterator[str]:
    if len(recovery) > 1:
        rate = float(1.0 / np.median(np.diff(recovery.t_s), overwrite_input=True))
        if rate < 0.97 * SLOW_IMU_HZ:
            yield f"Set the sensor to 80 samples per second or more: it gave {rate:.0f}."
    if recovery.arm.rate_hz < SLOW_CAMERA_HZ:
        yield f"Let the camera run at 30 frames per second: it gave {recovery.arm.rate_hz:.0f}."
    after = pauses(recovery.t_s)  # of the IMU, in which nothing is recovered
    if len(after):
        length_s = (recovery.t_s[after] - recovery.t_s[after - 1]).sum()
        times = "once" if len(after) == 1 else f"{len(after)} times"
        yield (
            f"The IMU paused {times}, for {length_s:.1f} s in all, and nothing is recovered there: check its"
            " battery, and keep its receiver near."
        )


def _listed(names: Iterable[str]) -> str:
    *first, last = list(names)
    return f"{', '.join(first)} and {last}" if first else last
