"""Camera to base IMU to world (JA II-F.2, many poses): what keeps the camera's tilt through every recording.

Rests and turns of both IMUs in each pose of the panel, first guesses, the chain of rotations from the camera
to the world and back over the panel by least squares, what it is worth, and gravity in a recording by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.errors import CalibrationError
from smoother.linalg import nearest_rotation, skew, unit
from smoother.recording import CameraFrame, ImuStream, Recording
from smoother.rotation import chained
from smoother.units import GRAVITY

from .file import CalibrationFile, FileSection, Vector, checked, corrected_streams, sensor_of
from .images import Panel, View
from .imu import Rests, find_rests
from .intrinsics import Intrinsics
from .panel import SeenPanel, see_panel
from .protocol import Answer, Check, graded

#: A rest this near to a pose's time is the pose's, s; it is averaged over what lies so near.
REACH_S = 1.0
#: A hand-held panel may move this many times more than a resting sensor (0.2 m/s^2, 0.075 rad/s).
HAND = 5.0
#: What a gyroscope's scale, axes and bias add to a turn: a share of it, and rad a second.
GYRO_SCALE, GYRO_DRIFT_RAD_S = 0.003, 2e-4
#: A pause of an IMU that breaks the link between two poses, s.
_PAUSE_S = 0.1


@dataclass(frozen=True)
class Rest:
    """Means over a time in which an IMU rests."""

    t_s: float  # The pose's time
    acc: FloatArray  # (3,) m/s^2: mean, about +9.81 upwards
    acc_sigma: FloatArray  # (3,) m/s^2: of that mean
    gyro: FloatArray  # (3,) rad/s: the gyroscope's bias
    mag: FloatArray | None  # (3,): in the sensor's unit, or None
    length_s: float  # How long it rested


class Turn(NamedTuple):
    """A rotation from one pose to the next by the gyroscope."""

    R: FloatArray  # (3, 3): maps the later axes of the IMU to the earlier ones
    sigma_rad: float  # An axis


def rest_at(imu: ImuStream, rests: Rests, t_s: float, pose: str, what: str) -> Rest:
    """Mean readings of an IMU while a pose is held."""
    near = np.abs(imu.t_s - t_s) <= REACH_S
    if near.sum() < 5:
        raise CalibrationError(
            f"{pose}: the IMU {what} has no samples at {t_s:.2f} s; record it while the panel is held still."
        )
    held = np.zeros(len(near), dtype=bool)
    for first, last in rests.ranges.tolist():
        if imu.t_s[first] <= t_s <= imu.t_s[last - 1]:
            held[first:last] = True
    rows = np.flatnonzero(near & held)
    if not len(rows):
        raise CalibrationError(
            f"{pose}: the IMU {what} moves at {t_s:.2f} s; hold the panel still for two seconds in each pose."
        )
    return Rest(
        t_s=t_s,
        acc=imu.acc[rows].mean(axis=0),
        acc_sigma=imu.acc[rows].std(axis=0) / np.sqrt(len(rows)),
        gyro=imu.gyro[rows].mean(axis=0),
        mag=None if imu.mag is None else imu.mag[rows].mean(axis=0),
        length_s=len(rows) / imu.rate_hz,
    )


def turn_between(imu: ImuStream, first: Rest, last: Rest) -> Turn | None:
    """The gyroscope's rotation from one rest to the next; None where the IMU paused between them."""
    rows = np.flatnonzero((imu.t_s >= first.t_s) & (imu.t_s <= last.t_s))
    t = imu.t_s[rows]
    if len(t) < 5 or max(np.diff(t).max(), t[0] - first.t_s, last.t_s - t[-1]) > _PAUSE_S:
        return None
    share = ((t - t[0]) / (t[-1] - t[0]))[:, None]
    rate = imu.gyro[rows] - ((1 - share) * first.gyro + share * last.gyro)
    edges = np.concatenate([[first.t_s], 0.5 * (t[1:] + t[:-1]), [last.t_s]])
    step = rate * np.diff(edges)[:, None]
    way = float(np.linalg.norm(step, axis=1).sum())
    sigma = np.hypot(GYRO_SCALE * way, GYRO_DRIFT_RAD_S * (last.t_s - first.t_s)) + 5e-4
    return Turn(chained(Rotation.from_rotvec(step).as_matrix())[-1], float(sigma))


