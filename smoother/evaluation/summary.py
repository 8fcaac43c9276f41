"""A recovery summarised in a few numbers: its gaps and how sure it is in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..angles import ForearmMounting, angles_by_joints
from ..angles.definitions import ELBOW_FLEXION
from ..array_types import BoolArray
from ..body import SEGMENTS
from ..calibration import LeverArm
from ..error_radius import error_radius, pooled_radius
from ..measurements.visibility import Gap
from ..recording import JOINTS
from ..result import Estimates, Recovery
from ..rotation import Rotation
from ..table import Table, fixed, percent, tabulated
from .metrics import coverage_95, squared_sigmas

if TYPE_CHECKING:
    import pyarrow as pa

#: About this many samples are pooled to one distance.
_MOST_POOLED = 4000


@dataclass(frozen=True)
class GapSummary(Gap):
    """One gap of a recovery, on the IMU's clock, and the largest uncertainties in it."""

    sigma_max_m: float | None = None  # Standard deviation of the IMU's position, on one axis
    sigma_max_deg: float | None = None  # Of the orientation
    sigma_max_flexion_deg: float | None = None  # Of the elbow's flexion
    error_95_m: float | None = None  # The IMU's position lies within this distance in 95 of 100 cases
    orientation_95_deg: float | None = None  # Likewise of the orientation
    answered: float = 0.0  # Part of the samples in it that have an answer, 0 to 1
    trusted: bool | None = None  # Whether its answer is to be trusted; None where not judged
    reasons: tuple[str, ...] = ()  # Why it is not
    number: int = 0  # Of the recovery's gaps, from 1

    @property
    def one_sided(self) -> bool:
        """Whether the camera saw the forearm on one side of the gap only, or on none."""
        return self.open_start or self.open_end

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {"length_s": self.length_s, **vars(self), "reasons": list(self.reasons)}


def gap_summaries(recovery: Recovery) -> list[GapSummary]:
    """The recovery's gaps, in order of time, with how sure it is in each."""
    judged = recovery.gap_verdicts if recovery.has_verdict else ()
    summaries = []
    for number, gap in enumerate(recovery.gaps):
        start = int(np.searchsorted(recovery.t_s, gap.start_s, "left"))
        stop = int(np.searchsorted(recovery.t_s, gap.end_s, "right"))
        inside = recovery.rows(slice(start, stop))
        flexion = angles_by_joints(inside, ForearmMounting(None), [ELBOW_FLEXION.name])[1]
        summaries.append(
            GapSummary(
                **vars(gap),
                sigma_max_m=_largest(inside.worst_sigma_m),
                sigma_max_deg=_largest(inside.sigma_deg),
                sigma_max_flexion_deg=_largest(flexion[ELBOW_FLEXION.name]),
                error_95_m=_largest(inside.error_95_m),
                orientation_95_deg=_largest(np.degrees(error_radius(inside.pose_covariance[:, 3:, 3:]))),
                answered=float(inside.answered.mean()) if len(inside) else 0.0,
                trusted=judged[number].trusted if judged else None,
                reasons=judged[number].reasons if judged else (),
                number=number + 1,
            )
        )
    return summaries


#: A gap in which 95 of 100 errors need not lie below this needs care, m.
WIDE_M = 0.10


def gap_table(title: str, gaps: Sequence[GapSummary], true: Mapping[float, float | None] = {}) -> Table:
    """Gaps, one per row, with what 95 of 100 errors stay below; `true` has those of a reference by start."""
    rows = []
    for gap in gaps:
        row = vars(gap) | {"seen_from": "one side only" if gap.one_sided else "both sides"}
        row |= {"true_m": true.get(gap.start_s), "remark": ""}
        row["elbow_deg"] = gap.sigma_max_flexion_deg and 1.96 * gap.sigma_max_flexion_deg
        if gap.trusted is False:  # what is stated is withdrawn
            row |= dict.fromkeys(("error_95_m", "orientation_95_deg", "elbow_deg"))
            row |= {"trusted": "not to be trusted", "remark": "; ".join(gap.reasons)}
        elif gap.one_sided or (gap.error_95_m or 0.0) > WIDE_M:
            row["remark"] = "take with care"
        rows.append(row | {"length_s": gap.length_s})
    against = "true_m=against_the_reference_m " if any(row["true_m"] for row in rows) else ""
    keys = f"number=gap start_s length_s trusted error_95_m=position_m {against}"
    keys += "orientation_95_deg=orientation_deg elbow_deg seen_from answered=answered_share remark"
    return tabulated(title, rows, keys)


