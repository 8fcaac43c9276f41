"""Faults in files and in live sessions: none is silent, none unexpected."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from tools.faults import surroundings
from tools.faults.cases import Case, Workshop, all_cases
from tools.faults.surroundings import can_mount
from tools.live_faults.bench import Sound, forked, simulated, verdict_of
from tools.live_faults.kinds import KINDS

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> list[Case]:
    """Every case."""
    return all_cases(Workshop(tmp_path_factory.mktemp("shop"), seed=1))


def faults(*options: str) -> str:
    """What the tool prints; a process of its own, as cases are forked: this one has threads by now."""
    command = [sys.executable, "-m", "tools.faults", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, cwd=ROOT)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.skipif(not hasattr(os, "fork"), reason="cases run in forked processes")
def test_a_sample_of_the_matrix(made: list[Case], tmp_path: Path):
    containers = [case for case in made if case.family.startswith("MCAP")]
    assert len(made) >= 1200 and len(containers) >= 288
    # half of it first: what the log holds is not run again
    sample = ("--first", "7", "--quick", "--log", str(tmp_path / "log.jsonl"))
    faults(*sample, "--every", "180")
    before = (tmp_path / "log.jsonl").read_text().splitlines()
    last = faults(*sample, "--every", "90").splitlines()[-1]
    count, right, note, sentence, silent, unexpected = (int(number) for number in re.findall(r"\d+", last))
    assert len(before) == len([case for case in made[7::180] if not case.cpu_s])
    assert count == len([case for case in made[7::90] if not case.cpu_s])
    after = (tmp_path / "log.jsonl").read_text().splitlines()
    assert after[: len(before)] == before and len(after) == count > len(before)
    assert silent == unexpected == 0
    assert min(right, note, sentence) > 1  # the sample has all three


def test_the_list_of_faults_is_whole(made: list[Case]):
    """What is to be tried, whatever else is."""
    faults = {case.fault for case in made}
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


#: On a busy machine a kind takes some seconds.
LONGEST_S = 120.0


@pytest.fixture(scope="module")
def sound() -> Sound:
    """Twelve seconds of a sound session; its calibration is there after 8."""
    return Sound(simulated(4, 16.0, ()), 12.0)


@pytest.mark.parametrize(
    "kind, said",
    [
        ("IMU held for 1 s", "the gyroscope repeats a value; the camera is followed meanwhile"),
        ("other body 1 m away for 3 s", "the camera is left out: it jumped away"),
        ("IMU clock set back 0.1 s", "stepped by -0.100 s"),
    ],
)
def test_a_fault_is_said_and_the_answer_stays_within_its_sigma(sound, kind, said):
    verdict = forked(partial(verdict_of, kind, 4, sound), LONGEST_S)
    assert verdict.wrong_s <= 0.5, verdict
    (first,) = [line for line in verdict.said if said in line][:1]
    assert float(first.split(" s:")[0]) < 0.5  # seconds after it began


def test_a_sound_session_is_not_accused(sound):
    verdict = forked(partial(verdict_of, "nothing wrong", 4, sound), LONGEST_S)
    assert verdict.wrong_s == 0.0 and verdict.silent_s == 0.0
    assert verdict.said == ()
    assert verdict.sound_cm < 4.0


def test_there_are_more_than_thirty_kinds():
    assert len(KINDS) > 30
