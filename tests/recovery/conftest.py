"""A recording of three sections and its recovery, made once a session."""

from __future__ import annotations

import pytest
from scenes import answer, moving

from smoother import Recovery
from smoother.simulation import SimulatedArm


@pytest.fixture(scope="session")
def three_minutes() -> SimulatedArm:
    """Three minutes with an occlusion of 2 s every 10 s: three sections."""
    often = {"occlusion_lengths_s": (2.0,), "occlusion_every_s": 10.0}
    return moving(8, "white", 180.0, imu_rate_hz=80.0, **often)


@pytest.fixture(scope="session")
def sectioned(three_minutes: SimulatedArm) -> Recovery:
    """Its recovery, section by section."""
    return answer(three_minutes.recording, three_minutes.calibration)