def recovery_figures(recovery: Recovery) -> dict[str, object]:
    """The figures of a recovery as plain values, as `smooth --json` writes them."""
    t = recovery.t_s
    return {
        "method": recovery.method,
        "recording": recovery.name,
        "side": recovery.side,
        "samples": len(recovery),
        "answered": int(recovery.answered.sum()),
        "duration_s": float(t[-1] - t[0]) if len(t) else 0.0,
        "rate_hz": float(1.0 / np.median(np.diff(t), overwrite_input=True)) if len(t) > 1 else None,
        "occluded_samples": int(recovery.occluded.sum()),
        "occluded_s": float(sum(gap.length_s for gap in recovery.gaps)),
        "gaps": [summary.to_dict() for summary in gap_summaries(recovery)],
        **certainty_figures(recovery),
        "clock_offset_s": recovery.clock_offset_s,
        "clock_offset_sigma_s": recovery.clock_offset_sigma_s,
        "gravity_direction": recovery.gravity_direction,
        "calibration": _calibration(recovery),
        "figures": recovery.estimates.plain(),
        "notes": list(recovery.notes),
        "config": recovery.config,
    }


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


def cameras(recovery: Recovery) -> Table:
    """Where each camera of several stands, and what it saw, one per row."""
    length_s = float(recovery.t_s[-1] - recovery.t_s[0]) if len(recovery) > 1 else float("nan")
    return tabulated(
        "Cameras",
        recovery.estimates.cameras,
        {
            "camera": "name",
            "place in the first one's frame, cm": lambda each: (
                each.p_K_C_m and ", ".join(f"{100 * item:.0f}" for item in each.p_K_C_m)
            ),
            "turned by, degrees": lambda each: (
                each.R_K_C and fixed(math.degrees(Rotation.from_matrix(each.R_K_C).magnitude()), 0)
            ),
            "sigma, cm per axis": "sigma_m",
            "sigma, degrees per axis": lambda each: fixed(each.sigma_deg),
            "first clock less its own, ms": lambda each: fixed(each.offset_s and 1000 * each.offset_s, 1),
            "sigma, ms": lambda each: fixed(each.offset_sigma_s and 1000 * each.offset_sigma_s, 1),
            "saw the forearm": lambda each: (
                percent(sum(b - a for a, b in each.seen_s) / length_s) if each.takes_part else None
            ),
            "remark": lambda each: f"left out: {each.reason}" if each.reason else "is used",
        },
    )


