"""What cameras' skeletons state of an arm: stamps, noise, occlusions, false tracks; pixels if no depth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import binary_closing, binary_opening
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.special import gammainc

from ..array_types import BoolArray, FloatArray
from ..linalg import runs, unit
from ..recording import (
    FOCAL_CALIBRATED,
    FOREARM_JOINTS,
    JOINTS,
    Camera,
    CameraFrame,
    CameraPose,
    JointState,
    JointTracks,
)
from ..rotation import matrix_of
from .config import ArmSimulation, SensorErrors
from .motion import ArmMotion, Stage, optical_axes, perform, tilt_rotation


@dataclass
class Footage:
    """Frames in the making: truth first, then spoilt step by step."""

    t_s: FloatArray  # (F,) s: True times of exposure
    position: FloatArray  # (F, 5, 3) m: in {K}, joints in the order of `JOINTS`
    state: np.ndarray  # (F, 5): `JointState` values


def exposures(duration_s: float, rate_hz: float, rng: np.random.Generator) -> FloatArray:
    """True times (F,) of the frames: a steady rate from a random phase."""
    return np.asarray(np.arange(rng.uniform(0, 1) / rate_hz, duration_s, 1.0 / rate_hz))


def film(t_s: FloatArray, joints: dict[str, FloatArray]) -> Footage:
    """Error-free frames with every given joint (F, 3) tracked and the others absent."""
    position = np.full((len(t_s), len(JOINTS), 3), np.nan)
    state = np.full((len(t_s), len(JOINTS)), JointState.NOT_TRACKED, dtype=np.int8)
    for joint, track in joints.items():
        position[:, JOINTS.index(joint)] = track
        state[:, JOINTS.index(joint)] = JointState.TRACKED
    return Footage(t_s, position, state)


def correlated_noise(
    frames: int, size: int, sigma: float | FloatArray, tau_s: float, step_s: float, rng: np.random.Generator
) -> FloatArray:
    """Noise (frames, size) with standard deviation `sigma` and autocorrelation exp(-lag / tau_s)."""
    memory = np.exp(-step_s / tau_s)
    drive = rng.normal(size=(frames, size)) * np.sqrt(1 - memory**2)
    drive[0] /= np.sqrt(1 - memory**2)  # stationary from the first frame on
    return np.asarray(sigma * lfilter([1.0], [1.0, -memory], drive, axis=0))


def add_noise(footage: Footage, errors: SensorErrors, rng: np.random.Generator) -> dict[str, Any]:
    """Add bias, correlated, white and depth noise to every joint; returns the biases (5, 3) m in {K}."""
    frames, joints, _ = footage.position.shape
    true = footage.position.copy()
    drawn = rng.normal(size=(joints, 3))
    bias = errors.joint_bias_m * drawn
    if errors.joint_off_m:
        # A normal vector's length is independent of its direction: its quantile gives the size.
        least, most = min(errors.joint_off_m), max(errors.joint_off_m)
        size = least + (most - least) * gammainc(1.5, 0.5 * (drawn**2).sum(axis=1, keepdims=True))
        bias += size * unit(drawn)
    footage.position += bias
    slow = np.zeros(joints)
    slow[: len(errors.joint_slow_m)] = errors.joint_slow_m
    footage.position += correlated_noise(
        frames,
        joints * 3,
        np.repeat(np.hypot(errors.noise_correlated_m, slow / np.sqrt(3)), 3),
        errors.noise_correlated_s,
        1.0 / errors.frame_rate_hz,
        rng,
    ).reshape(true.shape)
    footage.position += errors.noise_m * rng.normal(size=true.shape)
    distance = np.linalg.norm(true, axis=2, keepdims=True)
    along_ray = errors.noise_depth_m * (distance / 2.0) ** 2 * rng.normal(size=distance.shape)
    footage.position += along_ray * true / distance
    return {"joint_bias": {name: bias[k] for k, name in enumerate(JOINTS)}}


def add_outliers(footage: Footage, errors: SensorErrors, rng: np.random.Generator) -> BoolArray:
    """Displace a fraction of the tracked samples in a random direction; returns which (F, 5)."""
    wrong = rng.uniform(size=footage.state.shape) < errors.outliers
    wrong &= footage.state == JointState.TRACKED
    direction = unit(rng.normal(size=footage.position.shape))
    footage.position[wrong] += errors.outlier_m * direction[wrong]
    return wrong


def deliver(
    footage: Footage, name: str, errors: SensorErrors, rng: np.random.Generator
) -> tuple[JointTracks, BoolArray]:
    """Stamp the frames on the camera's clock and drop some; returns the tracks and which frames remain
    (F,).
    """
    jitter = errors.frame_jitter_s * rng.normal(size=len(footage.t_s))
    limit = 0.45 / errors.frame_rate_hz
    stamp = footage.t_s + errors.latency_s + np.clip(jitter, -limit, limit)
    delivered = rng.uniform(size=len(stamp)) >= errors.dropped_frames
    position = footage.position.copy()
    position[footage.state == JointState.NOT_TRACKED] = np.nan
    return JointTracks(name, stamp[delivered], position[delivered], footage.state[delivered]), delivered


_FOREARM = [JOINTS.index(joint) for joint in FOREARM_JOINTS]
_SHOULDER = JOINTS.index("shoulder")


def debounce(hidden: BoolArray, rate_hz: float) -> BoolArray:
    """The mask (F,) without runs under 0.2 s, of either kind: no tracker loses or gets a limb so fast."""
    size = np.ones(max(round(0.2 * rate_hz), 1), dtype=bool)
    padded = np.pad(hidden, len(size))
    settled = binary_opening(binary_closing(padded, size), size)
    return np.asarray(settled[len(size) : -len(size)])


def random_gaps(
    t_s: FloatArray, lengths_s: tuple[float, ...], every_s: float, begin_s: float, rng: np.random.Generator
) -> BoolArray:
    """(F,) True in occlusions of the given lengths, one in about `every_s`, at least 2 s visible between."""
    hidden = np.zeros(len(t_s), dtype=bool)
    if not lengths_s or len(t_s) == 0:
        return hidden
    count = int(np.ceil(t_s[-1] / every_s)) + 1
    length = rng.choice(lengths_s, count)
    wait = np.maximum(every_s - length, 2.0) * rng.uniform(0.7, 1.3, count)
    begin = begin_s + np.cumsum(np.maximum(wait, 2.0) + np.concatenate([[0.0], length[:-1]]))
    inside = begin + length < t_s[-1] - 2.0  # never at the end: both sides of a gap are seen
    for a, b in zip(begin[inside], (begin + length)[inside], strict=True):
        hidden[(t_s >= a) & (t_s < b)] = True
    return hidden


def occlusions(
    motion: ArmMotion, t_s: FloatArray, config: ArmSimulation, rng: np.random.Generator
) -> BoolArray:
    """(F,) frames in which the forearm is hidden: at random, or by the body."""
    if config.protocol != "random" or config.still_all:
        return debounce(motion.hidden(t_s), config.frame_rate_hz)
    return random_gaps(t_s, config.occlusion_lengths_s, config.occlusion_every_s, config.still_start_s, rng)


def lose_forearm(
    footage: Footage, hidden: BoolArray, true: FloatArray, config: ArmSimulation, rng: np.random.Generator
) -> None:
    """Set the forearm's joints to the configured state in the hidden frames (F,); `true` as in `Footage`.

    An inferred joint gets a wandering wrong guess.
    """
    lag = rng.uniform(0, config.elbow_lag_s * config.frame_rate_hz, len(runs(hidden)) + 1).round().astype(int)
    lost = np.repeat(hidden[:, None], len(_FOREARM), axis=1)
    for gap, frames in zip(runs(hidden), lag, strict=False):
        # The lag never eats a gap up: a third of it is the most.
        lost[gap.start : gap.start + min(int(frames), (gap.stop - gap.start) // 3), 0] = False
    guess = true[:, _FOREARM] + correlated_noise(
        len(lost), 3 * len(_FOREARM), config.inferred_error_m, 0.5, 1 / config.frame_rate_hz, rng
    ).reshape(len(lost), len(_FOREARM), 3)
    for column, joint in enumerate(_FOREARM):
        where = lost[:, column] & (footage.state[:, joint] != JointState.NOT_TRACKED)
        footage.state[where, joint] = JointState[config.occluded_state.upper()]
        footage.position[where, joint] = guess[where, column]
    blind = hidden & (rng.uniform(size=len(hidden)) < config.shoulder_lost)
    footage.state[blind, _SHOULDER] = JointState.NOT_TRACKED


def add_false_tracks(
    footage: Footage, hidden: BoolArray, other: FloatArray, config: ArmSimulation, rng: np.random.Generator
) -> dict[str, list[tuple[float, float]]]:
    """Make some occlusions look tracked: joints that stand still, or the other arm's (F, 5, 3) m in {K}."""
    deceptions: dict[str, list[tuple[float, float]]] = {"frozen": [], "swapped": []}
    for gap in runs(hidden):
        draw = rng.uniform()
        from_to = (float(footage.t_s[gap.start]), float(footage.t_s[gap.stop - 1]))
        noise = config.noise_m * rng.normal(size=(gap.stop - gap.start, len(_FOREARM), 3))
        if draw < config.frozen_gaps:
            last = footage.position[max(gap.start - 1, 0), _FOREARM]
            footage.position[gap, _FOREARM] = last  # bit for bit the same, as trackers do
            deceptions["frozen"].append(from_to)
        elif draw < config.frozen_gaps + config.swapped_gaps:
            footage.position[gap, _FOREARM] = other[gap][:, _FOREARM] + noise
            deceptions["swapped"].append(from_to)
        else:
            continue
        seen = np.isfinite(footage.position[gap][:, _FOREARM]).all(axis=2)
        footage.state[gap, _FOREARM] = np.where(seen, JointState.TRACKED, JointState.NOT_TRACKED)
    return deceptions


