"""A simulated arm, both arms of a person, or a point, before a depth camera, with truth."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..body import SEGMENTS
from ..calibration import ArmCalibration, Length, LeverArm, SegmentMounting
from ..recording import Camera, CameraFrame, ImuStream, Recording, TrunkSensors, Truth
from .camera import add_cameras, add_noise, deliver, exposures, film, is_rgb, occlusions, shoot
from .config import ArmSimulation
from .inertial import (
    Mount,
    Pose,
    SegmentImuMotion,
    TrunkImuMotion,
    draw_hand_mount,
    draw_trunk_axes,
    draw_upper_mount,
    ideal_imu,
    measure,
)
from .motion import (
    ArmMotion,
    BodyMeasures,
    Performance,
    Stage,
    TrunkTurn,
    draw_measures,
    draw_stage,
    draw_wobble,
    perform,
    wrist_angles,
)
from .people import mounted_anew, varied

#: What the true calibration claims to be good to, m.
LEVER_ARM_SIGMA_M = 0.002
UPPER_ARM_SIGMA_M = 0.003


@dataclass(frozen=True)
class SimulatedArm:
    """A recording with everything that is known of it."""

    recording: Recording  # What a reader of recordings would give, with truth
    calibration: ArmCalibration  # True lever arms and arm measures, with small sigmas (2 mm, 3 mm)
    parameters: dict[str, Any]  # What was drawn, by name; SI units, vectors as arrays
    ideal_imu: ImuStream  # The IMU without its errors
    occluded: BoolArray  # (F,): frames in which the camera cannot see the forearm, whatever it states
    motion: ArmMotion  # The motion itself, for further sensors
    # Of the IMUs on further segments, by the segment's name
    further_motions: dict[str, SegmentImuMotion] = field(default_factory=dict)
    trunk_motion: TrunkImuMotion | None = None  # Of the trunk's IMU, where there is one


def given(positions: dict[str, FloatArray]) -> dict[str, LeverArm]:
    """Lever arms as somebody would measure them, by joint."""
    return {joint: LeverArm(at, np.full(3, LEVER_ARM_SIGMA_M)) for joint, at in positions.items()}


def true_motion(motion: ArmMotion, t_s: FloatArray) -> Truth:
    """The motion at the given times (N,) as a reference to score against."""
    R, position = motion.imu_pose(t_s)
    quaternion = Rotation.from_matrix(R).as_quat(scalar_first=True)
    # One sign all along, so that a plot shows no jumps.
    turn = np.where((quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0, -1.0, 1.0)
    quaternion[1:] *= np.cumprod(turn)[:, None]
    return Truth(t_s, position, quaternion, np.ones(len(t_s), dtype=bool), motion.joints(t_s))


def simulate_arm(config: ArmSimulation | None = None, seed: int = 0) -> SimulatedArm:
    """Simulate an arm with an IMU on its wrist before a depth camera.

    The IMU's clock is the true time; the camera's stamps are late by `config.latency_s` (offset =
    -latency_s). The seed decides the person, the movements, the mounting and all noise: the same seed and
    configuration give the same recording, bit for bit; a seed moves in the same way whatever the errors.

    Parameters
    ----------
    config : ArmSimulation, optional
        What to simulate; None for the defaults (preset `white`).
    seed : int
        Non-negative.

    Returns
    -------
    simulated : SimulatedArm
    """
    config = config or ArmSimulation()
    if is_rgb(config, first=True):  # results are in the first camera's frame
        config = config.model_copy(update={"camera_frame": CameraFrame.OPTICAL})
    return record_arm(config, f"simulated arm, seed {seed}", *draw_person(config, seed))


def draw_person(
    config: ArmSimulation, seed: int
) -> tuple[BodyMeasures, Stage, Performance, list[np.random.Generator]]:
    """Who moves how before the camera, and the streams of `record_arm`."""
    body_rng, *streams = random_streams(seed)
    measures = draw_measures(body_rng)
    stage = draw_stage(config.distance_m, config.camera_frame, body_rng)
    return measures, stage, perform(config, body_rng), streams


def random_streams(seed: int | list[int]) -> list[np.random.Generator]:
    """Separate streams, so that an error switched on leaves the motion and the other sensor as they were."""
    return [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(8)]


def record_arm(
    config: ArmSimulation,
    name: str,
    measures: BodyMeasures,
    stage: Stage,
    performance: Performance,
    streams: list[np.random.Generator],
) -> SimulatedArm:
    """What camera and IMUs make of an arm that performs something."""
    imu_rng, noise_rng, gap_rng, stamp_rng, wobble_rng, upper_rng, upper_wobble_rng = streams
    wobble = draw_wobble(performance, config.wobble_deg, wobble_rng)
    trunk_rng, hand_rng = upper_rng.spawn(2)  # leaves what `upper_rng` draws as it is
    turn = TrunkTurn(performance, config.trunk_turn_deg, trunk_rng)
    wrist = wrist_angles(performance, config.wrist_deg, hand_rng)
    motion = ArmMotion(performance, measures, stage, wobble, config.side, turn, wrist)

    ideal = ideal_imu(motion.imu_pose, performance.duration_s, config.imu_rate_hz, stage.gravity)
    imu, parameters = measure(ideal, config, imu_rng)
    motions: dict[str, SegmentImuMotion] = {}
    further: dict[str, ImuStream] = {}
    mountings: dict[str, SegmentMounting] = {}

    def worn(name: str, prefix: str, imu_pose: Pose, rng: np.random.Generator) -> ImuStream:
        """A further IMU's samples on its own clock; what was drawn has names that begin with the prefix."""
        exact = ideal_imu(imu_pose, performance.duration_s, config.imu_rate_hz, stage.gravity)
        measured, drawn = measure(exact, config, rng)
        ahead_s = getattr(config, f"{prefix}_clock_s")
        rate = 1.0 + 1e-6 * getattr(config, f"{prefix}_clock_ppm", 0.0)
        parameters.update({f"{prefix}_imu_{key}": value for key, value in drawn.items()})
        parameters[f"{prefix}_clock_s"] = ahead_s
        return replace(measured, name=name, t_s=ahead_s + rate * measured.t_s)

    def wear(segment: str, bone: Pose, mount: Mount, wobble: FloatArray, rng: np.random.Generator) -> None:
        own = SegmentImuMotion(bone, mount, make_interp_spline(performance.t_s, wobble, k=5))
        name, prefix = f"/imu/{segment}_{config.side}", SEGMENTS[segment].prefix
        motions[segment], further[segment] = own, worn(name, prefix, own.imu_pose, rng)

    if "upper-arm" in config.imus:
        upper_wobble = draw_wobble(performance, config.upper_wobble_deg, upper_wobble_rng)
        mount = draw_upper_mount(measures, upper_rng)
        wear("upper_arm", motion.upper_arm, mount, upper_wobble, upper_rng)
        levers = motions["upper_arm"].levers({"elbow": 0.0, "shoulder": -measures.upper_arm})
        # to axes with y towards the shoulder, z to the lateral epicondyle
        lateral = -1.0 if config.side == "left" else 1.0
        R_U_B = np.asarray(np.diag([-lateral, -1.0, lateral]) @ mount[1])
        mountings["upper_arm"] = SegmentMounting(given(levers), R_bone=R_U_B)
    if "hand" in config.imus:
        hand_wobble = draw_wobble(performance, 0.5 * config.wobble_deg, hand_rng)
        wear("hand", motion.hand, draw_hand_mount(measures, hand_rng), hand_wobble, hand_rng)
        levers = motions["hand"].levers({"wrist": 0.0, "hand": measures.hand})
        mountings["hand"] = SegmentMounting(given(levers))

    times = exposures(performance.duration_s, config.frame_rate_hz, stamp_rng)
    hidden = occlusions(motion, times, config, gap_rng)
    if config.protocol == "random" and not config.still_all:
        hidden |= times >= performance.duration_s - config.end_gap_s
    same_stamps = deepcopy(stamp_rng)
    tracks, delivered, drawn = shoot(
        config,
        times,
        motion.joints(times) | ({"strap": motion.imu_pose(times)[1]} if config.strap else {}),
        hidden,
        (noise_rng, gap_rng, stamp_rng),
        flat=is_rgb(config, first=True),
        other=film(times, motion.other_arm(times)).position,
    )
    parameters |= drawn
    trunk_motion, trunk = None, None
    if "trunk" in config.imus:
        trunk_motion = TrunkImuMotion(stage.R_K_T, stage.origin_K, turn, draw_trunk_axes(trunk_rng))
        trunk_imu = worn("/imu/trunk", "trunk", trunk_motion.imu_pose, trunk_rng)
        other = film(times, {"shoulder": motion.other_arm(times)["shoulder"]})
        add_noise(other, config, trunk_rng)
        trunk = TrunkSensors(trunk_imu, deliver(other, "simulated", config, same_stamps)[0])

    cameras: tuple[Camera, ...] = ()
    if config.cameras:
        cameras, of_cameras = add_cameras(config, motion, hidden, times, gap_rng.spawn(1)[0])
        parameters["cameras"] = of_cameras

    on_forearm = ("elbow", "wrist") if "hand" in further else ("elbow", "wrist", "hand")
    lever_arms = given({joint: measures.lever_arm(joint) for joint in on_forearm})
    calibration = ArmCalibration(
        side=config.side,
        lever_arms=lever_arms,
        upper_arm=Length(measures.upper_arm, UPPER_ARM_SIGMA_M),
        R_F_A=measures.R_F_A,
        mountings=mountings,
    )
    parameters |= {
        "gravity": stage.gravity,
        "clock_offset_s": -config.latency_s,
        "upper_arm_m": measures.upper_arm,
        "forearm_m": measures.forearm,
        "hand_m": measures.hand,
        "strap_to_wrist_m": measures.strap_to_wrist,
    }
    recording = Recording(
        imu=imu,
        arm=tracks,
        side=config.side,
        camera_frame=config.camera_frame,
        truth=true_motion(motion, imu.t_s),
        name=name,
        further_imus=further,
        trunk=trunk,
        cameras=cameras,
    )
    return SimulatedArm(
        recording, calibration, parameters, ideal, hidden[delivered], motion, motions, trunk_motion
    )


