"""Advice for the next recording, from the figures of this one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
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
from ..table import Table, percent, tabulated
from .summary import GapSummary, gap_summaries
from .words import listed, said


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


def rejections(recovery: Recovery) -> Table:
    """Rejected camera samples, one row per reason and joint."""
    columns: dict[str, str | Callable[[Any], object]] = {
        "reason": "reason",
        "in words": "why",
        "joint": "joint",
        "samples": "count",
        "of its tracked ones": lambda row: percent(row["share"]),
        "first, s": lambda row: f"{row['first_s']:.2f}",
        "last, s": lambda row: f"{row['last_s']:.2f}",
    }
    return tabulated("Rejected camera samples", rejected(recovery), columns)


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

_said = partial(said, "advice")
NOTHING = _said("nothing")


def advice(recovery: Recovery, estimates: ArmEstimates | None) -> list[str]:
    """What to do better next time, one sentence each, what helps most first."""
    return list(_advice(recovery, estimates)) or [NOTHING]


def _advice(recovery: Recovery, estimates: ArmEstimates | None) -> Iterator[str]:
    found = recovery.estimates
    if found.trusted is False:  # its cause where it is known, else every sign of it
        what = found.cause or "; ".join(found.reasons) or "the cause is not known"
        yield _said("set_up", what=what)
        if named := [remedy for remedy in found.remedies if remedy not in what]:
            yield _said("again", remedies=" or ".join(named))
        return
    if reasons := list(dict.fromkeys(why for each in found.untrusted for why in each.reasons)):
        if (more := len(reasons) - _MOST_REASONS) > 0:
            reasons = [*reasons[:_MOST_REASONS], f"and {more} more"]
        yield _said("avoid", reasons="; ".join(reasons))
    if estimates is not None and not estimates.all_given:
        yield from _motion(estimates)
    yield from _gaps([each for each in gap_summaries(recovery) if each.trusted is not False])
    for offset in estimates.offsets if estimates is not None else ():
        if offset.sigma_s > CLOCK_SIGMA_S:
            yield _said("clock", ms=1000 * offset.sigma_s)
        if offset.drift_s > CLOCK_DRIFT_S:
            yield _said("drift", ms=1000 * offset.drift_s)
    yield from _view(recovery)
    yield from _camera(recovery, estimates)
    yield from _rates(recovery)


def _motion(estimates: ArmEstimates) -> Iterator[str]:
    evidence, frame, arm = estimates.evidence, estimates.frame, estimates.calibration
    what = "bend and stretch the elbow and raise the arm"
    if is_point(evidence):
        what = "turn and move the sensor"
    if little_motion(estimates):
        turning_deg_s = np.degrees(np.nan_to_num(evidence.turning_rad_s))
        yield _said("motion", what=what, visible_s=evidence.visible_s, turning_deg_s=turning_deg_s)
        return
    if is_point(evidence):
        return
    is_rolled = frame is not None and frame.roll_sigma_rad > ROLL_SIGMA_RAD and arm.R_F_A is None
    if frame is not None and is_rolled and not evidence.axial_rad > LITTLE_AXIAL_RAD:
        yield _said("roll", known=known_to(frame.roll_sigma_rad))
    sigmas = {
        joint: float(np.max(beyond(lever.sigma_m, estimates.joint_bias_sigma_m)))
        for joint, lever in arm.lever_arms.items()
        if joint not in estimates.given
    }
    if rough := [joint for joint, sigma in sigmas.items() if sigma > LEVER_SIGMA_M]:
        yield _said("levers", joints=listed(rough), cm=100 * max(sigmas.values()))


def little_motion(estimates: ArmEstimates | None) -> bool:
    """Whether too little was seen to learn the arm and the clock from."""
    if estimates is None:
        return False
    evidence = estimates.evidence
    return evidence.visible_s < LITTLE_VISIBLE_S or not evidence.turning_rad_s >= LITTLE_TURNING_RAD_S


def _gaps(gaps: list[GapSummary]) -> Iterator[str]:
    if open_ended := [each for each in gaps if each.one_sided]:
        yield _said("one_sided", times=_times(open_ended))
    long = [each for each in gaps if not each.one_sided and each.length_s > LONG_GAP_S]
    if weak := [each for each in long if (each.sigma_max_m or 0.0) > WEAK_M]:
        cm = 100 * max(each.sigma_max_m or 0.0 for each in weak)
        yield _said("long_gaps", every_s=LONG_GAP_S, times=_times(weak), cm=cm)


def _times(gaps: list[GapSummary]) -> str:
    starts = [f"{each.start_s:.1f} s" for each in gaps]
    return listed(starts if len(starts) <= 4 else [*starts[:3], f"{len(starts) - 3} more"])


def _view(recovery: Recovery) -> Iterator[str]:
    """The shoulder in view; the forearm not along the viewing ray."""
    shoulder, hidden = _tracked(recovery, "shoulder"), occluded_at(recovery.arm.t_s, recovery.gaps)
    seen = shoulder[hidden].mean() if hidden.any() else 1.0
    if not shoulder.any() and recovery.gaps and _tracked(recovery, "elbow").any():
        yield _said("shoulder")
    if shoulder.any() and hidden.sum() >= 5 and seen < SHOULDER_SHARE:
        yield _said("shoulder_in_gaps", percent=100 * seen)
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
    if share >= RAY_SHARE or lost >= RAY_REJECTED * max(tracked, 1):
        yield _said("ray", percent=100 * share)


def _tracked(recovery: Recovery, joint: str) -> BoolArray:
    """(F,) frames in which a joint is tracked."""
    parts = [frames.tracked(joint) for frames in recovery.frame_batches()]
    return np.concatenate(parts) if parts else np.zeros(0, bool)


def towards_the_camera(elbow: FloatArray, wrist: FloatArray) -> FloatArray:
    """Angle (N,) between the forearm's line and the viewing ray, degrees, 0 to 90; nan without an answer."""
    cosine = np.abs(np.sum(unit(wrist - elbow) * unit(wrist + elbow), axis=1))
    return np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))


