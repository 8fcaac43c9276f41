"""Camera to base IMU to world (JA II-F.2, many poses): what keeps the camera's tilt through every recording.

Rests and turns of both IMUs in each pose of the panel, first guesses, the chain of rotations from the camera
to the world and back over the panel by least squares, what it is worth, and gravity in a recording by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
#: Magnetic dip is not asked for: any from the equator to the pole, rad.
DIP_RAD = 3.0


@dataclass(frozen=True)
class WorldPose:
    """One pose of the panel, as camera and IMUs know it."""

    name: str  # For messages
    R_K_P: FloatArray  # (3, 3): the panel in the camera, from its images
    covariance: FloatArray  # (3, 3): of its rotation vector, rad^2 in {K}
    panel: Rest  # The IMUs at rest
    base: Rest  # The IMUs at rest
    panel_turn: Turn | None = None  # The panel's rotation since the pose before, or None
    base_turn: Turn | None = None  # The base's, or None

    @property
    def has_north(self) -> bool:
        """Both IMUs have a magnetometer."""
        return self.panel.mag is not None and self.base.mag is not None


@dataclass(frozen=True)
class Attitudes:
    """The unknowns."""

    R_K_B: Rotation  # Camera from base IMU
    R_P_I: Rotation  # Panel from its IMU
    R_W_B: Rotation  # The base's IMU in the world (z up), one per pose
    R_W_I: Rotation  # The panel's, one per pose
    rest: FloatArray  # (14,): biases

    def moved(self, step: FloatArray) -> Attitudes:
        """Rotated by small angles: `R_K_B` in {K}, the others in their own axes."""
        n = len(self.R_W_B)
        turns = Rotation.from_rotvec(step[: 6 + 6 * n].reshape(-1, 3))
        return Attitudes(
            turns[0] * self.R_K_B,
            self.R_P_I * turns[1],
            self.R_W_B * turns[2 : 2 + n],
            self.R_W_I * turns[2 + n :],
            self.rest + step[6 + 6 * n :],
        )


#: Rounds of one and the other rotation.
_GUESS_ROUNDS = 25
#: Answers nearer than this are one; this many are followed up.
_APART_RAD, _MOST = 0.3, 4
#: Mean square (rad^2 per pose) by which a guess may fit worse than the best and still lead to the answer.
_HOPELESS = 0.01
_DIP_RAD = 0.8


def first_guesses(poses: list[WorldPose], lined_up: bool) -> list[Attitudes]:
    """Start values, the likeliest first; the right one is good to some degrees.

    Camera from base IMU and the mounting in turn, each by Wahba's problem on the directions that both IMUs
    know (up, and the field), from every way to put a cube on the panel.
    """
    kinds = ("acc", "mag") if all(pose.has_north for pose in poses) else ("acc",)
    in_B, in_I = (  # (kinds, n, 3) unit vectors
        unit(np.array([[getattr(rest, kind) for rest in rests] for kind in kinds]))
        for rests in ([pose.base for pose in poses], [pose.panel for pose in poses])
    )
    R_K_P = np.array([pose.R_K_P for pose in poses])

    def camera_from_base(R_P_I: FloatArray) -> tuple[FloatArray, float]:
        """`R_K_B` for a mounting, and the sum of squares that is left."""
        in_K = np.einsum("nij,jk,mnk->mni", R_K_P, R_P_I, in_I).reshape(-1, 3)
        M = in_K.T @ in_B.reshape(-1, 3)
        R_K_B = nearest_rotation(M)
        return R_K_B, float(2 * (len(in_K) - np.sum(R_K_B * M)))

    def in_turn(R_P_I: FloatArray) -> tuple[float, FloatArray]:
        for _ in range(_GUESS_ROUNDS):
            in_P = np.einsum("nji,jk,mnk->mni", R_K_P, camera_from_base(R_P_I)[0], in_B)
            R_P_I = nearest_rotation(in_P.reshape(-1, 3).T @ in_I.reshape(-1, 3))
        return camera_from_base(R_P_I)[1], R_P_I

    chosen = [np.eye(3)]
    if not lined_up:
        starts = Rotation.create_group("O").as_matrix()
        tried = sorted((in_turn(R_P_I) for R_P_I in starts), key=lambda item: item[0])
        chosen = []
        for loss, R_P_I in tried:
            if loss > tried[0][0] + _HOPELESS * len(poses):
                break
            apart = [Rotation.from_matrix(R_P_I.T @ other).magnitude() for other in chosen]
            if not apart or min(apart) > _APART_RAD:
                chosen.append(R_P_I)
    R_W_B = _world_from_base(poses)
    biases = np.r_[np.zeros(12), _DIP_RAD, _DIP_RAD]
    found = []
    for R_P_I in chosen[:_MOST]:
        R_K_B = Rotation.from_matrix(camera_from_base(R_P_I)[0])
        R_W_I = R_W_B * R_K_B.inv() * Rotation.from_matrix(R_K_P @ R_P_I)
        found.append(Attitudes(R_K_B, Rotation.from_matrix(R_P_I), R_W_B, R_W_I, biases))
    return found


def _world_from_base(poses: list[WorldPose]) -> Rotation:
    """Level attitudes of the base IMU; north by its magnetometer, else the gyroscope's from pose to pose."""
    found: list[Rotation] = []
    for pose in poses:
        up = unit(pose.base.acc)
        if pose.has_north:
            east = unit(np.cross(np.asarray(pose.base.mag), up))  # field points north and down
            found.append(Rotation.from_matrix(np.stack([np.cross(up, east), -east, up])))
            continue
        before = found[-1] if found else Rotation.identity()
        if found and pose.base_turn is not None:
            before = found[-1] * Rotation.from_matrix(pose.base_turn.R)
        tip = Rotation.align_vectors([[0.0, 0.0, 1.0]], [before.apply(up)])[0]
        found.append(tip * before)
    return Rotation.concatenate(found)


