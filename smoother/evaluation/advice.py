"""Advice for the next recording, from the figures of this one. Every function is pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass

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


@dataclass(frozen=True)
class Rejected:
    """The samples of one joint that were rejected for one reason."""

    reason: str  # The reason's name ("jump")
    why: str  # The same in words
    joint: str  # The joint
    count: int  # Samples
    share: float  # Their part of the joint's tracked ones
    first_s: float  # Times of the first and the last, on the IMU's clock
    last_s: float  # Times of the first and the last, on the IMU's clock

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return asdict(self)


def rejected(recovery: Recovery) -> list[Rejected]:
    """One row per reason and joint, the most frequent reason first, joints from the shoulder down."""
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
    rows = []
    for code in sorted(totals, key=lambda code: (-totals[code], residuals.reasons[code])):
        reason = residuals.reasons[code]
        for column, joint in enumerate(JOINTS):
            if (code, column) in times:
                count, first_s, last_s = times[code, column]
                rows.append(Rejected(*reason, joint, count, count / int(tracked[column]), first_s, last_s))
    return rows


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
    sentences = [
        *_what_was_wrong(recovery),
        *_motion(estimates),
        *_gaps([each for each in gap_summaries(recovery) if each.trusted is not False]),
        *_clock(estimates),
        *_shoulder(recovery),
        *_towards_the_camera(recovery),
        *_camera(recovery, estimates),
        *_rates(recovery),
        *_pauses(recovery),
    ]
    return sentences or [NOTHING]


def _set_up(recovery: Recovery) -> list[str]:
    """What corrects a wrong set-up: its cause where it is known, else every sign of it."""
    estimates = recovery.estimates
    what = estimates.cause or "; ".join(estimates.reasons) or "the cause is not known"
    sentences = [f"Correct the set-up first: {what}."]
    named = [remedy for remedy in estimates.remedies if remedy not in what]
    if named:
        sentences.append(f"Run `unocclude smooth` again with {' or '.join(named)}.")
    return sentences


def _what_was_wrong(recovery: Recovery) -> list[str]:
    """Why some times are not to be trusted, to be avoided next time."""
    reasons = dict.fromkeys(why for each in recovery.estimates.untrusted for why in each.reasons)
    if not reasons:
        return []
    more = f"; and {len(reasons) - _MOST_REASONS} more" if len(reasons) > _MOST_REASONS else ""
    named = "; ".join(list(reasons)[:_MOST_REASONS])
    return [f"Avoid the causes of the parts that are not to be trusted: {named}{more}."]


def _motion(estimates: ArmEstimates | None) -> list[str]:
    if estimates is None or estimates.all_given:
        return []
    evidence, frame = estimates.evidence, estimates.frame
    point = is_point(evidence)
    if little_motion(estimates):
        what = "turn and move the sensor" if point else "bend and stretch the elbow and raise the arm"
        return [
            f"Begin with 20 s of lively motion in view ({what}): this recording showed"
            f" {evidence.visible_s:.0f} s, turning {_degrees(evidence.turning_rad_s)} degrees/s on average."
        ]
    if point:
        return []
    sentences = []
    if (
        frame is not None
        and frame.roll_sigma_rad > ROLL_SIGMA_RAD
        and not evidence.axial_rad > LITTLE_AXIAL_RAD
        and estimates.calibration.R_F_A is None
    ):
        how = f"is {known_to(frame.roll_sigma_rad)}"
        sentences.append(
            "Turn the forearm about its own axis, palm up and palm down, three times in view: on which side"
            f" of the forearm the sensor sits {how}."
        )
    worst = {
        joint: float(np.max(beyond(lever.sigma_m, estimates.joint_bias_sigma_m)))
        for joint, lever in estimates.calibration.lever_arms.items()
        if joint not in estimates.given
    }
    rough = [joint for joint, sigma in worst.items() if sigma > LEVER_SIGMA_M]
    if rough:
        sentences.append(
            f"Move the arm about more than one axis in view, sideways too: where the {_listed(rough)}"
            f" {'lies' if len(rough) == 1 else 'lie'} as seen from the sensor is known to"
            f" {100 * max(worst[joint] for joint in rough):.1f} cm only."
        )
    return sentences


def little_motion(estimates: ArmEstimates | None) -> bool:
    """Whether too little was seen to learn the arm and the clock from."""
    if estimates is None:
        return False
    evidence = estimates.evidence
    return evidence.visible_s < LITTLE_VISIBLE_S or not evidence.turning_rad_s >= LITTLE_TURNING_RAD_S


def _degrees(rate_rad_s: float) -> str:
    return f"{np.degrees(rate_rad_s):.0f}" if np.isfinite(rate_rad_s) else "0"


def _gaps(gaps: list[GapSummary]) -> list[str]:
    sentences = []
    early = [each for each in gaps if each.gap.open_start]
    late = [each for each in gaps if each.gap.open_end]
    if early or late:
        when = [
            *(["before the first movement out of view"] if early else []),
            *(["after the last one"] if late else []),
        ]
        was = "was" if len(early) + len(late) == 1 else "were"
        sentences.append(
            f"Keep the forearm in view for at least 1.5 s {' and '.join(when)}: the gap"
            f"{_times([*early, *late])} {was} seen from one side only."
        )
    two_sided = [each for each in gaps if not each.one_sided]
    weak = [each for each in two_sided if each.is_weaker_than(WEAK_M)]
    long = [each for each in weak if each.gap.length_s > LONG_GAP_S]
    if long:
        sentences.append(
            f"Bring the forearm into view for a moment every {LONG_GAP_S:.0f} s: in the gap{_times(long)} the"
            f" position is known to {100 * max(each.sigma_max_m or 0.0 for each in long):.0f} cm only."
        )
    return sentences


def _times(gaps: list[GapSummary]) -> str:
    starts = [f"{each.gap.start_s:.1f} s" for each in gaps]
    if len(starts) > 4:
        starts = [*starts[:3], f"{len(starts) - 3} more"]
    return f"{'s' if len(gaps) > 1 else ''} at {_listed(starts)}"


def _clock(estimates: ArmEstimates | None) -> list[str]:
    if estimates is None:
        return []
    sentences = []
    for each in estimates.offsets:
        if each.sigma_s > CLOCK_SIGMA_S:
            sentences.append(
                "Move briskly at the start, in view: the clocks of sensor and camera were matched to"
                f" {1000 * each.sigma_s:.0f} ms only."
            )
        if each.drift_s > CLOCK_DRIFT_S:
            sentences.append(
                "Keep the time stamps that the devices measure, not those of arrival or made up later: the"
                f" clocks moved against each other by {1000 * each.drift_s:.0f} ms."
            )
    return sentences


def _shoulder(recovery: Recovery) -> list[str]:
    tracked = _tracked(recovery, "shoulder")
    if not tracked.any():
        return (
            ["Keep the shoulder in view: it and the upper arm's length limit how far away the elbow can be."]
            if _tracked(recovery, "elbow").any() and recovery.gaps
            else []
        )
    hidden = _inside(recovery.arm.t_s, recovery.gaps)
    if hidden.sum() < 5 or tracked[hidden].mean() >= SHOULDER_SHARE:
        return []
    return [
        "Keep the shoulder in view while the forearm is hidden: it was seen in"
        f" {100 * tracked[hidden].mean():.0f} % of those frames, and it limits where the elbow can be."
    ]


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


def _towards_the_camera(recovery: Recovery) -> list[str]:
    if not {"elbow", "wrist"} <= recovery.joints.keys():
        return []
    visible = along = 0
    for batch in recovery.batches():
        pointing = towards_the_camera(batch.joints["elbow"], batch.joints["wrist"])
        pointing = pointing[~batch.occluded & np.isfinite(pointing)]
        visible, along = visible + len(pointing), along + int((pointing < RAY_DEG).sum())
    share = along / max(visible, 1)
    frames = max(int(_tracked(recovery, "wrist").sum()), 1)
    lost = sum(
        row.count for row in rejected(recovery) if row.reason == "viewing ray" and row.joint == "wrist"
    )
    if share < RAY_SHARE and lost < RAY_REJECTED * frames:
        return []
    return [
        "Stand a little sideways to the camera, or put it higher: the forearm pointed at it"
        f" {100 * share:.0f} % of the time, when a depth camera sees it worst."
    ]


def towards_the_camera(elbow: FloatArray, wrist: FloatArray) -> FloatArray:
    """Angle (N,) between the forearm's line and the viewing ray, degrees, 0 to 90; nan without an answer."""
    along, ray = wrist - elbow, wrist + elbow
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.abs(np.sum(along * ray, axis=1)) / (
            np.linalg.norm(along, axis=1) * np.linalg.norm(ray, axis=1)
        )
        return np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))


