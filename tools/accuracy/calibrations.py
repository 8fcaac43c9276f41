"""Calibrations of clocks, sensors and the forearm on simulated data: `clock`, `imu` and `forearm`.

`clock [sound|broadcast|motion|skew]`: beeps in rooms with a voice, broadcasts with missing and late
receptions (steps of 0.3125 ms), the realistic arm, and 15 minutes of it with a clock that runs 390 ppm fast.

`imu`. Accelerometer: offsets of 0.5 m/s^2, scale 3 %, cross-axis 1 %, twelve poses held for two seconds each,
turned by hand between. Magnetometer: hard iron 0.5, soft iron 20 % (of the field), 3,000 samples, noise 1 %.
Noise: white, beside a bias that wanders, over a rest.

`forearm [pose|strap]`. `pose`: realistic arms; whether pose and motion agree, and whether lever arms and roll
are as good as stated. `strap`: rendered images with joints 8 mm off, markers beside the strap, a body before
the arm.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.clock import solve_clocks
from calib.forearm import calibrate_forearm, compare
from calib.imu import GRAVITY, calibrate_imu, calibrate_magnetometer, find_rests, noise_density
from calib.intrinsics import Intrinsics, PlacedCamera
from calib.motion_clock import clock_from_motion
from calib.sound import find_beeps
from calib.strap import Depth, find_strap
from smoother.errors import CalibrationError
from smoother.linalg import sphere
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.rig import SensorModel, beep, broadcast, magnetometer_turns, rest_poses
from smoother.simulation.strap import Arm, StrapImageNoise, render
from tools.accuracy.check import ONE_PROCESS, check, parts_option, rms, seeds_option

SKEW = 390e-6


#: What is stated of an offset, s: how far off it is and its sigma; of a clock that runs fast, ppm off.
Stated = Iterator[tuple[float, float, float]]


def row(name: str, found: Stated, of_skew: str = "") -> str:
    """A line of figures."""
    error, sigma, skew = np.array(list(found)).T * [[1e3], [1e3], [1.0]]
    skews = {"rms": f"skew rms {rms(skew):.2f} ppm", "max": f"skew max {np.abs(skew).max():.1f} ppm off"}
    return (
        f"{name:34} rms {rms(error):7.3f} ms  max {np.abs(error).max():7.3f} ms  stated"
        f" {np.median(sigma):6.3f} ms  squared error / sigma^2 {np.mean((error / sigma) ** 2):5.2f} "
        f" {skews.get(of_skew, '')}"
    )


def beeps(seeds: range, rate_hz: int, quiet_db: float) -> Stated:
    for seed in seeds:
        samples, end, _ = beep(seed, rate_hz, quiet_db)
        nearest = min(find_beeps(samples, rate_hz), key=lambda each: abs(each.end_s - end))
        yield nearest.end_s - end, nearest.sigma_s, np.nan


def receptions(seeds: range, nodes: int, rounds: int, span_s: float) -> Stated:
    for seed in seeds:
        clocks, heard = broadcast(seed, nodes=nodes, rounds=rounds, span_s=span_s)
        for link in solve_clocks([heard]).links():
            yield clocks.error_s(link), link.sigma_s, clocks.skew_error_ppm(link)


def moved(seeds: range, fast: float, **settings: Any) -> Stated:
    """By the motion of the realistic arm; the IMU's clock runs fast."""
    for seed in seeds:
        made = simulate_arm(ArmSimulation.preset("realistic", **settings), seed)
        imu = made.recording.imu
        recording = replace(made.recording, imu=replace(imu, t_s=imu.t_s * (1 + fast)))
        link = clock_from_motion(recording, None, ONE_PROCESS).link
        at_s = link.at_s if fast else 0.0
        true = (at_s + made.parameters["clock_offset_s"]) * (1 + fast) - at_s
        yield link.offset_s - true, link.sigma_s, link.skew_ppm - 1e6 * fast


CLOCKS = ("sound", "broadcast", "motion", "skew")


