"""A tracked point (the strap alone) that carries an IMU, simulated in a frame with z up."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration
from smoother.recording import CameraFrame, JointState, Recording
from smoother.simulation.arm import SimulatedArm, true_motion
from smoother.simulation.camera import add_noise, add_outliers, deliver, exposures, film, random_gaps
from smoother.simulation.config import SensorErrors, setting, size
from smoother.simulation.inertial import ideal_imu, measure
from smoother.simulation.motion import PAD_S, knot_times, tilt_rotation, wander
from smoother.units import GRAVITY


class PointSimulation(SensorErrors):
    """A tracked point (the strap alone) that carries an IMU, in a frame with z up."""

    duration_s: float = setting(30.0, "length, s", gt=1)
    speed: float = setting(1.0, "factor on the speed of the movement", gt=0.1, le=3)
    tilt_deg: float = size(0.0, "gravity off -z by this angle, degrees", le=45)
    occlusion_lengths_s: tuple[float, ...] = setting(
        (0.5, 1.0, 2.0, 3.0), "lengths to choose from, s; empty = no occlusion"
    )
    occlusion_every_s: float = setting(6.0, "about one occlusion in this time, s", gt=0)


class PointMotion:
    """A body that moves and turns about at random, its IMU being the tracked point."""

    def __init__(self, duration_s: float, speed: float, rng: np.random.Generator) -> None:
        count = int(np.ceil((duration_s + 2 * PAD_S) / 0.4 * speed)) + 3
        times = np.cumsum(rng.uniform(0.4, 0.9, count)) / speed
        times -= times[0] + PAD_S
        # Positions in a box of 0.5 m about a metre over the floor, rotations within about 100 degrees.
        points = np.hstack([rng.uniform(-0.25, 0.25, (count, 3)), rng.normal(0, 0.6, (count, 3))])
        used = int(np.searchsorted(times, duration_s + PAD_S)) + 1
        t_s = knot_times(duration_s)
        table = wander(times[:used], points[:used])(t_s)
        table[:, :3] += [0.0, 0.0, 1.0]
        self._start = Rotation.from_quat(rng.normal(size=4))
        self._spline: BSpline = make_interp_spline(t_s, table, k=5)

    def imu_pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `ArmMotion.imu_pose`."""
        table = self._spline(t_s)
        return (self._start * Rotation.from_rotvec(table[:, 3:])).as_matrix(), table[:, :3]

    def joints(self, t_s: FloatArray) -> dict[str, FloatArray]:
        """See `ArmMotion.joints`."""
        return {"strap": self._spline(t_s)[:, :3]}


def simulate_point(config: PointSimulation | None = None, seed: int = 0) -> SimulatedArm:
    """Simulate a tracked point with an IMU in it, in a frame with z up; `strap` is the only joint."""
    config = config or PointSimulation()
    body_rng, imu_rng, noise_rng, gap_rng, stamp_rng = (
        np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(5)
    )
    motion = PointMotion(config.duration_s, config.speed, body_rng)
    tilt = tilt_rotation(config.tilt_deg, body_rng.uniform(-np.pi, np.pi), np.array([0.0, 0.0, 1.0]))
    gravity = tilt.apply([0.0, 0.0, -GRAVITY])

    ideal = ideal_imu(motion.imu_pose, config.duration_s, config.imu_rate_hz, gravity)
    imu, parameters = measure(ideal, config, imu_rng)
    times = exposures(config.duration_s, config.frame_rate_hz, stamp_rng)
    footage = film(times, motion.joints(times))
    parameters |= add_noise(footage, config, noise_rng)
    hidden = random_gaps(times, config.occlusion_lengths_s, config.occlusion_every_s, 0.0, gap_rng)
    footage.state[hidden] = JointState.NOT_TRACKED
    parameters["outliers"] = int(add_outliers(footage, config, noise_rng).sum())
    tracks, delivered = deliver(footage, "simulated", config, stamp_rng)
    parameters |= {"gravity": gravity, "clock_offset_s": -config.latency_s}
    recording = Recording(
        imu=imu,
        arm=tracks,
        camera_frame=CameraFrame.ZUP,
        truth=true_motion(motion, imu.t_s),
        name=f"simulated point, seed {seed}",
    )
    return SimulatedArm(recording, ArmCalibration(), parameters, ideal, hidden[delivered], motion)