@dataclass(frozen=True)
class WorldCalibration:
    """Camera from base IMU, how well it is known, and the data it is based on."""

    at: Attitudes  # The solution
    # (9, 9): Of `R_K_B` in {K} (rad), the base accelerometer's bias (m/s^2), `R_P_I` in {I} (rad)
    covariance: FloatArray
    camera_rad: FloatArray  # (n, 3) rad: what is left of `R_K_P`, in {K}
    worst_sigma: FloatArray  # (n,): the largest misfit of a pose in sigmas
    cost: float  # Sum of squares of all misfits
    poses: tuple[WorldPose, ...] = ()  # Those that were used
    by_eye: bool = False  # The poses did not give the mounting of the panel's IMU: lined up by eye
    notes: tuple[str, ...] = ()  # What was left out, and why
    # The base IMU's accelerometer was corrected by a calibration of its own before
    accelerometer_corrected: bool = False

    @property
    def R_K_B(self) -> FloatArray:
        """(3, 3) base IMU axes to camera axes."""
        return np.asarray(self.at.R_K_B.as_matrix())

    @property
    def R_P_I(self) -> FloatArray:
        """(3, 3) axes of the panel's IMU to panel axes."""
        return np.asarray(self.at.R_P_I.as_matrix())


class _Chain:
    """Misfits of the chain in sigmas, at any attitudes."""

    def __init__(
        self, poses: list[WorldPose], start: Attitudes, mounting_sigma_rad: float | None, bias_m_s2: float
    ):
        self._start, self._mounting = start, mounting_sigma_rad
        self._bias_sigma = np.array([bias_m_s2] * 6 + [IRON] * 6 + [DIP_RAD] * 2)
        self._weight = np.linalg.inv(np.linalg.cholesky([pose.covariance for pose in poses]))
        self._seen = Rotation.from_matrix([pose.R_K_P for pose in poses])
        sensors = [[pose.base for pose in poses], [pose.panel for pose in poses]]  # as everywhere below
        self._acc = np.array([[rest.acc for rest in rests] for rests in sensors])
        noise = np.array([[rest.acc_sigma.mean() for rest in rests] for rests in sensors])
        self._level = np.hypot(noise / np.linalg.norm(self._acc, axis=2), TILT_RAD)[..., None]
        self._field: FloatArray | None = None
        if all(pose.has_north for pose in poses):
            self._field = unit(np.array([[rest.mag for rest in rests] for rests in sensors]))
        self._turns = []
        for own in ([pose.base_turn for pose in poses], [pose.panel_turn for pose in poses]):
            known = [(i, turn) for i, turn in enumerate(own) if i and turn is not None]
            later = np.array([i for i, _ in known], dtype=int)
            back = Rotation.from_matrix(np.array([turn.R.T for _, turn in known]).reshape(-1, 3, 3))
            self._turns.append((later, back, np.array([[turn.sigma_rad] for _, turn in known])))

    def camera_left(self, at: Attitudes) -> FloatArray:
        """What is left (n, 3) of the panel's rotation in the camera, rad in {K}."""
        chain = at.R_K_B * at.R_W_B.inv() * at.R_W_I * at.R_P_I.inv()
        return np.asarray((chain * self._seen.inv()).as_rotvec())

    def of_poses(self, at: Attitudes) -> FloatArray:
        """(n, 3, 3): of the panel in the camera, and of up by either accelerometer."""
        rows = [np.einsum("nij,nj->ni", self._weight, self.camera_left(at))]
        for imu, R_W in enumerate((at.R_W_B, at.R_W_I)):
            up = R_W.apply(unit(self._acc[imu] - at.rest[3 * imu : 3 * imu + 3]))
            rows.append(np.cross(up, [0.0, 0.0, 1.0]) / self._level[imu])
        return np.stack(rows, axis=1)

    def misfit(self, at: Attitudes) -> FloatArray:
        """All misfits: of poses, fields and turns, and of what is known beforehand."""
        start, rows = self._start, [self.of_poses(at)]
        for imu, R_W in enumerate((at.R_W_B, at.R_W_I)):
            if self._field is not None:  # unit fields in {W}, whose x axis is magnetic north
                dip = at.rest[12 + imu]
                field = R_W.apply(unit(self._field[imu] - at.rest[6 + 3 * imu : 9 + 3 * imu]))
                rows.append((field - [np.cos(dip), 0.0, -np.sin(dip)]) / ROOM_RAD)
            later, back, sigma = self._turns[imu]  # since the pose before
            if len(later):
                rows.append((back * R_W[later - 1].inv() * R_W[later]).as_rotvec() / sigma)
        # every rotation is free, or nearly; biases are small
        for name in ("R_K_B", "R_P_I", "R_W_B", "R_W_I"):
            rows.append((getattr(start, name).inv() * getattr(at, name)).as_rotvec() / FREE_RAD)
        if self._mounting is not None:  # lined up by eye
            rows.append(at.R_P_I.as_rotvec() / self._mounting)
        rows.append((at.rest - start.rest) / self._bias_sigma)
        return np.concatenate([np.ravel(row) for row in rows])

    def solved(self) -> WorldCalibration:
        """Least squares over all poses; once more about the first answer, so that its slopes are local."""
        at, count = self._start, len(self._seen)
        size = 6 + 6 * count + len(at.rest)
        for _ in range(2):
            fit = least_squares(lambda x, about=at: self.misfit(about.moved(x)), np.zeros(size), method="lm")
            at = at.moved(fit.x)
        cost = 2 * float(fit.cost)
        # three rows of a direction have two degrees; a few poses may fit by luck
        spare = len(fit.fun) - (2 if self._field is None else 4) * count - size
        spread = max(1.0, cost / spare) if spare > 0 else 1.0
        bias = size - len(at.rest)
        kept = np.r_[0:3, bias : bias + 3, 3:6]
        covariance = np.linalg.inv(fit.jac.T @ fit.jac)[np.ix_(kept, kept)] * spread
        worst = np.linalg.norm(self.of_poses(at), axis=2).max(axis=1)
        return WorldCalibration(at, covariance, self.camera_left(at), worst, cost)