#: Sigma of a rotation of which nothing is known, rad.
FREE_RAD = 2.0
#: What scale and cross-axis errors of an accelerometer leave of a direction, rad.
TILT_RAD = np.radians(0.05)
#: Bias of an accelerometer as its maker calibrated it, and of one calibrated by rest poses, m/s^2 per axis.
BIAS_M_S2, CORRECTED_M_S2 = 0.03, 0.012
#: Magnetometers: iron on the sensor (a share of the field), and iron in the room, which differs from place to
#: place, rad.
IRON, ROOM_RAD = 0.05, np.radians(2.0)
#: An IMU that was lined up with the panel by eye is off by this, per axis.
BY_EYE_RAD = np.radians(3.0)
#: Poses that contradict the others by this many sigmas are left out.
CONTRADICTS_SIGMA = 5.0
#: Another answer that costs less than this more is as likely (two degrees of freedom, 99 %).
AS_LIKELY = 9.2
#: This many poses must remain.
FEWEST = 3


@dataclass(frozen=True)
class PanelView:
    """The panel in the camera in one pose."""

    name: str  # For messages
    t_s: float  # Time of the images on the IMUs' clock
    R_K_P: FloatArray  # (3, 3): panel axes to camera axes
    covariance: FloatArray  # (3, 3) rad^2: of its rotation vector in {K}


@dataclass(frozen=True)
class WorldPose:
    """One pose of the panel, as camera and IMUs know it."""

    view: PanelView
    base: Rest  # The IMUs at rest
    panel: Rest
    turns: tuple[Turn, Turn] | None = None  # The base's and the panel's since the pose before, or None


@dataclass(frozen=True)
class WorldCalibration:
    """Camera from base IMU, how well it is known, and the data it is based on."""

    R_K_B: FloatArray  # (3, 3): base IMU axes to camera axes
    R_P_I: FloatArray  # (3, 3): axes of the panel's IMU to panel axes
    bias: FloatArray  # (3,) m/s^2: of the base's accelerometer
    # (9, 9): Of `R_K_B` in {K} (rad), the base accelerometer's bias (m/s^2), `R_P_I` in {I} (rad)
    covariance: FloatArray
    left_rad: FloatArray  # (n,): what is left of `R_K_P`
    cost: float  # Sum of squares of all misfits
    sigmas_apart: FloatArray = field(default_factory=lambda: np.zeros(1))  # (n,): a pose and the others
    poses: tuple[WorldPose, ...] = ()  # Those that were used
    by_eye: bool = False  # The poses did not give the mounting of the panel's IMU: lined up by eye
    notes: tuple[str, ...] = ()  # What was left out, and why
    # The base IMU's accelerometer was corrected by a calibration of its own before
    accelerometer_corrected: bool = False