def _camera(recovery: Recovery, estimates: ArmEstimates | None) -> list[str]:
    sentences = []
    rows = rejected(recovery)
    frozen = _share(recovery, (row.count for row in rows if row.reason == "frozen"))
    if frozen > FREEZES:
        sentences.append(
            f"Check the skeleton tracker's load and settings: {100 * frozen:.0f} % of its samples repeated"
            " the one before while the arm moved."
        )
    # what contradicts a motion that was hardly there says little of the camera
    wrong = (
        ("jump", "bone length")
        if little_motion(estimates)
        else ("jump", "bone length", "direction", "residual")
    )
    jumping = _share(recovery, (row.count for row in rows if row.reason in wrong))
    if jumping > JUMPS:
        sentences.append(
            "Clear the view of other people and of things near the arm, and avoid bright light behind:"
            f" {100 * jumping:.0f} % of the tracked samples were not on the arm."
        )
    noise = {} if estimates is None else {joint: each.sample_m for joint, each in estimates.camera.items()}
    loud = [joint for joint, sigma in noise.items() if sigma > CAMERA_SIGMA_M]
    if loud:
        sentences.append(
            "Move closer to the camera (1.5 to 3 m), with even light and without loose sleeves: the"
            f" {_listed(loud)} jittered by {100 * max(noise[joint] for joint in loud):.1f} cm."
        )
    if estimates is not None and estimates.joint_bias_sigma_m > JOINT_BIAS_M:
        sentences.append(
            "Let the camera see the arm from the front and without wide sleeves: it places the joints"
            f" {100 * estimates.joint_bias_sigma_m:.1f} cm off, always in the same way."
        )
    return sentences


