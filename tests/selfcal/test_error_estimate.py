"""Errors that are constant over a recording, and the camera's noise from residuals."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scenes import ALONE, arm
from scipy.linalg import block_diag
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.body import UPPER_ARM
from smoother.calibration import ArmCalibration
from smoother.cameras import join_cameras
from smoother.config import Config
from smoother.measurements.clock import constant_clock
from smoother.measurements.outliers import JointNoise, reject_by_camera
from smoother.measurements.segment import Timeline
from smoother.recording import JOINTS, ImuStream
from smoother.runtime.pool import Pool
from smoother.selfcal import camera_noise
from smoother.selfcal.camera_noise import (
    SMALLEST_SIGMA_M,
    in_common,
    joint_noise,
    sigma_by_camera,
    sigma_by_joint,
)
from smoother.selfcal.error_estimate import (
    FEWEST_SAMPLES,
    JOINT_M,
    ConstantErrors,
    JointBias,
    PooledEvidence,
    _Sizes,
    well_seen_joints,
)
from smoother.selfcal.excerpts import informative_excerpts
from smoother.selfcal.further_imu import FurtherImu
from smoother.selfcal.rounds import SelfCalibration, self_calibrate
from smoother.simulation import SimulatedArm
from smoother.window.problem import JointMeasurements, Priors, Window
from smoother.window.shared import (
    IMU_ERRORS,
    JOINT_ERRORS,
    SIZE,
    ErrorEvidence,
    Gaussian,
    SharedLayout,
    axes_across,
)
from smoother.window.solution import Solution

SEEDS = range(3)
FOREARM = ("elbow", "wrist", "hand")


def errors_of(made: SimulatedArm) -> ConstantErrors:
    """What self-calibration says of a simulated recording with nothing calibrated."""
    recording = replace(made.recording, truth=None)
    excerpts = [reject_by_camera(each) for each in informative_excerpts(recording, Timeline.of(recording))]
    with Pool(1, len(recording.arm)) as workers:
        return self_calibrate(excerpts, ArmCalibration(side=recording.side), ALONE, workers).errors


def true_matrices(made: SimulatedArm) -> FloatArray:
    """True scales and axes (2, 3, 3) in the axes of the gyroscope: its matrix has no turn."""
    accelerometer, gyroscope = (
        made.parameters[f"{sensor}_matrix"] - np.eye(3) for sensor in ("accelerometer", "gyroscope")
    )
    turn = 0.5 * (gyroscope - gyroscope.T)
    return np.array([accelerometer - turn, gyroscope - turn])


def stated(errors: ConstantErrors) -> FloatArray:
    """Sigmas (SIZE,)."""
    return np.asarray(np.sqrt(np.diag(errors.considered.covariance)))


def joint_differences(made: SimulatedArm, errors: ConstantErrors) -> tuple[FloatArray, FloatArray]:
    """Estimated and true errors of the forearm's joints less their mean, (3, 3) m in {K}."""
    estimate = errors.joints.error_m[[JOINTS.index(joint) for joint in FOREARM]]
    true = np.array([made.parameters["joint_bias"][joint] for joint in FOREARM])
    return estimate - estimate.mean(axis=0), true - true.mean(axis=0)


Case = tuple[SimulatedArm, ConstantErrors]


@pytest.fixture(scope="module")
def realistic() -> list[Case]:
    """Errors of 0.3 % and 0.2 degrees, joints 8 mm per axis off, noise with a memory of 0.3 s."""
    return [(made, errors_of(made)) for made in (arm(seed, "realistic") for seed in SEEDS)]


@pytest.fixture(scope="module")
def white() -> list[Case]:
    """None of these errors, 8 mm of white noise."""
    return [(made, errors_of(made)) for made in (arm(seed) for seed in SEEDS)]


