"""Further depth cameras round a simulated person: each with its own place, clock, noise and occlusions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..linalg import runs, unit
from ..recording import Camera, CameraFrame
from .body import BodyMeasures
from .camera import (
    add_noise,
    add_outliers,
    calibrated,
    debounce,
    deliver,
    depth_free,
    exposures,
    film,
    is_rgb,
    lose_forearm,
    optical_from,
    photograph,
    random_gaps,
    with_pixels,
)
from .config import ArmSimulation
from .motion import ArmMotion, Stage, TrunkTurn, tilt_rotation
from .protocol import Performance, perform

#: A further camera's latency differs from the first one's by up to this, s.
LATENCY_S = 0.010
#: It is put up this far from the stated angle, degrees, and this much higher or lower, m (one sigma each).
ANGLE_DEG, HEIGHT_M = 2.0, 0.15
#: A camera that is knocked against: turned and pushed by this, degrees and m.
KNOCK_DEG, KNOCK_M = 8.0, 0.15


@dataclass(frozen=True)
class FilmedScene:
    """What all cameras see: the person's motion and where the first camera stands."""

    performance: Performance
    measures: BodyMeasures
    stage: Stage  # Before the first camera
    wobble: FloatArray  # Of the strap, see `draw_wobble`
    turn: TrunkTurn
    wrist: FloatArray  # The wrist's angles

    def motion(self, stage: Stage, side: str) -> ArmMotion:
        """The same motion before another camera."""
        return ArmMotion(self.performance, self.measures, stage, self.wobble, side, self.turn, self.wrist)


def stage_at(
    stage: Stage, angle_deg: float, rng: np.random.Generator
) -> tuple[Stage, FloatArray, FloatArray]:  # stage, R_K_C (3, 3), p_K_C_m (3,) m
    """The person as seen by a camera placed elsewhere around them."""
    up = -unit(stage.gravity)
    about = Rotation.from_rotvec(np.radians(angle_deg + ANGLE_DEG * rng.normal()) * up)
    tilt = tilt_rotation(rng.uniform(0, 5), rng.uniform(-np.pi, np.pi), up)
    R = (about * tilt).as_matrix()
    p = stage.origin_K + about.apply(-stage.origin_K) + HEIGHT_M * rng.normal() * up
    return Stage(R.T @ stage.R_K_T, R.T @ (stage.origin_K - p)), R, p


def add_cameras(
    config: ArmSimulation,
    scene: FilmedScene,
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
    for number, angle_deg in enumerate(config.cameras, start=2):
        fault = config.camera_fault if number == len(config.cameras) + 1 else "none"
        camera, drawn = _further(config, f"camera_{number}", number - 1, angle_deg, fault, scene, blind, rng)
        cameras.append(camera)
        parameters[camera.name] = drawn
    return tuple(cameras), parameters


def _further(
    config: ArmSimulation,
    name: str,
    number: int,
    angle_deg: float,
    fault: str,
    scene: FilmedScene,
    blind: list[tuple[float, float]],
    rng: np.random.Generator,
) -> tuple[Camera, dict[str, Any]]:
    place_rng, noise_rng, gap_rng, stamp_rng = rng.spawn(4)
    if fault == "other_person":
        other = perform(config, place_rng.spawn(1)[0])
        aside = scene.stage.R_K_T @ np.array([0.9, 0.0, 0.2])
        own = replace(
            scene, performance=other, stage=replace(scene.stage, origin_K=scene.stage.origin_K + aside)
        )
    else:
        own = scene
    stage, R, p = stage_at(scene.stage, angle_deg, place_rng)
    if fault == "other_person":
        stage = replace(stage, origin_K=R.T @ (own.stage.origin_K - p))
    motion = own.motion(stage, config.side)
    duration_s = scene.performance.duration_s
    times = exposures(duration_s, config.frame_rate_hz, stamp_rng)
    footage = film(times, motion.joints(times))
    true = footage.position.copy()
    flat = is_rgb(config, first=False)
    drawn = add_noise(footage, depth_free(config) if flat else config, noise_rng)
    if config.protocol == "random" and not config.still_all:
        hidden = random_gaps(
            times, config.occlusion_lengths_s, config.occlusion_every_s, config.still_start_s, gap_rng
        )
        for begin, end in blind:
            hidden |= (times >= begin) & (times <= end)
    else:
        hidden = debounce(motion.hidden(times), config.frame_rate_hz)
    lose_forearm(footage, hidden, true, config, gap_rng)
    add_outliers(footage, config, noise_rng)
    if fault == "mirrored":
        footage.position[:, :, 0] *= -1.0
    elif fault == "moved":
        later = times > 0.5 * duration_s
        knock = Rotation.from_rotvec(np.radians(KNOCK_DEG) * unit(place_rng.normal(size=3)))
        push = KNOCK_M * unit(place_rng.normal(size=3))
        footage.position[later] = footage.position[later] @ knock.as_matrix().T + push
    if flat:
        photograph(footage, config, noise_rng)
        R = R @ optical_from(config.camera_frame).T
    latency_s = config.latency_s + place_rng.uniform(-LATENCY_S, LATENCY_S)
    ahead_s = number * config.camera_clock_s
    tracks, _ = deliver(footage, name, config.model_copy(update={"latency_s": latency_s}), stamp_rng)
    tracks = replace(tracks, t_s=tracks.t_s + ahead_s + 1e-6 * config.camera_clock_ppm * tracks.t_s)
    frame, pose = config.camera_frame, None
    if flat:
        tracks, frame = with_pixels(tracks), CameraFrame.OPTICAL
        pose = calibrated(R, p, place_rng) if config.rgb == "all" else None
    return Camera(name, tracks, frame, pose=pose), drawn | {
        "R_K_C": R,
        "p_K_C_m": p,
        "offset_s": config.latency_s - latency_s - ahead_s,
        "angle_deg": angle_deg,
        "blind_s": _spans(times, hidden),
    }


def _spans(t: FloatArray, mask: BoolArray) -> list[tuple[float, float]]:
    return [(float(t[run.start]), float(t[run.stop - 1])) for run in runs(mask)]
