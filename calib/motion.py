"""`calibrate motion`: lever arms, limb lengths and mounting from one or several recordings of a person."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.pieces import take_apart
from smoother.pool import Pool
from smoother.recording import Recording
from smoother.selfcal import LARGEST_OFFSET_S, Knowledge, self_calibrate


@dataclass(frozen=True)
class MotionCalibration:
    """What the recordings told.

    Attributes
    ----------
    calibration : lever arms, lengths and mounting with sigmas; carries over to other recordings.
    knowledge : all that was found, clock offsets (one a recording, never carried over) included.
    recordings : names in the order of the offsets.
    """

    calibration: ArmCalibration
    knowledge: Knowledge
    recordings: tuple[str, ...]


def calibrate_motion(
    recordings: Sequence[Recording], known: ArmCalibration | None = None, config: Config | None = None
) -> MotionCalibration:
    """Calibrate one mounting of the IMU on one arm from visible motion, over all recordings together.

    Parameters
    ----------
    recordings : of one person, arm and mounting; each keeps a clock offset and gravity of its own.
    known : what is measured already; it is believed to its sigmas.
    config : settings; the defaults where None.

    Raises
    ------
    CalibrationError
        No recording shows the forearm together with the IMU, or they are of different arms.
    """
    config = config or Config()
    sides = sorted({recording.side for recording in recordings if recording.side})
    if len(sides) > 1:
        raise CalibrationError("the recordings are of both arms; calibrate the left and the right apart")
    known = known or ArmCalibration(side=sides[0] if sides else "")
    pieces = [
        piece
        for number, recording in enumerate(recordings)
        for piece in take_apart(recording, LARGEST_OFFSET_S, number)
    ]
    if not pieces:
        raise CalibrationError("in none of the recordings do the IMU and a visible forearm come together")
    with Pool(config.windows.processes, sum(len(piece.frame_t) for piece in pieces)) as pool:
        knowledge = self_calibrate(pieces, known, config, pool)
    missing = [k for k in range(len(recordings)) if k not in {piece.recording for piece in pieces}]
    knowledge.offset_sigma_s[missing] = np.nan
    return MotionCalibration(
        knowledge.calibration, knowledge, tuple(recording.name for recording in recordings)
    )