@pytest.mark.parametrize("sensor", [0, 1], ids=["accelerometer", "gyroscope"])
def test_the_imu_is_nearer_the_truth_than_without_and_its_sigmas_hold(
    realistic: list[Case], sensor: int
) -> None:
    """Errors left over what was there: 0.63, 0.39, 0.69 (accelerometer), 0.38, 0.30, 0.77 (gyroscope).

    Rms of the error in sigmas: 1.02 and 1.09; 27 elements of three recordings, correlated in each.
    """
    left, z = [], []
    for made, errors in realistic:
        true = true_matrices(made)[sensor]
        left.append(np.linalg.norm(errors.imu[sensor] - true) / np.linalg.norm(true))
        z.append((errors.imu[sensor] - true) / stated(errors)[IMU_ERRORS].reshape(2, 3, 3)[sensor])
    assert max(left) < 1.0 and np.mean(left) < 0.75
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.5
    assert np.abs(z).max() < 3.0


def test_differences_between_joints(realistic: list[Case]) -> None:
    """4.7 to 11 mm per axis are there, of which 1.0 to 2.3 mm are left."""
    for made, errors in realistic:
        estimate, true = joint_differences(made, errors)
        left, there = (float(np.sqrt(np.mean(x**2))) for x in (estimate - true, true))
        assert left < 0.4 * there
        assert errors.joints.joints == FOREARM
        assert errors.joints.sigma_m == pytest.approx(0.008, rel=0.6)  # nine draws of it


@pytest.mark.slow
def test_nothing_is_invented(white: list[Case]) -> None:
    """Of 0.5 % that may be, 0.1 % is left open; joints are treated as sound."""
    prior = Config().imu.scale_sigma
    for made, errors in white:
        sigma = stated(errors)
        assert np.abs(errors.imu).max() < 0.001
        assert sigma[IMU_ERRORS].max() < 0.5 * prior
        assert np.abs(errors.imu.ravel() / sigma[IMU_ERRORS]).max() < 3.0
        estimate, true = joint_differences(made, errors)
        assert not true.any()
        assert np.abs(estimate).max() < 0.003
        assert errors.joints.sigma_m < 0.4 * JOINT_M


def test_what_is_common_to_the_joints_stays_in_the_covariance(realistic: list[Case]) -> None:
    """The whole arm a little off cannot be seen: known no better than such errors are large."""
    for _, errors in realistic:
        covariance = errors.considered.covariance[JOINT_ERRORS, JOINT_ERRORS]
        rows = [3 * JOINTS.index(joint) for joint in FOREARM]
        along_x = covariance[np.ix_(rows, rows)]
        before = errors.joints.sigma_m**2
        assert along_x.mean() > 0.7 * before / len(FOREARM)  # of the mean of three
        difference = np.array([1.0, 0.0, -1.0])  # elbow and hand
        assert difference @ along_x @ difference < 0.25 * 2.0 * before
        estimate = errors.joints.error_m[[JOINTS.index(joint) for joint in FOREARM]]
        np.testing.assert_allclose(estimate.mean(axis=0), 0.0, atol=1e-12)


def test_corrected_data_are_the_right_ones() -> None:
    """Samples read (I + M) times what they should, joints are seen off: both are gone afterwards."""
    recording = arm(0).recording
    (segment, *_) = informative_excerpts(recording, Timeline.of(recording))
    rng = np.random.default_rng(0)
    imu, joints = 0.003 * rng.normal(size=(2, 3, 3)), 0.008 * rng.normal(size=(len(JOINTS), 3))
    spoiled = replace(
        segment, signal=segment.signal.scaled(*(np.eye(3) + imu)), position=segment.position + joints
    )
    errors, known = ConstantErrors(imu, JointBias(joints)), {}
    clean = errors.corrected(spoiled, known)
    assert errors.corrected(spoiled, known).signal is clean.signal  # segments of one signal share it
    np.testing.assert_allclose(clean.position, segment.position, atol=1e-12)
    start_s = np.linspace(segment.signal.start_s, segment.signal.end_s - 0.1, 100)
    means = [signal.mean(start_s, start_s + 0.1) for signal in (segment.signal, clean.signal)]
    np.testing.assert_allclose(*means, atol=1e-4 * np.abs(means[0]).max())  # errors of 0.5 %, to first order


