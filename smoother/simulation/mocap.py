"""A simulated optical motion capture of the arm, as a lab would deliver it: `capture`.

Mocap frame `{E}`: z up, origin on the floor beside the camera, turned about the vertical at random. Mocap
clock: t_imu = t_mocap (1 + skew) + offset; its frames begin at zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..linalg import unit
from .arm import SimulatedArm
from .config import Settings, setting, size
from .motion import PAD_S, ArmMotion, optical_axes

#: Markers of a joint: the mean of their positions is the joint's centre.
JOINT_MARKERS = {
    "shoulder": ("ACR",),
    "elbow": ("EL_MED", "EL_LAT"),
    "wrist": ("WR_RAD", "WR_ULN"),
    "hand": ("HA_RAD", "HA_ULN"),
}
#: Half the distance between the two markers of a joint, m.
_HALF_WIDTH_M = {"elbow": 0.042, "wrist": 0.032, "hand": 0.040}
#: The plate on the IMU: no two distances between its markers are alike. m in {A}; their mean is the IMU.
_PLATE_M = np.array(
    [
        [-0.041, -0.026, 0.004],
        [-0.012, -0.037, 0.013],
        [0.022, -0.030, 0.002],
        [0.046, -0.008, 0.010],
        [0.034, 0.023, 0.005],
        [0.007, 0.039, 0.016],
        [-0.027, 0.028, 0.008],
        [-0.048, 0.006, 0.019],
    ]
)
PLATE_M = _PLATE_M - _PLATE_M.mean(axis=0)
PLATE_MARKERS = tuple(f"IMU{number}" for number in range(1, 9))
#: A marker disappears for about as long as this, s.
_LOST_S = 0.4
#: The capture has at least so much of the recording, s.
LEAST_S = 2.0


class MocapSimulation(Settings):
    """The motion capture and its errors."""

    mocap_rate_hz: float = setting(120.0, "mocap frames per second", ge=20, le=1000)
    mocap_offset_s: float | None = setting(
        None, "t_imu = t_mocap + this; drawn between -4 and -1 if not given", ge=-600, le=600
    )
    mocap_skew_ppm: float = setting(
        20.0, "the IMU's seconds are longer than the mocap's by this, ppm", ge=-1000, le=1000
    )
    marker_noise_m: float = size(
        2e-05, "white noise of a marker, m per axis; 0.0002 for an older or far system"
    )
    marker_lost: float = size(0.05, "fraction of the time that a marker is not seen", le=0.9)


@dataclass(frozen=True)
class MarkerCapture:
    """What the motion capture recorded, and what is known of it."""

    names: tuple[str, ...]  # Of the M markers
    rate_hz: float  # Nominal, on the mocap's own clock
    position: FloatArray  # (N, M, 3) m: in {E}; nan where a marker was not seen. Frame k is at k / rate_hz
    R_C_E: FloatArray  # (3, 3)
    translation_m: FloatArray  # (3,) m
    offset_s: float  # t_imu = t_mocap (1 + skew) + offset
    skew_ppm: float

    @property
    def t_s(self) -> FloatArray:
        """(N,) frame times on the mocap's clock, s."""
        return np.asarray(np.arange(len(self.position)) / self.rate_hz)

    @property
    def marker_map(self) -> dict[str, list[str]]:
        """Names of the markers by joint, and of the IMU's plate."""
        return {
            **{joint: list(names) for joint, names in JOINT_MARKERS.items()},
            "imu_plate": [*PLATE_MARKERS],
        }

    @property
    def plate(self) -> dict[str, list[float]]:
        """Positions of the plate's markers in the IMU's axes {A}, m, by name."""
        return {name: row.round(9).tolist() for name, row in zip(PLATE_MARKERS, PLATE_M, strict=True)}

    @property
    def extrinsics(self) -> dict[str, list[float]]:
        """The calibration's table `camera_from_mocap`: rotation qw, qx, qy, qz and translation, m."""
        quaternion = Rotation.from_matrix(self.R_C_E).as_quat(canonical=True, scalar_first=True)
        return {"rotation": quaternion.tolist(), "translation": self.translation_m.tolist()}


