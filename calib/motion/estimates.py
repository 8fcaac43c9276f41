"""What was found of an arm and its sensor, with what stayed open: the same for calibrating and recovering."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from smoother.calibration import ArmCalibration
from smoother.recording import Recording
from smoother.result import Recovery

from ..file import CalibrationFile
from ..forearm.forearm_frame import ForearmFrame, forearm_frame
from ..protocol import Answer
from .evidence import ClockOffset, Evidence, gather_from
from .motion_summary import clocks_not_determined, motion_verdict, not_determined


@dataclass(frozen=True)
class JointError:
    """Errors of the camera's samples of one joint, m an axis.

    Attributes
    ----------
    sample_m : float, m
        Standard deviation of one sample.
    bias_m : float, m
        Length of the constant error against the other joints, nan where it was not looked for.
    """

    sample_m: float
    bias_m: float = float("nan")


@dataclass(frozen=True)
class ArmEstimates:
    """What one or several recordings told of the arm, the sensor and the clocks.

    Attributes
    ----------
    calibration : ArmCalibration
        Lever arms and lengths with their sigmas; carries over to other recordings.
    frame : ForearmFrame, optional
        The forearm's axes in the IMU with their sigmas, None without elbow and wrist.
    offsets : tuple of ClockOffset
        One a recording; never carried over.
    evidence : Evidence
        How long the forearm was seen, and how it moved.
    not_determined : tuple of str
        What the motion left open, one sentence each.
    camera : dict of str to JointError
        Errors of the camera's joints, by name.
    joint_bias_sigma_m : float, m
        How large a joint's constant error is, an axis.
    given : tuple of str
        What was given beforehand: lever arms by joint, `upper_arm`, `R_F_A`.
    """

    calibration: ArmCalibration
    frame: ForearmFrame | None
    offsets: tuple[ClockOffset, ...]
    evidence: Evidence
    not_determined: tuple[str, ...]
    camera: dict[str, JointError] = field(default_factory=dict)
    joint_bias_sigma_m: float = float("nan")
    given: tuple[str, ...] = ()

    @property
    def lengths(self) -> dict[str, tuple[float, float]]:
        """Upper arm, forearm and the IMU's distance from the forearm's axis with their sigmas, m."""
        arm, frame, table = self.calibration, self.frame, {}
        if arm.upper_arm is not None:
            table["upper_arm"] = (arm.upper_arm.value_m, arm.upper_arm.sigma_m)
        if frame is not None:
            table["forearm"] = (frame.length_m, frame.length_sigma_m)
            table["imu_to_forearm_axis"] = (frame.distance_m, frame.distance_sigma_m)
        return table

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        arm, frame, evidence = self.calibration, self.frame, self.evidence
        values: dict[str, Any] = {
            "side": arm.side,
            "lever_arms": {joint: asdict(lever) for joint, lever in arm.lever_arms.items()},
            "lengths": {
                name: {"value_m": value, "sigma_m": sigma} for name, (value, sigma) in self.lengths.items()
            },
            "R_F_A": arm.R_F_A,
            "given": list(self.given),
            "clock_offsets": [asdict(offset) for offset in self.offsets],
            "camera_sigma_m": {joint: error.sample_m for joint, error in self.camera.items()},
            "joint_bias_sigma_m": self.joint_bias_sigma_m,
            "visible_s": evidence.visible_s,
            "frames": evidence.frames,
            "turning_rms_deg_s": np.degrees(evidence.turning_rad_s),
            "turned_about_forearm_deg": np.degrees(evidence.axial_rad),
            "not_determined": list(self.not_determined),
        }
        if frame is not None:
            values |= {
                "forearm_direction": frame.direction,
                "forearm_direction_sigma_deg": np.degrees(frame.direction_sigma_rad),
                "roll_sigma_deg": np.degrees(frame.roll_sigma_rad),
            }
        return values

    @property
    def all_given(self) -> bool:
        """Whether nothing of the arm had to be found: lever arms and upper arm were given."""
        levers = set(self.calibration.lever_arms) - set(self.given)
        return not levers and (self.calibration.upper_arm is None or "upper_arm" in self.given)


def motion_answer(estimates: ArmEstimates) -> Answer:
    """Lever arms, lengths and mounting in the form that every calibration answers in.

    Parameters
    ----------
    estimates : ArmEstimates
        See `calibrate_motion`.

    Returns
    -------
    answer : Answer
        Its table holds the arm alone: clock offsets belong to their recordings.
    """
    arm = estimates.calibration
    levers = {f"lever_arm_{joint}": lever for joint, lever in arm.lever_arms.items()}
    estimate: dict[str, Any] = {name: lever.position_m for name, lever in levers.items()}
    sigma: dict[str, Any] = {name: lever.sigma_m for name, lever in levers.items()}
    for name, (value_m, sigma_m) in estimates.lengths.items():
        estimate[name], sigma[name] = value_m, sigma_m
    if arm.R_F_A is not None:
        estimate["R_F_A"] = arm.R_F_A
    return Answer(
        estimate,
        sigma,
        motion_verdict(arm, estimates.not_determined),
        estimates.not_determined,
        CalibrationFile().with_arm(arm),
        estimates.figures,
    )


def names_given(known: ArmCalibration | None) -> tuple[str, ...]:
    """What a calibration gives, by name: lever arms by joint, `upper_arm`, `R_F_A`."""
    if known is None:
        return ()
    parts = {"upper_arm": known.upper_arm, "R_F_A": known.R_F_A}
    return (*known.lever_arms, *(name for name, value in parts.items() if value is not None))


def with_given(recovery: Recovery, calibration: ArmCalibration | None) -> Recovery:
    """The recovery with the names of what was given for it, so that only the rest is called found."""
    given = names_given(calibration)
    return replace(recovery, estimates=replace(recovery.estimates, given=given)) if given else recovery


def found_in(recovery: Recovery, recording: Recording | None = None) -> ArmEstimates | None:
    """What a recovery found; None for methods that need no calibration, or that find no orientation.

    Parameters
    ----------
    recovery : Recovery
        Its `estimates.given` names what was given beforehand (`names_given`); nothing is said of that.
    recording : Recording, optional
        What it was made of; tells how far the clock wandered.

    Returns
    -------
    estimates : ArmEstimates or None
    """
    arm = recovery.calibration
    if arm is None or not any(np.isfinite(batch.quaternion).any() for batch in recovery.batches()):
        return None
    given = recovery.estimates.given
    known = ArmCalibration(
        arm.side,
        {joint: lever for joint, lever in arm.lever_arms.items() if joint in given},
        arm.upper_arm if "upper_arm" in given else None,
        arm.R_F_A,
    )
    frame, evidence = forearm_frame(arm), gather_from(recovery)
    offsets: tuple[ClockOffset, ...] = ()
    if np.isfinite(recovery.clock_offset_s):
        offset_s, sigma_s = recovery.clock_offset_s, recovery.clock_offset_sigma_s
        offsets = (ClockOffset(recovery.name, offset_s, sigma_s, _drift(recovery, recording)),)
    stated = recovery.estimates
    bias_sigma_m = float("nan") if stated.joint_bias_sigma_m is None else stated.joint_bias_sigma_m
    noise, bias = stated.camera_sigma_m or {}, stated.joint_bias_m or {}
    return ArmEstimates(
        calibration=arm,
        frame=frame,
        offsets=offsets,
        evidence=evidence,
        not_determined=(
            *not_determined(arm, frame, evidence, known, bias_sigma_m),
            *clocks_not_determined(offsets),
        ),
        camera={
            joint: JointError(
                float(sigma), float(np.linalg.norm(bias[joint])) if joint in bias else float("nan")
            )
            for joint, sigma in noise.items()
        },
        joint_bias_sigma_m=bias_sigma_m,
        given=given,
    )


def _drift(recovery: Recovery, recording: Recording | None) -> float:
    """How far the offset wandered, s; nan where that cannot be told."""
    if recording is None or not 0 < len(recording.arm) == len(recovery.arm):
        return float("nan")
    return float(np.ptp(recovery.arm.t_s - recording.arm.t_s))
