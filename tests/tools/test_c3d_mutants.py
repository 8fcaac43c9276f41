"""A few of the damaged C3D files: none ends the reader."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from smoother.io.markers import read_c3d
from tools.faults.c3d import ENDS, mutants, outcome, sound_files

pytest.importorskip("ezc3d")
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="mutants are read in forked processes")


def test_some_mutants(tmp_path: Path):
    files = sound_files(tmp_path, [])
    path = tmp_path / "mutant.c3d"
    ends: Counter[str] = Counter()
    for data in files:
        path.write_bytes(data)
        assert outcome(path, read_c3d(path).position) == (ENDS[0], "")
    assert outcome(path, np.zeros((1, 1, 3)))[0] == ENDS[1]
    drawn = mutants(files, 27, 1)
    assert drawn == mutants(files, 27, 1) and len({data for _, _, data in drawn}) > 25
    for _, _, data in drawn:
        path.write_bytes(data)
        ends[outcome(path, np.zeros((1, 1, 3)))[0]] += 1
    assert ends[ENDS[3]] == 0 and ends[ENDS[2]] > 5 and ends[ENDS[1]] > 5


def test_what_is_unexpected_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tools.faults.c3d.read_c3d", lambda path: os.abort())
    assert outcome(tmp_path / "a.c3d", np.zeros(1)) == (ENDS[3], "ended by signal 6")
    monkeypatch.setattr("tools.faults.c3d.read_c3d", lambda path: 1 / 0)
    assert outcome(tmp_path / "a.c3d", np.zeros(1))[1].startswith("ZeroDivisionError")