def _share(recovery: Recovery, counts: Iterable[int]) -> float:
    """Part of all tracked samples."""
    if recovery.residuals is None:
        return 0.0
    batches = recovery.residuals.batches()
    tracked = sum(int(np.count_nonzero(batch.used | (batch.reason != 0))) for batch in batches)
    return sum(counts) / max(tracked, 1)


def _pauses(recovery: Recovery) -> list[str]:
    """Times without samples of the IMU: nothing is recovered in them."""
    after = pauses(recovery.t_s)
    pauses_s = recovery.t_s[after] - recovery.t_s[after - 1]
    if not len(pauses_s):
        return []
    times = "once" if len(pauses_s) == 1 else f"{len(pauses_s)} times"
    return [
        f"The IMU paused {times}, for {pauses_s.sum():.1f} s in all, and nothing is recovered there: check"
        " its battery, and keep its receiver near."
    ]


def _rates(recovery: Recovery) -> list[str]:
    sentences = []
    if len(recovery) > 1:
        rate = float(1.0 / np.median(np.diff(recovery.t_s), overwrite_input=True))
        if rate < 0.97 * SLOW_IMU_HZ:
            sentences.append(f"Set the sensor to 80 samples per second or more: it gave {rate:.0f}.")
    if recovery.arm.rate_hz < SLOW_CAMERA_HZ:
        sentences.append(f"Let the camera run at 30 frames per second: it gave {recovery.arm.rate_hz:.0f}.")
    return sentences


def _listed(names: Iterable[str]) -> str:
    *first, last = list(names)
    return f"{', '.join(first)} and {last}" if first else last