def test_a_further_imus_samples_are_corrected_and_held_a_little_at_both_ends() -> None:
    rng, t = np.random.default_rng(0), np.arange(0.0, 20.0, 0.01)
    true = rng.normal(size=(2, len(t), 3)) + np.array([[[0.0, 9.8, 0.0]], [[0.0, 0.0, 0.0]]])
    errors = 0.003 * rng.normal(size=(2, 3, 3))
    acc, gyro = true @ np.swapaxes(np.eye(3) + errors, 1, 2)
    model = cast("SelfCalibration", SimpleNamespace(errors=ConstantErrors(errors)))
    further = FurtherImu(UPPER_ARM, ImuStream("", t, acc, gyro), model, constant_clock(0.0))
    (run,) = further.runs(5.0, 10.0)
    inside = (run.t_s > 4.995) & (run.t_s < 9.995)
    np.testing.assert_allclose(run.acc[inside], true[0, 500:1000], atol=1e-3)  # to first order: 0.01 % of g
    np.testing.assert_allclose(run.gyro[inside], true[1, 500:1000], atol=1e-3)
    np.testing.assert_allclose(np.diff(run.t_s), 0.01, atol=1e-9)
    assert not inside[[0, -1]].any() and (run.acc[0] == run.acc[inside][0]).all()


def test_a_joint_alone_has_no_error() -> None:
    """There is nothing to differ from; a joint with hardly a sample does not count."""
    few = FEWEST_SAMPLES - 1
    for windows, only_joints, joints in (
        ([{"wrist": 50}], True, ()),
        ([{"wrist": 50, "hand": few}], True, ()),
        ([{"wrist": 50, "hand": few}, {"elbow": few, "hand": 1}], True, ("wrist", "hand")),
        # a strap that stands for the IMU has no error of the camera to tell from others'
        ([{"wrist": 50, "strap": 50}], True, ()),
        ([{"wrist": 50, "strap": 50}], False, ("wrist", "strap")),
    ):
        seen = [
            window_of(*(sight_of(joint, np.arange(count)) for joint, count in samples.items()))
            for samples in windows
        ]
        assert well_seen_joints(seen, only_joints) == joints


def test_a_turned_sensor_is_no_error() -> None:
    """A gyroscope turned by 0.5 degrees defines the axes all the same: the accelerometer is off."""
    made = arm(0)
    turn = Rotation.from_rotvec(np.radians([0.3, -0.4, 0.2]))
    imu = replace(made.recording.imu, gyro=turn.apply(made.recording.imu.gyro))
    errors = errors_of(replace(made, recording=replace(made.recording, imu=imu)))
    accelerometer = np.eye(3) - turn.as_matrix()  # in the gyroscope's axes
    left = np.linalg.norm(errors.imu[0] - accelerometer)
    # twice what is usual (0.005 rad), so drawn to zero: 0.53 of it is left
    assert left < 0.7 * np.linalg.norm(accelerometer)
    assert np.abs(errors.imu[1]).max() < 0.0015


LAYOUT = SharedLayout(("elbow", "wrist"), True, axes_across(np.array([0.0, -1.0, 0.1])))
#: Which recording each window is of, and the share of it that no neighbour has seen.
RECORDINGS, SHARES = np.array([0, 1, 1, 0]), np.array([1.0, 0.5, 0.8, 1.0])
OTHERS = 2 * 2 + LAYOUT.size - LAYOUT.constants.start


