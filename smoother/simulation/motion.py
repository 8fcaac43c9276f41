"""Motion as a function of time in the camera frame: what sensors are simulated from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..recording import CameraFrame
from ..units import GRAVITY
from .body import BODY, FLEXION, POSTURE_SIZE, PRONATION, SHOULDER, BodyMeasures, arm_chain
from .protocol import KNOT_RATE_HZ, Performance, band_noise, reference

#: What the trunk turns about, between the hips, m in {T}.
HIPS = np.array([0.0, -0.45, 0.0])
#: How the turning is shared by leaning forwards, turning about the vertical and leaning sideways.
SHARES = np.sqrt([0.25, 0.6, 0.15])


class TrunkTurn:
    """How the trunk turns about the hips over time."""

    def __init__(self, performance: Performance, rms_deg: float, rng: np.random.Generator) -> None:
        self._spline: BSpline | None = None
        if rms_deg > 0.0:
            turn = np.radians(rms_deg) * SHARES * band_noise(performance.t_s, 0.05, 0.3, 3, rng)
            self._spline = make_interp_spline(performance.t_s, turn, k=5)

    @property
    def is_still(self) -> bool:
        """The trunk never turns."""
        return self._spline is None

    def at(self, t_s: FloatArray) -> FloatArray:
        """The trunk as it is turned against the upright one, (N, 3, 3)."""
        if self._spline is None:
            return np.tile(np.eye(3), (len(t_s), 1, 1))
        return np.asarray(Rotation.from_rotvec(self._spline(t_s)).as_matrix())

    def moved(self, points_T: FloatArray, t_s: FloatArray) -> FloatArray:
        """Points (N, 3) of the upright trunk, m in {T}, where its turning takes them."""
        if self._spline is None:
            return points_T
        return HIPS + np.einsum("nij,nj->ni", self.at(t_s), points_T - HIPS)

    def back(self, points_T: FloatArray, t_s: FloatArray) -> FloatArray:
        """The other way round: points (N, 3) of the turned trunk as the upright one has them."""
        if self._spline is None:
            return points_T
        return HIPS + np.einsum("nji,nj->ni", self.at(t_s), points_T - HIPS)


#: Axes of a level Kinect to those of other level cameras.
LEVEL_FROM_KINECT = {
    CameraFrame.KINECT: np.eye(3),
    CameraFrame.OPTICAL: np.diag([-1.0, -1.0, 1.0]),
    CameraFrame.ZUP: np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
}


class MotionModel(Protocol):
    """A body with an IMU on it, in {K}, at any time of the recording (and 0.4 s beyond its ends)."""

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`R_K_A` (N, 3, 3) and the IMU's position (N, 3) m in {K}."""
        ...

    def joints(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """Positions (N, 3) by joint, m in {K}."""
        ...


@dataclass(frozen=True)
class Stage:
    """Where the person stands before the camera."""

    R_K_T: FloatArray  # (3, 3): torso axes to camera axes
    origin_K: FloatArray  # (3,) m: origin of {T} (between the shoulders) in {K}

    @property
    def gravity(self) -> FloatArray:
        """(3,) m/s^2 in {K}; the torso is upright."""
        return np.asarray(self.R_K_T @ [0.0, -GRAVITY, 0.0])


def tilt_rotation(degrees: float, heading: float, up: FloatArray) -> Rotation:
    """A rotation by `degrees` about a level axis; `up` (3,) is a unit axis, `heading` rad turns about it."""
    level = np.roll(up, 1)
    axis = Rotation.from_rotvec(heading * up).apply(level)
    return Rotation.from_rotvec(np.radians(degrees) * axis)


def draw_stage(distance_m: float, frame: CameraFrame, rng: np.random.Generator) -> Stage:
    """A camera tilted by 3 to 10 degrees, and a person about `distance_m` before it who faces it."""
    up = np.array([0.0, 1.0, 0.0])
    tilt = tilt_rotation(rng.uniform(3, 10), rng.uniform(-np.pi, np.pi), up)
    turn = Rotation.from_euler("y", rng.normal(0, 4), degrees=True)
    origin = [rng.normal(0, 0.08), rng.uniform(0.1, 0.35), distance_m * rng.uniform(0.95, 1.05)]
    to_frame = LEVEL_FROM_KINECT[frame]
    return Stage(to_frame @ (tilt * turn).as_matrix(), to_frame @ origin)


def draw_wobble(performance: Performance, rms_deg: float, rng: np.random.Generator) -> FloatArray:
    """Rotation vectors (N, 3), rad in {F}, of a strap that slides as the arm moves; the mean is zero."""
    drive = performance.posture[:, [SHOULDER.start, SHOULDER.start + 1, FLEXION, PRONATION]]
    spread = drive.std(axis=0)
    moving = spread > 1e-6
    if rms_deg == 0.0 or not moving.any():
        return np.zeros((len(drive), 3))
    drive = (drive[:, moving] - drive[:, moving].mean(axis=0)) / spread[moving]
    drive = gaussian_filter1d(drive, 0.2 * KNOT_RATE_HZ, axis=0, mode="nearest")
    delay = int(0.2 * KNOT_RATE_HZ)
    drive = np.concatenate([np.repeat(drive[:1], delay, axis=0), drive[:-delay]])
    wobble = drive @ rng.normal(size=(drive.shape[1], 3))
    wobble /= wobble.std(axis=0)
    wobble = 0.8 * wobble + 0.6 * band_noise(performance.t_s, 0.1, 0.5, 3, rng)
    wobble -= wobble.mean(axis=0)
    wobble *= np.sqrt([0.2, 0.6, 0.2]) / wobble.std(axis=0)
    return np.radians(rms_deg) * wobble


def wrist_angles(performance: Performance, rms_deg: float, rng: np.random.Generator) -> FloatArray:
    """The wrist's flexion and deviation to the thumb (N, 2), rad; zero where it is held straight."""
    if rms_deg == 0.0:
        return np.zeros((len(performance.t_s), 2))
    angles = band_noise(performance.t_s, 0.1, 0.8, 2, rng)
    return np.asarray(np.radians(rms_deg) * angles * [1.0, 1.0 / 3.0])


class ArmMotion:
    """An arm that performs a protocol before the camera."""

    def __init__(
        self,
        performance: Performance,
        measures: BodyMeasures,
        stage: Stage,
        wobble: FloatArray,
        side: str,
        trunk: TrunkTurn | None = None,
        wrist: FloatArray | None = None,
    ) -> None:
        self.measures, self.stage = measures, stage
        self.trunk = trunk or TrunkTurn(performance, 0.0, np.random.default_rng(0))
        # A left arm is the mirror image of a right one; z of its {F} is then mirrored twice (x cross y).
        self._mirror = np.diag([-1.0 if side == "left" else 1.0, 1.0, 1.0])
        self._flip = np.diag([1.0, 1.0, -1.0 if side == "left" else 1.0])
        table = np.hstack([performance.posture, performance.sway, wobble])
        self._spline: BSpline = make_interp_spline(performance.t_s, table, k=5)
        bends = wrist is not None and bool(wrist.any())
        self._wrist: BSpline | None = make_interp_spline(performance.t_s, wrist, k=5) if bends else None

    def upper_arm(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The bone of the upper arm: elbow (N, 3) m in {K}, and `R_K_U` (N, 3, 3) (see `body`)."""
        table = self._spline(t_s)
        _, elbow, _, _ = self._chain(t_s)
        R_T_U = (reference() * Rotation.from_rotvec(table[:, SHOULDER])).as_matrix()
        return self._to_camera(elbow, t_s), self._trunk(t_s) @ self._mirror @ R_T_U @ self._flip

    def hand(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The hand: wrist (N, 3) m in {K}, and `R_K_H` (N, 3, 3), {H} as {F} where the wrist is straight."""
        _, elbow, R_T_F, _ = self._chain(t_s)
        wrist = elbow + self.measures.forearm * R_T_F[:, :, 1]
        return self._to_camera(wrist, t_s), self._trunk(t_s) @ R_T_F @ self._bend(t_s)

    def _bend(self, t_s: FloatArray) -> FloatArray:
        """`R_F_H` (N, 3, 3): flexion takes the hand to the palm (-x of {F}), deviation to the thumb."""
        if self._wrist is None:
            return np.tile(np.eye(3), (len(t_s), 1, 1))
        flexion, deviation = self._wrist(t_s).T
        thumb = self._flip[2, 2]  # z of {F} points to the thumb's side of a right arm
        turned = Rotation.from_euler("ZX", np.stack([flexion, thumb * deviation], axis=1))
        return np.asarray(turned.as_matrix())

    def _chain(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Shoulder, elbow (N, 3) and `R_T_F` (N, 3, 3) in {T}, and the strap's rotation vector (N, 3)."""
        table = self._spline(t_s)
        sway = table[:, POSTURE_SIZE : POSTURE_SIZE + 3]
        shoulder, elbow, R_T_F = arm_chain(table[:, :POSTURE_SIZE], reference(), self.measures)
        mirror = self._mirror
        return (
            (shoulder + sway) @ mirror,
            (elbow + sway) @ mirror,
            mirror @ R_T_F @ self._flip,
            table[:, POSTURE_SIZE + 3 :],
        )

    def _to_camera(self, points_T: FloatArray, t_s: FloatArray) -> FloatArray:
        moved = self.trunk.moved(points_T, t_s)
        return np.asarray(moved @ self.stage.R_K_T.T + self.stage.origin_K)

    def _trunk(self, t_s: FloatArray) -> FloatArray:
        """`R_K_T` of the trunk as it is turned: (3, 3) of one that stands still, else (N, 3, 3)."""
        return self.stage.R_K_T if self.trunk.is_still else self.stage.R_K_T @ self.trunk.at(t_s)

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `MotionModel.imu_pose`."""
        _, elbow, R_T_F, wobble = self._chain(t_s)
        strap = Rotation.from_rotvec(wobble).as_matrix()
        # The strap turns about the arm's core: the sensor moves with it.
        in_forearm = strap @ self.measures.imu_in_forearm
        in_forearm[:, 1] -= self.measures.along_forearm["elbow"]
        position = elbow + np.einsum("nij,nj->ni", R_T_F, in_forearm)
        R_K_A = self._trunk(t_s) @ R_T_F @ strap @ self.measures.R_F_A
        return R_K_A, self._to_camera(position, t_s)

    def joints(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """See `MotionModel.joints`."""
        shoulder, elbow, R_T_F, _ = self._chain(t_s)
        along, direction = self.measures.along_forearm, R_T_F[:, :, 1]
        positions = {"shoulder": shoulder, "elbow": elbow}
        positions["wrist"] = elbow + (along["wrist"] - along["elbow"]) * direction
        if self._wrist is None:
            positions["hand"] = elbow + (along["hand"] - along["elbow"]) * direction
        else:
            fingers = (R_T_F @ self._bend(t_s))[:, :, 1]
            positions["hand"] = positions["wrist"] + self.measures.hand * fingers
        return {joint: self._to_camera(position, t_s) for joint, position in positions.items()}

    def bone_axes(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Elbow's flexion axis, from the medial to the lateral epicondyle, (N, 3), and `R_K_F` (N, 3, 3)."""
        _, _, R_T_F, _ = self._chain(t_s)
        # Undo the pronation: what is left turns about the flexion axis only, z of {U}.
        turn = np.asarray(self._spline(t_s)[:, PRONATION])
        axis_F = np.stack([np.sin(turn), np.zeros_like(turn), np.cos(turn)], axis=1) @ self._flip
        lateral = np.einsum("nij,nj->ni", R_T_F, axis_F)
        R_K_T = self._trunk(t_s)
        return (R_K_T @ lateral[:, :, None])[:, :, 0], np.asarray(R_K_T @ R_T_F)

    def other_arm(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """The joints of the other arm, which hangs and sways with the trunk: (N, 3) by joint, m in {K}."""
        sway = self._spline(t_s)[:, POSTURE_SIZE : POSTURE_SIZE + 3] @ self._mirror
        rest = self.measures.shoulder * [-1.0, 1.0, 1.0] @ self._mirror
        down = np.array([0.0, -1.0, 0.0])
        reach = {
            "shoulder": 0.0,
            "elbow": self.measures.upper_arm,
            "wrist": self.measures.upper_arm + self.measures.forearm,
            "hand": self.measures.upper_arm + self.measures.forearm + self.measures.hand,
        }
        return {joint: self._to_camera(rest + sway + length * down, t_s) for joint, length in reach.items()}

    def hidden(self, t_s: FloatArray) -> BoolArray:
        """(N,) True where the body stands between the camera and the wrist or the hand."""
        # The body sways with the shoulder.
        sway = self._spline(t_s)[:, POSTURE_SIZE : POSTURE_SIZE + 3] @ self._mirror
        R_T_K = self.stage.R_K_T.T
        camera = np.tile(-R_T_K @ self.stage.origin_K, (len(t_s), 1))
        eye = self.trunk.back(camera, t_s) - sway
        joints = self.joints(t_s)
        hidden = np.zeros(len(t_s), dtype=bool)
        for joint in ("wrist", "hand"):
            position_T = self.trunk.back((joints[joint] - self.stage.origin_K) @ R_T_K.T, t_s) - sway
            for part in BODY:
                hidden |= part.hides(position_T, eye)
        return hidden
