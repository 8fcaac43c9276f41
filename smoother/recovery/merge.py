"""One trajectory at the IMU's own stamps, from the answers of the sections."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..errors import SolveError
from ..measurements.clock import Clock
from ..measurements.segment import Timeline
from ..measurements.visibility import Gap
from ..recording import JOINTS, Recording
from ..result import Estimates, Recovery
from ..result.verdict import Sign
from ..selfcal.self_calibration import SelfCalibration
from .blended_columns import ArmColumns, DrawColumns, FurtherColumns, merged_gaps
from .magnetometer import Magnetometer
from .notes import notes_on, unexplained_gaps
from .solve_section import SolvedSection
from .task import Task


def merge(
    answers: Iterable[SolvedSection],
    recording: Recording,
    timeline: Timeline,
    task: Task,
    magnetometer: Magnetometer,
    coarse_clock: Clock | None,
) -> Recovery:
    """The answer at every IMU sample; nan where no section has one."""
    columns = ArmColumns(recording, task.joints)
    further = FurtherColumns(len(recording.imu))
    drawn = DrawColumns(recording.imu.t_s, task.plan)
    unexplained: list[Gap] = []
    for answer in answers:
        share, rows = columns.add(answer.answer), answer.answer.samples
        for each in answer.answer.further:
            further.add(each, rows, share)
        drawn.add(answer.draws, rows, share)
        unexplained = merged_gaps(unexplained, answer.unexplained)
    if not columns.bias:
        raise SolveError(f"{recording.name}: in no part of the recording camera and IMU give one motion")
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
        calibration=further.calibration(model, recording.side),
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
        config=task.config.model_dump(exclude={"windows": {"processes"}}, exclude_none=True),
        estimates=_estimates(model, np.mean(columns.bias, axis=0)).with_signs(
            Sign(note, (gap.start_s, gap.end_s))
            for gap, note in zip(unexplained, unexplained_gaps(unexplained), strict=True)
        ),
        segments=further.motions(recording, model, coarse_clock),
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
