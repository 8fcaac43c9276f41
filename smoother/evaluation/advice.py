"""Rejected camera samples, and advice for the next recording: what no other part of a result says."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

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
    reason, rows = residuals.reason, []
    tracked = np.count_nonzero(residuals.used | (reason != 0), axis=0)
    codes, counts = np.unique(reason[reason != 0], return_counts=True)
    for _, code in sorted(zip((-counts).tolist(), codes.tolist(), strict=True)):
        for column in np.flatnonzero((reason == code).any(axis=0)).tolist():
            t_s = residuals.t_s[reason[:, column] == code]
            rows.append(
                {"reason": residuals.reasons[code].label, "why": residuals.reasons[code].words}
                | {"joint": JOINTS[column], "count": len(t_s), "share": len(t_s) / int(tracked[column])}
                | {"first_s": float(t_s[0]), "last_s": float(t_s[-1])}
            )
    return rows


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
LONG_GAP_S, WEAK_M, CAMERA_SIGMA_M = 3.0, 0.05, 0.015
REJECTED_SHARE, SHOULDER_SHARE = 0.02, 0.5
SLOW_IMU_HZ, SLOW_CAMERA_HZ = 39.0, 14.0
#: Why samples are rejected, by the sentence that helps.
_REASONS = {
    "ray": ("viewing ray",),
    "frozen": ("frozen",),
    "jumps": ("jump", "bone length", "direction", "residual"),
}

_said = partial(said, "advice")


def advice(recovery: Recovery) -> list[str]:
    """What to do better next time, one sentence each, where the verdict does not say it already."""
    found = recovery.estimates
    if found.trusted is False:  # what follows from a wrong set-up is no fault of the view or the camera
        return []
    return list(_advice(recovery)) or ([] if found.cautions else [_said("nothing")])


def _advice(recovery: Recovery) -> Iterator[str]:
    if causes := dict.fromkeys(why for each in recovery.estimates.untrusted for why in each.reasons):
        yield _said("avoid", reasons="; ".join(causes))
    gaps = [each for each in gap_summaries(recovery) if each.trusted is not False]
    if open_ended := [each for each in gaps if each.one_sided]:
        yield _said("one_sided", times=_times(open_ended))
    weak = [each for each in gaps if each.length_s > LONG_GAP_S and (each.sigma_max_m or 0.0) > WEAK_M]
    if weak := [each for each in weak if not each.one_sided]:
        cm = 100 * max(each.sigma_max_m or 0.0 for each in weak)
        yield _said("long_gaps", every_s=LONG_GAP_S, times=_times(weak), cm=cm)
    arm, rows = recovery.arm, rejected(recovery)
    shoulder, hidden = arm.tracked("shoulder"), occluded_at(arm.t_s, recovery.gaps)
    if hidden.sum() >= 5 and arm.tracked("elbow").any() and shoulder[hidden].mean() < SHOULDER_SHARE:
        yield _said("shoulder", percent=100 * shoulder[hidden].mean())
    kept = recovery.residuals
    tracked = 1 if kept is None else max(np.count_nonzero(kept.used | (kept.reason != 0)), 1)
    for name, reasons in _REASONS.items():
        share = sum(row["count"] for row in rows if row["reason"] in reasons) / tracked
        if share > REJECTED_SHARE:
            yield _said(name, percent=100 * share)
    noise = recovery.estimates.camera_sigma_m or {}
    if loud := [joint for joint, sigma in noise.items() if sigma > CAMERA_SIGMA_M]:
        yield _said("noise", joints=listed(loud), cm=100 * max(noise.values()))
    t_s = recovery.t_s
    if len(t_s) > 1 and (imu_hz := 1.0 / float(np.median(np.diff(t_s)))) < SLOW_IMU_HZ:
        yield _said("slow_imu", hz=imu_hz)
    if arm.rate_hz < SLOW_CAMERA_HZ:
        yield _said("slow_camera", hz=arm.rate_hz)
    if len(after := pauses(t_s)):  # of the IMU, in which nothing is recovered
        yield _said("pauses", count=len(after), total_s=(t_s[after] - t_s[after - 1]).sum())


def _times(gaps: list[GapSummary]) -> str:
    starts = [f"{each.start_s:.1f} s" for each in gaps]
    return listed(starts if len(starts) <= 4 else [*starts[:3], f"{len(starts) - 3} more"])
