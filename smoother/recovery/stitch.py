"""The `Recovery` of a recording from the answers of its sections."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ..calibration import ArmCalibration
from ..config import Config
from ..measurements.clock import Clock
from ..measurements.outliers import REASONS
from ..measurements.visibility import Gap
from ..recording import JOINTS, FloatArray, Recording
from ..result import FrameResiduals, Recovery
from ..runtime.store import Store
from ..selfcal.rounds import SelfCalibration
from ..window.problem import Message
from ..window.trajectory import mix, share_after, turn_to
from .notes import notes_on
from .samples import SectionAnswer


class Merger:
    """Puts the sections' answers together, in the order of time.

    Parameters
    ----------
    recording : what is answered for.
    names : joints to answer for.
    store : where the columns live.
    """

    def __init__(self, recording: Recording, names: tuple[str, ...], store: Store) -> None:
        self._recording = recording
        samples, frames = len(recording.imu), len(recording.arm)
        self._columns = {
            "position": store.array((samples, 3)),
            "quaternion": store.array((samples, 4)),
            "velocity": store.array((samples, 3)),
            "pose_covariance": store.array((samples, 6, 6)),
            "velocity_covariance": store.array((samples, 3, 3)),
        }
        self._joints = {joint: store.array((samples, 3)) for joint in names}
        self._joint_covariance = {joint: store.array((samples, 3, 3)) for joint in names}
        self._occluded = np.ones(samples, bool)
        self._residual = store.array((frames, len(JOINTS), 3))
        self._used = np.zeros((frames, len(JOINTS)), bool)
        self._reason = np.zeros((frames, len(JOINTS)), np.uint8)
        self._gaps: list[Gap] = []
        self._gravity: list[FloatArray] = []
        self._bias: list[FloatArray] = []
        self._end = 0  # first sample without an answer yet

    def add(self, answer: SectionAnswer, messages: list[Message]) -> None:
        """The next section, blended with the one before over their border; its windows' messages."""
        rows = answer.samples
        t = self._recording.imu.t_s[rows]
        share = share_after(t, answer.border_s)
        share[~(np.arange(rows.start, rows.stop) < self._end)] = 1.0
        both = slice(rows.start, rows.start + int(np.count_nonzero(share < 1.0)))
        before = self._columns["quaternion"][both].copy()
        for name, column in self._columns.items():
            _blend(column, rows, getattr(answer, name), share)
        self._columns["quaternion"][both] = _between(before, answer.quaternion[: len(before)], share)
        for joint, place in self._joints.items():
            _blend(place, rows, answer.joints[joint], share)
            _blend(self._joint_covariance[joint], rows, answer.joint_covariance[joint], share)
        mine = (t >= answer.border_s) | (share == 1.0)
        self._occluded[rows] = np.where(mine, answer.occluded, self._occluded[rows])
        self._residual[answer.frames] = answer.residual
        self._used[answer.frames], self._reason[answer.frames] = answer.used, answer.reason
        self._gaps = _joined(self._gaps, answer.gaps)
        self._gravity.append(answer.gravity)
        self._bias += [message.shared.mean[:6] for message in messages]
        self._end = rows.stop

    def recovery(
        self, calibration: ArmCalibration, config: Config, known: SelfCalibration, clock: Clock
    ) -> Recovery:
        """The answer at every IMU sample; nan where no section has one.

        Parameters
        ----------
        clock : of the camera's stamps as they were recorded.
        """
        recording = self._recording
        frame_t = recording.arm.t_s + known.clocks[0].at(recording.arm.t_s)
        down = np.mean(self._gravity, axis=0)
        bias = np.mean(self._bias, axis=0)
        gaps = tuple(self._gaps)
        residuals = FrameResiduals(frame_t, self._residual, self._used, self._reason, REASONS)
        return Recovery(
            method="graph",
            t_s=recording.imu.t_s,
            occluded=self._occluded,
            **self._columns,
            joints=self._joints,
            joint_covariance=self._joint_covariance,
            gaps=gaps,
            calibration=calibration,
            gravity_direction=down / np.linalg.norm(down),
            clock_offset_s=clock.mean_s,
            clock_offset_sigma_s=clock.sigma_s,
            arm=replace(recording.arm, t_s=frame_t),
            residuals=residuals,
            origin_ns=recording.origin_ns,
            side=recording.side,
            name=recording.name,
            notes=notes_on(recording, known, clock, residuals, gaps),
            # the answer is the same on any number of processes
            config=config.model_dump(exclude={"windows": {"processes"}}),
            figures={
                "camera_sigma_m": {joint: noise.sample_m for joint, noise in known.noise.items()},
                "camera_effective_sigma_m": {
                    joint: noise.effective_m for joint, noise in known.noise.items()
                },
                "joint_bias_m": {
                    joint: known.bias.found_m[JOINTS.index(joint)].tolist() for joint in known.bias.joints
                },
                "joint_bias_sigma_m": known.bias.sigma_m,
                "accelerometer_bias": bias[:3].tolist(),
                "gyroscope_bias": bias[3:].tolist(),
            },
        )


def _blend(column: NDArray, rows: slice, value: FloatArray, share: FloatArray) -> None:
    """Write the values to rows, over what stands there by the share (k,) of the way."""
    mixed = np.flatnonzero(share < 1.0)
    old = column[rows.start + mixed]
    column[rows] = value
    if len(mixed):
        mix(old, np.arange(len(mixed)), value[mixed], share[mixed])
        known = np.isfinite(old)
        column[rows.start + mixed] = np.where(known, old, value[mixed])


def _between(before: FloatArray, after: FloatArray, share: FloatArray) -> FloatArray:
    """Quaternions on the way from one to the other by the share; `after` where there is nothing before."""
    out = after.copy()
    known = np.flatnonzero(np.isfinite(before).all(axis=1))
    if len(known):
        R = Rotation.from_quat(before[known], scalar_first=True).as_matrix()
        target = Rotation.from_quat(after[known], scalar_first=True).as_matrix()
        step = Rotation.from_rotvec(share[known, None] * turn_to(R, target, np.ones(len(known), bool)))
        out[known] = (Rotation.from_matrix(R) * step).as_quat(scalar_first=True)
    return out


def _joined(gaps: list[Gap], more: tuple[Gap, ...]) -> list[Gap]:
    """Gaps in order of time; one that both sections saw a part of counts once."""
    gaps = list(gaps)
    for gap in more:
        if gaps and gap.start_s < gaps[-1].end_s:
            last = gaps.pop()
            start, end = min(last, gap, key=lambda g: g.start_s), max(last, gap, key=lambda g: g.end_s)
            gap = Gap(start.start_s, end.end_s, start.open_start, end.open_end)
        gaps.append(gap)
    return gaps
