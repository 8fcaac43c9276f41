"""What grows with a recording, filled section by section: neighbours are blended over their border."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..measurements.clock import Clock
from ..measurements.visibility import REASONS, Gap
from ..recording import JOINTS, Recording
from ..result import Draws, FrameResiduals
from ..result.segment_motion import SegmentMotion
from ..rotation import Rotation
from ..runtime.store import large_array
from ..selfcal.self_calibration import SelfCalibration
from ..window.draw_plan import DrawPlan
from ..window.trajectory import mix, share_after, turn_to
from .drawn_samples import SectionDraws
from .samples import ElbowAxis, FurtherAnswer, SectionAnswer, bone_axes


def blend(column: NDArray, rows: slice, value: FloatArray, share: FloatArray) -> None:
    """Write the values to rows, over what is there by the share (k,) of the way."""
    mixed = np.flatnonzero(share < 1.0)
    old = column[rows.start + mixed]
    column[rows] = value
    if len(mixed):
        either = np.where(np.isfinite(value[mixed]), value[mixed], old)
        mixture = old.copy()
        mix(mixture, np.arange(len(mixed)), value[mixed], share[mixed])
        column[rows.start + mixed] = np.where(np.isfinite(mixture), mixture, either)


def between_quaternions(before: FloatArray, after: FloatArray, share: FloatArray) -> FloatArray:
    """Quaternions on the way from one to the other by the share; where one is not known, the other."""
    known = np.asarray(np.isfinite(after).all(axis=1))
    out = np.where(known[:, None], after, before)
    both = np.flatnonzero(known & np.isfinite(before).all(axis=1))
    if len(both):
        R = Rotation.from_quat(before[both], scalar_first=True).as_matrix()
        target = Rotation.from_quat(after[both], scalar_first=True).as_matrix()
        step = Rotation.from_rotvec(share[both, None] * turn_to(R, target, np.ones(len(both), bool)))
        out[both] = (Rotation.from_matrix(R) * step).as_quat(scalar_first=True)
    return out


class FurtherColumns:
    """The answers on IMUs of further segments at a recording's samples, neighbours blended over their
    border.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._columns: dict[str, dict[str, FloatArray]] = {}
        self._elbow: dict[str, list[ElbowAxis]] = {}

    def add(self, answer: FurtherAnswer, rows: slice, share: FloatArray) -> None:
        """The next section's answer at its samples; its share against the one before at each of them."""
        name = answer.segment
        if name not in self._columns:
            self._columns[name] = {
                column: large_array((self._count, *size))
                for column, size in (("position", (3,)), ("quaternion", (4,)), ("pose_covariance", (6, 6)))
            }
        columns = self._columns[name]
        both = slice(rows.start, rows.start + int(np.count_nonzero(share < 1.0)))
        before = columns["quaternion"][both].copy()
        for column, values in columns.items():
            blend(values, rows, getattr(answer, column), share)
        turned = between_quaternions(before, answer.quaternion[: len(before)], share)
        known = np.asarray(np.isfinite(answer.quaternion[: len(before)]).all(axis=1))
        columns["quaternion"][both] = np.where(known[:, None], turned, before)
        self._elbow.setdefault(name, []).append(answer.elbow)

    def calibration(self, model: SelfCalibration, side: str) -> ArmCalibration:
        """The arm's calibration with the bones' axes in these IMUs."""
        calibration = model.estimate
        for name in self._columns:
            R_bone, _ = bone_axes(name, self._elbow[name], calibration.mountings[name], side)
            calibration = calibration.with_bone_axes(name, R_bone)
        return calibration

    def motions(
        self, recording: Recording, model: SelfCalibration, coarse_clock: Clock | None
    ) -> dict[str, SegmentMotion]:
        """The whole of them by segment. The coarse clock moved the camera's stamps before."""
        moved_s = 0.0 if coarse_clock is None else coarse_clock.mean_s
        return {
            name: SegmentMotion(
                **columns,
                mount_sigma_rad=bone_axes(
                    name, self._elbow[name], model.estimate.mountings[name], recording.side
                )[1],
                clock_offset_s=model.further_clock_offset_s[name] + moved_s,
                name=recording.further_imus[name].name,
            )
            for name, columns in self._columns.items()
        }


