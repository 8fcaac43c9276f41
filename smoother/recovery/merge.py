"""One trajectory at the IMU's own stamps, from the answers of the sections."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..measurements.clock import Clock
from ..measurements.rejection import REASONS
from ..measurements.timeline import Timeline
from ..measurements.visibility import Gap
from ..recording import JOINTS, Recording
from ..result import Estimates, FrameResiduals, Recovery
from ..runtime.store import Store
from ..selfcal.self_calibration import SelfCalibration
from ..window.solution import Message
from ..window.trajectory import share_after
from .blending import between_quaternions, blend
from .draw_columns import DrawColumns
from .magnetometer import Magnetometer
from .notes import notes_on
from .samples import SectionAnswer
from .second_pass import SecondAnswer
from .task import Task
from .upper_columns import UpperColumns


def merge(
    answers: Iterable[SecondAnswer],
    recording: Recording,
    timeline: Timeline,
    task: Task,
    magnetometer: Magnetometer,
    coarse_clock: Clock | None,
    store: Store,
) -> Recovery:
    """The answer at every IMU sample; nan where no section has one.

    Parameters
    ----------
    answers : iterable of SecondAnswer
        In the order of time; taken one by one, as they are solved.
    recording : Recording
        With the camera's stamps as `coarse_clock` moved them.
    timeline : Timeline
        Of the recording.
    task : Task
        Refined by the first pass.
    magnetometer : Magnetometer
        What became of it.
    coarse_clock : Clock or None
        How the camera's stamps were moved beforehand.
    store : Store
        Where the columns live.
    """
    columns = _Columns(recording, task.joints, store)
    upper = UpperColumns(len(recording.imu), store)
    drawn = DrawColumns(recording.imu.t_s, task.plan, store)
    unexplained: list[Gap] = []
    for answer in answers:
        share, rows = columns.add(answer.answer, answer.messages), answer.answer.samples
        upper.add(answer.upper, rows, share)
        drawn.add(answer.draws, rows, share)
        unexplained = merged_gaps(unexplained, answer.unexplained)
    model = task.model
    clock = model.clock.after(coarse_clock)
    arm = replace(recording.arm, t_s=model.clock.to_imu(recording.arm.t_s))
    residuals = columns.residuals(arm.t_s)
    gaps = tuple(columns.gaps)
    recovery = Recovery(
        method="graph",
        t_s=recording.imu.t_s,
        occluded=columns.occluded,
        **columns.motion,
        joints=columns.joints,
        joint_covariance=columns.joint_covariance,
        gaps=gaps,
        calibration=upper.calibration(model, recording.side),
        gravity_direction=columns.gravity_direction(),
        clock_offset_s=clock.mean_s,
        clock_offset_sigma_s=clock.sigma_s,
        arm=arm,
        residuals=residuals,
        origin_ns=recording.origin_ns,
        side=recording.side,
        name=recording.name,
        notes=notes_on(recording, timeline, model, clock, residuals, gaps, unexplained),
        # the answer is the same on any number of processes
        config=task.config.model_dump(exclude={"windows": {"processes"}}),
        estimates=_estimates(model, np.mean(columns.bias, axis=0)),
        upper=upper.motion(recording, model, coarse_clock),
        body=recording.body,
        trunk=None,  # beside the arm: `with_trunk`
        draws=drawn.draws(),
    )
    return magnetometer.noted(recovery)


def _estimates(model: SelfCalibration, bias: FloatArray) -> Estimates:
    joint_bias = model.joint_bias
    return Estimates(
        camera_sigma_m={joint: noise.sample_m for joint, noise in model.joint_noise.items()},
        camera_effective_sigma_m={joint: noise.effective_m for joint, noise in model.joint_noise.items()},
        joint_bias_m={
            joint: tuple(joint_bias.error_m[JOINTS.index(joint)].tolist()) for joint in joint_bias.joints
        },
        joint_bias_sigma_m=joint_bias.sigma_m,
        accelerometer_bias=tuple(bias[:3].tolist()),
        gyroscope_bias=tuple(bias[3:].tolist()),
    )


class _Columns:
    """What grows with the recording: filled section by section, neighbours blended over their border."""

    def __init__(self, recording: Recording, names: tuple[str, ...], store: Store) -> None:
        self._recording = recording
        samples, frames = len(recording.imu), len(recording.arm)
        self.motion = {
            "position": store.array((samples, 3)),
            "quaternion": store.array((samples, 4)),
            "velocity": store.array((samples, 3)),
            "pose_covariance": store.array((samples, 6, 6)),
            "velocity_covariance": store.array((samples, 3, 3)),
        }
        self.joints = {joint: store.array((samples, 3)) for joint in names}
        self.joint_covariance = {joint: store.array((samples, 3, 3)) for joint in names}
        self.occluded = np.ones(samples, bool)
        self._residual = store.array((frames, len(JOINTS), 3))
        self._used = np.zeros((frames, len(JOINTS)), bool)
        self._reason = np.zeros((frames, len(JOINTS)), np.uint8)
        self.gaps: list[Gap] = []
        self._gravity: list[FloatArray] = []
        self.bias: list[FloatArray] = []
        self._end = 0  # first sample without an answer yet

    def add(self, answer: SectionAnswer, messages: list[Message]) -> FloatArray:
        """The next section, blended with the one before over their border; its windows' messages.

        Returns the share of this section, against the one before, at each of its samples.
        """
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
        self.bias += [message.shared.mean[:6] for message in messages]
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
