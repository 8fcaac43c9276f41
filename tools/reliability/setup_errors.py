"""Wrong set-ups, which `python -m tools.accuracy oracle --only "set-up errors"` counts.

Each case is a mistake that people make with sensors, axes, clocks, units or names, put into a simulated
recording; which case, recording, preset and length is drawn from the seed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from smoother.array_types import BoolArray, FloatArray
from smoother.calibration import ArmCalibration
from smoother.linalg import interpolate, unit
from smoother.recording import JOINTS, CameraFrame, JointState, Recording, Truth
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm
from smoother.simulation.arm import true_motion
from smoother.simulation.camera import add_noise, film
from smoother.simulation.inertial import ideal_imu, measure
from smoother.simulation.people import on_upper_arm
from tools.accuracy.check import PRESETS


@dataclass(frozen=True)
class Setup:
    """What is smoothed, and what it is made of."""

    simulated: SimulatedArm  # Where the skeleton comes from; gives what the camera could not see
    config: ArmSimulation  # What was simulated
    rng: np.random.Generator  # Of the mistake's draws
    recording: Recording  # Its truth is the IMU's motion in the coordinates that the camera gives
    calibration: ArmCalibration | None = None  # Given to `smooth`

    def with_imu(self, **changes: Any) -> Setup:
        """The set-up with other samples of the IMU."""
        return self.with_recording(imu=replace(self.recording.imu, **changes))

    def with_arm(self, **changes: Any) -> Setup:
        """The set-up with another skeleton."""
        return self.with_recording(arm=replace(self.recording.arm, **changes))

    def with_recording(self, **changes: Any) -> Setup:
        """The set-up with another recording."""
        return replace(self, recording=replace(self.recording, **changes))

    @property
    def truth(self) -> Truth:
        """Of the recording."""
        assert self.recording.truth is not None
        return self.recording.truth

    def another(self) -> SimulatedArm:
        """Another person before another camera, as long and with the same errors."""
        return simulate_arm(self.config, int(self.rng.integers(2**31)))


def sound(setup: Setup) -> Setup:
    """No mistake."""
    return setup


def mirrored_skeleton(setup: Setup) -> Setup:
    """One of the camera's axes, most often left and right, points the other way."""
    mirror = np.ones(3)
    mirror[setup.rng.choice(3, p=[0.5, 0.25, 0.25])] = -1.0
    position = setup.truth.position * mirror
    setup = setup.with_recording(truth=replace(setup.truth, position=position, joints={}))
    return setup.with_arm(position=setup.recording.arm.position * mirror)


def accelerometer_sign(setup: Setup) -> Setup:
    """Acceleration with gravity instead of specific force."""
    return setup.with_imu(acc=-setup.recording.imu.acc)


def gyroscope_sign(setup: Setup) -> Setup:
    """Turns counted the other way round."""
    return setup.with_imu(gyro=-setup.recording.imu.gyro)


def left_handed_axes(setup: Setup) -> Setup:
    """One axis of the IMU points the other way in both sensors."""
    flip = np.ones(3)
    flip[setup.rng.integers(3)] = -1.0
    return setup.with_imu(acc=setup.recording.imu.acc * flip, gyro=setup.recording.imu.gyro * flip)


def elbow_and_wrist_swapped(setup: Setup) -> Setup:
    """The names of two joints exchanged."""
    order = [JOINTS.index(joint) for joint in ("shoulder", "wrist", "elbow", "hand", "strap")]
    arm = setup.recording.arm
    return setup.with_arm(position=arm.position[:, order], state=arm.state[:, order])


def hand_given_as_wrist(setup: Setup) -> Setup:
    """The hand's column read as the wrist's, and no hand."""
    order = [JOINTS.index(joint) for joint in ("shoulder", "elbow", "hand", "strap", "strap")]
    arm = setup.recording.arm
    return setup.with_arm(position=arm.position[:, order], state=arm.state[:, order])


def joints_of_the_other_arm(setup: Setup) -> Setup:
    """The camera's left arm with the right arm's IMU."""
    arm, motion = setup.recording.arm, setup.simulated.motion
    t_s = arm.t_s + setup.simulated.parameters["clock_offset_s"]
    footage = film(t_s, motion.other_arm(t_s))
    add_noise(footage, setup.config, setup.rng)
    seen = arm.state[:, :, None] != JointState.NOT_TRACKED
    return setup.with_arm(position=np.where(seen, footage.position, np.nan))


