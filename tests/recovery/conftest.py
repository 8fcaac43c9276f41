"""A recording of three sections and its recovery, made once a session."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scenes import ALONE

from smoother import Recovery, smooth
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm


@pytest.fixture(scope="session")
def three_minutes() -> SimulatedArm:
    """Three minutes with an occlusion of 2 s every 10 s: three sections."""
    return simulate_arm(
        ArmSimulation.preset(
            "white",
            protocol="random",
            duration_s=180.0,
            imu_rate_hz=80.0,
            occlusion_lengths_s=(2.0,),
            occlusion_every_s=10.0,
        ),
        seed=8,
    )


@pytest.fixture(scope="session")
def sectioned(three_minutes: SimulatedArm) -> Recovery:
    """Its recovery, section by section."""
    return smooth(replace(three_minutes.recording, truth=None), three_minutes.calibration, ALONE)
