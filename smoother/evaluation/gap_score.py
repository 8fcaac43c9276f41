"""The errors of a recovery inside one hidden gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..linalg import robust_sigma
from ..recording import JOINTS, Recording
from ..result import Recovery
from .align import linear_at, position_at, truth_at
from .metrics import Figures, orientation_error_deg, squared_sigmas, summarise
from .placement import HiddenGap
from .sigma_factor import LEVELS, needed_factors

#: Hidden joints to compare with where there is no truth, the best first.
REFERENCES = ("wrist", "strap", "hand", "elbow")


@dataclass(frozen=True)
class GapErrors:
    """Errors sample by sample inside a gap.

    Attributes
    ----------
    reference : str
        What the answer was compared with: "truth" or a joint.
    distance_m, angle_deg, squared_sigmas : ndarray, shape (n,)
        As in `metrics`; nan where there is no answer.
    unanswered : int
        Samples with a reference and without an answer.
    sigma_max_m : float, m, or None
        Largest stated standard deviation, on one axis.
    path_m : float, m, or None
        Length of the hidden path.
    needed_factors : ndarray, shape (n, 2)
        By what sigma would have to be multiplied to hold, see `sigma_factor.needed_factors`.
    since_s : ndarray, shape (n,), s
        Time since the gap began.
    """

    reference: str
    distance_m: FloatArray
    angle_deg: FloatArray
    squared_sigmas: FloatArray
    unanswered: int = 0
    sigma_max_m: float | None = None
    path_m: float | None = None
    needed_factors: FloatArray = field(default_factory=lambda: np.zeros((0, len(LEVELS))))
    since_s: FloatArray = field(default_factory=lambda: np.zeros(0))

    def figures(self) -> Figures:
        """The figures of these samples."""
        return summarise(self.distance_m, self.angle_deg, self.squared_sigmas, self.unanswered)

    @staticmethod
    def empty() -> GapErrors:
        """A gap in which nothing can be compared."""
        return GapErrors("", np.zeros(0), np.zeros(0), np.zeros(0))

    @staticmethod
    def pooled(parts: Sequence[GapErrors]) -> GapErrors:
        """The samples of several gaps together."""
        return GapErrors(
            reference=parts[0].reference,
            distance_m=np.concatenate([part.distance_m for part in parts]),
            angle_deg=np.concatenate([part.angle_deg for part in parts]),
            squared_sigmas=np.concatenate([part.squared_sigmas for part in parts]),
            unanswered=sum(part.unanswered for part in parts),
            needed_factors=np.concatenate([part.needed_factors for part in parts]),
            since_s=np.concatenate([part.since_s for part in parts]),
        )


def score_gap(recording: Recording, recovery: Recovery, gap: HiddenGap) -> GapErrors:
    """Errors of a recovery inside a gap of the recording, which still holds what was hidden."""
    if recording.truth is not None and len(recording.truth):
        errors, t_s = _against_truth(recording, recovery, gap)
    else:
        errors, t_s = _against_camera(recording, recovery, gap)
    return replace(errors, since_s=t_s - gap.start_s)


def frame_times(recording: Recording, recovery: Recovery) -> FloatArray:
    """The frames' own times (F,) on the IMU's clock, s: with its drift, not its mean offset alone."""
    if len(recovery.arm) == len(recording.arm):
        return np.asarray(recovery.arm.t_s)
    offset = recovery.clock_offset_s if np.isfinite(recovery.clock_offset_s) else 0.0
    return np.asarray(recording.arm.t_s + offset)


def _on_camera_clock(recording: Recording, recovery: Recovery) -> FloatArray:
    """The answer's times (N,) on the camera's clock, on which gaps are hidden, s."""
    own = frame_times(recording, recovery)
    if not len(own):
        return recovery.t_s
    return np.asarray(recovery.t_s - np.interp(recovery.t_s, own, own - recording.arm.t_s))


def _against_truth(recording: Recording, recovery: Recovery, gap: HiddenGap) -> tuple[GapErrors, FloatArray]:
    """Errors at the IMU's times, and these on the camera's clock."""
    assert recording.truth is not None
    t_s = _on_camera_clock(recording, recovery)
    inside = gap.contains(t_s)
    truth = truth_at(recording.truth, recovery.t_s[inside])
    scored = truth.score & np.isfinite(truth.position).all(axis=1)
    position = np.where(scored[:, None], recovery.position[inside], np.nan)
    covariance = recovery.pose_covariance[inside, :3, :3]
    angle = orientation_error_deg(recovery.quaternion[inside], truth.quaternion)
    exact = np.zeros((3, 3))
    angle = np.where(truth.score, angle, np.nan)
    errors = _errors("truth", position, truth.position, covariance, exact, angle, scored)
    return errors, t_s[inside]


def _against_camera(recording: Recording, recovery: Recovery, gap: HiddenGap) -> tuple[GapErrors, FloatArray]:
    """Errors at the hidden frames, and their times on the camera's clock."""
    joint = _reference_joint(recording, recovery, gap)
    if joint is None:
        return GapErrors.empty(), np.zeros(0)
    frames = gap.contains(recording.arm.t_s) & recording.arm.tracked(joint)
    reference = recording.arm.joint(joint)[frames]
    t_s = frame_times(recording, recovery)[frames]
    if joint == "strap":
        known, covariance = strap_position(recovery), recovery.pose_covariance[:, :3, :3]
    else:
        known = recovery.joints[joint]
        covariance = recovery.joint_covariance.get(joint, np.full((len(recovery), 3, 3), np.nan))
    answer = position_at(recovery.t_s, known, t_s)
    stated = linear_at(recovery.t_s, covariance.reshape(-1, 9), t_s).reshape(-1, 3, 3)
    # a hidden sample has the camera's own noise, which the answer's covariance knows nothing of
    noise = camera_noise(recovery, joint)
    scored = np.ones(len(t_s), dtype=bool)
    errors = _errors(joint, answer, reference, stated, noise, np.full(len(t_s), np.nan), scored)
    return errors, recording.arm.t_s[frames]