def skeleton_of_another_recording(setup: Setup) -> Setup:
    """Files mixed up: the IMU of one recording, the skeleton (and where the arm truly was) of another."""
    other = setup.another()
    setup = replace(setup, simulated=other)
    return setup.with_recording(arm=other.recording.arm, truth=other.recording.truth)


def sensor_on_the_upper_arm(setup: Setup) -> Setup:
    """The IMU strapped above the elbow."""
    made, config = setup.simulated, setup.config
    imu_pose = on_upper_arm(made.motion, 0.0, setup.rng)
    ideal = ideal_imu(imu_pose, config.duration_s, config.imu_rate_hz, made.parameters["gravity"])
    imu, _ = measure(ideal, config, setup.rng)
    R, position = imu_pose(imu.t_s)
    quaternion = Rotation.from_matrix(R).as_quat(scalar_first=True)
    truth = replace(true_motion(made.motion, imu.t_s), position=position, quaternion=quaternion)
    return setup.with_recording(imu=imu, truth=truth)


def clocks_apart(setup: Setup) -> Setup:
    """The camera's stamps off by half a second to one and a half."""
    shift_s = setup.rng.choice([-1.0, 1.0]) * setup.rng.uniform(0.5, 1.5)
    return setup.with_arm(t_s=setup.recording.arm.t_s + shift_s)


def imu_at_10_hz(setup: Setup) -> Setup:
    """Every eighth sample of an IMU at 80 Hz."""
    imu = setup.recording.imu
    return setup.with_recording(imu=imu.select(slice(None, None, round(imu.rate_hz / 10.0))))


def clipped_sensor(setup: Setup) -> Setup:
    """The accelerometer or the gyroscope saturates at 40 to 70 % of what the motion needs."""
    sensor = str(setup.rng.choice(["acc", "gyro"]))
    values = getattr(setup.recording.imu, sensor)
    limit = setup.rng.uniform(0.4, 0.7) * np.abs(values).max()
    return setup.with_imu(**{sensor: np.clip(values, -limit, limit)})


def strap_turned_half_way(setup: Setup) -> Setup:
    """The strap slips round the forearm by 15 degrees."""
    imu, truth, R_F_A = setup.recording.imu, setup.truth, setup.simulated.calibration.R_F_A
    assert R_F_A is not None
    turn = Rotation.from_rotvec(setup.rng.choice([-15.0, 15.0]) * R_F_A[1], degrees=True)
    late = _late(imu.t_s)
    acc, gyro, quaternion = imu.acc.copy(), imu.gyro.copy(), truth.quaternion.copy()
    acc[late], gyro[late] = turn.inv().apply(acc[late]), turn.inv().apply(gyro[late])
    R_K_A = Rotation.from_quat(quaternion[late], scalar_first=True)
    quaternion[late] = (R_K_A * turn).as_quat(scalar_first=True)
    return setup.with_imu(acc=acc, gyro=gyro).with_recording(truth=replace(truth, quaternion=quaternion))


def camera_bumped_half_way(setup: Setup) -> Setup:
    """Somebody turns the camera by 5 degrees; the truth is what the camera then calls it."""
    arm, truth = setup.recording.arm, setup.truth
    turn = Rotation.from_rotvec(5.0 * unit(setup.rng.normal(size=3)), degrees=True)
    late, seen, true = _late(arm.t_s), arm.position.copy(), truth.position.copy()
    seen[late] = seen[late] @ turn.as_matrix().T
    quaternion, late = truth.quaternion.copy(), _late(truth.t_s)
    true[late] = turn.apply(true[late])
    R_K_A = Rotation.from_quat(quaternion[late], scalar_first=True)
    quaternion[late] = (turn * R_K_A).as_quat(scalar_first=True)
    bumped = replace(truth, position=true, quaternion=quaternion, joints={})
    return setup.with_arm(position=seen).with_recording(truth=bumped)


def _late(t_s: FloatArray) -> BoolArray:
    """(N,) the second half."""
    return np.asarray(t_s > 0.5 * (t_s[0] + t_s[-1]))


