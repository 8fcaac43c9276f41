"""What was found of the arm, the sensor and the clocks: printed alike by `smooth` and `calibrate motion`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from .output import print_table, say

if TYPE_CHECKING:
    from calib.motion.motion_calibration import ArmEstimates
    from calib.motion.motion_summary import ClockOffset


def print_arm(estimates: ArmEstimates) -> None:
    """Print lever arms and lengths, each with its sigma."""
    rows = []
    for joint, lever in estimates.calibration.lever_arms.items():
        cells = [
            f"{1e3 * value:.1f} +- {1e3 * sigma:.1f}"
            for value, sigma in zip(lever.position_m, lever.sigma_m, strict=True)
        ]
        rows.append((joint, *cells))
    if rows:
        print_table("Lever arms in the IMU's axes, mm (+- one sigma)", ("joint", "x", "y", "z"), rows)
    rows = [
        (name.replace("_", " ").replace("imu", "IMU"), f"{1e3 * value:.1f} +- {1e3 * sigma:.1f}")
        for name, (value, sigma) in estimates.lengths.items()
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


def print_camera(estimates: ArmEstimates) -> None:
    """Print the camera's noise and the constant errors of its joints, a line."""
    if not estimates.camera:
        return
    noise = ", ".join(f"{joint} {1e3 * each.sample_m:.1f}" for joint, each in estimates.camera.items())
    say(f"noise of the camera's joints, mm an axis: {noise}")
    off = [f"{joint} {1e3 * each.bias_m:.1f}" for joint, each in estimates.camera.items() if each.bias_m > 0]
    if off:
        say(
            f"constant errors of the joints against each other, mm: {', '.join(off)}; their common part"
            f" counts as {1e3 * estimates.joint_bias_sigma_m:.1f} an axis"
        )


def print_open(estimates: ArmEstimates) -> None:
    """Print in words what the motion did not determine."""
    for sentence in estimates.not_determined:
        say(f"not determined: {sentence}")


#: A clock that wandered less is not worth a word, s.
WANDERED_S = 0.001