def capture(simulated: SimulatedArm, config: MocapSimulation | None = None, seed: int = 0) -> MarkerCapture:
    """Record a simulated arm with 15 markers: 8 on the IMU's plate, 7 on the skin over the joints."""
    config = config or MocapSimulation()
    recording = simulated.recording
    # Apart from the recording's own draws, which the same seed makes.
    rng, noise_rng, lost_rng = (
        np.random.default_rng(child) for child in np.random.SeedSequence([seed, 0x6D6F636170]).spawn(3)
    )
    drawn, after_s = -rng.uniform(1, 4), rng.uniform(0.5, 2)
    offset_s = drawn if config.mocap_offset_s is None else config.mocap_offset_s
    rate = 1.0 + 1e-6 * config.mocap_skew_ppm
    end_s = float(recording.imu.t_s[-1])
    if offset_s > end_s - LEAST_S:
        raise ValueError(
            f"a motion capture with mocap_offset_s={offset_s:g} begins when the recording of {end_s:.0f} s is"
            f" over; choose at most {end_s - LEAST_S:.0f}, or a longer recording"
        )
    count = int(np.ceil((end_s + after_s - offset_s) / rate * config.mocap_rate_hz))
    t_imu = np.arange(count) / config.mocap_rate_hz * rate + offset_s
    # Beyond its ends the motion is not defined: the person stands still.
    moving = np.clip(t_imu, -0.8 * PAD_S, end_s + 0.8 * PAD_S)
    assert recording.camera_frame is not None
    R_K_C = optical_axes(recording.camera_frame)
    up = unit(-R_K_C.T @ simulated.parameters["gravity"])
    ahead = unit(np.array([0.0, 0.0, 1.0]) - up[2] * up)
    level = np.column_stack([ahead, np.cross(up, ahead), up])
    turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
    camera_in_level = np.array([rng.uniform(-3, -1), rng.uniform(-1.5, 1.5), rng.uniform(0.9, 1.5)])
    R_C_E, translation = level @ turn, level @ -camera_in_level
    in_camera = marker_positions(simulated.motion, moving, recording.side)
    position = (in_camera @ R_K_C - translation) @ R_C_E  # rows: R_C_E^T (R_K_C^T p - t)
    position += config.marker_noise_m * noise_rng.normal(size=position.shape)
    position[_lost(count, position.shape[1], config, lost_rng)] = np.nan
    return MarkerCapture(
        (*(name for names in JOINT_MARKERS.values() for name in names), *PLATE_MARKERS),
        config.mocap_rate_hz,
        position,
        R_C_E,
        translation,
        offset_s,
        config.mocap_skew_ppm,
    )


def marker_positions(motion: ArmMotion, t_s: FloatArray, side: str) -> FloatArray:
    """Positions (N, 15, 3) of the markers, m in {K}, at true times (N,) s."""
    joints = motion.joints(t_s)
    R_K_A, imu = motion.imu_pose(t_s)
    across_elbow, R_K_F = motion.bone_axes(t_s)
    # z of {F} points to the thumb of a right arm, away from it on a left one.
    to_thumb = R_K_F[:, :, 2] * (-1.0 if side == "left" else 1.0)
    medial = {"elbow": -across_elbow, "wrist": to_thumb, "hand": to_thumb}
    positions = [joints["shoulder"]]
    for joint, half in _HALF_WIDTH_M.items():
        positions += [joints[joint] + half * medial[joint], joints[joint] - half * medial[joint]]
    plate = imu[:, None, :] + np.einsum("nij,mj->nmi", R_K_A, PLATE_M)
    return np.concatenate([np.stack(positions, axis=1), plate], axis=1)


def _lost(frames: int, markers: int, config: MocapSimulation, rng: np.random.Generator) -> BoolArray:
    """(N, M) True where a marker is not seen: for some tenths of a second, each marker by itself."""
    lost = np.zeros((frames, markers), dtype=bool)
    seconds = frames / config.mocap_rate_hz
    for marker in range(markers if config.marker_lost else 0):
        count = max(round(config.marker_lost * seconds / _LOST_S), 1)
        begin = rng.uniform(0, seconds, count)
        for a, b in zip(begin, begin + rng.uniform(0.2, 1.8, count) * _LOST_S, strict=True):
            lost[int(a * config.mocap_rate_hz) : int(b * config.mocap_rate_hz) + 1, marker] = True
    return lost
