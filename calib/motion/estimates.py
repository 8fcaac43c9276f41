"""What was found of an arm and its sensor, with what stayed open: the same for calibrating and recovering."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from smoother.calibration import ArmCalibration
from smoother.recording import Recording
from smoother.result import Recovery

from ..forearm.forearm_frame import ForearmFrame, forearm_frame
from .evidence import ClockOffset, Evidence, gather_from
from .motion_summary import clocks_not_determined, not_determined

#: Figures of a recovery that these functions read and add.
GIVEN = "given"


@dataclass(frozen=True)
class JointError:
    """Errors of the camera's samples of one joint, m an axis.

    Attributes
    ----------
    sample_m : deviation of one sample.
    bias_m : length of the constant error against the other joints, nan where it was not looked for.
    """

    sample_m: float
    bias_m: float = float("nan")


@dataclass(frozen=True)
class ArmEstimates:
    """What one or several recordings told of the arm, the sensor and the clocks.

    Attributes
    ----------
    calibration : lever arms and lengths with their sigmas.
    frame : the forearm's axes in the IMU with their sigmas, None without elbow and wrist.
    offsets : clock offset of each recording.
    evidence : how long the forearm was seen, and how it moved.
    not_determined : what the motion left open, one sentence each.
    camera : errors of the camera's joints, by name.
    joint_bias_sigma_m : how large a joint's constant error is, m an axis.
    given : what was given beforehand, by name: lever arms by joint, `upper_arm`, `R_F_A`.
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
    def all_given(self) -> bool:
        """Whether nothing of the arm had to be found: lever arms and upper arm were given."""
        levers = set(self.calibration.lever_arms) - set(self.given)
        return not levers and (self.calibration.upper_arm is None or "upper_arm" in self.given)


def names_given(known: ArmCalibration | None) -> tuple[str, ...]:
    """What a calibration gives, by name."""
    if known is None:
        return ()
    parts = {"upper_arm": known.upper_arm, "R_F_A": known.R_F_A}
    return (*known.lever_arms, *(name for name, value in parts.items() if value is not None))


def with_given(recovery: Recovery, calibration: ArmCalibration | None) -> Recovery:
    """The recovery with the names of what was given for it, so that only the rest is called found."""
    given = names_given(calibration)
    return replace(recovery, figures={**recovery.figures, GIVEN: list(given)}) if given else recovery


def found_in(recovery: Recovery, recording: Recording | None = None) -> ArmEstimates | None:
    """What a recovery found; None for methods that need no calibration, or that find no orientation.

    Parameters
    ----------
    recovery : its figure `given` names what was given beforehand (`names_given`); nothing is said of that.
    recording : what it was made of; tells how far the clock wandered.
    """
    arm = recovery.calibration
    if arm is None or not any(np.isfinite(block.quaternion).any() for block in recovery.blocks()):
        return None
    given = recovery.figures.get(GIVEN, ())
    assert isinstance(given, tuple | list)
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
    bias_sigma_m = _number(recovery.figures.get("joint_bias_sigma_m"))
    noise, bias = _by_joint(recovery, "camera_sigma_m"), _by_joint(recovery, "joint_bias_m")
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
        given=tuple(given),
    )


def _by_joint(recovery: Recovery, name: str) -> dict[str, float]:
    values = recovery.figures.get(name)
    return values if isinstance(values, dict) else {}


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")


def _drift(recovery: Recovery, recording: Recording | None) -> float:
    """How far the offset wandered, s; nan where that cannot be told."""
    if recording is None or not 0 < len(recording.arm) == len(recovery.arm):
        return float("nan")
    return float(np.ptp(recovery.arm.t_s - recording.arm.t_s))