def observed() -> tuple[FloatArray, FloatArray, ConstantErrors, PooledEvidence]:
    """Observations of two directions of gravity, the arm's constants and the errors: their rows and values.

    Also the errors that were taken off before, and what is pooled of the windows.
    """
    rng, size = np.random.default_rng(7), LAYOUT.size
    root = rng.normal(size=(size, size))
    covariance = np.asarray(root @ root.T / size + 0.1 * np.eye(size))
    covariance[6:8, 8:] = covariance[8:, 6:8] = 0.0  # gravity is each recording's, the rest the arm's
    covariance[:6, 6:] = covariance[6:, :6] = 0.0
    mean = 0.3 * rng.normal(size=size)
    before = ConstantErrors(0.01 * rng.normal(size=(2, 3, 3)), JointBias(0.01 * rng.normal(size=(5, 3))))
    gravity, constants = (
        np.linalg.cholesky(np.linalg.inv(covariance[part, part])).T for part in (slice(6, 8), slice(8, None))
    )
    whiten = block_diag(gravity, gravity, constants)
    rows, values = [np.eye(OTHERS, OTHERS + SIZE)], [np.concatenate([mean[6:8], mean[6:]])]
    rows[0], values[0] = whiten @ rows[0], whiten @ values[0]
    windows, solutions = [], []
    for recording, share in zip(RECORDINGS, SHARES, strict=True):
        J, y = rng.normal(size=(60, size - 6 + SIZE)), rng.normal(size=60)
        own = np.zeros((60, OTHERS + SIZE))
        own[:, 2 * recording : 2 * recording + 2], own[:, 4:] = J[:, :2], J[:, 2:]
        rows.append(np.sqrt(share) * own)
        values.append(np.sqrt(share) * y)
        windows.append(SimpleNamespace(core_start_s=3.0, core_end_s=3.0 + 10 * share, t=np.array([2, 12])))
        solutions.append(SimpleNamespace(evidence=ErrorEvidence(J.T @ J, J.T @ y)))
    prior = Priors(LAYOUT, Gaussian(mean, covariance), np.ones(6))
    pooled = PooledEvidence.of(windows, solutions, prior, RECORDINGS, before)  # type: ignore[arg-type]
    return np.concatenate(rows), np.concatenate(values), before, pooled


