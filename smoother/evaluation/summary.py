"""A recovery summarised in a few numbers: its gaps and how sure it is in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..angles import ForearmMounting, angles_by_joints
from ..angles.definitions import ELBOW_FLEXION
from ..array_types import BoolArray, FloatArray, IntArray
from ..body import SEGMENTS
from ..calibration import LeverArm
from ..error_radius import error_radius, pooled_radius
from ..measurements.visibility import Gap
from ..recording import JOINTS
from ..result import Estimates, GapVerdict, Recovery
from ..table import Table, fixed, percent, tabulated
from .metrics import rms, squared_sigmas

#: About this many samples are pooled to one distance.
_MOST_POOLED = 4000


@dataclass(frozen=True)
class GapSummary:
    """One gap of a recovery."""

    gap: Gap  # On the IMU's clock
    sigma_max_m: float | None  # Largest standard deviation of the IMU's position in it, on one axis
    sigma_max_deg: float | None  # Largest standard deviation of the orientation in it
    sigma_max_flexion_deg: float | None  # Likewise of the elbow's flexion
    answered: float  # Part of the samples in it that have an answer, 0 to 1
    verdict: GapVerdict | None = None  # Whether its answer is to be trusted; None where not judged
    # The IMU's position lies within this distance in 95 of 100 cases, at the least certain moment of it
    error_95_m: float | None = None
    orientation_95_deg: float | None = None  # Likewise of the orientation

    @property
    def one_sided(self) -> bool:
        """Whether the camera saw the forearm on one side of the gap only, or on none."""
        return self.gap.open_start or self.gap.open_end

    @property
    def trusted(self) -> bool | None:
        """Whether its answer is to be trusted; None where not judged."""
        return None if self.verdict is None else self.verdict.trusted

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not."""
        return () if self.verdict is None else self.verdict.reasons

    def is_wider_than(self, error_95_m: float) -> bool:
        """Whether the position is stated, and may be farther off than this somewhere in the gap."""
        return self.error_95_m is not None and self.error_95_m > error_95_m

    def is_weaker_than(self, sigma_m: float) -> bool:
        """Whether the position is stated, and less certain than this somewhere in the gap."""
        return self.sigma_max_m is not None and self.sigma_max_m > sigma_m

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        gap = {name: getattr(self.gap, name) for name in _OF_GAP}
        return gap | {name: getattr(self, name) for name in _OF_ANSWER} | {"reasons": list(self.reasons)}


_OF_GAP = ("start_s", "end_s", "length_s", "open_start", "open_end")
_OF_ANSWER = (
    *("sigma_max_m", "sigma_max_deg", "sigma_max_flexion_deg", "error_95_m", "orientation_95_deg"),
    *("answered", "trusted"),
)


def gap_summaries(recovery: Recovery) -> list[GapSummary]:
    """The recovery's gaps, in order of time, with how sure it is in each."""
    verdicts = recovery.gap_verdicts if recovery.has_verdict else (None,) * len(recovery.gaps)
    summaries = []
    for gap, verdict in zip(recovery.gaps, verdicts, strict=True):
        start = int(np.searchsorted(recovery.t_s, gap.start_s, "left"))
        stop = int(np.searchsorted(recovery.t_s, gap.end_s, "right"))
        inside = recovery.rows(slice(start, stop))
        flexion = angles_by_joints(inside, ForearmMounting(None), [ELBOW_FLEXION.name])
        summaries.append(
            GapSummary(
                gap,
                _largest(inside.worst_sigma_m),
                _largest(inside.sigma_deg),
                _largest(flexion[1][ELBOW_FLEXION.name]),
                float(inside.answered.mean()) if len(inside) else 0.0,
                verdict,
                _largest(inside.error_95_m),
                _largest(np.degrees(error_radius(inside.pose_covariance[:, 3:, 3:]))),
            )
        )
    return summaries


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
        "sigma_m": sigma_figures(recovery),
        "error_95_m": error_figures(recovery),
        "clock_offset_s": recovery.clock_offset_s,
        "clock_offset_sigma_s": recovery.clock_offset_sigma_s,
        "gravity_direction": recovery.gravity_direction,
        "calibration": _calibration(recovery),
        "figures": recovery.estimates.plain(),
        "notes": list(recovery.notes),
        "config": recovery.config,
    }


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
            "turned by, degrees": lambda each: fixed(_turned_deg(each.R_K_C), 0),
            "sigma, cm per axis": "sigma_m",
            "sigma, degrees per axis": lambda each: fixed(each.sigma_deg),
            "first clock less its own, ms": lambda each: fixed(each.offset_s and 1000 * each.offset_s, 1),
            "sigma, ms": lambda each: fixed(each.offset_sigma_s and 1000 * each.offset_sigma_s, 1),
            "saw the forearm": lambda each: (
                percent(sum(b - a for a, b in each.seen_s) / length_s) if each.takes_part else None
            ),
            "remark": lambda each: f"left out: {each.reason}" if each.reason else "is used",
        },
        "Each camera was placed by the joints that it and the first one saw. A gap is a time in which none of"
        " them saw the forearm.",
    )