def world_poses(
    views: Sequence[PanelView], panel: Sequence[ImuStream], base: Sequence[ImuStream]
) -> tuple[list[WorldPose], list[str]]:
    """Each pose as measured by camera and IMUs; poses in which an IMU moves are left out, with a note."""
    poses: list[WorldPose] = []
    notes: list[str] = []
    last = -1
    held = {id(imu): find_rests(imu, HAND) for imu in {id(imu): imu for imu in (*panel, *base)}.values()}
    for i, view in enumerate(views):
        imus = (base[i], "on the camera"), (panel[i], "on the panel")
        try:
            on_base, on_panel = (rest_at(imu, held[id(imu)], view.t_s, view.name, what) for imu, what in imus)
        except CalibrationError as error:
            notes.append(f"{error} The pose is left out.")
            continue
        pose = WorldPose(view, on_base, on_panel)
        if poses and panel[i] is panel[last] and base[i] is base[last]:
            of_base = turn_between(base[i], poses[-1].base, pose.base)
            of_panel = turn_between(panel[i], poses[-1].panel, pose.panel)
            if of_base is not None and of_panel is not None:
                pose = replace(pose, turns=(of_base, of_panel))
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
    """Find `R_K_B`, and how the panel's IMU sits on the panel."""
    kept, sentences = list(poses), list(notes)
    while True:
        found = _solve(kept, bias_m_s2)
        apart, mounting = np.zeros(len(kept)), BY_EYE_RAD if found.by_eye else None
        if len(kept) > 1:  # what the others' misfits are without it
            start = found.R_K_B, found.R_P_I
            costs = [_fit(_without(kept, k), start, mounting, bias_m_s2).cost for k in range(len(kept))]
            apart = np.sqrt(np.maximum(found.cost - np.array(costs), 0.0))
        worst = int(np.argmax(apart))
        if apart[worst] < CONTRADICTS_SIGMA:
            return replace(found, sigmas_apart=apart, poses=tuple(kept), notes=tuple(sentences))
        text = f"{kept[worst].view.name} contradicts the other poses by {apart[worst]:.0f} sigmas"
        if len(kept) <= FEWEST:
            raise CalibrationError(
                f"The poses contradict each other: {text}; check that each IMU is fixed to its body and uses"
                " the camera's clock, and record more poses."
            )
        sentences.append(f"{text} and is left out.")
        kept = _without(kept, worst)


def _without(poses: list[WorldPose], k: int) -> list[WorldPose]:
    """The poses but one; what followed it is no longer linked to what went before."""
    return [*poses[:k], *(replace(pose, turns=None) for pose in poses[k + 1 : k + 2]), *poses[k + 2 :]]


#: Rounds of one and the other rotation; starts that end nearer to each other than this are one.
_GUESS_ROUNDS, _SAME_RAD = 25, 0.3
#: Mean square (rad^2 per pose) by which a start may fit worse than the best and still lead to the answer.
_HOPELESS = 0.01


def _solve(poses: list[WorldPose], bias_m_s2: float) -> WorldCalibration:
    """The best of the answers from every way to put a cube on the panel; with the IMU lined up by eye where
    the poses do not give the mounting.
    """
    starts = _starts(poses)
    if len(poses) >= FEWEST:
        best, *others = sorted((_fit(poses, s, None, bias_m_s2) for s in starts[:-1]), key=lambda f: f.cost)
        likely = [other.R_P_I for other in others if other.cost < best.cost + AS_LIKELY]
        apart = [Rotation.from_matrix(best.R_P_I.T @ other).magnitude() for other in likely]
        best = _fit(poses, (best.R_K_B, best.R_P_I), None, bias_m_s2)  # slopes about the answer
        known = np.sqrt(np.linalg.eigvalsh(best.covariance[6:, 6:])[-1]) < BY_EYE_RAD
        if known and max(apart, default=0.0) < BY_EYE_RAD:
            return best
    rough = _fit(poses, starts[-1], BY_EYE_RAD, bias_m_s2)
    return replace(_fit(poses, (rough.R_K_B, rough.R_P_I), BY_EYE_RAD, bias_m_s2), by_eye=True)


