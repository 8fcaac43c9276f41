"""Joint angles of simulated arms with one IMU: errors in gaps, and whether the stated intervals hold them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from tools.accuracy.angles import Z_95, AngleErrors, angle_errors, rows, simulated

#: Two arms, a left one and a right one; `tools.accuracy angles` measures many.
SEEDS = (20, 21)


@pytest.fixture(scope="module")
def errors() -> list[AngleErrors]:
    settings = {"repetitions": 1}
    return [each for seed in SEEDS for each in angle_errors(simulated(seed, "realistic", settings), imus=1)]


def pooled(errors: list[AngleErrors], name: str, hidden: bool) -> tuple[np.ndarray, np.ndarray]:
    mine = [(each, each.occluded == hidden) for each in errors if each.name == name]
    return (
        np.concatenate([each.off[rows] for each, rows in mine]),
        np.concatenate([each.sigma[rows] for each, rows in mine]),
    )


def test_flexion_in_gaps(errors: list[AngleErrors]) -> None:
    off, _ = pooled(errors, "elbow_flexion", hidden=True)
    assert len(off) > 200 and np.sqrt(np.mean(off**2)) < 3.0


@pytest.mark.parametrize("name", ["shoulder_plane", "shoulder_elevation", "shoulder_rotation"])
@pytest.mark.parametrize("hidden", [True, False])
def test_the_shoulder_lies_in_its_intervals(errors: list[AngleErrors], name: str, hidden: bool) -> None:
    off, sigma = pooled(errors, name, hidden)
    ratio = off / sigma
    # Most of an error is constant over a recording, so that two arms say little: 24 have 90 to 98 %.
    assert np.mean(np.abs(ratio) < Z_95) > 0.8 and np.mean(ratio**2) < 2.0
    assert np.median(sigma) < 12.0  # and not by saying nothing
    assert np.sqrt(np.mean(off**2)) < 12.0


def test_against_the_trunk_that_the_camera_sees(errors: list[AngleErrors]) -> None:
    for name in ("shoulder_plane_trunk", "shoulder_elevation_trunk", "shoulder_rotation_trunk"):
        off, sigma = pooled(errors, name, hidden=False)
        assert np.mean(np.abs(off / sigma) < Z_95) > 0.85 and np.median(sigma) < 15.0


def test_a_table_of_them(errors: list[AngleErrors]) -> None:
    lines = list(rows("realistic", errors))
    assert lines[0].split()[:2] == ["realistic", "elbow_flexion"] and lines[0].endswith("%")
    assert len({line.split()[1] for line in lines}) >= 7
