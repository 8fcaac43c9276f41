"""Specific force against gravity: a wrong scale is told from a bias, from motion and from a gyroscope."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.recording import ImuStream
from smoother.recovery.imu_signs import doubtful_scale, force_scale, wrong_scale
from smoother.rotation import Rotation
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.units import STANDARD_GRAVITY

NO_BIAS = np.zeros(3)


def arm(protocol: str, seed: int = 1) -> ImuStream:
    length = {"duration_s": 30.0} if protocol == "random" else {}
    return simulate_arm(ArmSimulation.preset("realistic", protocol=protocol, **length), seed).recording.imu


def poses(turns: list[np.ndarray], still_s: float = 5.0, rate_hz: float = 50.0) -> ImuStream:
    """A sensor that rests, turns about an axis within a second, and rests again."""
    count, during = round(still_s * rate_hz), (np.arange(round(rate_hz)) + 0.5) / rate_hz
    rates = [np.zeros((count, 3))]
    for turn in turns:
        rates += [2.0 * np.sin(np.pi * during[:, None]) ** 2 * turn, np.zeros((count, 3))]
    rate = np.concatenate(rates)
    R = Rotation.from_rotvec(np.zeros(3))
    force = np.empty_like(rate)
    for row, each in enumerate(rate):  # the slow way: sample after sample, each at its interval's middle
        half = Rotation.from_rotvec(0.5 * each / rate_hz)
        force[row] = (R * half).inv().apply([0.0, 0.0, STANDARD_GRAVITY])
        R = R * half * half
    return ImuStream("poses", (np.arange(len(rate)) + 0.5) / rate_hz, force, rate)


def turned() -> ImuStream:
    return poses([np.array(turn, float) * np.pi / 2 for turn in ([1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 0, 1])])


@pytest.mark.parametrize("protocol", ["random", "hang", "behind"])
def test_a_sound_accelerometer(protocol: str) -> None:
    for seed in (1, 2):
        scale = force_scale(arm(protocol, seed), NO_BIAS)
        assert scale is not None and abs(scale.ratio - 1.0) < 0.03
        assert [*wrong_scale(scale), *doubtful_scale(scale)] == []


@pytest.mark.parametrize("protocol", ["random", "hang", "behind"])
@pytest.mark.parametrize("factor", [0.5, 0.75, 1.3, 2.0])
def test_a_wrong_scale_is_not_to_be_trusted(protocol: str, factor: float) -> None:
    """0.5 to 2 g at rest were accepted."""
    imu = arm(protocol)
    (said,) = wrong_scale(force_scale(replace(imu, acc=factor * imu.acc), NO_BIAS))
    assert abs(float(said.split("reads ")[1].split()[0]) / STANDARD_GRAVITY / factor - 1.0) < 0.04
    assert (f"as if its range were {factor:g} times as wide" in said) == (factor in (0.5, 2.0))


def test_a_scale_that_is_somewhat_off_is_a_caution() -> None:
    imu = arm("behind")
    for factor, word in ((0.92, "little"), (1.09, "much")):
        scale = force_scale(replace(imu, acc=factor * imu.acc), NO_BIAS)
        assert [*wrong_scale(scale)] == []
        (said,) = doubtful_scale(scale)
        assert f"% too {word} where gravity alone acts" in said


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_bias_is_no_scale(axis: int, sign: int) -> None:
    """A tenth of g along one axis, as real sensors have it: several poses show it, a single one does not."""
    bias = 0.1 * STANDARD_GRAVITY * sign * np.eye(3)[axis]
    moved = turned()
    scale = force_scale(replace(moved, acc=moved.acc + bias), NO_BIAS)
    assert scale is not None and abs(scale.ratio - 1.0) < 0.02 and not scale.is_doubtful
    for imu in (arm("random"), arm("hang"), poses([])):
        scale = force_scale(replace(imu, acc=imu.acc + bias), NO_BIAS)
        assert scale is not None and [*wrong_scale(scale)] == []


def test_rest_gives_the_scale_itself() -> None:
    scale = force_scale(turned(), NO_BIAS)
    assert scale is not None and abs(scale.ratio - 1.0) < 1e-3 and scale.sigma < 0.01


def test_a_gyroscope_at_fault_is_not_the_accelerometers() -> None:
    imu = arm("random")
    for gyro in (-imu.gyro, np.radians(imu.gyro), imu.gyro * [1, 1, -1]):
        assert [*wrong_scale(force_scale(replace(imu, gyro=gyro), NO_BIAS))] == []


def test_short_and_empty_streams() -> None:
    imu = arm("random")
    assert force_scale(imu.select(slice(0, 3)), NO_BIAS) is None
    for rows in (slice(0, 40), slice(0, 160)):
        assert [*wrong_scale(force_scale(imu.select(rows), NO_BIAS))] == []
    assert force_scale(replace(imu, acc=0.0 * imu.acc), NO_BIAS) is None
    clipped = replace(imu, gyro=np.clip(imu.gyro, -0.5, 0.5))
    assert [*wrong_scale(force_scale(clipped, NO_BIAS))] == []


@pytest.mark.real
def test_sensors_of_others_are_sound() -> None:
    """UTD-MHAD's has a bias of 0.095 g along one axis; its clips are of 2 to 6 s."""
    folder = os.environ.get("UNOCCLUDE_DATASETS")
    if folder is None:
        pytest.skip("UNOCCLUDE_DATASETS is not set")
    from scipy.io import loadmat

    bias = np.radians([-2.2, 1.0, -1.0])
    for path in sorted(Path(folder, "utd_mhad", "Inertial").glob("*_t1_inertial.mat"))[::4]:
        samples = loadmat(path)["d_iner"]
        imu = ImuStream(
            path.name,
            np.arange(len(samples)) / 50,
            samples[:, :3] * STANDARD_GRAVITY,
            np.radians(samples[:, 3:]),
        )
        scale = force_scale(imu, bias)
        assert [*wrong_scale(scale), *doubtful_scale(scale)] == [], path.name
    for path in sorted(Path(folder, "broad").glob("*.mat")):
        trial = loadmat(path)
        imu = ImuStream(
            path.name, np.arange(len(trial["imu_acc"])) / 285.714, trial["imu_acc"], trial["imu_gyr"]
        )
        scale = force_scale(imu, NO_BIAS)
        assert [*wrong_scale(scale), *doubtful_scale(scale)] == [], path.name
