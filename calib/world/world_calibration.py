"""Camera from base IMU from poses of the panel (JA II-F.2, many poses): the whole method on one page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import skew
from smoother.recording import ImuStream

from .chain import BIAS_M_S2, WorldPose
from .first_guess import first_guesses
from .still_pose import rest_at, turn_between
from .world_fit import WorldSolution, solve

#: An IMU that was lined up with the panel by eye is off by this, an axis.
BY_EYE_RAD = np.radians(3.0)
#: Poses whose residuals exceed this many sigmas contradict the others and are left out.
CONTRADICTS_SIGMA = 5.0
#: Another answer that costs less than this more is as likely (two degrees of freedom, 99 %).
AS_LIKELY = 9.2
#: So many poses must remain.
FEWEST = 3


@dataclass(frozen=True)
class WorldCalibration:
    """Camera from base IMU, and what it rests on.

    Attributes
    ----------
    solution : WorldSolution
        Rotations with covariance.
    poses : tuple of WorldPose
        Those that took part.
    by_eye : bool
        The poses did not give the mounting of the panel's IMU: it was taken as lined up by eye.
    notes : tuple of str
        What was left out, and why.
    accelerometer_corrected : bool
        The base IMU's accelerometer was corrected by a calibration of its own before.
    """

    solution: WorldSolution
    poses: tuple[WorldPose, ...]
    by_eye: bool
    notes: tuple[str, ...]
    accelerometer_corrected: bool = False

    @property
    def R_K_B(self) -> FloatArray:
        """(3, 3) base IMU axes to camera axes."""
        return np.asarray(self.solution.at.R_K_B.as_matrix())

    @property
    def R_P_I(self) -> FloatArray:
        """(3, 3) axes of the panel's IMU to panel axes."""
        return np.asarray(self.solution.at.R_P_I.as_matrix())


@dataclass(frozen=True)
class PanelView:
    """The panel in the camera in one pose.

    Attributes
    ----------
    name : str
        For messages.
    t_s : float, s
        Time of the images on the IMUs' clock.
    R_K_P : ndarray, shape (3, 3)
        Panel axes to camera axes.
    covariance : ndarray, shape (3, 3), rad^2
        Of its rotation vector in {K}.
    """

    name: str
    t_s: float
    R_K_P: FloatArray
    covariance: FloatArray


def world_poses(
    views: Sequence[PanelView], panel: Sequence[ImuStream], base: Sequence[ImuStream]
) -> tuple[list[WorldPose], list[str]]:
    """What camera and IMUs know of each pose; poses in which an IMU moves are left out, with a note.

    Parameters
    ----------
    views : sequence of PanelView
        One a pose.
    panel, base : sequence of ImuStream
        The IMUs' samples, one a pose. The same stream for every pose where the session was recorded in one
        go: then the gyroscopes link the poses.

    Returns
    -------
    poses : list of WorldPose
    notes : list of str
        What was left out, and why.

    Raises
    ------
    CalibrationError
        In no pose both IMUs rest.
    """
    poses: list[WorldPose] = []
    notes: list[str] = []
    last = -1
    for i, view in enumerate(views):
        try:
            on_panel = rest_at(panel[i], view.t_s, view.name, "on the panel")
            on_base = rest_at(base[i], view.t_s, view.name, "on the camera")
        except CalibrationError as error:
            notes.append(f"{error} The pose is left out.")
            continue
        pose = WorldPose(view.name, view.R_K_P, view.covariance, on_panel, on_base)
        if poses and panel[i] is panel[last] and base[i] is base[last]:
            pose = replace(
                pose,
                panel_turn=turn_between(panel[i], poses[-1].panel, on_panel),
                base_turn=turn_between(base[i], poses[-1].base, on_base),
            )
        poses.append(pose)
        last = i
    if not poses:
        raise CalibrationError(
            notes[0].removesuffix(" The pose is left out.") if notes else "There is no pose."
        )
    return poses, notes


def calibrate_world(
    poses: Sequence[WorldPose], notes: Sequence[str] = (), bias_m_s2: float = BIAS_M_S2
) -> WorldCalibration:
    """Find `R_K_B`, and how the panel's IMU sits on the panel.

    From few poses, or poses that are alike, the mounting is taken as lined up by eye: the paper's way.

    Parameters
    ----------
    poses : sequence of WorldPose
        See `world_poses`.
    notes : sequence of str
        What happened before.
    bias_m_s2 : float, m/s^2
        Sigma of the accelerometers' biases, an axis.

    Returns
    -------
    found : WorldCalibration
        See `world_answer` for what belongs into a file.

    Raises
    ------
    CalibrationError
        The poses contradict each other.
    """
    kept, sentences = list(poses), list(notes)
    while True:
        solution, by_eye = _solve(kept, bias_m_s2)
        worst = int(np.argmax(solution.worst_sigma))
        if solution.worst_sigma[worst] < CONTRADICTS_SIGMA or len(kept) < 2:
            return WorldCalibration(solution, tuple(kept), by_eye, tuple(sentences))
        if len(kept) <= FEWEST:
            raise CalibrationError(
                f"The poses contradict each other ({kept[worst].name} by {solution.worst_sigma[worst]:.0f} "
                "sigmas); see that each IMU is fixed to its body and keeps the camera's clock, and take more."
            )
        sentences.append(
            f"{kept[worst].name} contradicts the other poses by {solution.worst_sigma[worst]:.0f} sigmas "
            "and is left out."
        )
        kept.pop(worst)
        # what followed it is no longer linked to what went before
        if worst < len(kept):
            kept[worst] = replace(kept[worst], panel_turn=None, base_turn=None)


def _solve(poses: list[WorldPose], bias_m_s2: float) -> tuple[WorldSolution, bool]:
    """The solution, and whether the mounting had to be taken as lined up by eye."""
    if len(poses) >= FEWEST:
        tried = [solve(poses, start, None, bias_m_s2) for start in first_guesses(poses, lined_up=False)]
        tried.sort(key=lambda solution: solution.cost)
        best = tried[0]
        known = np.sqrt(np.linalg.eigvalsh(best.covariance[6:, 6:])[-1]) < BY_EYE_RAD
        likely = [other for other in tried[1:] if other.cost < best.cost + AS_LIKELY]
        apart = [(best.at.R_P_I.inv() * other.at.R_P_I).magnitude() for other in likely]
        if known and max(apart, default=0.0) < BY_EYE_RAD:
            return best, False
    return solve(poses, first_guesses(poses, lined_up=True)[0], BY_EYE_RAD, bias_m_s2), True


def tilt_covariance(R_K_B: FloatArray, covariance: FloatArray, acc: FloatArray) -> FloatArray:
    """Covariance (3, 3) of down in {K} (rad^2 across it) for a reading of the base accelerometer.

    Parameters
    ----------
    R_K_B : ndarray, shape (3, 3)
        Base IMU axes to camera axes.
    covariance : ndarray, shape (6, 6)
        Of `R_K_B` in {K} (rad) and of the accelerometer's bias (m/s^2).
    acc : ndarray, shape (3,), m/s^2
        Bias taken off.

    Returns
    -------
    covariance : ndarray, shape (3, 3), rad^2
    """
    size = float(np.linalg.norm(acc))
    up = acc / size
    slope = np.hstack([-skew(R_K_B @ up), -R_K_B @ (np.eye(3) - np.outer(up, up)) / size])
    return np.asarray(slope @ covariance @ slope.T)


def rotation_degrees(R: FloatArray) -> float:
    """Angle of a rotation."""
    return float(np.degrees(Rotation.from_matrix(R).magnitude()))