def _camera(recovery: Recovery, estimates: ArmEstimates | None) -> Iterator[str]:
    rows, tracked = rejected(recovery), 0
    if recovery.residuals is not None:
        batches = recovery.residuals.batches()
        tracked = sum(int(np.count_nonzero(batch.used | (batch.reason != 0))) for batch in batches)

    def share(*reasons: str) -> float:
        """Part of all tracked samples."""
        return sum(row["count"] for row in rows if row["reason"] in reasons) / max(tracked, 1)

    if (frozen := share("frozen")) > FREEZES:
        yield _said("frozen", percent=100 * frozen)
    # what contradicts a motion that was hardly there says little of the camera
    jumping = share("jump", "bone length", *(() if little_motion(estimates) else ("direction", "residual")))
    if jumping > JUMPS:
        yield _said("jumps", percent=100 * jumping)
    if estimates is None:
        return
    noise = estimates.camera_sigma_m
    if loud := [joint for joint, sigma in noise.items() if sigma > CAMERA_SIGMA_M]:
        yield _said("noise", joints=listed(loud), cm=100 * max(noise.values()))
    if (bias_m := estimates.joint_bias_sigma_m) > JOINT_BIAS_M:
        yield _said("bias", cm=100 * bias_m)


def _rates(recovery: Recovery) -> Iterator[str]:
    t_s = recovery.t_s
    rate = float(1.0 / np.median(np.diff(t_s), overwrite_input=True)) if len(recovery) > 1 else np.inf
    if rate < 0.97 * SLOW_IMU_HZ:
        yield _said("slow_imu", hz=rate)
    if (camera_hz := recovery.arm.rate_hz) < SLOW_CAMERA_HZ:
        yield _said("slow_camera", hz=camera_hz)
    if len(after := pauses(t_s)):  # of the IMU, in which nothing is recovered
        yield _said("pauses", count=len(after), total_s=(t_s[after] - t_s[after - 1]).sum())
