"""Windows side by side in processes: the same answer, byte for byte."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

import smoother.pool
from smoother import Config, Recovery, smooth
from smoother.pool import Pool

from .scenes import point


def recover(processes: int) -> Recovery:
    made = point(5, duration_s=20.0)
    config = Config.model_validate({"windows": {"processes": processes}})
    return smooth(replace(made.recording, truth=None), made.calibration, config)


def test_two_processes_give_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    alone = recover(1)
    monkeypatch.setattr(smoother.pool, "WORTH_NODES", 10)
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
