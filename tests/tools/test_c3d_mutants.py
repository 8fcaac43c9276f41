"""A few of the damaged C3D files: none ends the reader."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from smoother.io.markers import read_c3d
from tools.faults.c3d import ENDS, mutants, outcome, sound_files

pytest.importorskip("ezc3d")
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="mutants are read in forked processes")


def test_some_mutants(tmp_path: Path):
    files = sound_files(tmp_path, [])
    drawn = mutants(files, 27, 1)
    assert drawn == mutants(files, 27, 1) and len({data for _, _, data in drawn}) > 25
    # in a process of its own: files are read in forked ones, and this one has threads by now
    command = [sys.executable, "-m", "tools.faults.c3d", "--count", "27"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, cwd=Path(__file__).parents[2])
    assert done.returncode == 0, done.stdout + done.stderr
    _, whole = done.stdout.split("| all | ")
    count, *ends = (int(number) for number in re.findall(r"\d+", whole.splitlines()[0]))
    assert count == sum(ends) == 27 and ends[ENDS.index("unexpected")] == 0
    assert ends[1] > 5 and ends[2] > 5


def test_a_file_is_as_it_was_or_another(tmp_path: Path):
    path = tmp_path / "sound.c3d"
    path.write_bytes(sound_files(tmp_path, [])[0])
    assert outcome(path, read_c3d(path).position) == (ENDS[0], "")
    assert outcome(path, np.zeros((1, 1, 3)))[0] == ENDS[1]


def test_what_is_unexpected_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tools.faults.c3d.read_c3d", lambda path: os.abort())
    assert outcome(tmp_path / "a.c3d", np.zeros(1)) == (ENDS[3], "ended by signal 6")
    monkeypatch.setattr("tools.faults.c3d.read_c3d", lambda path: 1 / 0)
    assert outcome(tmp_path / "a.c3d", np.zeros(1))[1].startswith("ZeroDivisionError")
