"""`simulate_panel`: images, mocap markers, IMUs and truth of a panel held before a depth camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ...array_types import FloatArray
from ...recording import ImuStream
from ...units import GRAVITY
from ..config import SensorErrors
from ..inertial import ideal_imu, measure
from ..protocol import band_noise, ramp
from .config import PanelSimulation
from .placing import (
    RenderLens,
    panel_corners,
    place_base,
    place_camera,
    place_imu,
    place_mocap,
    place_panel,
    tilt_camera,
)
from .scene import PanelScene, add_distractor, build_scene, depth_image, infrared_image, render

#: The earth's field in {W}, uT: 60 degrees below the horizon, x to the north.
FIELD_W = np.array([24.0, 0.0, -41.6])
_SWAY_HZ = (0.5, 3.0)
_SWAY_M_A_DEG = 0.005  # a hand that sways by a degree also moves by this


@dataclass(frozen=True)
class Held:
    """A body that is held in one pose after the other, and sways a little."""

    R_W: FloatArray  # (n, 3, 3): orientation in each pose, body to world
    p_W: FloatArray  # (n, 3) m
    hold_s: float  # Time in a pose, and from one to the next
    move_s: float  # Time in a pose, and from one to the next
    sway_deg: float = 0.0  # Rms of the sway
    seed: int = 0  # Of the sway

    def middle_s(self) -> FloatArray:
        """Times (n,) in the middle of the holds."""
        return (np.arange(len(self.R_W)) + 0.5) * self.hold_s + np.arange(len(self.R_W)) * self.move_s

    @property
    def duration_s(self) -> float:
        """From the start of the first hold to the end of the last."""
        return len(self.R_W) * self.hold_s + (len(self.R_W) - 1) * self.move_s

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Orientation (N, 3, 3) and position (N, 3) m in {W}: minimum jerk between the poses."""
        poses = Rotation.from_matrix(self.R_W)
        step = (poses[:-1].inv() * poses[1:]).as_rotvec()
        R = np.tile(self.R_W[0], (len(t_s), 1, 1))
        p = np.tile(self.p_W[0], (len(t_s), 1))
        for i, begin in enumerate(self.middle_s()[:-1] + self.hold_s / 2):
            now = t_s >= begin
            share = ramp(t_s[now], begin, self.move_s)[:, None]
            R[now] = (poses[i] * Rotation.from_rotvec(share * step[i])).as_matrix()
            p[now] = self.p_W[i] + share * (self.p_W[i + 1] - self.p_W[i])
        if self.sway_deg > 0:
            sway = self.sway_deg * band_noise(t_s, *_SWAY_HZ, 6, np.random.default_rng(self.seed))
            R = R @ Rotation.from_rotvec(np.radians(sway[:, :3]) / np.sqrt(3)).as_matrix()
            p = p + _SWAY_M_A_DEG * sway[:, 3:]
        return R, p

    def joints(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """No joints."""
        return {}


def imu_stream(
    name: str, body: Held, R_body_imu: FloatArray, config: PanelSimulation, rng: np.random.Generator
) -> ImuStream:
    """Samples of an IMU on a body, in the IMU's axes, over the whole session."""
    on_body = replace(body, R_W=body.R_W @ R_body_imu)
    ideal = ideal_imu(on_body, body.duration_s, config.imu_rate_hz, np.array([0, 0, -GRAVITY]))
    errors = SensorErrors.preset(
        "clean",
        imu_rate_hz=config.imu_rate_hz,
        accelerometer_noise=config.accelerometer_noise,
        gyroscope_noise=config.gyroscope_noise,
        accelerometer_bias=config.accelerometer_bias,
        gyroscope_bias=config.gyroscope_bias,
        imu_scale=config.imu_scale,
    )
    stream, _ = measure(ideal, errors, rng)
    mag = None
    if config.magnetometer:
        R, _ = on_body.imu_pose(ideal.t_s)
        mag = np.einsum("nji,j->ni", R, FIELD_W) + config.magnetometer_bias * rng.normal(size=3)
        mag = mag + config.magnetometer_noise * rng.normal(size=mag.shape)
    return ImuStream(name, stream.t_s, stream.acc, stream.gyro, mag)


#: A distractor stays at least this far from the panel's outline, pixels.
_DISTRACTOR_FROM_PANEL_PX = 15.0


@dataclass(frozen=True)
class PanelPose:
    """What camera and mocap see of the panel in one pose, and where it truly is."""

    t_s: float  # Time of the images, in the middle of the hold; the clock is the IMUs'
    # (height, width) mm: Along the optical axis, 0 = none (float where not quantised)
    depth: NDArray[np.uint16] | FloatArray
    infrared: NDArray[np.uint16]  # (height, width)
    marker_names: tuple[str, ...]  # Of the mocap markers, in the order they come in
    markers: FloatArray  # (n, 3) m: in {E}, with the mocap's noise, shuffled
    marker_order: NDArray[np.int64]  # (n,): which marker of the panel's definition each of them is
    R_K_P: FloatArray  # (3, 3) and (3,) m: the panel in the camera
    p_K_P: FloatArray  # (3, 3) and (3,) m: the panel in the camera
    # (n, 2) pixels: Exact pixels of the markers' centres, in the order of the definition
    marker_pixels: FloatArray
    R_W_K: FloatArray  # (3, 3): the camera in the world, z up


@dataclass(frozen=True)
class SimulatedPanel:
    """Poses of one panel before one camera, and the answer."""

    config: PanelSimulation
    seed: int
    lens: RenderLens  # The camera's intrinsics
    poses: tuple[PanelPose, ...]
    imu_panel: ImuStream  # The IMU on the panel and the one on the camera, over the whole session
    imu_base: ImuStream  # The IMU on the panel and the one on the camera, over the whole session
    R_K_E: FloatArray  # (3, 3) and (3,) m: the answer of `calibrate panel`, camera from mocap
    t_K_E: FloatArray  # (3, 3) and (3,) m: the answer of `calibrate panel`, camera from mocap
    R_K_B: FloatArray  # (3, 3): the answer of `calibrate world`: camera from base IMU, panel from its IMU
    R_P_I: FloatArray  # (3, 3): the answer of `calibrate world`: camera from base IMU, panel from its IMU


def simulate_panel(config: PanelSimulation, seed: int = 0) -> SimulatedPanel:
    """Hold a panel before a depth camera, in as many poses as the settings say."""
    streams = np.random.SeedSequence(seed).spawn(config.poses + 2)
    rng = np.random.default_rng(streams[0])
    lens = make_lens(config)
    R_W_K = place_camera(rng)
    R_K_E, t_K_E = place_mocap(R_W_K, rng)
    mocap_W = (R_W_K @ R_K_E, R_W_K @ t_K_E)
    poses = []
    for number, stream in enumerate(streams[1:-1]):
        own = np.random.default_rng(stream)
        tilted = tilt_camera(R_W_K, config.camera_tilt_deg, own) if number else R_W_K
        poses.append(_pose(config, lens, number, tilted, mocap_W, own))
    rng = np.random.default_rng(streams[-1])
    R_K_B, R_P_I = place_base(rng), place_imu(config.imu_mounting_deg, rng)
    panel, camera = _bodies(config, poses, seed)
    imu_panel = imu_stream("panel", panel, R_P_I, config, rng)
    imu_base = imu_stream("base", camera, R_K_B, config, rng)
    return SimulatedPanel(config, seed, lens, tuple(poses), imu_panel, imu_base, R_K_E, t_K_E, R_K_B, R_P_I)


def make_lens(config: PanelSimulation) -> RenderLens:
    """The camera's intrinsics: the principal point lies some pixels off the middle."""
    return RenderLens(
        config.width,
        config.height,
        fx=config.focal_px,
        fy=config.focal_px * 1.0008,
        cx=config.width / 2 + 2.3,
        cy=config.height / 2 - 4.1,
        distortion=config.distortion,
    )


def marker_points(config: PanelSimulation) -> FloatArray:
    """Centres of the markers (n, 3), m in {P}."""
    height = config.marker_height_m if config.marker_shape == "sphere" else 0.0
    return np.column_stack([config.markers, np.full(len(config.markers), height)])


def _pose(
    config: PanelSimulation,
    lens: RenderLens,
    number: int,
    R_W_K: FloatArray,
    mocap_W: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
) -> PanelPose:
    R_K_P, p_K_P = place_panel(config, lens, R_W_K, rng)
    scene = build_scene(config, R_K_P, p_K_P, R_W_K.T, rng)
    _distract(scene, lens, config.distractors, rng)
    ideal = render(scene, lens)
    infrared = infrared_image(ideal, config, rng)
    depth = depth_image(ideal, config, rng)
    true_K = marker_points(config) @ R_K_P.T + p_K_P
    order = rng.permutation(len(true_K))
    noise = config.mocap_noise_m * rng.normal(size=true_K.shape)
    R_W_E, t_W_E = mocap_W
    markers = ((true_K @ R_W_K.T - t_W_E) @ R_W_E + noise)[order]
    names = tuple(f"M{number:02d}" for number in rng.permutation(np.arange(1, 1 + len(true_K))))
    t_s = (number + 0.5) * config.hold_s + number * config.move_s
    pixels = lens.project(true_K)
    return PanelPose(t_s, depth, infrared, names, markers, order, R_K_P, p_K_P, pixels, R_W_K)


def _bodies(config: PanelSimulation, poses: list[PanelPose], seed: int) -> tuple[Held, Held]:
    """The panel (a point near its middle) and the camera, from pose to pose."""
    R_W_K = np.array([pose.R_W_K for pose in poses])
    R_K_P = np.array([pose.R_K_P for pose in poses])
    middle = panel_corners(config).mean(axis=0) + np.array([0.05, 0.03, -0.01])
    p_K = np.array([pose.R_K_P @ middle + pose.p_K_P for pose in poses])
    p_W = np.einsum("nij,nj->ni", R_W_K, p_K)
    times = (config.hold_s, config.move_s)
    panel = Held(R_W_K @ R_K_P, p_W, *times, config.sway_deg, seed)
    return panel, Held(R_W_K, np.zeros((len(poses), 3)), *times)


def _distract(scene: PanelScene, lens: RenderLens, count: int, rng: np.random.Generator) -> None:
    """Put bright balls beside the panel, wherever there is room in the image."""
    import cv2

    outline = lens.project(panel_corners(scene.config) @ scene.R_K_P.T + scene.p_K_P).astype(np.float32)
    rays = lens.all_rays()
    placed = 0
    for _ in range(1000 * bool(count)):
        row, column = rng.integers(10, lens.height - 10), rng.integers(10, lens.width - 10)
        if cv2.pointPolygonTest(outline, (float(column), float(row)), True) > -_DISTRACTOR_FROM_PANEL_PX:
            continue
        z = float(scene.cast(rays[row, column][None]).z[0])
        if np.isfinite(z):
            add_distractor(scene, rays[row, column], rng.uniform(1.0, min(z - 0.05, 2.0)))
            placed += 1
        if placed == count:
            return