@check(
    parts_option(*CLOCKS),
    seeds_option("16"),
)
def clock(options: argparse.Namespace) -> Iterator[str]:
    """Clock offsets by a beep, by broadcasts and by motion, against the simulated ones."""
    parts, seeds = options.parts or CLOCKS, options.seeds
    if "sound" in parts:
        for rate_hz, quiet_db in ((16000, 25.0), (44100, 25.0), (16000, 10.0)):
            name = f"sound, {rate_hz} Hz, noise -{quiet_db:.0f} dB"
            yield row(name, beeps(seeds, rate_hz, quiet_db))
    if "broadcast" in parts:
        for nodes, rounds, span_s in ((2, 20, 900.0), (5, 20, 900.0), (3, 20, 5.0), (3, 8, 60.0)):
            name = f"broadcast, {nodes} nodes, {rounds} in {span_s:.0f} s"
            yield row(name, receptions(seeds, nodes, rounds, span_s), "rms")
    if "motion" in parts:
        yield row("motion, realistic arm", moved(seeds, 0.0))
    if "skew" in parts:
        few = seeds[: max(len(seeds) // 8, 2)]
        found = moved(few, SKEW, protocol="random", duration_s=900.0)
        yield row("motion, 15 minutes, 390 ppm", found, "max")


def accelerometer(seeds: range, poses: int, noise: float) -> Iterator[str]:
    """Error of the corrected specific force at rest, over all directions."""
    errors, biases, found = [], [], []
    up = sphere(500) * GRAVITY
    for seed in seeds:
        model = SensorModel.draw(np.random.default_rng(seed), offset=0.5, scale=0.03, cross=0.01)
        stream, bias = rest_poses(model, poses, seed=seed, acc_noise=noise, gyro_noise=noise / 50.0)
        found.append(find_rests(stream).poses)
        got = calibrate_imu(stream)
        assert got.accelerometer is not None
        errors.append(rms(np.linalg.norm(got.accelerometer.apply(model.distort(up)) - up, axis=1)))
        biases.append(np.abs(got.gyroscope.offset - bias).max())
    yield (
        f"  {poses} poses, noise {noise:g} m/s^2: rms error {np.mean(errors):.4f}, worst of"
        f" {len(seeds)} seeds {max(errors):.4f} m/s^2; poses found {min(found)}..{max(found)};"
        f" gyroscope bias {np.degrees(max(biases)):.4f} deg/s at worst"
    )


def refusal(calibrate: Callable[[], object]) -> str:
    """The sentence with which a calibration refuses; it must not take what it is given."""
    try:
        calibrate()
    except CalibrationError as error:
        return str(error)
    raise SystemExit("what does not suffice was taken")


def refused(seeds: range) -> Iterator[str]:
    """Eight poses."""
    for seed in seeds:
        model = SensorModel.draw(np.random.default_rng(seed), offset=0.5, scale=0.03, cross=0.01)
        poses, _ = rest_poses(model, 8, seed=seed)
        text = refusal(partial(calibrate_imu, poses))
    yield f"  8 poses: refused for all seeds: {text}"


def magnetometer(seeds: range) -> Iterator[str]:
    """Length of the corrected true field, over the sphere."""
    off = []
    for seed in seeds:
        model = SensorModel.draw(np.random.default_rng(seed), offset=0.5, scale=0.2, cross=0.2)
        got = calibrate_magnetometer(magnetometer_turns(model, 3000, noise=0.01, seed=seed))
        off.append(np.linalg.norm(got.apply(model.distort(sphere(500))), axis=1) - 1.0)
    yield (
        f"  3000 samples: radius error rms {100 * np.mean([rms(each) for each in off]):.3f} %,"
        f" worst direction {100 * np.abs(off).max():.3f} %"
    )
    rng = np.random.default_rng(0)
    angle = rng.uniform(0.0, 2.0 * np.pi, 3000)
    plane = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0]).apply([0.5, 0.0, -0.86])
    flat = plane + rng.normal(0.0, 0.01, plane.shape)
    yield f"  planar rotation: refused: {refusal(partial(calibrate_magnetometer, flat))}"


def noise(seeds: range) -> Iterator[str]:
    """White noise of a long rest, against the one that was drawn."""
    rate, hours = 100.0, 1.0
    ratio = []
    for seed in seeds[:5]:
        rng = np.random.default_rng(seed)
        count = int(3600 * hours * rate)
        white, walk = 2e-3, 1e-4
        samples = white * np.sqrt(rate) * rng.normal(size=(count, 3))
        samples += np.cumsum(walk / np.sqrt(rate) * rng.normal(size=(count, 3)), axis=0)
        got = noise_density(samples, rate)
        assert got is not None
        ratio.append(np.sqrt(np.mean(got**2)) / white)
    yield f"  {hours:g} h at {rate:g} Hz: white noise {min(ratio):.3f}..{max(ratio):.3f} of the truth"


@check(
    seeds_option("20"),
)
def imu(options: argparse.Namespace) -> Iterator[str]:
    """Errors of corrected accelerometers, gyroscopes and magnetometers, and of noise figures."""
    yield "accelerometer"
    for level in (0.005, 0.02, 0.1):
        yield from accelerometer(options.seeds, 12, level)
    yield from refused(options.seeds)
    yield "magnetometer"
    yield from magnetometer(options.seeds)
    yield "noise"
    yield from noise(options.seeds)


