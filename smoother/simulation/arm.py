"""A simulated arm before a depth camera, with truth: `simulate_arm`."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..array_types import BoolArray, FloatArray
from ..calibration import ArmCalibration, Length, LeverArm
from ..recording import ImuStream, Recording, TrunkSensors, Truth
from .body import BodyMeasures, draw_measures
from .camera import add_noise, add_outliers, deliver, exposures, film
from .config import ArmSimulation
from .gaps import add_false_tracks, debounce, degrade_before_trunk, lose_forearm, random_gaps
from .inertial import ideal_imu, measure
from .motion import ArmMotion, MotionModel, Stage, draw_stage, draw_wobble
from .protocol import Performance, perform
from .trunk import TrunkTurn
from .trunk_imu import TrunkImuMotion, draw_trunk_axes, measure_trunk
from .upper_arm import UpperArmMotion, draw_upper_mount, measure_upper_arm

#: What the true calibration claims to be good to, m.
LEVER_ARM_SIGMA_M = 0.002
UPPER_ARM_SIGMA_M = 0.003


@dataclass(frozen=True)
class SimulatedArm:
    """A recording with everything that is known of it.

    Attributes
    ----------
    recording : Recording
        What a reader of recordings would give, with truth.
    calibration : ArmCalibration
        True lever arms and arm measures, with small sigmas (2 mm, 3 mm).
    parameters : dict
        What was drawn, by name; SI units, vectors as arrays. Among them `gravity` (3,) m/s^2 in {K},
        `clock_offset_s` (t_imu = t_camera + offset), `accelerometer_bias` and `gyroscope_bias` (3,) means,
        `..._bias_t` (N, 3), `..._matrix` (3, 3), `joint_bias` {joint: (3,)}.
    ideal_imu : ImuStream
        The IMU without its errors.
    occluded : ndarray, shape (F,)
        Frames in which the camera cannot see the forearm, whatever it states.
    motion : MotionModel
        The motion itself, for further sensors.
    upper_motion : UpperArmMotion or None
        Of the upper-arm IMU, where there is one.
    trunk_motion : TrunkImuMotion or None
        Of the trunk's IMU, where there is one.
    """

    recording: Recording
    calibration: ArmCalibration
    parameters: dict[str, Any]
    ideal_imu: ImuStream
    occluded: BoolArray
    motion: MotionModel
    upper_motion: UpperArmMotion | None = None
    trunk_motion: TrunkImuMotion | None = None


def true_motion(motion: MotionModel, t_s: FloatArray) -> Truth:
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
    body_rng, *streams = random_streams(seed)
    measures = draw_measures(body_rng)
    stage = draw_stage(config.distance_m, config.camera_frame, body_rng)
    performance = perform(config, body_rng)
    return record_arm(config, f"simulated arm, seed {seed}", measures, stage, performance, streams)


def random_streams(seed: int | list[int]) -> list[np.random.Generator]:
    """Separate streams, so that an error switched on leaves the motion and the other sensor as they were.

    Of the body, then those of `record_arm`.
    """
    return [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(8)]


def record_arm(
    config: ArmSimulation,
    name: str,
    measures: BodyMeasures,
    stage: Stage,
    performance: Performance,
    streams: list[np.random.Generator],
) -> SimulatedArm:
    """What camera and IMUs make of an arm that performs something.

    Parameters
    ----------
    config : ArmSimulation
        Sensors and errors; the protocol says where occlusions come from.
    name : str
        Of the recording.
    measures : BodyMeasures
        Of the arm.
    stage : Stage
        Where the person stands.
    performance : Performance
        What the arm does.
    streams : list of numpy.random.Generator
        Of IMU, camera noise, gaps, stamps, strap, upper-arm IMU and its tissue.

    Returns
    -------
    simulated : SimulatedArm
    """
    imu_rng, noise_rng, gap_rng, stamp_rng, wobble_rng, upper_rng, upper_wobble_rng = streams
    wobble = draw_wobble(performance, config.wobble_deg, wobble_rng)
    (trunk_rng,) = upper_rng.spawn(1)  # leaves what `upper_rng` draws as it is
    turn = TrunkTurn(performance, config.trunk_turn_deg, trunk_rng)
    motion = ArmMotion(performance, measures, stage, wobble, config.side, turn)

    ideal = ideal_imu(motion, performance.duration_s, config.imu_rate_hz, stage.gravity)
    imu, parameters = measure(ideal, config, imu_rng)
    upper_motion, upper_imu = None, None
    if "upper-arm" in config.imus:
        upper_wobble = draw_wobble(performance, config.upper_wobble_deg, upper_wobble_rng)
        mount = draw_upper_mount(measures, config.side, upper_rng)
        upper_motion = UpperArmMotion(motion, mount, performance.t_s, upper_wobble)
        upper_imu, upper_parameters = measure_upper_arm(
            upper_motion, performance.duration_s, stage.gravity, config, upper_rng
        )
        parameters |= upper_parameters

    times = exposures(performance.duration_s, config.frame_rate_hz, stamp_rng)
    strap = {"strap": motion.imu_pose(times)[1]} if config.strap else {}
    footage = film(times, motion.joints(times) | strap)
    true = footage.position.copy()
    parameters |= add_noise(footage, config, noise_rng)
    if config.protocol == "random" and not config.still_all:
        hidden = random_gaps(
            times, config.occlusion_lengths_s, config.occlusion_every_s, config.still_start_s, gap_rng
        )
        hidden |= times >= performance.duration_s - config.end_gap_s
    else:
        hidden = debounce(motion.hidden(times), config.frame_rate_hz)
    before_belly = np.zeros(len(times), dtype=bool)
    for begin, end in performance.belly_s:
        before_belly |= (times >= begin) & (times < end) & ~hidden
    degrade_before_trunk(footage, before_belly, true, config, gap_rng)
    lose_forearm(footage, hidden, true, config, gap_rng)
    parameters |= add_false_tracks(
        footage, hidden, film(times, motion.other_arm(times)).position, config, gap_rng
    )
    parameters["outliers"] = int(add_outliers(footage, config, noise_rng).sum())
    same_stamps = deepcopy(stamp_rng)
    tracks, delivered = deliver(footage, "simulated", config, stamp_rng)
    trunk_motion, trunk = None, None
    if "trunk" in config.imus:
        trunk_motion = TrunkImuMotion(stage.R_K_T, stage.origin_K, turn, draw_trunk_axes(trunk_rng))
        trunk_imu, trunk_parameters = measure_trunk(
            trunk_motion, performance.duration_s, stage.gravity, config, trunk_rng
        )
        parameters |= trunk_parameters
        other = film(times, {"shoulder": motion.other_arm(times)["shoulder"]})
        add_noise(other, config, trunk_rng)
        trunk = TrunkSensors(trunk_imu, deliver(other, "simulated", config, same_stamps)[0])

    lever_arms = {
        joint: LeverArm(measures.lever_arm(joint), np.full(3, LEVER_ARM_SIGMA_M))
        for joint in ("elbow", "wrist", "hand")
    }
    calibration = ArmCalibration(
        side=config.side,
        lever_arms=lever_arms,
        upper_arm=Length(measures.upper_arm, UPPER_ARM_SIGMA_M),
        R_F_A=measures.R_F_A,
        upper_imu={}
        if upper_motion is None
        else {
            joint: LeverArm(position, np.full(3, LEVER_ARM_SIGMA_M))
            for joint, position in upper_motion.mount.levers(measures.upper_arm).items()
        },
        R_U_B=None if upper_motion is None else upper_motion.mount.R_U_B,
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
        upper_imu=upper_imu,
        trunk=trunk,
    )
    return SimulatedArm(
        recording, calibration, parameters, ideal, hidden[delivered], motion, upper_motion, trunk_motion
    )