#: Pixels of an image without depth, and the focal length.
WIDTH, HEIGHT, FOCAL_PX = 1280, 720, 920.0
#: How well the place of a calibrated camera is known, degrees and m per axis.
CALIBRATED_DEG, CALIBRATED_M = 0.2, 0.005


def is_rgb(config: ArmSimulation, first: bool) -> bool:
    """Whether the first camera, or the further ones, see no depth."""
    return config.rgb == "all" or config.rgb == ("first" if first else "further")


def photograph(footage: Footage, config: ArmSimulation, rng: np.random.Generator) -> None:
    """Positions become points of their rays a metre in front of the camera, with the network's pixel
    errors.
    """
    points = footage.position @ optical_axes(config.camera_frame)
    frames, joints, _ = points.shape
    sigma = config.rgb_noise_px
    slow = sigma / np.sqrt(2.0) if config.noise_correlated_m else 0.0
    noise = np.sqrt(sigma**2 - slow**2) * rng.normal(size=(frames, joints, 2))
    noise += correlated_noise(
        frames, 2 * joints, slow, config.noise_correlated_s, 1.0 / config.frame_rate_hz, rng
    ).reshape(noise.shape)
    with np.errstate(invalid="ignore", divide="ignore"):
        pixels = FOCAL_PX * points[..., :2] / points[..., 2:] + noise
        inside = (np.abs(pixels) < 0.5 * np.array([WIDTH, HEIGHT])).all(axis=2) & (points[..., 2] > 0.1)
    footage.state[~inside] = JointState.NOT_TRACKED
    forwards = np.where(np.isfinite(pixels).all(axis=2), 1.0, np.nan)
    footage.position = np.concatenate([pixels / FOCAL_PX, forwards[..., None]], axis=2)


