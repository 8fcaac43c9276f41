"""Four people who do the same at once, one IMU on each right wrist: UTD-MHAD through the files."""

from __future__ import annotations

from pathlib import Path

import pytest

from smoother.io import import_utd_mhad, open_recording, write_recording
from smoother.io.recording.select import match_file

pytestmark = pytest.mark.real


@pytest.mark.parametrize("action", [2, 8, 13, 20])
def test_four_at_once(datasets: Path, tmp_path: Path, action: int) -> None:
    folder = datasets / "utd_mhad"
    group = [
        import_utd_mhad(
            folder / "Inertial" / f"a{action}_s{subject}_t3_inertial.mat",
            folder / "Skeleton" / f"a{action}_s{subject}_t3_skeleton.mat",
        )
        for subject in range(1, 5)
    ]
    write_recording(group, tmp_path / "four.mcap")
    matches, _ = match_file(open_recording(tmp_path / "four.mcap"))
    assert [match.imu for match in matches] == [
        "/imu/forearm_right" + suffix for suffix in ("", "_2", "_3", "_4")
    ]
    # Found by motion alone, though the names say `forearm_right` of all four.
    assert [(m.limb and m.limb.body, m.joint) for m in matches] == [(b, "wrist_right") for b in range(4)]