class DrawColumns:
    """The drawn motions of a recording, neighbouring sections blended over their border."""

    def __init__(self, imu_t: FloatArray, plan: DrawPlan | None) -> None:
        self._imu_t, self._plan = imu_t, plan
        self._columns: dict[str, FloatArray] = {}
        self._end = 0  # first drawn time that is not filled yet; on disk, filling all at once takes seconds

    def add(self, answer: SectionDraws | None, rows: slice, share: FloatArray) -> None:
        """The next section's motions; its samples' rows, and its share against the one before at each."""
        if answer is None or self._plan is None or not len(answer.samples):
            return
        count = -(-len(self._imu_t) // self._plan.every)
        first = (rows.start + int(answer.samples[0])) // self._plan.every
        drawn = slice(first, first + len(answer.samples))
        for name, values in answer.columns.items():
            if name not in self._columns:
                self._columns[name] = large_array((count, *values.shape[1:]), 0.0, np.float32)
                self._columns[name][: self._end] = np.nan
        for column in self._columns.values():
            column[self._end : drawn.stop] = np.nan
        for name, values in answer.columns.items():
            blend(self._columns[name], drawn, values, share[answer.samples])
        self._end = max(self._end, drawn.stop)

    def draws(self) -> Draws | None:
        """All of them; None where none were drawn."""
        if self._plan is None:
            return None
        for values in self._columns.values():
            values[self._end :] = np.nan
        # a draw at a time is how they are read; a time after the other is how they lie
        columns = {name: np.moveaxis(values, 0, 1) for name, values in self._columns.items()}
        return Draws.from_columns(self._imu_t[:: self._plan.every], self._plan.seed, columns)


class ArmColumns:
    """What grows with the recording: filled section by section, neighbours blended over their border."""

    def __init__(self, recording: Recording, names: tuple[str, ...]) -> None:
        self._recording = recording
        samples, frames = len(recording.imu), len(recording.arm)
        self.motion = {
            "position": large_array((samples, 3)),
            "quaternion": large_array((samples, 4)),
            "velocity": large_array((samples, 3)),
            "pose_covariance": large_array((samples, 6, 6)),
            "velocity_covariance": large_array((samples, 3, 3)),
        }
        self.joints = {joint: large_array((samples, 3)) for joint in names}
        self.joint_covariance = {joint: large_array((samples, 3, 3)) for joint in names}
        self.occluded = np.ones(samples, bool)
        self._residual = large_array((frames, len(JOINTS), 3))
        self._used = np.zeros((frames, len(JOINTS)), bool)
        self._reason = np.zeros((frames, len(JOINTS)), np.uint8)
        self.gaps: list[Gap] = []
        self._gravity: list[FloatArray] = []
        self.bias: list[FloatArray] = []
        self._end = 0  # first sample without an answer yet

    def add(self, answer: SectionAnswer) -> FloatArray:
        """The next section, blended with the one before over their border."""
        rows = answer.samples
        t = self._recording.imu.t_s[rows]
        share = share_after(t, answer.border_s)
        share[~(np.arange(rows.start, rows.stop) < self._end)] = 1.0
        both = slice(rows.start, rows.start + int(np.count_nonzero(share < 1.0)))
        before = self.motion["quaternion"][both].copy()
        for name, column in self.motion.items():
            blend(column, rows, getattr(answer, name), share)
        self.motion["quaternion"][both] = between_quaternions(before, answer.quaternion[: len(before)], share)
        for joint, column in self.joints.items():
            blend(column, rows, answer.joints[joint], share)
            blend(self.joint_covariance[joint], rows, answer.joint_covariance[joint], share)
        mine = (t >= answer.border_s) | (share == 1.0)
        self.occluded[rows] = np.where(mine, answer.occluded, self.occluded[rows])
        self._residual[answer.frames] = answer.residual
        self._used[answer.frames], self._reason[answer.frames] = answer.used, answer.reason
        self.gaps = merged_gaps(self.gaps, answer.gaps)
        self._gravity.append(answer.gravity)
        self.bias.append(answer.bias)
        self._end = rows.stop
        return share

    def gravity_direction(self) -> FloatArray:
        """Mean direction of down, (3,) in {K}."""
        down = np.mean(self._gravity, axis=0)
        return np.asarray(down / np.linalg.norm(down))

    def residuals(self, frame_t_imu: FloatArray) -> FrameResiduals:
        """Camera against answer, frame by frame."""
        return FrameResiduals(frame_t_imu, self._residual, self._used, self._reason, REASONS)


def merged_gaps(gaps: list[Gap], more: tuple[Gap, ...]) -> list[Gap]:
    """Gaps in order of time; one that both sections saw a part of counts once."""
    gaps = list(gaps)
    for gap in more:
        if gaps and gap.start_s < gaps[-1].end_s:
            last = gaps.pop()
            start, end = min(last, gap, key=lambda g: g.start_s), max(last, gap, key=lambda g: g.end_s)
            gap = Gap(start.start_s, end.end_s, start.open_start, end.open_end)
        gaps.append(gap)
    return gaps
