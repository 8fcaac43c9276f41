"""A recovery held against a reference: all samples, the occluded ones, the visible ones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import RecordingError
from ..recording import BoolArray, FloatArray, Truth
from ..result import Recovery
from .align import truth_at
from .metrics import Figures, orientation_error_deg, position_error, rms, squared_sigmas, summarise


@dataclass(frozen=True)
class SampleErrors:
    """Errors sample by sample, at the recovery's times; nan where there is nothing to compare.

    Attributes
    ----------
    reference : the truth at the recovery's times.
    scored : (N,) the reference has a position there that is to be scored.
    distance_m : (N,) position error, m.
    angle_deg : (N,) orientation error, degrees of rotation.
    squared_sigmas : (N,) squared position error in sigmas.
    joint_distance_m : by joint, (N,) position error of the joints that the reference has, m.
    """

    reference: Truth
    scored: BoolArray
    distance_m: FloatArray
    angle_deg: FloatArray
    squared_sigmas: FloatArray
    joint_distance_m: dict[str, FloatArray]

    def figures(self, chosen: BoolArray) -> Figures:
        """The figures of the chosen samples (N,)."""
        unanswered = int((chosen & self.scored & ~np.isfinite(self.distance_m)).sum())
        figures = summarise(
            self.distance_m[chosen], self.angle_deg[chosen], self.squared_sigmas[chosen], unanswered
        )
        joints = {name: rms(distance[chosen]) for name, distance in self.joint_distance_m.items()}
        return replace(figures, joint_rms_m=joints)


@dataclass(frozen=True)
class Validation:
    """What `validate` found.

    Attributes
    ----------
    all, occluded, visible : figures of all samples, of those in gaps, and of the others.
    notes : what a reader must know of the comparison, one sentence each.
    """

    all: Figures
    occluded: Figures
    visible: Figures
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, dict[str, object]]:
        """The three sets of figures by name, as `--json` writes them."""
        return {
            "all": self.all.to_dict(),
            "occluded": self.occluded.to_dict(),
            "visible": self.visible.to_dict(),
        }


def sample_errors(recovery: Recovery, truth: Truth) -> SampleErrors:
    """Errors of a recovery at each of its samples; the truth is read at the recovery's times."""
    reference = truth_at(truth, recovery.t_s)
    difference = np.where(reference.score[:, None], recovery.position - reference.position, np.nan)
    angle = orientation_error_deg(recovery.quaternion, reference.quaternion)
    return SampleErrors(
        reference=reference,
        scored=reference.score & np.isfinite(reference.position).all(axis=1),
        distance_m=np.linalg.norm(difference, axis=1),
        angle_deg=np.where(reference.score, angle, np.nan),
        squared_sigmas=squared_sigmas(difference, recovery.pose_covariance[:, :3, :3]),
        joint_distance_m={
            name: np.where(reference.score, position_error(recovery.joints[name], position), np.nan)
            for name, position in reference.joints.items()
            if name in recovery.joints
        },
    )


def validate(recovery: Recovery, truth: Truth) -> Validation:
    """Compare a recovery with a reference on the same clock and in the same frame.

    Parameters
    ----------
    recovery : the result to judge.
    truth : pose of the forearm IMU in the camera frame, on the IMU's clock; times count from the
        recovery's origin. Samples outside `truth.score` are not scored.

    Raises
    ------
    RecordingError
        The truth holds nothing during the recovery.
    """
    errors = sample_errors(recovery, truth)
    _refuse_without_overlap(recovery, truth, errors)
    notes = []
    if not np.isfinite(errors.angle_deg).any():
        notes.append("The truth and the result share no orientation; only positions are compared.")
    everything = np.ones(len(recovery), dtype=bool)
    figures = errors.figures(everything)
    if figures.unanswered:
        notes.append(
            f"{figures.unanswered} of {figures.unanswered + figures.samples} samples with truth have"
            " no answer and are in no figure."
        )
    return Validation(
        all=figures,
        occluded=errors.figures(recovery.occluded),
        visible=errors.figures(~recovery.occluded),
        notes=tuple(notes),
    )


def _refuse_without_overlap(recovery: Recovery, truth: Truth, errors: SampleErrors) -> None:
    if errors.scored.any() or np.isfinite(errors.angle_deg).any():
        return
    known = truth.t_s[np.isfinite(truth.position).all(axis=1)]
    if not len(known):
        raise RecordingError("the truth holds no finite position, so there is nothing to compare with")
    if not len(recovery):
        raise RecordingError("the result holds no sample, so there is nothing to compare")
    first, last = recovery.t_s[0], recovery.t_s[-1]
    if known[-1] < first or known[0] > last:
        raise RecordingError(
            f"the truth covers {known[0]:.3f} to {known[-1]:.3f} s and the result {first:.3f} to"
            f" {last:.3f} s: they do not overlap in time, so check that both count from the same clock"
        )
    if len(known) > 1 and np.median(np.diff(known)) > 0.1:
        raise RecordingError(
            "the truth's samples lie more than 0.1 s apart, and holes that long are not bridged:"
            " give a truth with at least 10 samples a second"
        )
    raise RecordingError("no sample of the truth that is to be scored falls on a sample of the result")