#: An IMU that was lined up with the panel by eye is off by this, per axis.
BY_EYE_RAD = np.radians(3.0)
#: Poses whose residuals exceed this many sigmas contradict the others and are left out.
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


def world_poses(
    views: Sequence[PanelView], panel: Sequence[ImuStream], base: Sequence[ImuStream]
) -> tuple[list[WorldPose], list[str]]:
    """Each pose as measured by camera and IMUs; poses in which an IMU moves are left out, with a note."""
    poses: list[WorldPose] = []
    notes: list[str] = []
    last = -1
    held = {id(imu): find_rests(imu, HAND) for imu in {id(imu): imu for imu in (*panel, *base)}.values()}
    for i, view in enumerate(views):
        try:
            on_panel, on_base = (
                rest_at(imu, held[id(imu)], view.t_s, view.name, f"on the {what}")
                for imu, what in ((panel[i], "panel"), (base[i], "camera"))
            )
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
    """Find `R_K_B`, and how the panel's IMU sits on the panel."""
    kept, sentences = list(poses), list(notes)
    while True:
        found = _solve(kept, bias_m_s2)
        worst = int(np.argmax(found.worst_sigma))
        if found.worst_sigma[worst] < CONTRADICTS_SIGMA or len(kept) < 2:
            return replace(found, poses=tuple(kept), notes=tuple(sentences))
        text = f"{kept[worst].name} contradicts the other poses by {found.worst_sigma[worst]:.0f} sigmas"
        if len(kept) <= FEWEST:
            raise CalibrationError(
                f"The poses contradict each other: {text}; check that each IMU is fixed to its body and uses"
                " the camera's clock, and record more poses."
            )
        sentences.append(f"{text} and is left out.")
        kept.pop(worst)
        # what followed it is no longer linked to what went before
        if worst < len(kept):
            kept[worst] = replace(kept[worst], panel_turn=None, base_turn=None)