def test_what_windows_say_together_is_a_dense_solve() -> None:
    """The arm's constants, the errors as they were taken off; the errors; what all share follows them."""
    rows, values, taken_off, pooled = observed()
    inverse, found = np.linalg.pinv(rows[:, :OTHERS]), pooled.constants
    np.testing.assert_allclose(found.mean, (inverse @ values)[4:], rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(found.covariance, (inverse @ inverse.T)[4:, 4:], rtol=1e-8, atol=1e-12)
    # a known error moves the answer as if the data had been without it
    error = np.random.default_rng(9).normal(size=SIZE)
    moved, follows = -inverse @ rows[:, OTHERS:] @ error, pooled.shared_sensitivity() @ error
    np.testing.assert_allclose(follows[:6], 0.0)
    np.testing.assert_allclose(follows[6:], np.concatenate([moved[:2], moved[4:]]), rtol=1e-8, atol=1e-10)
    # a prior about zero on all of an error, of which a part was taken off the data
    root = np.random.default_rng(8).normal(size=(SIZE, SIZE)) / np.sqrt(SIZE) + np.eye(SIZE)
    before = np.concatenate([taken_off.imu.ravel(), taken_off.joints.error_m.ravel(), np.zeros(9)])
    whiten = np.linalg.inv(root)
    inverse = np.linalg.pinv(np.vstack([rows, np.hstack([np.zeros((SIZE, OTHERS)), whiten])]))
    mean, covariance = pooled.posterior(root @ root.T)
    change = inverse @ np.concatenate([values, -whiten @ before])
    np.testing.assert_allclose(mean, before + change[OTHERS:], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(covariance, (inverse @ inverse.T)[OTHERS:, OTHERS:], rtol=1e-7, atol=1e-9)


STEP_S = 1 / 30


def sight_of(joint: str, node: np.ndarray) -> JointMeasurements:
    """Samples at nodes, of which only the times are looked at."""
    nothing = np.zeros((len(node), 3))
    return JointMeasurements(joint, STEP_S * node, node, nothing, np.full(len(node), 0.01), nothing, nothing)


def window_of(*measured: JointMeasurements) -> Window:
    """A window of which only the samples are looked at."""
    return cast("Window", SimpleNamespace(joint_measurements=measured))


def noise_in(*windows: dict[str, FloatArray], frames: FloatArray | None = None) -> dict[str, JointNoise]:
    """From the residuals of windows, by joint; each is of every frame, if not said."""
    sights = [
        window_of(
            *(sight_of(joint, np.arange(len(x)) if frames is None else frames) for joint, x in each.items())
        )
        for each in windows
    ]
    return joint_noise(sights, [cast("Solution", SimpleNamespace(residuals=each)) for each in windows])


def remembering(phi: float, sigma: float, count: int, rng: np.random.Generator) -> FloatArray:
    """Stationary noise (count, 3), each sample phi times the one before and something new."""
    drive = sigma * np.sqrt(1 - phi**2) * rng.normal(size=(count + 500, 3))
    return np.asarray(lfilter([1.0], [1.0, -phi], drive, axis=0)[500:])


def memory_of(tau_s: float) -> float:
    """How much of a sample is in the next one."""
    return float(np.exp(-STEP_S / tau_s))


SIZES_M = {"elbow": 0.004, "wrist": 0.008, "hand": 0.020}


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("tau_s", "white", "lost", "is_followed"),
    [
        (0.0, 0.0, 0.0, False),
        *((tau_s, white, 0.0, False) for tau_s in (0.3, 0.6) for white in (0.0, 1.0)),
        # fewer samples share the same long-run error: the sigma is of all frames, lags are lags in time
        (0.3, 0.0, 0.33, False),
        # residuals without their mean over 3 s, which the answer followed, still tell most
        (0.3, 0.0, 0.0, True),
    ],
)
def test_noise_and_its_memory(tau_s: float, white: float, lost: float, is_followed: bool, seed: int) -> None:
    """Long-run variance: (1 + phi) / (1 - phi) times that of the part with a memory, and the white part's."""
    rng, phi = np.random.default_rng(seed), memory_of(tau_s) if tau_s else 0.0
    seen, windows = np.flatnonzero(rng.uniform(size=600) >= lost), []
    for _ in range(6):
        noise = {joint: remembering(phi, size_m, 600, rng) for joint, size_m in SIZES_M.items()}
        for joint, x in noise.items():
            slow = uniform_filter1d(x, 90, axis=0, mode="nearest") if is_followed else 0.0
            noise[joint] = (x - slow + white * SIZES_M[joint] * rng.normal(size=x.shape))[seen]
        windows.append(noise)
    for joint, found in noise_in(*windows, frames=seen).items():
        long_run = found.effective_m / SIZES_M[joint]
        tolerance = 0.35 if lost or is_followed else 0.25
        assert long_run == pytest.approx(np.sqrt((1 + phi) / (1 - phi) + white), rel=tolerance)
        if not is_followed:
            assert found.sample_m == pytest.approx(SIZES_M[joint] * np.sqrt(1.0 + white), rel=0.08)
            # three neighbours, so a little less
            assert found.memory_m == pytest.approx(SIZES_M[joint] if phi else 0.0, rel=0.15)
        assert phi or found.effective_m == found.sample_m


def test_outliers_few_samples_and_a_perfect_camera() -> None:
    noise = 0.008 * np.random.default_rng(1).normal(size=(3000, 3))
    noise[::50] += 0.5
    assert noise_in({"wrist": noise})["wrist"].sample_m < 0.010  # outliers hardly count
    assert noise_in({"wrist": np.zeros((100, 3))})["wrist"].effective_m == SMALLEST_SIGMA_M
    few = noise_in({"wrist": np.cumsum(np.full((5, 3), 0.001), axis=0)})["wrist"]  # they tell no memory
    assert few.effective_m == few.sample_m and few.memory_m == 0.0


@pytest.mark.parametrize(("share", "hidden"), [(0.6, 0.0), (0.5, 0.2), (0.3, 0.1), (0.0, 0.1)])
@pytest.mark.parametrize("tau_s", camera_noise.TIMES_S[[7, 9]])
def test_the_memory_behind_an_exact_autocorrelation(share: float, hidden: float, tau_s: float) -> None:
    """Of noise of which a part was followed and a share of the rest is exp(-lag / tau)."""
    lag, ratio = np.arange(1, 46), memory_of(tau_s)
    rho = np.concatenate([[1.0], (share * ratio**lag - hidden) / (1.0 - hidden)])
    found = camera_noise._fitted(rho, np.full(46, 1e5), STEP_S)
    if share:
        assert found.long_run == pytest.approx(1.0 + 2.0 * share * ratio / (1.0 - ratio), rel=1e-6)
        assert found.hidden == pytest.approx(1.0 / (1.0 - hidden), rel=1e-6)
    else:
        assert (found.long_run, found.hidden, found.neighbours) == (1.0, 1.0, 0.0)


def test_each_camera_has_a_noise_of_its_own_and_one_that_saw_nothing_that_of_the_others() -> None:
    noise = {"wrist": JointNoise(0.01, 0.02, 0.0), "wrist@1": JointNoise(0.01, 0.03, 0.0)}
    np.testing.assert_allclose(sigma_by_camera(noise, 0.5, 3)[:, 1], [0.02, 0.03, 0.02])


def test_noise_across_a_ray_is_that_of_an_axis() -> None:
    """It has two directions of three: nothing is seen along the ray."""
    sight, noise = sight_of("wrist", np.arange(3000)), np.random.default_rng(1).normal(size=(3000, 3))
    sight = replace(sight, origin_m=np.zeros(3))
    seen = cast("Solution", SimpleNamespace(residuals={sight.key: 0.008 * noise * [1.0, 1.0, 0.0]}))
    assert joint_noise([window_of(sight)], [seen])[sight.key].sample_m == pytest.approx(
        0.008, rel=0.08
    )  # some are clipped


def test_the_shoulder_is_as_good_as_the_best() -> None:
    noise = {"elbow": JointNoise(0.01, 0.02, 0.0), "wrist": JointNoise(0.01, 0.015, 0.0)}
    by_joint = dict(zip(JOINTS, sigma_by_joint(noise, 0.5).tolist(), strict=True))
    assert by_joint == {joint: 0.02 if joint == "elbow" else 0.015 for joint in JOINTS}
    assert sigma_by_joint({}, 0.5).tolist() == [0.5] * 5


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_what_joints_err_together(share: float) -> None:
    """Of three joints with a share of their variance in common, the sum has 1 + 2 share times as much."""
    rng = np.random.default_rng(0)
    windows, solutions = [], []
    for _ in range(4):
        common, nodes = rng.normal(size=(600, 3)), np.arange(600)
        own = {joint: rng.normal(size=(600, 3)) for joint in FOREARM}
        residuals = {
            joint: 0.01 * (np.sqrt(share) * common + np.sqrt(1.0 - share) * x) for joint, x in own.items()
        }
        windows.append(window_of(*(sight_of(joint, nodes) for joint in FOREARM)))
        solutions.append(cast("Solution", SimpleNamespace(residuals=residuals)))
    assert in_common(windows, solutions) == pytest.approx(1.0 + 2.0 * share, abs=0.07)


@pytest.mark.parametrize("angles_deg", [(75.0,), (75.0, -60.0)])
def test_what_several_cameras_have_in_common_does_not_average_out(angles_deg: tuple[float, ...]) -> None:
    """Joined frames of cameras whose joints are constantly off, against the covariance that is stated."""
    sigma_m, joints, cameras = 0.008, ("shoulder", *FOREARM), 1 + len(angles_deg)
    settings = {"duration_s": 20.0, "occlusion_lengths_s": (), "noise_m": 0.001, "latency_s": 0.0}
    off = []
    for seed in range(16):
        made = arm(seed, protocol="random", joint_bias_m=sigma_m, cameras=angles_deg, **settings)
        seen = join_cameras(made.recording)[0].arm
        true = made.motion.joints(seen.t_s + made.parameters["clock_offset_s"])
        off.append([np.nanmean(seen.joint(joint) - true[joint], axis=0) for joint in joints])
    by_axis = np.moveaxis(np.array(off), 2, 1).reshape(-1, len(joints))
    rows = [JOINTS.index(joint) for joint in joints]
    sizes = _Sizes(0.0, 0.0, sigma_m / np.sqrt(cameras), 0.0, None, FOREARM, cameras)
    stated = sizes.joint_m**2 * sizes.alike[np.ix_(rows, rows)]
    common = np.full(len(joints), 1.0 / len(joints))
    for direction in (common, np.array([1.0, 0.0, -1.0, 0.0]), np.array([0.0, 1.0, -1.0, 0.0])):
        found = np.mean((by_axis @ direction) ** 2)
        assert found == pytest.approx(direction @ stated @ direction, rel=0.35)
