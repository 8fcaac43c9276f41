"""One case in thirty of the matrix of faults: none is silent, none unexpected."""

from __future__ import annotations

import os
import subprocess
import time
from collections import Counter
from pathlib import Path

import pytest

from tools.faults import surroundings
from tools.faults.__main__ import ENDS, run_all, table
from tools.faults.cases import Case, Workshop, all_cases
from tools.faults.surroundings import can_mount


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Workshop, list[Case]]:
    """Sound files and every case."""
    shop = Workshop(tmp_path_factory.mktemp("shop"), seed=1)
    return shop, all_cases(shop)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="cases run in forked processes")
def test_a_sample_of_the_matrix(made: tuple[Workshop, list[Case]]):
    shop, cases = made
    containers = [case for case in cases if case.family.startswith("MCAP")]
    assert len(cases) >= 1200 and len(containers) >= 288
    outcomes = run_all([case for case in cases[7::30] if not case.cpu_s], shop, shown=False)
    ends = Counter(outcome.end for outcome in outcomes)
    worst = [(o.case.family, o.case.name, o.text) for o in outcomes if o.end in ENDS[3:]]
    assert not worst
    assert min(ends["right"], ends["note"], ends["sentence"]) > 3  # the sample has all three
    assert f"**{len(outcomes)}**" in table(outcomes)


def test_outcomes_are_not_computed_twice(made: tuple[Workshop, list[Case]], tmp_path: Path):
    shop, cases = made
    cases = [case for case in cases if case.family == "CSV, imu.csv"][:3]
    log = tmp_path / "log.jsonl"
    first = run_all(cases[:2], shop, shown=False, log=log)
    lines = log.read_text().splitlines()
    assert len(lines) == 2
    again = run_all(cases, shop, shown=False, log=log)
    assert log.read_text().splitlines()[:2] == lines and len(log.read_text().splitlines()) == 3
    assert [(o.end, o.text) for o in again[:2]] == [(o.end, o.text) for o in first]


def test_the_list_of_faults_is_whole(made: tuple[Workshop, list[Case]]):
    """What is to be tried, whatever else is."""
    faults = {case.fault for case in made[1]}
    wanted = """
        IMU nan|IMU inf|IMU 1e300|IMU denormal|spikes of 1 %|a spike of one sample|one IMU sample|two frames
        |IMU at 1 Hz|IMU at 10 kHz|camera at 240 Hz|joints in one point|an hour without the camera
        |IMU missing for half|imu stamp back|imu stamp repeated|imu stamp 2554|imu stamp zero
        |imu stamp 10 days|camera stamp 10 days
        |little memory|two runs on one output|a worker killed|ledger of a study damaged
    """
    assert {fault.strip() for fault in wanted.split("|")} <= faults
    if can_mount():
        wanted = "disk for outputs full|disk for temporary files full|a folder that cannot be written to"
        assert set(wanted.split("|")) <= faults


def test_a_command_that_never_ends_is_killed_with_its_children(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(surroundings, "LONGEST_S", 1)
    began = time.monotonic()
    program = subprocess.Popen(
        ["sh", "-c", "sleep 600; true"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    printed, said = surroundings.ended_in_time(program)
    assert not printed and "did not end within 1 s" in said and program.returncode == -9
    assert time.monotonic() - began < 60
    assert surroundings.end_of(surroundings.Ended(-9, "", said, []), "")[0] == "UNEXPECTED"