def _starts(poses: list[WorldPose]) -> list[tuple[FloatArray, FloatArray]]:
    """Camera from base IMU and mounting by every likely way to put a cube on the panel; lined up by eye last.

    The two in turn, each by Wahba's problem on the directions that both IMUs know.
    """
    R_K_P = np.array([pose.view.R_K_P for pose in poses])
    in_B, in_I = (_directions(each, np.zeros(6)) for each in _readings(poses))
    R_P_I = np.concatenate([Rotation.create_group("O").as_matrix(), [np.eye(3)]])
    for k in range(_GUESS_ROUNDS):
        in_K = np.einsum("nij,sjk,mnk->smni", R_K_P, R_P_I, in_I)
        R_K_B = nearest_rotation(np.einsum("smni,mnj->sij", in_K, in_B))
        if k < _GUESS_ROUNDS - 1:
            in_P = np.einsum("nji,sjk,mnk->smni", R_K_P, R_K_B[:-1], in_B)
            R_P_I[:-1] = nearest_rotation(np.einsum("smni,mnj->sij", in_P, in_I))
    left = in_K - np.einsum("sij,mnj->smni", R_K_B, in_B)
    loss, chosen = np.sum(left**2, axis=(1, 2, 3))[:-1], list[int]()
    for s in np.argsort(loss).tolist():
        apart = [Rotation.from_matrix(R_P_I[s].T @ R_P_I[other]).magnitude() for other in chosen]
        if loss[s] <= loss.min() + _HOPELESS * len(poses) and min(apart, default=np.inf) > _SAME_RAD:
            chosen.append(s)
    return [(R_K_B[s], R_P_I[s]) for s in (*chosen, -1)]


def _readings(poses: list[WorldPose]) -> list[tuple[FloatArray, FloatArray | None]]:
    """Accelerations and, if all have them, unit fields (n, 3) of the base's IMU and of the panel's."""
    rests = [[pose.base for pose in poses], [pose.panel for pose in poses]]
    acc = [np.array([rest.acc for rest in own]) for own in rests]
    if any(rest.mag is None for own in rests for rest in own):
        return [(each, None) for each in acc]
    return list(zip(acc, (unit(np.array([rest.mag for rest in own])) for own in rests), strict=True))


def _directions(reading: tuple[FloatArray, FloatArray | None], bias: FloatArray) -> FloatArray:
    """(kinds, n, 3) up and, where known, the magnetic field in an IMU's axes, less its biases (..., 6)."""
    acc, magnetic = reading
    up = unit(acc - bias[..., :3])
    return up[None] if magnetic is None else np.stack([up, unit(magnetic - bias[..., 3:])])