def certainty_figures(recovery: Recovery, only: BoolArray | None = None) -> dict[str, dict[str, Any]]:
    """How certain the position of some samples (N,) or of all is, m, while seen and in gaps.

    Of `sigma_m`, the standard deviation on the worst axis, median and largest; of `error_95_m`, how far off
    it is in 95 of 100 cases, that of all samples together and the largest.
    """
    sigma, radius = recovery.worst_sigma_m, recovery.error_95_m
    figures: dict[str, dict[str, Any]] = {"sigma_m": {}, "error_95_m": {}}
    for part, inside in (("visible", ~recovery.occluded), ("occluded", recovery.occluded)):
        chosen = inside if only is None else inside & only
        known, rows = (np.flatnonzero(chosen & np.isfinite(each)) for each in (sigma, radius))
        some = recovery.pose_covariance[rows[:: max(1, len(rows) // _MOST_POOLED)]]
        median = float(np.median(sigma[known])) if len(known) else None
        figures["sigma_m"][part] = {"median": median, "max": _largest(sigma[known])}
        figures["error_95_m"][part] = {"all": pooled_radius(some[:, :3, :3]), "max": _largest(radius[rows])}
    return figures


#: Most samples of a joint whose consistency is looked at, evenly spaced over the recording.
_MOST_RESIDUALS = 50_000


def camera_inside_95(recovery: Recovery) -> dict[str, float]:
    """By joint, the share of the used camera samples inside the 95 % region of noise and joint covariance."""
    residuals = recovery.residuals
    noise, bias = recovery.estimates.camera_sigma_m, recovery.estimates.joint_bias_m or {}
    if residuals is None or noise is None or len(recovery) < 1:
        return {}
    spreads = {"strap": recovery.pose_covariance[:, :3, :3], **recovery.joint_covariance}
    by_joint = {}
    for joint in (name for name in noise if name in spreads):
        column = JOINTS.index(joint)
        used = np.flatnonzero(residuals.used[:, column])
        used = used[np.linspace(0, len(used) - 1, min(len(used), _MOST_RESIDUALS)).round().astype(int)]
        nearest = np.clip(np.searchsorted(recovery.t_s, residuals.t_s[used]), 0, len(recovery) - 1)
        own = spreads[joint][nearest]
        variance = np.einsum("nii->n", own) / 3.0
        shared = np.nanmin(variance) if np.isfinite(variance).any() else 0.0
        # rather by a factor than by a difference: what is left is a covariance for certain
        covariance = own * (1.0 - shared / variance)[:, None, None] + float(noise[joint]) ** 2 * np.eye(3)
        off = residuals.residual[:, column][used] - np.array(bias.get(joint, np.zeros(3)))
        by_joint[joint] = coverage_95(squared_sigmas(off, covariance))
    return {joint: share for joint, share in by_joint.items() if share is not None}


def verdict_figures(estimates: Estimates) -> dict[str, object]:
    """The verdict as plain values, as `smooth --json` and `check --json` write it."""
    stated = estimates.plain()
    cameras = {"cameras": stated["cameras"]} if estimates.cameras else {}
    return {
        "trusted": estimates.trusted,
        "verdict": estimates.verdict,
        **{name: stated.get(name, []) for name in ("reasons", "cautions", "remedies", "findings")},
        **{name: stated.get(name) for name in ("cause", "self_check", "pairing")},
        **cameras,
    }


def trust_word(trusted: bool | None, gaps: int | None, untrusted: int | None) -> str:
    """For a table over results: "no", "2 of 5 gaps not", "yes", or "" where not judged."""
    if trusted is False:
        return "no"
    if untrusted:
        return f"{untrusted} of {gaps} gaps not"
    return "" if trusted is None else "yes"


def worst_of(rows: pa.Table, most: int) -> pa.Table:
    """The rows to look at first, at most this many: what is not to be trusted, then the largest sigma."""
    few = rows.select(["trusted", "gaps_untrusted", "sigma_max_m"]).to_pylist()

    def rank(place: int) -> tuple[bool, bool, float]:
        row = few[place]
        return row["trusted"] is not False, not row["gaps_untrusted"], -(row["sigma_max_m"] or 0.0)

    return rows.take(np.array(sorted(range(len(few)), key=rank)[:most], np.int64))


def _largest(values: np.ndarray) -> float | None:
    largest = np.max(values, initial=-np.inf, where=np.isfinite(values))
    return float(largest) if np.isfinite(largest) else None


def _calibration(recovery: Recovery) -> dict[str, object] | None:
    arm = recovery.calibration
    if arm is None:
        return None

    def levers(arms: Mapping[str, LeverArm]) -> dict[str, object]:
        return {
            joint: {"position_m": each.position_m, "sigma_m": each.sigma_m} for joint, each in arms.items()
        }

    plain = {name: getattr(arm, name) for name in ("R_F_A", "accelerometer_bias", "gyroscope_bias")}
    plain |= {f"{SEGMENTS[name].prefix}_imu": levers(each.lever_arms) for name, each in arm.mountings.items()}
    return plain | {
        "side": arm.side,
        "lever_arms": levers(arm.lever_arms),
        "upper_arm_m": arm.upper_arm and arm.upper_arm.value_m,
        "upper_arm_sigma_m": arm.upper_arm and arm.upper_arm.sigma_m,
        **({"R_U_B": arm.R_U_B} if arm.upper_imu else {}),
    }
