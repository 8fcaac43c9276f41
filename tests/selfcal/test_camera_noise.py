"""The camera's noise from residuals: white, and with a memory."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from smoother.array_types import FloatArray
from smoother.measurements.outliers import JointNoise
from smoother.recording import JOINTS
from smoother.selfcal.camera_noise import SMALLEST_SIGMA_M, joint_noise, sigma_by_joint
from smoother.window.problem import JointMeasurements, Window
from smoother.window.solution import Solution

STEP_S = 1 / 30


def sight_of(joint: str, node: np.ndarray) -> JointMeasurements:
    """Samples at nodes, of which only the times are looked at."""
    nothing = np.zeros((len(node), 3))
    return JointMeasurements(joint, STEP_S * node, node, nothing, np.full(len(node), 0.01), nothing, nothing)


def window_of(*measured: JointMeasurements) -> Window:
    """A window of which only the samples are looked at."""
    return cast("Window", SimpleNamespace(joint_measurements=measured))


def noise_in(*windows: dict[str, FloatArray]) -> dict[str, JointNoise]:
    """From the residuals of windows, by joint, a frame each."""
    sights = [
        window_of(*(sight_of(joint, np.arange(len(values))) for joint, values in residuals.items()))
        for residuals in windows
    ]
    return joint_noise(sights, [cast("Solution", SimpleNamespace(residuals=each)) for each in windows])


def remembering(phi: float, sigma: float, count: int, rng: np.random.Generator) -> FloatArray:
    """Stationary noise (count, 3), each sample phi times the one before and something new."""
    drive = sigma * np.sqrt(1 - phi**2) * rng.normal(size=(count + 500, 3))
    return np.asarray(lfilter([1.0], [1.0, -phi], drive, axis=0)[500:])


def memory_of(tau_s: float) -> float:
    """How much of a sample is in the next one."""
    return float(np.exp(-STEP_S / tau_s))


@pytest.mark.parametrize("seed", range(8))
def test_no_memory_is_called_where_none_is(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = {"elbow": 0.004, "wrist": 0.008, "hand": 0.020}
    windows = [{j: s * rng.normal(size=(240, 3)) for j, s in sizes.items()} for _ in range(6)]
    noise = noise_in(*windows)
    for joint, sigma in sizes.items():
        assert noise[joint].sample_m == pytest.approx(sigma, rel=0.05)
        assert noise[joint].effective_m == noise[joint].sample_m
        assert noise[joint].memory_m == 0.0


@pytest.mark.parametrize("white", [0.0, 1.0])
@pytest.mark.parametrize("tau_s", [0.3, 0.6])
@pytest.mark.parametrize("seed", range(4))
def test_noise_with_a_memory(tau_s: float, white: float, seed: int) -> None:
    """Long-run variance: (1 + phi) / (1 - phi) times that of the part with a memory, and the white part's."""
    rng, phi = np.random.default_rng(seed), memory_of(tau_s)
    windows = [
        {
            joint: remembering(phi, 0.008, 600, rng) + white * 0.008 * rng.normal(size=(600, 3))
            for joint in ("elbow", "wrist", "hand")
        }
        for _ in range(6)
    ]
    sample_m = 0.008 * np.sqrt(1.0 + white)
    effective_m = 0.008 * np.sqrt((1 + phi) / (1 - phi) + white)
    for each in noise_in(*windows).values():
        assert each.sample_m == pytest.approx(sample_m, rel=0.08)
        assert each.effective_m == pytest.approx(effective_m, rel=0.25)
        assert each.memory_m == pytest.approx(0.008, rel=0.15)  # three neighbours, so a little less


def test_what_the_answer_followed_is_put_back() -> None:
    """States follow the slowest part of an error: residuals without their mean over 3 s still tell most."""
    rng, phi = np.random.default_rng(0), memory_of(0.3)
    windows = []
    for _ in range(6):
        series = {joint: remembering(phi, 0.008, 630, rng) for joint in ("elbow", "wrist", "hand")}
        windows.append(
            {joint: x - uniform_filter1d(x, 90, axis=0, mode="nearest") for joint, x in series.items()}
        )
    truth_m = 0.008 * np.sqrt((1 + phi) / (1 - phi))
    for each in noise_in(*windows).values():
        assert each.effective_m == pytest.approx(truth_m, rel=0.25)


def test_lost_frames_do_not_hide_the_memory() -> None:
    """Lags are lags in time: with a third of the frames gone the answer is much the same."""
    rng, phi = np.random.default_rng(0), memory_of(0.3)
    windows, solutions = [], []
    for _ in range(6):
        series = remembering(phi, 0.008, 600, rng)
        seen = np.flatnonzero(rng.uniform(size=600) > 0.33)
        windows.append(window_of(sight_of("wrist", seen)))
        solutions.append(cast("Solution", SimpleNamespace(residuals={"wrist": series[seen]})))
    # a frame is dropped at times, so fewer samples share the same long-run error: the sigma is of all frames
    truth_m = 0.008 * np.sqrt((1 + phi) / (1 - phi))
    assert joint_noise(windows, solutions)["wrist"].effective_m == pytest.approx(truth_m, rel=0.3)


def test_outliers_hardly_count() -> None:
    rng = np.random.default_rng(1)
    noise = 0.008 * rng.normal(size=(3000, 3))
    noise[::50] += 0.5
    assert noise_in({"wrist": noise})["wrist"].sample_m < 0.010


def test_the_perfect_camera_has_a_floor() -> None:
    assert noise_in({"wrist": np.zeros((100, 3))})["wrist"].effective_m == SMALLEST_SIGMA_M


def test_a_few_samples_tell_no_memory() -> None:
    steps = np.cumsum(np.full((5, 3), 0.001), axis=0)
    noise = noise_in({"wrist": steps})["wrist"]
    assert noise.effective_m == noise.sample_m and noise.memory_m == 0.0


def test_the_shoulder_is_as_good_as_the_best() -> None:
    noise = {"elbow": JointNoise(0.01, 0.02, 0.0), "wrist": JointNoise(0.01, 0.015, 0.0)}
    by_joint = dict(zip(JOINTS, sigma_by_joint(noise, 0.5).tolist(), strict=True))
    assert by_joint == {joint: 0.02 if joint == "elbow" else 0.015 for joint in JOINTS}
    assert sigma_by_joint({}, 0.5).tolist() == [0.5] * 5