def _turned_deg(R_K_C: Sequence[Sequence[float]] | None) -> float | None:
    if R_K_C is None:
        return None
    cosine = 0.5 * (float(np.trace(np.array(R_K_C))) - 1.0)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _by_part(
    recovery: Recovery,
    values: FloatArray,
    only: BoolArray | None,
    figures: Callable[[IntArray], dict[str, float | None]],
) -> dict[str, dict[str, float | None]]:
    """Figures of the samples with a finite value, while seen and in gaps."""
    good = np.isfinite(values) if only is None else only & np.isfinite(values)
    parts = {"visible": ~recovery.occluded, "occluded": recovery.occluded}
    return {part: figures(np.flatnonzero(good & inside)) for part, inside in parts.items()}


def sigma_figures(
    recovery: Recovery,
    only: BoolArray | None = None,  # bool (N,)
) -> dict[str, dict[str, float | None]]:
    """Median and largest standard deviation of the position on its worst axis, m, while seen and in gaps."""
    sigma = recovery.worst_sigma_m

    def figures(rows: IntArray) -> dict[str, float | None]:
        return {"median": float(np.median(sigma[rows])) if len(rows) else None, "max": _largest(sigma[rows])}

    return _by_part(recovery, sigma, only, figures)


def error_figures(
    recovery: Recovery,
    only: BoolArray | None = None,  # bool (N,)
) -> dict[str, dict[str, float | None]]:
    """How far off the IMU's position is in 95 of 100 cases, m, while seen and in gaps."""
    radius = recovery.error_95_m

    def figures(rows: IntArray) -> dict[str, float | None]:
        some = recovery.pose_covariance[rows[:: max(1, len(rows) // _MOST_POOLED)]]
        return {"all": pooled_radius(some[:, :3, :3]), "max": _largest(radius[rows])}

    return _by_part(recovery, radius, only, figures)


#: Most samples of a joint whose consistency is looked at, evenly spaced over the recording.
_MOST_RESIDUALS = 50_000


def consistency(error_m: FloatArray, covariance: FloatArray) -> dict[str, Any]:
    """How errors (n, 3) m lie in what is stated of them (n, 3, 3) m^2: shares inside, sigma and rms per axis.

    What is not finite is left out.
    """
    squared = squared_sigmas(error_m, covariance)
    good = np.isfinite(squared)
    from scipy.special import chdtr  # slow to load

    level = chdtr(3.0, squared[good])
    stated = np.sqrt(np.trace(covariance[good], axis1=1, axis2=2) / 3.0)
    return {
        "samples": int(good.sum()),
        "inside_50": float((level <= 0.5).mean()) if good.any() else None,
        "inside_95": float((level <= 0.95).mean()) if good.any() else None,
        "stated_m": rms(stated),
        "actual_m": rms(np.linalg.norm(error_m[good], axis=1) / np.sqrt(3.0)),
    }


def camera_consistency(recovery: Recovery) -> dict[str, dict[str, Any]]:
    """The camera's samples that were used, by joint: residual against camera noise and joint covariance."""
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
        off = np.array(bias.get(joint, np.zeros(3)))
        by_joint[joint] = consistency(residuals.residual[:, column][used] - off, covariance)
    return {joint: found for joint, found in by_joint.items() if found["samples"]}


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
