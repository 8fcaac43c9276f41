"""Recoveries that several tests look at, made once a session."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from browser import Browser, chromium
from hypothesis import HealthCheck, settings
from scenes import SEEDS, Scene, arm, blind, point, recovered

# a machine that is busy with something else is no fault of a strategy
settings.register_profile("any machine", suppress_health_check=[HealthCheck.too_slow], deadline=None)
settings.load_profile("any machine")


@pytest.fixture(scope="session")
def white_point() -> Scene:
    """The strap alone, four gaps of 0.5 to 3 s."""
    return recovered(point(1))


@pytest.fixture(scope="session")
def white_arms() -> list[Scene]:
    """The clinical protocol, 8 mm of white noise, nothing calibrated: four gaps of 1 to 2 s each."""
    return [blind(arm(seed)) for seed in SEEDS]


@pytest.fixture(scope="session")
def realistic_arms() -> list[Scene]:
    """Joint biases, correlated noise, a late camera, wobble, dropped frames; nothing calibrated."""
    return [blind(arm(seed, "realistic")) for seed in SEEDS]


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    if (program := chromium()) is None:
        pytest.skip("Chromium is not installed (apt install chromium)")
    opened = Browser(program)
    yield opened
    opened.close()