def shoot(
    config: ArmSimulation,
    t_s: FloatArray,
    joints: dict[str, FloatArray],
    hidden: BoolArray,
    rngs: tuple[np.random.Generator, np.random.Generator, np.random.Generator],
    name: str = "simulated",
    flat: bool = False,
    other: FloatArray | None = None,
    spoil: Callable[[FloatArray], FloatArray] = lambda position: position,
) -> tuple[JointTracks, BoolArray, dict[str, Any]]:
    """What a camera states of joints, by frame (F, 3): the tracks, which frames remain (F,), what was drawn.

    `rngs` are of the noise, the gaps and the stamps; `flat`: without depth; `other`: joints (F, 5, 3) of the
    other arm, for occlusions that look tracked.
    """
    noise_rng, gap_rng, stamp_rng = rngs
    footage = film(t_s, joints)
    true = footage.position.copy()
    # without depth: the joints' constant errors alone, in space
    nothing = {"noise_m": 0.0, "noise_depth_m": 0.0, "noise_correlated_m": 0.0, "joint_slow_m": ()}
    drawn = add_noise(footage, config.model_copy(update=nothing) if flat else config, noise_rng)
    lose_forearm(footage, hidden, true, config, gap_rng)
    if other is not None:
        drawn |= add_false_tracks(footage, hidden, other, config, gap_rng)
    drawn["outliers"] = int(add_outliers(footage, config, noise_rng).sum())
    footage.position = spoil(footage.position)
    if flat:
        photograph(footage, config, noise_rng)
    tracks, delivered = deliver(footage, name, config, stamp_rng)
    if flat:
        tracks = replace(tracks, pixel_rad=1.0 / FOCAL_PX, focal_share=FOCAL_CALIBRATED)
    return tracks, delivered, drawn


#: A further camera's latency differs from the first one's by up to this, s.
LATENCY_S = 0.010
#: It is put up this far from the stated angle, degrees, and this much higher or lower, m (one sigma each).
ANGLE_DEG, HEIGHT_M = 2.0, 0.15
#: A camera that is knocked against: turned and pushed by this, degrees and m.
KNOCK_DEG, KNOCK_M = 8.0, 0.15