def _fit(
    poses: list[WorldPose],
    start: tuple[FloatArray, FloatArray],  # R_K_B and R_P_I
    mounting_rad: float | None,  # how well the panel's IMU was lined up by eye
    bias_m_s2: float,
) -> WorldCalibration:
    """Least squares of the chain `R_K_P = R_K_B R_B_W R_W_I R_I_P` (JA eq 7 and 8) in the camera's axes.

    Up, the magnetic field where there are magnetometers, and the turn since the pose before are each known by
    both IMUs: the base's by `R_K_B`, the panel's by `R_K_P R_P_I`. What is left is between the two.
    """
    seen, count = np.array([pose.view.R_K_P for pose in poses]), len(poses)
    whiten = np.linalg.inv(np.linalg.cholesky([pose.view.covariance for pose in poses]))
    readings = _readings(poses)
    noise = np.array([[rest.acc_sigma.mean() for rest in (pose.base, pose.panel)] for pose in poses]).T
    tilts = np.hypot(noise / [np.linalg.norm(acc, axis=1) for acc, _ in readings], TILT_RAD)
    sigmas = [tilts[1]]
    if readings[0][1] is not None:
        sigmas.append(np.full(count, np.sqrt(2.0) * ROOM_RAD))  # of two places in the room
    linked = np.array([i for i, pose in enumerate(poses) if i and pose.turns], dtype=int)
    turns = [pose.turns for pose in poses[1:] if pose.turns]
    T_B, T_I = (np.array([own[k].R for own in turns]).reshape(-1, 3, 3) for k in (0, 1))
    swung = np.array([[turn.sigma_rad for turn in own] for own in turns]).reshape(-1, 2).T
    # two rotations in {K} and {I}, the biases of the base's sensors and of the panel's, what the images leave
    # of each pose's rotation in {K}, and the base's tilt (rad)
    known = np.array([FREE_RAD] * 6 + 2 * ([bias_m_s2] * 3 + [IRON] * 3))

    def moved(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        turn = Rotation.from_rotvec(x[:6].reshape(2, 3)).as_matrix()
        return turn[0] @ start[0], start[1] @ turn[1]

    def misfit(x: FloatArray) -> FloatArray:
        """All misfits in sigmas, and what is known beforehand: biases are small, rotations free or nearly."""
        (R_K_B, R_P_I), (left, off) = moved(x), x[18:].reshape(2, -1, 3)
        R_K_I = Rotation.from_rotvec(left).as_matrix() @ seen @ R_P_I
        of_base = _directions(readings[0], x[6:12] + np.pad(GRAVITY * off, ((0, 0), (0, 3)))) @ R_K_B.T
        apart = of_base - np.einsum("nij,knj->kni", R_K_I, _directions(readings[1], x[12:18]))
        turned = R_K_I[linked - 1] @ T_I @ np.swapaxes(R_K_I[linked], 1, 2)
        of_turns = _rotvec(turned @ np.swapaxes(R_K_B @ T_B @ R_K_B.T, 1, 2))
        up = of_base[0]
        heading = np.sum(of_turns * up[linked - 1], axis=1) / np.hypot(*swung)
        rows = [apart / np.array(sigmas)[..., None], off / tilts[0, :, None], heading, x[:18] / known]
        rows.append(np.einsum("nij,nj->ni", whiten, left))
        for R_K, T, sigma in ((np.tile(R_K_B, (count, 1, 1)), T_B, swung[0]), (R_K_I, T_I, swung[1])):
            own = np.einsum("nji,nj->ni", R_K, up)  # up in the IMU's axes, before a turn and after it
            after = np.einsum("nij,nj->ni", T, own[linked])
            rows.append((own[linked - 1] - after) / sigma[:, None])
        if mounting_rad is not None:
            rows.append(_rotvec(R_P_I) / mounting_rad)
        return np.concatenate([np.ravel(row) for row in rows])

    scale = np.append(known, np.full(6 * count, 1e-3))
    fit = least_squares(misfit, np.zeros(len(scale)), method="lm", x_scale=scale, ftol=1e-6)
    R_K_B, R_P_I = moved(fit.x)
    # three rows of a direction have two degrees; a few poses may fit by luck
    spare = len(fit.fun) - len(sigmas) * count - 2 * len(linked) - len(fit.x)
    spread = max(1.0, 2 * float(fit.cost) / spare) if spare > 0 else 1.0
    kept = np.r_[0:3, 6:9, 3:6]
    return WorldCalibration(
        R_K_B=R_K_B,
        R_P_I=R_P_I,
        bias=fit.x[6:9],
        covariance=np.linalg.inv(fit.jac.T @ fit.jac)[np.ix_(kept, kept)] * spread,
        left_rad=np.linalg.norm(fit.x[18 : 18 + 3 * count].reshape(-1, 3), axis=1),
        cost=2 * float(fit.cost),
    )


def _rotvec(R: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_matrix(R).as_rotvec()) if R.size else np.zeros((0, 3))


def tilt_covariance(
    R_K_B: FloatArray,  # (3, 3)
    covariance: FloatArray,  # (6, 6)
    acc: FloatArray,  # (3,) m/s^2
) -> FloatArray:  # (3, 3) rad^2
    """Covariance (3, 3) of down in {K} (rad^2 across it) for a reading of the base accelerometer."""
    size = float(np.linalg.norm(acc))
    up = acc / size
    slope = np.hstack([-skew(R_K_B @ up), -R_K_B @ (np.eye(3) - np.outer(up, up)) / size])
    return np.asarray(slope @ covariance @ slope.T)


#: A rotation is not known better than this: lens, and the shape of the panel, rad.
FLOOR_RAD = np.radians(0.03)


def calibrate_world_from_views(
    views: Sequence[View],
    t_s: Sequence[float],
    panel_imu: Sequence[ImuStream],
    base_imu: Sequence[ImuStream],
    panel: Panel,
    lens: Intrinsics,
    file: CalibrationFile | None = None,
) -> WorldCalibration:
    """Camera from base IMU from images of the panel and the IMUs' samples (JA II-F.2)."""
    file = file or CalibrationFile()
    panel_imu, panel_known = corrected_streams(panel_imu, file)
    base_imu, base_known = corrected_streams(base_imu, file)
    poses, notes = world_poses(
        [view_panel(view, at, panel, lens) for view, at in zip(views, t_s, strict=True)], panel_imu, base_imu
    )
    found = calibrate_world(poses, notes, CORRECTED_M_S2 if panel_known and base_known else BIAS_M_S2)
    return replace(found, accelerometer_corrected=base_known)


def common_time(panel_imu: ImuStream, base_imu: ImuStream) -> float:
    """The middle of the time in which both IMUs were recorded, s: when a pose of its own was held."""
    first, last = max(panel_imu.t_s[0], base_imu.t_s[0]), min(panel_imu.t_s[-1], base_imu.t_s[-1])
    if last <= first:
        raise CalibrationError("the IMUs' samples do not overlap in time")
    return 0.5 * float(first + last)


def view_panel(view: View, t_s: float, panel: Panel, lens: Intrinsics) -> PanelView:
    """Find the panel in a pair of images."""
    seen = see_panel(view, panel, lens)
    return PanelView(view.name, t_s, seen.frame.R, rotation_covariance(seen, lens))


def rotation_covariance(seen: SeenPanel, lens: Intrinsics) -> FloatArray:
    """Covariance (3, 3) of the panel's rotation vector, rad^2 in {K}."""
    theta = seen.plane.theta
    size = float(np.linalg.norm(theta))
    n = theta / size
    slope = skew(n) @ (np.eye(3) - np.outer(n, n)) / size
    arms = seen.points_K - seen.points_K.mean(axis=0)
    sigma_m = seen.blobs.sigmas_px[list(seen.spots)] / lens.focal_px * seen.points_K[:, 2]
    about_n = 1 / float(((arms**2).sum(axis=1) / sigma_m**2).sum())
    covariance = slope @ seen.plane.covariance @ slope.T + about_n * np.outer(n, n)
    return np.asarray(covariance + FLOOR_RAD**2 * np.eye(3))


#: Sigma of the camera's tilt that is good for `smooth`, or still of use, degrees.
GOOD_DEG, USABLE_DEG = 0.3, 1.0
#: A heading that is known less than this is as good as free, degrees.
FREE_DEG = 15.0


class WorldAccuracy(NamedTuple):
    """Standard deviations, degrees."""

    rotation_deg: FloatArray  # (3,): of camera from base IMU about the camera's axes
    tilt_deg: float  # Of down in the camera, per axis, for the worst of the poses
    heading_deg: float  # Of the turn between camera and base IMU about the vertical
    mounting_deg: FloatArray  # (3,): of the panel's IMU on the panel, about the IMU's axes


def accuracy(calibration: WorldCalibration) -> WorldAccuracy:
    """Sigmas of rotation, tilt, heading and mounting."""
    covariance, R_K_B = calibration.covariance, calibration.R_K_B
    forces = np.array([pose.base.acc - calibration.bias for pose in calibration.poses])
    tilts = [np.trace(tilt_covariance(R_K_B, covariance[:6, :6], acc)) / 2 for acc in forces]
    up = unit(R_K_B @ unit(forces).mean(axis=0))
    return WorldAccuracy(
        rotation_deg=np.degrees(np.sqrt(np.diag(covariance)[:3])),
        tilt_deg=float(np.degrees(np.sqrt(max(tilts)))),
        heading_deg=float(np.degrees(np.sqrt(up @ covariance[:3, :3] @ up))),
        mounting_deg=np.degrees(np.sqrt(np.diag(covariance)[6:])),
    )


#: What to record next.
MORE_POSES = "hold the panel in at least four different poses: rolled by 90 degrees, and tilted by 30 to 40"
TURN_CAMERA = (
    "to have the heading, turn and tilt the camera with its base IMU by 30 degrees or more between some"
    " poses, the panel in view"
)
AGAIN = "take more poses, the camera tilted anew for each, and hold each for two seconds"


NAME = "camera_from_base"


def world_answer(calibration: WorldCalibration) -> Answer:
    """Camera from base IMU, and its tables; quaternions are qw, qx, qy, qz, sigmas one standard deviation."""
    sigma, mounting = accuracy(calibration), Rotation.from_matrix(calibration.R_P_I)
    forces = np.array([pose.base.acc - calibration.bias for pose in calibration.poses])
    down = -unit(forces) @ calibration.R_K_B.T
    grade = graded((sigma.tilt_deg, GOOD_DEG, USABLE_DEG))
    sentence = f"{grade}: the camera's tilt is known to {sigma.tilt_deg:.2f} degrees (one sigma)"
    checks = [
        Check("sigma of the tilt", sigma.tilt_deg, GOOD_DEG, "degrees", AGAIN),
        Check("sigma of the heading between camera and base IMU", sigma.heading_deg, FREE_DEG, "degrees",
                TURN_CAMERA, is_open=True),
        Check("sigma of how the IMU sits on the panel", float(sigma.mounting_deg.max()), GOOD_DEG,
                "degrees", MORE_POSES, is_open=calibration.by_eye),
        *map(Check, calibration.notes),
    ]  # fmt: skip
    tables = {
        NAME: {
            "rotation": Rotation.from_matrix(calibration.R_K_B)
            .as_quat(canonical=True, scalar_first=True)
            .tolist(),
            "rotation_sigma_deg": sigma.rotation_deg.tolist(),
            "accelerometer_bias": calibration.bias.tolist(),
            "covariance": calibration.covariance[:6, :6].tolist(),
            "accelerometer_corrected": calibration.accelerometer_corrected,
        },
        "panel_from_imu": {
            "rotation": mounting.as_quat(canonical=True, scalar_first=True).tolist(),
            "rotation_sigma_deg": sigma.mounting_deg.tolist(),
            "off_deg": float(np.degrees(mounting.magnitude())),
            "lined_up_by_eye": calibration.by_eye,
        },
        "world": {
            "tilt_sigma_deg": sigma.tilt_deg,
            "heading": "free" if sigma.heading_deg > FREE_DEG else "known",
            "heading_sigma_deg": sigma.heading_deg,
            "poses": len(calibration.poses),
            "grade": grade,
            "verdict": sentence,
            "residuals": [
                {
                    "pose": pose.view.name,
                    "down": [round(float(x), 6) for x in down[i]],
                    "rotation_deg": round(float(np.degrees(calibration.left_rad[i])), 4),
                    "worst_sigma": round(float(calibration.sigmas_apart[i]), 2),
                    "rest_s": round(min(pose.panel.length_s, pose.base.length_s), 2),
                }
                for i, pose in enumerate(calibration.poses)
            ],
        },
    }
    return Answer(grade, sentence, checks, CalibrationFile(tables=tables), dict(tables))


class CameraFromBase(FileSection):
    """The base IMU on the camera, as a file has it; camera optical, x right, y down, z forward."""

    rotation: Annotated[list[float], Field(min_length=4, max_length=4)]  # base IMU axes to camera axes
    accelerometer_bias: Vector = Field(default=[0.0, 0.0, 0.0])  # m/s^2: in {B}
    covariance: list[list[float]] | None = None  # (6, 6): of a small rotation in {K} and the bias
    rotation_sigma_deg: Vector | None = None
    accelerometer_corrected: bool = False  # `[imu.base]` was taken off before

    @property
    def R_K_B(self) -> FloatArray:
        """(3, 3) base IMU axes to camera axes."""
        return np.asarray(Rotation.from_quat(self.rotation, scalar_first=True).as_matrix())

    @property
    def spread(self) -> FloatArray:
        """The covariance (6, 6)."""
        sigma = np.radians(self.rotation_sigma_deg or [np.nan] * 3)
        return np.array(self.covariance or np.diag([*(sigma**2), 0.0, 0.0, 0.0]))


def read_table(file: CalibrationFile) -> CameraFromBase | None:
    """The base IMU on the camera."""
    if NAME not in file.tables:
        return None
    table = checked(CameraFromBase, file.tables[NAME], f"{file.source}: {NAME}")
    is_unit, spread = abs(np.linalg.norm(table.rotation) - 1) < 1e-3, table.spread
    if not (is_unit and spread.shape == (6, 6) and np.linalg.eigvalsh(spread)[0] > -1e-9):
        raise CalibrationError(
            f"{file.source}: [{NAME}] has no unit quaternion [qw, qx, qy, qz] with its covariance; run"
            " `unocclude calibrate world` again."
        )
    return table


#: What a bias drifts with temperature, m/s^2; axes of the skeleton against those of the images, rad.
_DRIFT_M_S2, _SKELETON_RAD = 0.02, np.radians(0.05)
#: A camera that tilts by more than this in a recording did not stand still, rad.
_MOVED_RAD = np.radians(0.7)
#: Optical axes (x right, y down, z forward) to those of the skeleton.
_FROM_OPTICAL = {CameraFrame.OPTICAL: np.eye(3), CameraFrame.KINECT: np.diag([-1.0, -1.0, 1.0])}


def with_gravity(recording: Recording, file: CalibrationFile) -> Recording:
    """The recording with down in the camera from its base IMU, where both know it."""
    known, base = read_table(file), recording.base_imu
    if known is None or base is None or len(base) == 0:
        return recording
    sensor = sensor_of(file, base.name)
    is_corrected = sensor is not None and sensor.accelerometer.is_known
    if recording.camera_frame not in _FROM_OPTICAL:
        note = "The base IMU was not used: the camera's axes of the recording are unknown."
    elif is_corrected != known.accelerometer_corrected:
        note = (
            "The base IMU was not used: its accelerometer's calibration is newer or older than "
            "[camera_from_base]; run `unocclude calibrate world` again."
        )
    else:
        down, sigma, moved = down_of(known, base)
        note = f"Gravity in the camera is from the base IMU, good to {np.degrees(sigma):.1f} degrees."
        if moved > _MOVED_RAD:
            note += f" The camera was tilted by up to {np.degrees(moved):.1f} degrees while it recorded."
        hint = _FROM_OPTICAL[recording.camera_frame] @ down
        recording = replace(recording, gravity_hint=hint, gravity_sigma_rad=sigma)
    return replace(recording, notes=(*recording.notes, note))


def down_of(known: CameraFromBase, base: ImuStream) -> tuple[FloatArray, float, float]:
    """Down in {K} (3,) by the base IMU, its sigma (rad per axis), and how far the camera tilted (rad)."""
    starts = np.flatnonzero(np.diff(np.floor(base.t_s - base.t_s[0]), prepend=-1.0))
    count = np.diff(starts, append=len(base))
    means = np.add.reduceat(base.acc, starts) / count[:, None]  # of each second that has samples
    bias = np.array(known.accelerometer_bias)
    acc = np.median(means, axis=0) - bias
    each = (means - bias) / np.linalg.norm(means, axis=1)[:, None]
    up = unit(acc)
    away = np.linalg.norm(np.cross(each, up), axis=1)
    moved = float(np.percentile(away, 95)) if len(away) > 1 else 0.0
    drifted = known.spread
    drifted[3:, 3:] += _DRIFT_M_S2**2 * np.eye(3)
    variance = np.trace(tilt_covariance(known.R_K_B, drifted, acc)) / 2
    sigma = float(np.sqrt(variance + _SKELETON_RAD**2 + (moved if moved > _MOVED_RAD else 0.0) ** 2))
    return -known.R_K_B @ up, sigma, moved
