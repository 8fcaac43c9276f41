"""What holds for all sections of a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..config import Config
from ..recording import JOINTS, Recording
from ..selfcal.self_calibration import SelfCalibration
from ..window.draw_plan import DrawPlan, samples_apart
from ..window.priors import first_priors, noise_of
from ..window.problem import NoiseModel, Priors
from .magnetometer import Field
from .sections import Sections

#: Visible stretches that are hidden to check the answer, of a recording, about, and of a section at most.
STRETCHES, MOST_IN_SECTION = 12, 6


@dataclass(frozen=True)
class Task:
    """What holds for all sections."""

    model: SelfCalibration  # What the excerpts gave
    config: Config
    prior: Priors  # On what all sections share
    noise: NoiseModel  # Densities and losses
    sharing: int  # How many sections share the attitude prior
    joints: tuple[str, ...]  # To answer for
    stretches: int  # This many visible stretches of each section are hidden to check the answer
    usual_gap_s: float  # How long the recording's gaps are
    plan: DrawPlan | None = None  # Of the motions to draw from the posterior
    field: Field | None = None  # The magnetic field where a calibrated magnetometer read it

    @classmethod
    def of(
        cls,
        recording: Recording,
        sections: Sections,
        model: SelfCalibration,
        config: Config,
        usual_gap_s: float = 1.0,
        is_read_whole: bool = False,
    ) -> Task:
        """The task of a recording whose sections are cut; what was read whole is no prior on itself."""
        present = recording.arm.present
        return cls(
            model=model,
            config=config,
            prior=first_priors(model.initial, model.prior if is_read_whole else model.estimate, config),
            noise=replace(noise_of(config, model.upper_arm_sigma_m, model.prior), in_common=model.in_common),
            sharing=len(sections),
            joints=tuple(joint for joint in JOINTS if joint in present and joint != "strap"),
            stretches=min(-(-STRETCHES // max(len(sections), 1)), MOST_IN_SECTION),
            usual_gap_s=usual_gap_s,
        )

    def drawing(self, count: int, seed: int, recording: Recording) -> Task:
        """The task with motions to draw; the same one where none are asked for."""
        if not count:
            return self
        plan = DrawPlan(
            count=count,
            seed=seed,
            arm=f"{recording.side}/{recording.body}",
            every=samples_apart(recording.imu.t_s),
            shared=self.prior.shared.covariance,
            considered=self.model.errors.considered,
        )
        return replace(self, plan=plan)