def add_cameras(
    config: ArmSimulation,
    motion: ArmMotion,
    hidden: BoolArray,  # bool (F,)
    hidden_t: FloatArray,  # (F,) s
    rng: np.random.Generator,
) -> tuple[tuple[Camera, ...], dict[str, Any]]:
    """The further cameras of a simulation."""
    cameras, parameters = [], {}
    # in a part of the first camera's random occlusions no camera sees the forearm
    blind = [
        (float(hidden_t[gap.start]), float(hidden_t[gap.stop - 1]))
        for gap in runs(hidden)
        if rng.spawn(1)[0].uniform() < config.camera_blind
    ]
    for number, angle_deg in enumerate(config.cameras, start=1):
        fault = config.camera_fault if number == len(config.cameras) else "none"
        camera, drawn = _further(config, number, angle_deg, fault, motion, blind, rng)
        cameras.append(camera)
        parameters[camera.name] = drawn
    return tuple(cameras), parameters


def _further(
    config: ArmSimulation,
    number: int,
    angle_deg: float,
    fault: str,
    motion: ArmMotion,
    blind: list[tuple[float, float]],
    rng: np.random.Generator,
) -> tuple[Camera, dict[str, Any]]:
    """A camera that is placed elsewhere around the person, or before another one."""
    place_rng, noise_rng, gap_rng, stamp_rng = rng.spawn(4)
    first, own = motion.stage, motion
    duration_s, origin = motion.performance.duration_s, first.origin_K
    if fault == "other_person":
        other = perform(config, place_rng.spawn(1)[0])
        knots = min(len(other.t_s), len(motion.performance.t_s))  # they may take longer, or not so long
        own = replace(
            motion,
            performance=replace(
                other, t_s=other.t_s[:knots], posture=other.posture[:knots], sway=other.sway[:knots]
            ),
            wobble=motion.wobble[:knots],
            wrist=None if motion.wrist is None else motion.wrist[:knots],
        )
        duration_s = min(duration_s, other.duration_s)
        origin = origin + first.R_K_T @ np.array([0.9, 0.0, 0.2])
    up = -unit(first.gravity)
    about = Rotation.from_rotvec(np.radians(angle_deg + ANGLE_DEG * place_rng.normal()) * up)
    tilt = tilt_rotation(place_rng.uniform(0, 5), place_rng.uniform(-np.pi, np.pi), up)
    R = (about * tilt).as_matrix()
    p = first.origin_K + about.apply(-first.origin_K) + HEIGHT_M * place_rng.normal() * up
    own = replace(own, stage=Stage(R.T @ first.R_K_T, R.T @ (origin - p)))
    times = exposures(duration_s, config.frame_rate_hz, stamp_rng)
    hidden = occlusions(own, times, config, gap_rng)
    if config.protocol == "random" and not config.still_all:
        for begin, end in blind:
            hidden |= (times >= begin) & (times <= end)

    knock, push, since_s = np.eye(3), np.zeros(3), np.inf
    if fault == "moved":
        turn = np.radians(KNOCK_DEG) * unit(place_rng.normal(size=3))
        knock, push = Rotation.from_rotvec(turn).as_matrix(), KNOCK_M * unit(place_rng.normal(size=3))
        since_s = 0.5 * duration_s

    def spoil(position: FloatArray) -> FloatArray:
        position[:, :, 0] *= -1.0 if fault == "mirrored" else 1.0
        position[times > since_s] = position[times > since_s] @ knock.T + push
        return position

    flat, name = is_rgb(config, first=False), f"camera_{number + 1}"
    latency_s = config.latency_s + place_rng.uniform(-LATENCY_S, LATENCY_S)
    settings = config.model_copy(update={"latency_s": latency_s})
    tracks, _, drawn = shoot(
        settings, times, own.joints(times), hidden, (noise_rng, gap_rng, stamp_rng), name, flat, spoil=spoil
    )
    ahead_s = number * config.camera_clock_s
    tracks = replace(tracks, t_s=tracks.t_s + ahead_s + 1e-6 * config.camera_clock_ppm * tracks.t_s)
    frame, pose = config.camera_frame, None
    if flat:
        frame, R = CameraFrame.OPTICAL, R @ optical_axes(config.camera_frame)
    if flat and config.rgb == "all":  # its place is known by a calibration, with its errors
        sigma_rad = float(np.radians(CALIBRATED_DEG))
        turned = R @ matrix_of(sigma_rad * place_rng.normal(size=3))
        pose = CameraPose(turned, p + CALIBRATED_M * place_rng.normal(size=3), sigma_rad, CALIBRATED_M)
    return Camera(name, tracks, frame, pose=pose), drawn | {
        "R_K_C": R,
        "p_K_C_m": p,
        "offset_s": config.latency_s - latency_s - ahead_s,
        "angle_deg": angle_deg,
        "blind_s": [(float(times[run.start]), float(times[run.stop - 1])) for run in runs(hidden)],
    }
