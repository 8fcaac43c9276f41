"""What grows with the recording of an upper-arm IMU: filled section by section."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..measurements.clock import Clock
from ..recording import Recording
from ..result.upper_motion import UpperMotion
from ..runtime.store import Store
from ..selfcal.self_calibration import SelfCalibration
from .blending import between_quaternions, blend
from .upper_samples import UpperAnswer, humerus_axes


class UpperColumns:
    """The answers on an upper-arm IMU at a recording's samples, neighbours blended over their border.

    Parameters
    ----------
    count : int
        Samples of the recording.
    store : Store
        Where the columns live.
    """

    def __init__(self, count: int, store: Store) -> None:
        self._count, self._store = count, store
        self._columns: dict[str, FloatArray] = {}
        self._answers: list[UpperAnswer] = []

    def add(self, answer: UpperAnswer | None, rows: slice, share: FloatArray) -> None:
        """The next section's answer at its samples; its share against the one before at each of them."""
        if answer is None:
            return
        if not self._columns:
            for name, size in (("position", (3,)), ("quaternion", (4,)), ("pose_covariance", (6, 6))):
                self._columns[name] = self._store.array((self._count, *size))
        both = slice(rows.start, rows.start + int(np.count_nonzero(share < 1.0)))
        before = self._columns["quaternion"][both].copy()
        for name, column in self._columns.items():
            blend(column, rows, getattr(answer, name), share)
        turned = between_quaternions(before, answer.quaternion[: len(before)], share)
        known = np.asarray(np.isfinite(answer.quaternion[: len(before)]).all(axis=1))
        self._columns["quaternion"][both] = np.where(known[:, None], turned, before)
        empty = np.zeros((0, 0))  # of the samples nothing more is needed
        self._answers.append(replace(answer, position=empty, quaternion=empty, pose_covariance=empty))

    def calibration(self, model: SelfCalibration, side: str) -> ArmCalibration:
        """The arm's calibration with the bone's axes in that IMU."""
        if not self._columns:
            return model.estimate
        R_U_B, _ = humerus_axes(self._answers, model.estimate, side, model.tissue_m)
        return replace(model.estimate, R_U_B=R_U_B)

    def motion(
        self, recording: Recording, model: SelfCalibration, coarse_clock: Clock | None
    ) -> UpperMotion | None:
        """The whole of it; None without such an IMU. The coarse clock moved the camera's stamps before."""
        if not self._columns or recording.upper_imu is None:
            return None
        _, sigma = humerus_axes(self._answers, model.estimate, recording.side, model.tissue_m)
        moved_s = 0.0 if coarse_clock is None else coarse_clock.mean_s
        return UpperMotion(
            **self._columns,
            mount_sigma_rad=sigma,
            clock_offset_s=model.upper_clock_offset_s + moved_s,
            name=recording.upper_imu.name,
        )
