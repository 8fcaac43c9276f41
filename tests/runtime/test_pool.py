"""Sections side by side in processes: the same answer, byte for byte."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from scenes import point

import smoother.runtime.pool
from smoother import Config, Recovery, smooth
from smoother.runtime.pool import Pool


def recover(processes: int) -> Recovery:
    made = point(5, duration_s=130.0)  # two sections
    config = Config.model_validate({"windows": {"processes": processes}})
    return smooth(replace(made.recording, truth=None), made.calibration, config)


def test_two_processes_give_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    alone = recover(1)
    monkeypatch.setattr(smoother.runtime.pool, "WORTH_FRAMES", 10)
    with Pool(2, 100) as pool:
        assert pool._executor is not None  # the threshold is what decides
    together = recover(2)
    for field in fields(Recovery):
        a, b = getattr(alone, field.name), getattr(together, field.name)
        if isinstance(a, np.ndarray):
            assert a.tobytes() == b.tobytes(), field.name
    assert alone.gaps == together.gaps
    for joint, track in alone.joints.items():
        assert track.tobytes() == together.joints[joint].tobytes()


def test_a_small_job_starts_no_process() -> None:
    with Pool(2, 100) as pool:
        assert pool._executor is None
    with Pool(1, 10**6) as pool:
        assert pool._executor is None


SCRIPT = """
from dataclasses import replace

import smoother.runtime.pool
from smoother import Config, smooth
from smoother.simulation import PointSimulation, simulate_point

print("begun")
smoother.runtime.pool.WORTH_FRAMES = 10
recording = replace(simulate_point(PointSimulation(duration_s=12.0), 5).recording, truth=None)
recovery = smooth(recording, None, Config.model_validate({"windows": {"processes": 2}}))
print("recovered", len(recovery))
"""


@pytest.mark.parametrize("how", ["file", "stdin"])
def test_a_plain_script_without_a_guard(how: str, tmp_path: Path) -> None:
    """No `if __name__ == "__main__"`: the workers must not run the script again."""
    script = tmp_path / "plain.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, str(script) if how == "file" else "-"],
        input=None if how == "file" else SCRIPT,
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["begun", "recovered", "960"]
    assert "Traceback" not in done.stderr
