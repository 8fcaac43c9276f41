"""The method on one page: `smooth(recording, calibration, config) -> Recovery`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .assemble import assemble
from .calibration import ArmCalibration, Length
from .config import Config
from .errors import CalibrationError, SolveError
from .firstpass import tell
from .join import join
from .occlusion import accepted_samples, visible_frames
from .plan import Stretch, cut, cut_times
from .pool import Pool
from .prepare import GRAVITY, prepare
from .recording import FOREARM_JOINTS, JOINTS, FloatArray, Recording
from .result import Recovery
from .start import Alignment, InertialAttitude
from .timing import split_at_pauses
from .shared import Gaussian, Layout, axes_across
from .window import Noise, Priors, Solution, Window

#: How well gravity's direction is known before the first pass, rad.
GRAVITY_SIGMA_RAD = 0.2

Progress = Callable[[float, str], None]


def smooth(
    recording: Recording,
    calibration: ArmCalibration | None = None,
    config: Config | None = None,
    progress: Progress | None = None,
) -> Recovery:
    """Recover the arm's motion over a whole recording.

    Parameters
    ----------
    recording : one arm and its forearm IMU.
    calibration : lever arms and upper-arm length; not needed where `strap` is the only forearm joint.
    config : settings; the defaults where None.
    progress : called with a fraction (0..1) and a word for the step.

    Returns
    -------
    Recovery
        At the IMU's times, in the camera's frame {K}, with covariance.

    Raises
    ------
    SolveError, CalibrationError
        Nothing of the recording can be solved, in one sentence.
    """
    config = config or Config()
    calibration = calibration or ArmCalibration(side=recording.side)
    say = progress or (lambda fraction, text: None)
    _check(recording, calibration)

    # clocks
    offset_s = 0.0
    frame_t = recording.arm.t_s + offset_s
    # what is occluded
    accepted = accepted_samples(recording.arm)
    visible = visible_frames(recording.arm, accepted)
    # start values
    sigma_m = np.full(accepted.shape, config.camera.joint_sigma_m)
    stretches, starts = [], []
    for piece in split_at_pauses(recording.imu):
        ready = prepare(
            recording, recording.imu.select(piece), frame_t, accepted, visible, calibration, sigma_m
        )
        if ready is not None:
            stretches.append(ready[0])
            starts.append(ready[1:])
    if not stretches:
        raise SolveError(f"{recording.name}: at no time do the IMU and a visible forearm come together")
    # windows, graphs, solve: a first pass for what they share, a second with what the first one found
    borders = [cut_times(stretch, config.windows.length_s) for stretch in stretches]
    prior = _first_priors(starts, calibration, config, stretches)
    noise = _noise(config)
    with Pool(config.windows.processes, sum(len(stretch.t) for stretch in stretches)) as pool:
        first = [
            cut(stretch, prior, noise, border, config.windows.margin_s, GRAVITY)
            for stretch, border in zip(stretches, borders, strict=True)
        ]
        answers = _solve(pool, first, False, lambda share: say(0.05 + 0.45 * share, "first pass"))
        told = iter(tell([answer.message for each in answers for answer in each], prior))
        measured = _camera_sigma(first, answers)
        second = []
        for stretch, border, windows, solutions in zip(stretches, borders, first, answers, strict=True):
            better = _refine(stretch, windows, solutions, measured)
            priors = [next(told) for _ in windows]
            second.append(cut(better, priors, noise, border, config.windows.margin_s, GRAVITY))
        answers = _solve(pool, second, True, lambda share: say(0.5 + 0.45 * share, "recovering"))
    # join
    motions = [
        join(stretch.t, windows, solutions)
        for stretch, windows, solutions in zip(stretches, second, answers, strict=True)
    ]
    say(1.0, "done")
    messages = [answer.message for each in answers for answer in each]
    return assemble(
        recording, calibration, config, offset_s, stretches, motions, messages, accepted, visible, measured
    )


def _check(recording: Recording, calibration: ArmCalibration) -> None:
    seen = [joint for joint in recording.arm.present if joint in FOREARM_JOINTS]
    if not seen:
        raise SolveError(f"{recording.name}: the camera never tracked the forearm")
    if "strap" not in seen and not any(joint in calibration.lever_arms for joint in seen):
        raise CalibrationError(
            f"{recording.name}: no lever arm of {', '.join(seen)} is known; give a calibration of this arm"
        )


def _noise(config: Config) -> Noise:
    return Noise(
        accelerometer_density=config.imu.accelerometer_density,
        gyroscope_density=config.imu.gyroscope_density,
        huber=config.camera.huber,
        upper_arm_sigma_m=config.arm.upper_arm_flex_m,
        shoulder_walk=config.arm.shoulder_walk,
    )


def _first_priors(
    starts: list[tuple[InertialAttitude, Alignment]],
    calibration: ArmCalibration,
    config: Config,
    stretches: list[Stretch],
) -> Priors:
    """What is known before the first pass."""
    attitude, alignment = max(starts, key=lambda start: len(start[0].t))
    down = -alignment.R_K_E.apply([0.0, 0.0, 1.0]).mean(axis=0)
    bias = np.concatenate([np.zeros(3), attitude.gyroscope_bias])
    if calibration.accelerometer_bias is not None:
        bias[:3] = calibration.accelerometer_bias
    sigma = np.repeat([config.imu.accelerometer_bias_sigma, config.imu.gyroscope_bias_sigma], 3)
    has_shoulder = any(stretch.accepted[:, JOINTS.index("shoulder")].any() for stretch in stretches)
    layout = Layout(
        joints=tuple(joint for joint in JOINTS if joint in calibration.lever_arms),
        has_upper_arm=has_shoulder and "elbow" in calibration.lever_arms,
        gravity_axes=axes_across(down),
    )
    mean, variance = np.zeros(layout.size), np.ones(layout.size)
    mean[layout.bias], variance[layout.bias] = bias, sigma**2
    variance[layout.gravity] = GRAVITY_SIGMA_RAD**2
    if layout.has_upper_arm:
        known = calibration.upper_arm or Length(config.arm.upper_arm_m, config.arm.upper_arm_sigma_m)
        mean[layout.upper_arm], variance[layout.upper_arm] = known.value_m, known.sigma_m**2
    for joint in layout.joints:
        lever = calibration.lever_arms[joint]
        mean[layout.lever(joint)], variance[layout.lever(joint)] = lever.position_m, lever.sigma_m**2
    walk = np.repeat([config.imu.accelerometer_bias_walk, config.imu.gyroscope_bias_walk], 3)
    return Priors(layout, Gaussian(mean, np.diag(variance)), walk)


def _solve(
    pool: Pool, windows: list[list[Window]], with_covariance: bool, done: Callable[[float], None]
) -> list[list[Solution]]:
    """Solve the windows of all stretches together and give them back by stretch."""
    flat = iter(pool.solve([window for each in windows for window in each], with_covariance, done))
    return [[next(flat) for _ in each] for each in windows]


def _camera_sigma(windows: list[list[Window]], solutions: list[list[Solution]]) -> dict[str, float]:
    """Noise of each joint, m an axis, from the first pass's residuals (median, so outliers count little)."""
    found: dict[str, list[FloatArray]] = {}
    for solution in (each for stretch in solutions for each in stretch):
        for joint, residual in solution.residuals.items():
            found.setdefault(joint, []).append(residual)
    return {
        joint: float(max(1.4826 * np.median(np.abs(np.vstack(rows))), 5e-4)) for joint, rows in found.items()
    }


def _refine(
    stretch: Stretch, windows: list[Window], solutions: list[Solution], measured: dict[str, float]
) -> Stretch:
    """The stretch with the first pass's motion as start values and the camera noise it measured."""
    motion = join(stretch.t, windows, solutions)
    sigma_m = stretch.sigma_m.copy()
    for joint, sigma in measured.items():
        sigma_m[:, JOINTS.index(joint)] = sigma
    return replace(stretch, start=motion.states, sigma_m=sigma_m)
