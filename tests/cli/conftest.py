"""A recording that several files of tests use."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import done


@pytest.fixture(scope="session")
def ten_seconds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seconds with an occlusion (`rec.mcap`), its motion capture and its calibration."""
    folder = tmp_path_factory.mktemp("ten_seconds")
    done(
        *("simulate", "arm", "--set", "protocol=random", "--set", "duration_s=10", "--seed", 6),
        *("-o", folder / "rec.mcap", "--mocap", "--calibration-out", folder / "cal.toml"),
    )
    return folder
