"""One trajectory at the IMU's own stamps, from the answers of the sections."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from ..errors import SolveError
from ..measurements.clock import Clock
from ..measurements.segment import Timeline
from ..measurements.visibility import REASONS, Gap
from ..recording import JOINTS, Recording
from ..result import Draws, Estimates, FrameResiduals, Recovery, SegmentMotion
from ..result.verdict import finding
from ..runtime.store import large_array
from ..selfcal.self_calibration import SelfCalibration
from ..window.draw_plan import DrawPlan
from ..window.trajectory import share_after
from .blended_columns import BlendedColumns
from .magnetometer import Magnetometer
from .notes import notes_on, unexplained_gaps
from .samples import ElbowAxis, SectionAnswer, bone_axes
from .task import Task


def merge(
    answers: Iterable[SectionAnswer],
    recording: Recording,
    timeline: Timeline,
    task: Task,
    magnetometer: Magnetometer,
    coarse_clock: Clock | None,
) -> Recovery:
    """The answer at every IMU sample; nan where no section has one."""
    samples, frames = len(recording.imu), len(recording.arm)
    motion, places, spreads = BlendedColumns(samples), BlendedColumns(samples), BlendedColumns(samples)
    further: dict[str, BlendedColumns] = {}
    elbow: dict[str, list[ElbowAxis]] = {}
    every = 1 if task.plan is None else task.plan.every
    drawn = BlendedColumns(-(-samples // every), np.float32)
    occluded = np.ones(samples, bool)
    residual = large_array((frames, len(JOINTS), 3))
    used, reason = np.zeros((frames, len(JOINTS)), bool), np.zeros((frames, len(JOINTS)), np.uint8)
    gaps: list[Gap] = []
    unexplained: list[Gap] = []
    downs: list[FloatArray] = []
    biases: list[FloatArray] = []
    end = 0  # first sample without an answer yet
    for answer in answers:
        rows = answer.samples
        t = recording.imu.t_s[rows]
        share = share_after(t, answer.border_s)
        motion.add(rows, answer.motion, share)
        places.add(rows, answer.joints, share)
        spreads.add(rows, answer.joint_covariance, share)
        for name, columns in answer.further.items():
            further.setdefault(name, BlendedColumns(samples)).add(rows, columns, share)
            elbow.setdefault(name, []).append(answer.elbow[name])
        if answer.drawn is not None and len(answer.drawn):
            first = (rows.start + int(answer.drawn[0])) // every
            drawn.add(slice(first, first + len(answer.drawn)), answer.draws, share[answer.drawn])
        mine = (t >= answer.border_s) | (np.arange(rows.start, rows.stop) >= end)
        occluded[rows] = np.where(mine, answer.occluded, occluded[rows])
        residual[answer.frames] = answer.residual
        used[answer.frames], reason[answer.frames] = answer.used, answer.reason
        gaps, unexplained = merged_gaps(gaps, answer.gaps), merged_gaps(unexplained, answer.unexplained)
        downs.append(answer.gravity)
        biases.append(answer.bias)
        end = rows.stop
    if not biases:
        raise SolveError(f"{recording.name}: in no part of the recording camera and IMU give one motion")
    model = task.model
    clock = model.clock.after(coarse_clock)
    arm = replace(recording.arm, t_s=model.clock.to_imu(recording.arm.t_s))
    residuals = FrameResiduals(arm.t_s, residual, used, reason, REASONS)
    calibration, segments = _further(further, elbow, recording, model, coarse_clock)
    down = np.mean(downs, axis=0)
    recovery = Recovery(
        method="graph",
        t_s=recording.imu.t_s,
        occluded=occluded,
        **motion.done(),
        joints=places.done(),
        joint_covariance=spreads.done(),
        gaps=tuple(gaps),
        calibration=calibration,
        gravity_direction=down / np.linalg.norm(down),
        clock_offset_s=clock.mean_s,
        clock_offset_sigma_s=clock.sigma_s,
        arm=arm,
        residuals=residuals,
        origin_ns=recording.origin_ns,
        side=recording.side,
        name=recording.name,
        notes=notes_on(recording, timeline, model, clock, residuals, tuple(gaps), unexplained),
        # the answer is the same on any number of processes
        config=task.config.model_dump(exclude={"windows": {"processes"}}, exclude_none=True),
        estimates=_estimates(model, np.mean(biases, axis=0)).with_findings(
            finding("gap-unexplained", note, (gap.start_s, gap.end_s))
            for gap, note in zip(unexplained, unexplained_gaps(unexplained), strict=True)
        ),
        segments=segments,
        body=recording.body,
        trunk=None,  # beside the arm: `with_trunk`
        draws=_draws(drawn, recording, task.plan),
    )
    return magnetometer.noted(recovery)


def _further(
    columns: dict[str, BlendedColumns],
    elbow: dict[str, list[ElbowAxis]],
    recording: Recording,
    model: SelfCalibration,
    coarse_clock: Clock | None,
) -> tuple[ArmCalibration, dict[str, SegmentMotion]]:
    """The arm's calibration with the bones' axes in IMUs on further segments, and the motions of these."""
    calibration, motions = model.estimate, {}
    moved_s = 0.0 if coarse_clock is None else coarse_clock.mean_s  # of the camera's stamps, before
    for name, of_segment in columns.items():
        mounting = model.estimate.mountings[name]
        R_bone, mount_sigma_rad = bone_axes(name, elbow[name], mounting, recording.side)
        calibration = calibration.with_bone_axes(name, R_bone)
        motions[name] = SegmentMotion(
            **of_segment.done(),
            mount_sigma_rad=mount_sigma_rad,
            clock_offset_s=model.further_clock_offset_s[name] + moved_s,
            name=recording.further_imus[name].name,
        )
    return calibration, motions


def _draws(drawn: BlendedColumns, recording: Recording, plan: DrawPlan | None) -> Draws | None:
    if plan is None:
        return None
    # a draw at a time is how they are read; a time after the other is how they lie
    columns = {name: np.moveaxis(values, 0, 1) for name, values in drawn.done().items()}
    return Draws.from_columns(recording.imu.t_s[:: plan.every], plan.seed, columns)


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