def strap_position(recovery: Recovery) -> FloatArray:
    """The strap (N, 3), m in {K}: the IMU itself, or where its lever arm puts it if one was solved."""
    levers = {} if recovery.calibration is None else recovery.calibration.lever_arms
    known = np.isfinite(recovery.quaternion).all(axis=1)
    if "strap" not in levers or not known.any():
        return recovery.position
    strap = np.full_like(recovery.position, np.nan)
    turned = Rotation.from_quat(recovery.quaternion[known], scalar_first=True)
    strap[known] = recovery.position[known] + turned.apply(levers["strap"].position_m)
    return strap


def _reference_joint(recording: Recording, recovery: Recovery, gap: HiddenGap) -> str | None:
    """The first joint that the camera saw in the gap and that the recovery answers."""
    inside = gap.contains(recording.arm.t_s)
    for joint in REFERENCES:
        answered = joint == "strap" or joint in recovery.joints
        if answered and (recording.arm.tracked(joint) & inside).any():
            return joint
    return None


def camera_noise(recovery: Recovery, joint: str) -> FloatArray:
    """Covariance (3, 3) of a joint's camera samples, m^2, from the residuals where it was used."""
    if recovery.residuals is None:
        return np.zeros((3, 3))
    index = JOINTS.index(joint)
    used = recovery.residuals.used[:, index]
    residual = recovery.residuals.residual[used, index]
    residual = residual[np.isfinite(residual).all(axis=1)]
    if len(residual) < 10:
        return np.zeros((3, 3))
    return np.diag(robust_sigma(residual - np.median(residual, axis=0), axis=0) ** 2)


def _errors(
    name: str,
    answer: FloatArray,
    reference: FloatArray,
    stated: FloatArray,
    noise: FloatArray,
    angle: FloatArray,
    scored: BoolArray,
) -> GapErrors:
    """Errors against a reference with noise of its own (3, 3) m^2."""
    difference = answer - reference
    distance = np.linalg.norm(difference, axis=1)
    variance = np.einsum("nii->ni", stated)
    finite = variance[np.isfinite(variance).all(axis=1)]
    path = reference[np.isfinite(reference).all(axis=1)]
    return GapErrors(
        reference=name,
        distance_m=distance,
        angle_deg=angle,
        squared_sigmas=squared_sigmas(difference, stated + noise),
        unanswered=int((scored & ~np.isfinite(distance)).sum()),
        sigma_max_m=float(np.sqrt(finite.max())) if len(finite) else None,
        path_m=float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum()) if len(path) > 1 else None,
        needed_factors=needed_factors(difference, stated, noise),
    )