COLOUR = PlacedCamera(Intrinsics(960, 540, 600.0, 600.0, 480.0, 270.0), t_C_K=np.array([0.05, 0.0, 0.0]))
INFRARED = PlacedCamera(Intrinsics(512, 424, 366.0, 366.0, 256.0, 212.0))


def pose(seeds: range) -> Iterator[str]:
    """Pose against motion, with the strap seen and with the strap's place by ruler."""
    for seen in (True, False):
        agree, asked = Counter[str](), Counter[str]()
        levers, rolls = [], []
        for seed in seeds:
            arm = simulate_arm(ArmSimulation.preset("realistic", repetitions=1, strap=seen), seed)
            to_wrist = None if seen else arm.parameters["strap_to_wrist_m"]
            found = calibrate_forearm(
                arm.recording,
                radius_m=None if seen else 0.035,
                strap_to_wrist_m=to_wrist,
                config=ONE_PROCESS,
            )
            for row in compare(found):
                asked[row.measure] += 1
                agree[row.measure] += row.agrees
            for joint, lever in found.calibration.lever_arms.items():
                error = lever.position_m - arm.calibration.lever_arms[joint].position_m
                levers += np.square(error / lever.sigma_m).tolist()
            if found.calibration.R_F_A is not None and arm.calibration.R_F_A is not None:
                turn = found.calibration.R_F_A @ arm.calibration.R_F_A.T
                rolls.append(np.degrees(np.arctan2(turn[0, 2], turn[0, 0])))
        yield ("strap seen" if seen else "strap by ruler")
        yield "  agree: " + ", ".join(f"{name} {agree[name]} of {asked[name]}" for name in asked)
        nees = np.mean(levers)
        yield (f"  lever arms: squared error / sigma^2 {nees:.2f}; roll rms {rms(rolls):.0f} degrees")


def strap(seeds: range) -> Iterator[str]:
    """The arm's core under the strap; and what is accepted where no strap can be seen."""
    for sigma_m in (0.0, 0.003, 0.008):
        errors, nees, reasons, wrong = [], [], Counter[str](), 0
        for seed in range(5 * len(seeds)):
            rng = np.random.default_rng(seed)
            along = rng.normal(size=3) * [1.0, 1.0, 0.5]
            elbow = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), rng.uniform(1.5, 2.5)])
            length = rng.uniform(0.23, 0.28)
            wrist = elbow + length * along / np.linalg.norm(along)
            marker = (None, 0.03, -0.03)[int(rng.integers(3))]
            arm = Arm(elbow, wrist, rng.uniform(0.03, 0.04), length - rng.uniform(0.03, 0.07), marker=marker)
            body = (0.5 * (elbow + wrist) - [0.0, 0.0, 0.3], np.array([0.22, 0.4, 0.12]))
            hidden = Arm(elbow, wrist, arm.radius, arm.strap, trunk=body)
            for one in (arm, hidden):
                noise = StrapImageNoise(rng=rng)
                grey, _ = render(one, COLOUR, noise)
                depth = Depth(render(one, INFRARED, noise)[1], INFRARED)
                ends = [end + rng.normal(0, sigma_m, 3) for end in (elbow, wrist)]
                seen = find_strap(
                    grey, COLOUR, depth, *ends, radius_m=arm.radius, joint_sigma_m=max(sigma_m, 0.003)
                )
                if one is hidden:
                    wrong += seen.found
                    continue
                reasons[seen.reason or "found"] += 1
                if seen.found:
                    error = seen.core - arm.strap_core
                    errors.append(error)
                    nees.append(error @ np.linalg.solve(seen.covariance, error) / 3)
        size = 1e3 * np.linalg.norm(errors, axis=1)
        yield (
            f"joints {1e3 * sigma_m:.0f} mm off: core rms {rms(size):.1f} mm, max {size.max():.1f} mm,"
            f" squared error / sigma^2 {np.mean(nees):.2f}; {dict(reasons)}; accepted behind a body: {wrong}"
        )


FOREARM_PARTS = {"pose": pose, "strap": strap}


@check(
    parts_option(*FOREARM_PARTS),
    seeds_option("20:32", "`strap`: five for each"),
)
def forearm(options: argparse.Namespace) -> Iterator[str]:
    """The forearm by its held pose and by the strap in images, against the simulated one."""
    for part in options.parts or FOREARM_PARTS:
        yield from FOREARM_PARTS[part](options.seeds)
