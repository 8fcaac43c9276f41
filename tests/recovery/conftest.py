"""A recording of three sections and its recovery, made once a session."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scenes import ALONE, arm

from smoother import Recovery
from smoother.simulation import SimulatedArm
from smoother.smoothing import smooth


@pytest.fixture(scope="session")
def three_minutes() -> SimulatedArm:
    """Three minutes with an occlusion of 2 s every 10 s: three sections."""
    often = {"occlusion_lengths_s": (2.0,), "occlusion_every_s": 10.0}
    return arm(8, protocol="random", duration_s=180.0, imu_rate_hz=80.0, **often)


@pytest.fixture(scope="session")
def sectioned(three_minutes: SimulatedArm) -> Recovery:
    """Its recovery, section by section."""
    return smooth(replace(three_minutes.recording, truth=None), three_minutes.calibration, ALONE)
