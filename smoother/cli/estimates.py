"""What was found of the arm, the sensor and the clocks: printed alike by `smooth` and `calibrate motion`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .output import print_table, say

if TYPE_CHECKING:
    from calib.forearm.forearm_frame import ForearmFrame
    from calib.motion.estimates import ArmEstimates
    from calib.motion.evidence import ClockOffset

    from ..calibration import ArmCalibration


def lengths(calibration: ArmCalibration, frame: ForearmFrame | None) -> dict[str, tuple[float, float]]:
    """Upper arm, forearm and the IMU's distance from the forearm's axis with their sigmas, m."""
    table = {}
    if calibration.upper_arm is not None:
        table["upper_arm"] = (calibration.upper_arm.value_m, calibration.upper_arm.sigma_m)
    if frame is not None:
        table["forearm"] = (frame.length_m, frame.length_sigma_m)
        table["imu_to_forearm_axis"] = (frame.distance_m, frame.distance_sigma_m)
    return table


def found_figures(found: ArmEstimates) -> dict[str, Any]:
    """What was found, as plain values for `--json`."""
    import numpy as np

    arm, frame, evidence = found.calibration, found.frame, found.evidence
    values: dict[str, Any] = {
        "side": arm.side,
        "lever_arms": {
            joint: {"position_m": lever.position_m, "sigma_m": lever.sigma_m}
            for joint, lever in arm.lever_arms.items()
        },
        "lengths": {
            name: {"value_m": value, "sigma_m": sigma} for name, (value, sigma) in lengths(arm, frame).items()
        },
        "R_F_A": arm.R_F_A,
        "given": list(found.given),
        "clock_offsets": [
            {
                "recording": each.recording,
                "offset_s": each.offset_s,
                "sigma_s": each.sigma_s,
                "drift_s": each.drift_s,
            }
            for each in found.offsets
        ],
        "camera_sigma_m": {joint: each.sample_m for joint, each in found.camera.items()},
        "joint_bias_sigma_m": found.joint_bias_sigma_m,
        "visible_s": evidence.visible_s,
        "frames": evidence.frames,
        "turning_rms_deg_s": np.degrees(evidence.turning_rad_s),
        "turned_about_forearm_deg": np.degrees(evidence.axial_rad),
        "not_determined": list(found.not_determined),
    }
    if frame is not None:
        values |= {
            "forearm_direction": frame.direction,
            "forearm_direction_sigma_deg": np.degrees(frame.direction_sigma_rad),
            "roll_sigma_deg": np.degrees(frame.roll_sigma_rad),
        }
    return values


def print_arm(found: ArmEstimates) -> None:
    """Print lever arms and lengths, each with its sigma."""
    rows = []
    for joint, lever in found.calibration.lever_arms.items():
        cells = [
            f"{1e3 * value:.1f} +- {1e3 * sigma:.1f}"
            for value, sigma in zip(lever.position_m, lever.sigma_m, strict=True)
        ]
        rows.append((joint, *cells))
    if rows:
        print_table("Lever arms in the IMU's axes, mm (+- one sigma)", ("joint", "x", "y", "z"), rows)
    rows = [
        (name.replace("_", " ").replace("imu", "IMU"), f"{1e3 * value:.1f} +- {1e3 * sigma:.1f}")
        for name, (value, sigma) in lengths(found.calibration, found.frame).items()
    ]
    if rows:
        print_table("Lengths, mm", ("length", "found"), rows)


def print_clocks(offsets: Sequence[ClockOffset]) -> None:
    """Print the clock offset of every recording, as a table."""
    print_table(
        "Clocks, ms",
        ("recording", "IMU minus camera", "wandered by"),
        [
            (each.recording, f"{1e3 * each.offset_s:+.1f} +- {1e3 * each.sigma_s:.1f}", 1e3 * each.drift_s)
            if each.offset_s == each.offset_s
            else (each.recording, "not known", "-")
            for each in offsets
        ],
    )


def print_clock(offset: ClockOffset) -> None:
    """Print the clock offset of one recording, in a line."""
    known = f" +- {1e3 * offset.sigma_s:.1f} ms" if offset.sigma_s == offset.sigma_s else ""
    wandered = f"; it wandered by {1e3 * offset.drift_s:.0f} ms" if offset.drift_s > WANDERED_S else ""
    say(f"the IMU's clock is {1e3 * offset.offset_s:+.1f} ms{known} against the camera's{wandered}")


def print_camera(found: ArmEstimates) -> None:
    """Print the camera's noise and the constant errors of its joints, a line."""
    if not found.camera:
        return
    noise = ", ".join(f"{joint} {1e3 * each.sample_m:.1f}" for joint, each in found.camera.items())
    say(f"noise of the camera's joints, mm an axis: {noise}")
    off = [f"{joint} {1e3 * each.bias_m:.1f}" for joint, each in found.camera.items() if each.bias_m > 0]
    if off:
        say(
            f"constant errors of the joints against each other, mm: {', '.join(off)}; what they have in"
            f" common is taken for {1e3 * found.joint_bias_sigma_m:.1f} an axis"
        )


def print_open(found: ArmEstimates) -> None:
    """Print in words what the motion did not determine."""
    for sentence in found.not_determined:
        say(f"not determined: {sentence}")


#: A clock that wandered less is not worth a word, s.
WANDERED_S = 0.001