def skeleton_interpolated(setup: Setup) -> Setup:
    """A straight line through every gap, called tracked."""
    arm = setup.recording.arm
    position, state = arm.position.copy(), arm.state.copy()
    for joint in arm.present:
        tracked, column = arm.tracked(joint), JOINTS.index(joint)
        position[:, column] = interpolate(arm.t_s[tracked], position[tracked, column], arm.t_s)
        state[:, column] = JointState.TRACKED
    return setup.with_arm(position=position, state=state)


def imu_zero_for_a_second(setup: Setup) -> Setup:
    """A reader that fills what was lost with zeros."""
    t_s = setup.recording.imu.t_s
    start_s = setup.rng.uniform(t_s[0], t_s[-1] - 1.0)
    lost = ((t_s >= start_s) & (t_s < start_s + 1.0))[:, None]
    imu = setup.recording.imu
    return setup.with_imu(acc=np.where(lost, 0.0, imu.acc), gyro=np.where(lost, 0.0, imu.gyro))


def one_wild_gyroscope_sample(setup: Setup) -> Setup:
    """34 rad/s in one sample of one axis: a bit that fell over."""
    gyro = setup.recording.imu.gyro.copy()
    gyro[setup.rng.integers(len(gyro)), setup.rng.integers(3)] = 34.0
    return setup.with_imu(gyro=gyro)


def frames_far_away(setup: Setup) -> Setup:
    """4 % of the frames contain 1e6 m, a mark of missing values that was left in."""
    position = setup.recording.arm.position.copy()
    position[setup.rng.uniform(size=len(position)) < 0.04] = 1e6
    return setup.with_arm(position=position)


def radians_called_degrees(setup: Setup) -> Setup:
    """Angular velocity converted that was in rad/s already."""
    return setup.with_imu(gyro=np.radians(setup.recording.imu.gyro))


def metres_called_millimetres(setup: Setup) -> Setup:
    """Positions divided by 1000 that were in metres already; the truth stays in metres."""
    return setup.with_arm(position=setup.recording.arm.position / 1000.0)


def wrong_camera_frame(setup: Setup) -> Setup:
    """The name of another convention of the camera's axes."""
    others = [frame for frame in CameraFrame if frame is not setup.recording.camera_frame]
    return setup.with_recording(camera_frame=others[setup.rng.integers(len(others))])


def calibration_of_another_mounting(setup: Setup) -> Setup:
    """The calibration of another person's strap."""
    return replace(setup, calibration=setup.another().calibration)


CASES: tuple[Callable[[Setup], Setup], ...] = (
    mirrored_skeleton,
    accelerometer_sign,
    gyroscope_sign,
    left_handed_axes,
    elbow_and_wrist_swapped,
    hand_given_as_wrist,
    joints_of_the_other_arm,
    skeleton_of_another_recording,
    sensor_on_the_upper_arm,
    clocks_apart,
    imu_at_10_hz,
    clipped_sensor,
    strap_turned_half_way,
    camera_bumped_half_way,
    skeleton_interpolated,
    imu_zero_for_a_second,
    one_wild_gyroscope_sample,
    frames_far_away,
    radians_called_degrees,
    metres_called_millimetres,
    wrong_camera_frame,
    calibration_of_another_mounting,
)

LENGTHS_S = (24.0, 60.0)
#: An answer that is off by more than this in the gaps must not be called trusted, m.
LARGEST_ERROR_M = 0.10


@dataclass(frozen=True)
class Job:
    """One recording to draw."""

    case: Callable[[Setup], Setup]  # The mistake
    seed: int  # Of the recording and of the mistake's draws
    preset: str
    duration_s: float

    def setup(self) -> Setup:
        """The recording with its mistake."""
        config = ArmSimulation.preset(self.preset, protocol="random", duration_s=self.duration_s)
        simulated, rng = simulate_arm(config, self.seed), np.random.default_rng(self.seed)
        return self.case(Setup(simulated, config, rng, simulated.recording))


def draw(count: int, seed: int, cases: tuple[Callable[[Setup], Setup], ...] = CASES) -> list[Job]:
    """As many jobs, the cases in turn; the first ones do not depend on how many follow."""
    rng = np.random.default_rng([seed, int(cases == (sound,))])
    return [
        Job(
            cases[number % len(cases)],
            int(rng.integers(2**31)),
            str(rng.choice(PRESETS)),
            round(float(rng.uniform(*LENGTHS_S)), 1),
        )
        for number in range(count)
    ]