def simulate_both_arms(
    config: ArmSimulation | None = None, seed: int = 0
) -> tuple[SimulatedArm, SimulatedArm]:
    """Simulate an arm as `simulate_arm` does, and the same person's other arm beside it."""
    config = config or ArmSimulation()
    first = simulate_arm(config, seed)
    other_config = config.model_copy(update={"side": "left" if config.side == "right" else "right"})
    # what both share is drawn again from the first arm's streams: the person, the camera, its frames
    measures, stage, performance, streams_of_first = draw_person(config, seed)
    own_rng, *streams = random_streams([seed, 1])
    streams[3] = streams_of_first[3]  # one camera: the same frames
    if config.protocol == "random" and not config.still_all:
        own = perform(other_config, own_rng)
        posture = own.posture[: len(performance.posture)]
    else:
        posture = performance.posture
        if config.protocol == "behind":
            posture = varied(posture, performance.t_s, own_rng)
    performance = replace(performance, posture=posture, sway=performance.sway * np.array([-1.0, 1.0, 1.0]))
    other = record_arm(
        other_config,
        first.recording.name,
        mounted_anew(measures, own_rng),
        stage,
        performance,
        streams,
    )
    return _named(first), _named(other)


def _named(arm: SimulatedArm) -> SimulatedArm:
    """Its IMU named after its side."""
    recording = arm.recording
    imu = replace(recording.imu, name=f"/imu/forearm_{recording.side}")
    return replace(arm, recording=replace(recording, imu=imu))
