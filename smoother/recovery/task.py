"""What holds for all sections of a recording, and what is known of one between the two passes."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray, IntArray
from ..config import Config
from ..measurements.alignment import Alignment
from ..measurements.clock import Clock
from ..measurements.outliers import reject_by_residual
from ..measurements.segment import Segment
from ..recording import JOINTS, Recording
from ..selfcal.clock_fit import ClockScore, pooled_score, refined_clock
from ..selfcal.excerpts import most_telling
from ..selfcal.rounds import with_initial_values
from ..selfcal.self_calibration import SelfCalibration
from ..units import GRAVITY
from ..window.cut import cut
from ..window.draw_plan import DrawPlan, samples_apart
from ..window.pooling import pooled, pooled_shared
from ..window.prepare import PreparedSegment, prepare
from ..window.priors import calibration_from, first_priors, noise_of
from ..window.problem import NoiseModel, Priors, Window
from ..window.solution import Message
from ..window.trajectory import Trajectory, with_start
from .magnetometer import FieldObservation, takes_part
from .samples import frame_residuals
from .sections import Sections

#: With more windows than this the first pass asks some of each section only, this many in all.
ASKED_WINDOWS = 40
#: Visible stretches that are hidden to check the answer, of a recording, about, and of a section at most.
STRETCHES, MOST_IN_SECTION = 12, 6
#: With this many sections the clock is found anew from all of them: it wanders over a long recording.
CLOCK_SECTIONS = 5


@dataclass(frozen=True)
class Task:
    """What holds for all sections."""

    model: SelfCalibration  # What the excerpts gave
    config: Config
    prior: Priors  # Of every window of the first pass
    noise: NoiseModel  # Densities and losses
    sharing: int  # How many windows share the attitude prior, about
    joints: tuple[str, ...]  # To answer for
    magnetometer: bool  # There is a calibrated one
    with_clock: bool  # The first pass asks every section for the clock
    asked_windows: int  # This many windows of each section are solved for what all share; 0 = all
    plan: DrawPlan | None = None  # Of the motions to draw from the posterior in the second pass
    stretches: int = 0  # This many visible stretches of each section are hidden to check the answer
    usual_gap_s: float = 1.0  # How long the recording's gaps are

    @classmethod
    def of(
        cls,
        recording: Recording,
        sections: Sections,
        model: SelfCalibration,
        config: Config,
        usual_gap_s: float = 1.0,
    ) -> Task:
        """The task of a recording whose sections are cut."""
        present = recording.arm.present
        length_s = config.windows.length_s
        windows = sum(max(round(section.length_s / length_s), 1) for section in sections.all)
        # a magnetometer is read with the first pass's attitude: everywhere
        with_field = takes_part(recording.imu)
        some = windows > ASKED_WINDOWS and not with_field
        return cls(
            model=model,
            config=config,
            prior=first_priors(model.initial, model.prior, config),
            noise=noise_of(config, model.upper_arm_sigma_m, model.prior),
            sharing=windows,
            joints=tuple(joint for joint in JOINTS if joint in present and joint != "strap"),
            magnetometer=with_field,
            with_clock=len(sections) >= CLOCK_SECTIONS,
            asked_windows=-(-ASKED_WINDOWS // len(sections)) if some else 0,
            stretches=min(-(-STRETCHES // len(sections)), MOST_IN_SECTION),
            usual_gap_s=usual_gap_s,
        )

    def refined(
        self, messages: Sequence[Message], scores: Sequence[ClockScore], synthetic_stamps: bool
    ) -> Task:
        """The task with the arm and the clock as all sections of the first pass together have them."""
        model = self.model
        arm = pooled(messages, self.prior)
        estimate = calibration_from(arm, self.prior.layout, model.prior, model.joint_bias.sigma_m)
        clocks = model.clocks
        if self.with_clock:
            clocks = (refined_clock(model.clock, pooled_score(scores), synthetic_stamps),)
        return replace(self, model=replace(model, estimate=estimate, clocks=clocks))

    def selected(self, segment: Segment, borders: Sequence[float]) -> IntArray:
        """Numbers of a section's windows that the first pass asks."""
        return most_telling(segment, borders, self.asked_windows or len(borders))

    def drawing(self, count: int, seed: int, recording: Recording, messages: Sequence[Message]) -> Task:
        """The task with motions to draw in the second pass; the same one where none are asked for."""
        if not count:
            return self
        plan = DrawPlan(
            count=count,
            seed=seed,
            arm=f"{recording.side}/{recording.body}",
            every=samples_apart(recording.imu.t_s),
            shared=pooled_shared(messages, self.prior).covariance,
            considered=self.model.errors.considered,
        )
        return replace(self, plan=plan)

    def windows(
        self,
        prepared: PreparedSegment,
        borders: list[float],
        priors: Sequence[Priors],
        only: Container[int] | None = None,
    ) -> list[Window]:
        """A section's windows, or those whose numbers are given only."""
        margin_s = self.config.windows.margin_s
        return list(cut(prepared, priors, self.noise, borders, margin_s, GRAVITY, self.sharing, only))


@dataclass(frozen=True)
class SectionState:
    """What the second pass needs of a section's first."""

    imu_t: FloatArray  # (n,) s: the IMU's stamps; the first is the recording's sample `first_sample`
    first_sample: int
    segment: Segment  # Samples and nodes
    prepared: PreparedSegment  # Samples and nodes
    alignment: Alignment  # Of the inertial frame to the camera's
    clock: Clock  # That the first pass had
    borders: list[float]  # s: Where windows begin and end
    trajectory: Trajectory | None  # The first pass's; None where it selected some of the windows only
    observations: tuple[FieldObservation, ...]  # What the magnetometer read, one per window
    outliers_rejected: bool = False  # Samples that the first pass contradicts are out already

    def without_outliers(self, task: Task) -> SectionState:
        """Samples that the trajectory contradicts rejected, and it as start values."""
        if self.outliers_rejected or self.trajectory is None:
            return self
        segment, prepared, clock = self.segment, self.prepared, task.model.clock
        frame_t_imu = segment.frame_t_imu(clock)
        residual = frame_residuals(
            segment.position, frame_t_imu, prepared, self.trajectory, task.model.estimate
        )
        inliers = reject_by_residual(segment, residual, task.model.joint_noise)
        again = None
        if inliers is not segment:
            again = prepare(
                inliers,
                task.model.prior,
                clock,
                task.model.joint_sigma_m,
                task.config.windows.margin_s,
                self.alignment,
            )
        if again is not None:
            start = with_initial_values(again[0], self.trajectory).forearm.start
            prepared = with_start(again[0], start, self.trajectory, prepared)
            return replace(self, segment=inliers, prepared=prepared, outliers_rejected=True)
        start = self.trajectory.forearm.states
        prepared = with_start(self.at_clock(clock).prepared, start, self.trajectory, prepared)
        return replace(self, prepared=prepared, clock=clock, outliers_rejected=True)

    def at_clock(self, clock: Clock) -> SectionState:
        """The same with its frames on a clock that was found anew; they are propagated to the same nodes."""
        segment, signal = self.segment, self.prepared.forearm.signal
        before = segment.frame_t_imu(self.clock)
        inside = (before >= segment.start_s) & (before <= segment.end_s)
        frame_t = np.clip(segment.frame_t_imu(clock), signal.start_s, signal.end_s)[inside]
        return replace(self, prepared=replace(self.prepared, frame_t_imu=frame_t), clock=clock)
