"""The camera's noise from residuals, and the constant errors of its joints."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from made_segments import forearm
from scenes import Scene, arm, blind
from scipy.signal import lfilter

from smoother.config import Config
from smoother.measurements.joint_noise import JointNoise
from smoother.recording import JOINTS, FloatArray
from smoother.selfcal.camera_noise import joint_noise, sigma_by_joint
from smoother.selfcal.joint_bias import GAIN, JointBias
from smoother.window.problem import JointMeasurements, Solution, Window

STEP_S = 1 / 30


def sight_of(joint: str, node: np.ndarray, sigma_m: float) -> JointMeasurements:
    """Samples at nodes, of which only time and sigma are looked at."""
    nothing = np.zeros((len(node), 3))
    return JointMeasurements(
        joint, STEP_S * node, node, nothing, np.full(len(node), sigma_m), nothing, nothing
    )


def answered(residuals: dict[str, FloatArray], sigma_m: float = 0.01) -> tuple[Window, Solution]:
    """A window and an answer of which only times, samples and residuals are looked at."""
    count = max(map(len, residuals.values()))
    joint_measurements = tuple(
        sight_of(joint, np.arange(len(each)), sigma_m) for joint, each in residuals.items()
    )
    window = SimpleNamespace(
        t=STEP_S * np.arange(count),
        joint_measurements=joint_measurements,
        noise=SimpleNamespace(cauchy=Config().camera.cauchy),
    )
    return cast(Window, window), cast(Solution, SimpleNamespace(residuals=residuals))


def found_in(*windows: dict[str, FloatArray]) -> dict[str, JointNoise]:
    pairs = [answered(each) for each in windows]
    return joint_noise([window for window, _ in pairs], [solution for _, solution in pairs])


def remembering(phi: float, sigma: float, count: int, rng: np.random.Generator) -> FloatArray:
    """Stationary noise (count, 3), each sample phi times the one before and something new."""
    drive = sigma * np.sqrt(1 - phi**2) * rng.normal(size=(count + 500, 3))
    return np.asarray(lfilter([1.0], [1.0, -phi], drive, axis=0)[500:])


@pytest.mark.parametrize("seed", range(4))
def test_white_noise(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = {"elbow": 0.004, "wrist": 0.008, "hand": 0.020}
    windows = [{j: s * rng.normal(size=(240, 3)) for j, s in sizes.items()} for _ in range(6)]
    found = found_in(*windows)
    for joint, sigma in sizes.items():
        assert found[joint].sample_m == pytest.approx(sigma, rel=0.05)
        assert found[joint].effective_m == pytest.approx(sigma, rel=0.05)
        assert found[joint].memory_m < 0.2 * sigma


@pytest.mark.parametrize("phi", [0.3, 0.6, 0.8])
@pytest.mark.parametrize("seed", range(4))
def test_noise_with_a_memory(phi: float, seed: int) -> None:
    """The long-run variance of the process is (1 + phi) / (1 - phi) times its variance."""
    rng = np.random.default_rng(seed)
    windows = [{j: remembering(phi, 0.008, 400, rng) for j in ("elbow", "wrist")} for _ in range(6)]
    for each in found_in(*windows).values():
        assert each.sample_m == pytest.approx(0.008, rel=0.08)
        assert each.effective_m == pytest.approx(0.008 * np.sqrt((1 + phi) / (1 - phi)), rel=0.25)
        assert each.memory_m > (0.002 if phi > 0.5 else -1.0)  # three neighbours and more


def test_lost_frames_do_not_hide_the_memory() -> None:
    """Lags are lags in time: with a third of the frames gone the answer is much the same."""
    rng = np.random.default_rng(0)
    windows, solutions = [], []
    for _ in range(6):
        series = remembering(0.8, 0.008, 600, rng)
        kept = np.flatnonzero(rng.uniform(size=600) > 0.33)
        window, _ = answered({"wrist": series})
        measured = sight_of("wrist", kept, 0.01)
        windows.append(
            cast(Window, SimpleNamespace(t=window.t, joint_measurements=(measured,), noise=window.noise))
        )
        solutions.append(cast(Solution, SimpleNamespace(residuals={"wrist": series[kept]})))
    assert joint_noise(windows, solutions)["wrist"].effective_m == pytest.approx(0.024, rel=0.3)


def test_outliers_hardly_count() -> None:
    rng = np.random.default_rng(1)
    noise = 0.008 * rng.normal(size=(3000, 3))
    noise[::50] += 0.5
    assert found_in({"wrist": noise})["wrist"].sample_m < 0.010


def test_the_perfect_camera_has_a_floor() -> None:
    assert found_in({"wrist": np.zeros((100, 3))})["wrist"].effective_m > 1e-4


def test_the_shoulder_is_as_bad_as_the_worst() -> None:
    noise = {"elbow": JointNoise(0.01, 0.02, 0.0), "wrist": JointNoise(0.01, 0.015, 0.0)}
    sigma = sigma_by_joint(noise, 0.5)
    assert sigma.tolist() == [0.02, 0.02, 0.015, 0.02, 0.02]
    assert sigma_by_joint({}, 0.5).tolist() == [0.5] * 5


def test_a_step_takes_differences_only() -> None:
    """Twice the mean residual, less what the joints have in common; outliers beyond the loss do not count."""
    elbow, wrist = np.tile([0.004, 0.0, 0.0], (50, 1)), np.tile([0.0, 0.002, 0.0], (50, 1))
    elbow[0] = 1.0
    window, solution = answered({"elbow": elbow, "wrist": wrist, "hand": np.ones((5, 3))})
    bias = JointBias().updated([window], [solution])
    assert bias.joints == ("elbow", "wrist")  # five samples of the hand are too few
    found = {joint: bias.error_m[JOINTS.index(joint)] for joint in JOINTS}
    np.testing.assert_allclose(found["elbow"], GAIN * np.array([0.002, -0.001, 0.0]), atol=1e-12)
    np.testing.assert_allclose(found["wrist"], -found["elbow"], atol=1e-12)
    assert not found["hand"].any()
    piece = forearm()
    corrected = bias.corrected(piece)
    moved = piece.position - corrected.position
    np.testing.assert_allclose(moved[:, JOINTS.index("elbow")], np.tile(found["elbow"], (90, 1)), atol=1e-12)


def test_a_joint_alone_has_no_bias() -> None:
    window, solution = answered({"wrist": np.full((50, 3), 0.003)})
    bias = JointBias().updated([window], [solution])
    assert not bias.error_m.any()
    assert bias.sigma_m == 0.0


def differences(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Found and true errors of the forearm's joints less their mean, (3, 3) m in {K}."""
    names = ("elbow", "wrist", "hand")
    found = np.array([scene.recovery.estimates.joint_bias_m[joint] for joint in names])  # type: ignore[index]
    true = np.array([scene.made.parameters["joint_bias"][joint] for joint in names])
    return found - found.mean(axis=0), true - true.mean(axis=0)


@pytest.mark.parametrize("seed", range(3))
def test_differences_between_joints(seed: int) -> None:
    """8 mm an axis and white noise: told apart to 3 mm rms where the motion is the clinical protocol."""
    found, true = differences(blind(arm(seed, joint_bias_m=0.008)))
    assert np.sqrt(np.mean((found - true) ** 2)) < 0.004  # of differences of 8 mm an axis; found 3.3 mm


def test_differences_between_joints_in_realistic_noise(realistic_arms: list[Scene]) -> None:
    for scene in realistic_arms:
        found, true = differences(scene)
        assert np.sqrt(np.mean((found - true) ** 2)) < 0.004  # of differences of 8 mm an axis; found 3.3 mm


def test_no_bias_is_invented(white_arms: list[Scene]) -> None:
    for scene in white_arms:
        found, true = differences(scene)
        assert not true.any()
        assert np.abs(found).max() < 0.003
        assert float(str(scene.recovery.estimates.joint_bias_sigma_m)) < 0.003
