"""The bench of faults: no kind may make the answer wrong for longer than half a second."""

from __future__ import annotations

import multiprocessing

import pytest

from smoother.simulation import ArmSimulation, simulate_arm
from tools import live_faults as bench

SEED, AT_S = 1, 17.0


@pytest.fixture(scope="module")
def sound() -> bench.Sound:
    made = {"protocol": "random", "duration_s": 32.0, "imu_rate_hz": 100, "occlusion_lengths_s": (1.0,)}
    bench.sound = bench.Sound(simulate_arm(ArmSimulation.preset("realistic", **made), SEED), AT_S)
    return bench.sound


@pytest.mark.slow
@pytest.mark.parametrize("kind", bench.KINDS)
def test_no_fault_makes_it_wrong_for_long(sound: bench.Sound, kind: str):
    with multiprocessing.get_context("fork").Pool(1) as pool:
        (wrong_s, *_), _ = pool.apply_async(bench.verdict, (kind, SEED, "forearm")).get(bench.LONGEST_S)
    assert wrong_s <= bench.MOST_S