def _solve(poses: list[WorldPose], bias_m_s2: float) -> WorldCalibration:
    """The solution; with the mounting lined up by eye where the poses do not give it."""
    if len(poses) >= FEWEST:
        starts = first_guesses(poses, lined_up=False)
        tried = [_Chain(poses, start, None, bias_m_s2).solved() for start in starts]
        best, *others = sorted(tried, key=lambda found: found.cost)
        known = np.sqrt(np.linalg.eigvalsh(best.covariance[6:, 6:])[-1]) < BY_EYE_RAD
        likely = [other for other in others if other.cost < best.cost + AS_LIKELY]
        apart = [(best.at.R_P_I.inv() * other.at.R_P_I).magnitude() for other in likely]
        if known and max(apart, default=0.0) < BY_EYE_RAD:
            return best
    start = first_guesses(poses, lined_up=True)[0]
    return replace(_Chain(poses, start, BY_EYE_RAD, bias_m_s2).solved(), by_eye=True)


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
    forces = np.array([pose.base.acc - calibration.at.rest[:3] for pose in calibration.poses])
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
    sigma, at = accuracy(calibration), calibration.at
    down = -(at.R_K_B * at.R_W_B.inv()).apply([0.0, 0.0, 1.0])
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
            "rotation": at.R_K_B.as_quat(canonical=True, scalar_first=True).tolist(),
            "rotation_sigma_deg": sigma.rotation_deg.tolist(),
            "accelerometer_bias": at.rest[:3].tolist(),
            "covariance": calibration.covariance[:6, :6].tolist(),
            "accelerometer_corrected": calibration.accelerometer_corrected,
        },
        "panel_from_imu": {
            "rotation": at.R_P_I.as_quat(canonical=True, scalar_first=True).tolist(),
            "rotation_sigma_deg": sigma.mounting_deg.tolist(),
            "off_deg": float(np.degrees(at.R_P_I.magnitude())),
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
                    "pose": pose.name,
                    "down": [round(float(x), 6) for x in down[i]],
                    "rotation_deg": round(float(np.degrees(np.linalg.norm(calibration.camera_rad[i]))), 4),
                    "worst_sigma": round(float(calibration.worst_sigma[i]), 2),
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
