"""`--solve-lever-arms`: where the tracked strap lies from the IMU, as a variable."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..recording import Recording
    from ..result import Recovery

#: How far the camera's strap may lie from the IMU where that is to be found, m an axis.
STRAP_SIGMA_M = 0.02


def with_strap(calibration: ArmCalibration | None, recording: Recording) -> ArmCalibration:
    """The calibration with the strap's lever arm as a variable, unless it holds one."""
    import numpy as np

    from ..calibration import ArmCalibration, LeverArm

    calibration = calibration or ArmCalibration(side=recording.side)
    if "strap" not in recording.arm.present:
        raise typer.BadParameter(
            "--solve-lever-arms is for recordings with a tracked strap;"
            " lever arms of the joints are found without it"
        )
    strap = LeverArm(np.zeros(3), np.full(3, STRAP_SIGMA_M))
    return replace(calibration, lever_arms={"strap": strap, **calibration.lever_arms})


def with_strap_note(recovery: Recovery) -> Recovery:
    """The recovery with a note that its positions are the IMU's, not the strap's."""
    import numpy as np

    arm = recovery.calibration
    if arm is None or "strap" not in arm.lever_arms:
        return recovery
    lever = arm.lever_arms["strap"]
    note = (
        f"The tracked strap was found {1e3 * np.linalg.norm(lever.position_m):.1f} mm from the IMU; positions"
        " are those of the IMU, and a reference of the strap is that far off."
    )
    return replace(recovery, notes=(*recovery.notes, note))
