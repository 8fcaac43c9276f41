"""The tool's own way to a clock agrees with the simulated one, and its table counts what it says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from smoother.simulation import ArmSimulation, simulate_arm
from tools.accuracy.pairing import crossed, known_clock_s, rows_of


def test_both_ways_know_a_clock() -> None:
    made = simulate_arm(ArmSimulation.preset("white", protocol="random", duration_s=20.0), 4)
    recording = made.recording
    late = replace(recording, arm=replace(recording.arm, t_s=recording.arm.t_s - 3.0))
    assert known_clock_s(late) == pytest.approx(3.0 + made.parameters["clock_offset_s"], abs=0.1)


def test_a_table_of_right_and_wrong_pairs() -> None:
    config = ArmSimulation.preset("white", protocol="random", duration_s=30.0)
    simulated = [simulate_arm(config, seed) for seed in (5, 6)]
    pairs = [(replace(each.recording, truth=None), each.parameters["clock_offset_s"]) for each in simulated]
    right, wrong = rows_of("random", [*crossed(pairs)])
    assert "right    2: proved    2, accepted of one recorder    2" in right and "2 of 2" in right
    assert "wrong    2: proved    0, accepted of one recorder    0" in wrong
