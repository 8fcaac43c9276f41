"""What a result states of how it was made, as plain values: every figure of a methods section is one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..array_types import FloatArray
from ..config import Config
from ..evaluation.summary import gap_summaries
from ..joint_angles import recovery_angles
from ..linalg import median_rate_hz
from ..recording import JOINTS
from ..result import Recovery
from ..result.verdict import Pairing, SelfCheck

#: Settings that the program itself adapts to a recording where they were not set.
ADAPTED = ("imu.accelerometer_density", "imu.gyroscope_density", "arm.shoulder_walk")


@dataclass(frozen=True)
class SegmentImu:
    """An IMU on a segment beyond the forearm.

    Attributes
    ----------
    segment : str
        In sentences, after "the": "upper arm", "trunk".
    answered : float
        Part of the samples at which its motion is known, 0 to 1.
    clock_offset_s : float, s
        t_own = t_camera + offset; nan where it is not stated.
    mount_sigma_deg : float, degrees
        How far the bone's axes may be off about the worst of them; nan where not known.
    """

    segment: str
    answered: float
    clock_offset_s: float
    mount_sigma_deg: float


@dataclass(frozen=True)
class JointFacts:
    """A joint of the arm: what the camera saw of it, and where it is from the forearm's IMU.

    Attributes
    ----------
    name : str
    tracked : float
        Part of the camera's frames that call it tracked, 0 to 1.
    sample_sigma_m : float or None, m per axis
        Noise of a sample, as it was estimated.
    lever_m, lever_sigma_m : tuple of float or None, m
        Its place in the IMU's axes, and one standard deviation of each axis.
    given : bool
        The place was given beforehand, not only estimated.
    """

    name: str
    tracked: float
    sample_sigma_m: float | None
    lever_m: tuple[float, ...] | None
    lever_sigma_m: tuple[float, ...] | None
    given: bool


@dataclass(frozen=True)
class Setting:
    """A setting in effect that is not the program's default.

    Attributes
    ----------
    name : str
        "arm.shoulder_walk".
    value, default : object
        Plain values.
    adapted : bool
        The program itself may have adapted it to the recording.
    """

    name: str
    value: object
    default: object
    adapted: bool


@dataclass(frozen=True)
class ArmFacts:
    """What a result states of one arm.

    Attributes
    ----------
    recording, arm : str
        Names.
    simulation : str
        What a simulated recording calls itself; "" of any other.
    method : str
        Of recovery.
    orientation : str
        Of a baseline: its orientation filter; "" where it has none.
    version : str
        Of the program that wrote the result.
    length_s : float, s
        From the first to the last sample of the forearm's IMU.
    imu_samples, camera_frames : int
    imu_rate_hz, camera_rate_hz : float, Hz
        Medians.
    joints : tuple of JointFacts
        Those that the camera ever tracked.
    further_imus : tuple of SegmentImu
    magnetometer_means, magnetometer_used : int
        Means of the field over some seconds, and how many were used.
    upper_arm_m, upper_arm_sigma_m : float or None, m
    upper_arm_given : bool
    forearm_axes : str
        "given", "estimated" or "": the forearm's axes in its IMU (`R_F_A`).
    gyroscope_bias, accelerometer_bias : tuple of float or None, rad/s and m/s^2
        Means.
    angles : tuple of str
        Joint angles that can be computed from it, `joint_angles.ANGLES`.
    clock_offset_s, clock_sigma_s : float, s
        t_imu = t_camera + offset.
    clock_given_s : tuple of float or None, s
        Offset and sigma that were measured and given beforehand.
    pairing : Pairing or None
    gaps, one_sided_gaps, untrusted_gaps : int
    occluded_s, longest_gap_s : float, s
    occluded_share : float
        Of the length.
    answered : float
        Part of the samples with an answer.
    gap_error_95_m, gap_sigma_deg : float or None, m and degrees
        At the least certain moment of all gaps: the distance of 95 of 100 errors of the IMU's position, and
        sigma of its orientation (root of the covariance's trace).
    tracked_samples, rejected_samples : int
        Of the camera's joints.
    self_check : SelfCheck or None
    sigma_factors : tuple of float
        What sigma of positions was multiplied by in each gap.
    verdict : str
    settings : tuple of Setting
    margin_s, window_s : float or None, s
        Of the windows.
    draws : int
        Motions drawn from the posterior.
    max_sigma_m : float or None, m
        Samples less certain than this are marked.
    notes : tuple of str
        The program's notes on the recording.
    """

    recording: str
    arm: str
    simulation: str
    method: str
    orientation: str
    version: str
    length_s: float
    imu_samples: int
    camera_frames: int
    imu_rate_hz: float
    camera_rate_hz: float
    joints: tuple[JointFacts, ...]
    further_imus: tuple[SegmentImu, ...]
    magnetometer_means: int
    magnetometer_used: int
    upper_arm_m: float | None
    upper_arm_sigma_m: float | None
    upper_arm_given: bool
    forearm_axes: str
    gyroscope_bias: tuple[float, ...] | None
    accelerometer_bias: tuple[float, ...] | None
    angles: tuple[str, ...]
    clock_offset_s: float
    clock_sigma_s: float
    clock_given_s: tuple[float, ...] | None
    pairing: Pairing | None
    gaps: int
    one_sided_gaps: int
    untrusted_gaps: int
    occluded_s: float
    longest_gap_s: float
    occluded_share: float
    answered: float
    gap_error_95_m: float | None
    gap_sigma_deg: float | None
    tracked_samples: int
    rejected_samples: int
    self_check: SelfCheck | None
    sigma_factors: tuple[float, ...]
    verdict: str
    settings: tuple[Setting, ...]
    margin_s: float | None
    window_s: float | None
    draws: int
    max_sigma_m: float | None
    notes: tuple[str, ...]


def arm_facts(recovery: Recovery, version: str = "", simulation: str = "") -> ArmFacts:
    """What a result states of one arm.

    Parameters
    ----------
    recovery : Recovery
        One arm.
    version : str
        Of the program that wrote it; "" where the file does not say.
    simulation : str
        What a simulated recording calls itself; "" of any other.

    Returns
    -------
    facts : ArmFacts
    """
    estimates, arm = recovery.estimates, recovery.calibration
    windows = recovery.config.get("windows")
    sizes = windows if isinstance(windows, Mapping) else {}
    summaries = gap_summaries(recovery)
    length_s = float(recovery.t_s[-1] - recovery.t_s[0]) if len(recovery) else 0.0
    occluded_s = sum(gap.length_s for gap in recovery.gaps)
    is_graph = recovery.method == "graph"
    tracked, rejected = _samples(recovery)
    axes = None if arm is None else arm.R_F_A
    given = estimates.given
    upper = None if arm is None else arm.upper_arm
    return ArmFacts(
        recording=recovery.name,
        arm=recovery.arm_label,
        simulation=simulation,
        method=recovery.method,
        orientation=str(estimates.further.get("orientation", "")),
        version=version,
        length_s=length_s,
        imu_samples=len(recovery),
        camera_frames=len(recovery.arm),
        imu_rate_hz=median_rate_hz(recovery.t_s),
        camera_rate_hz=median_rate_hz(np.asarray(recovery.arm.t_s)),
        joints=_joints(recovery),
        further_imus=tuple(_further(recovery)),
        magnetometer_means=estimates.magnetometer_blocks or 0,
        magnetometer_used=estimates.magnetometer_blocks_used or 0,
        upper_arm_m=None if upper is None else upper.value_m,
        upper_arm_sigma_m=None if upper is None else upper.sigma_m,
        upper_arm_given="upper_arm" in given,
        forearm_axes="" if axes is None else "given" if "R_F_A" in given else "estimated",
        gyroscope_bias=estimates.gyroscope_bias,
        accelerometer_bias=estimates.accelerometer_bias,
        angles=_angles(recovery),
        clock_offset_s=recovery.clock_offset_s,
        clock_sigma_s=recovery.clock_offset_sigma_s,
        clock_given_s=estimates.clock_given_s,
        pairing=estimates.pairing,
        gaps=len(recovery.gaps),
        one_sided_gaps=sum(each.one_sided for each in summaries),
        untrusted_gaps=sum(each.trusted is False for each in summaries),
        occluded_s=occluded_s,
        longest_gap_s=max((gap.length_s for gap in recovery.gaps), default=0.0),
        occluded_share=occluded_s / length_s if length_s else 0.0,
        answered=float(recovery.answered.mean()) if len(recovery) else 0.0,
        gap_error_95_m=_largest(each.error_95_m for each in summaries),
        gap_sigma_deg=_largest(each.sigma_max_deg for each in summaries),
        tracked_samples=tracked,
        rejected_samples=rejected,
        # a baseline's file repeats what the graph found, and the check of that does not apply to its own path
        self_check=estimates.self_check if is_graph else None,
        sigma_factors=tuple(factor for factor in estimates.sigma_factors if factor != 1.0),
        verdict=estimates.verdict,
        settings=tuple(_settings(recovery.config)),
        margin_s=sizes.get("margin_s"),
        window_s=sizes.get("length_s"),
        draws=0 if recovery.draws is None else len(recovery.draws),
        max_sigma_m=estimates.max_sigma_m,
        notes=recovery.notes,
    )


def _joints(recovery: Recovery) -> tuple[JointFacts, ...]:
    tracked = np.zeros(len(JOINTS))
    for frames in recovery.frame_batches():
        tracked += [np.count_nonzero(frames.tracked(joint)) for joint in JOINTS]
    levers = {} if recovery.calibration is None else recovery.calibration.lever_arms
    noise = recovery.estimates.camera_sigma_m or {}
    rows = []
    for joint, count in zip(JOINTS, tracked.tolist(), strict=True):
        if not count:
            continue
        lever = levers.get(joint)
        rows.append(
            JointFacts(
                joint,
                count / len(recovery.arm),
                noise.get(joint),
                None if lever is None else tuple(np.asarray(lever.position_m, float).tolist()),
                None if lever is None else tuple(np.asarray(lever.sigma_m, float).tolist()),
                joint in recovery.estimates.given,
            )
        )
    return tuple(rows)


def _further(recovery: Recovery) -> Iterator[SegmentImu]:
    from ..body import SEGMENTS

    for name, motion in recovery.segments.items():
        yield _imu(SEGMENTS[name].label, motion.quaternion, motion.clock_offset_s, motion.mount_sigma_rad)
    if (trunk := recovery.trunk) is not None:
        yield _imu("trunk", trunk.quaternion, trunk.clock_offset_s, trunk.mount_sigma_rad)


def _imu(segment: str, quaternion: FloatArray, offset_s: float, mount_sigma_rad: FloatArray) -> SegmentImu:
    answered = float(np.isfinite(quaternion).all(axis=1).mean()) if len(quaternion) else 0.0
    return SegmentImu(segment, answered, float(offset_s), float(np.degrees(np.max(mount_sigma_rad))))


def _samples(recovery: Recovery) -> tuple[int, int]:
    """How many samples of the camera's joints were tracked, and how many of these were rejected."""
    tracked = rejected = 0
    if recovery.residuals is not None:
        for batch in recovery.residuals.batches():
            tracked += int(np.count_nonzero(batch.used | (batch.reason != 0)))
            rejected += int(np.count_nonzero(batch.reason))
    return tracked, rejected


def _angles(recovery: Recovery) -> tuple[str, ...]:
    known: dict[str, bool] = {}
    for batch in recovery.batches():
        for name, values in recovery_angles(batch).items():
            known[name] = known.get(name, False) or bool(np.isfinite(values).any())
    return tuple(name for name, is_known in known.items() if is_known)


def _largest(values: Iterator[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _settings(config: Mapping[str, Any]) -> Iterator[Setting]:
    """The settings of a result that are not today's defaults, in the order of its file."""
    usual = Config().model_dump(mode="json", exclude_none=True)
    for section, settings in config.items():
        if not isinstance(settings, Mapping):
            continue
        for key, value in settings.items():
            name = f"{section}.{key}"
            default = usual.get(section, {}).get(key)
            if default is not None and value != default:
                yield Setting(name, value, default, name in ADAPTED)
