"""Every reader refuses a pipe, a device or a link to nothing in one sentence, and does not wait for it."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from importers import import_csv

import smoother
from calib.file import read_calibration
from calib.images import read_view
from calib.intrinsics import read_intrinsics
from calib.panel import read_panel
from smoother.cli.config import read_config
from smoother.errors import UnoccludeError
from smoother.evaluation.mocap.motion import read_marker_map
from smoother.io import describe, open_recording, read_recording, read_recovery
from smoother.io.datasets import import_utd_mhad
from smoother.io.files import ImuFiles, import_files
from smoother.io.mcap.container import Container
from smoother.io.recording.read import read_imu
from smoother.io.rig.clock import read_broadcast, read_sound
from smoother.io.rig.images import read_images
from smoother.io.tables.columns import read_exact as read_strict
from smoother.io.tables.columns import read_pose_table
from smoother.io.tables.markers import read_c3d, read_markers, read_positions, read_trc
from smoother.io.tables.table import read_head, read_table
from smoother.study.inputs import file_hash, find_entries

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
#: No reader waits so long for a writer, s; on a busy machine the processes of `batch` take 10 s to start.
LONGEST_S = 60

READERS: dict[str, Callable[[Path], object]] = {
    "a.mcap": read_recording,
    "b.mcap": open_recording,
    "c.mcap": describe,
    "d.mcap": read_imu,
    "e.mcap": read_recovery,
    "f.mcap": smoother.smooth,
    "g.mcap": lambda path: list(Container(path).chunks()),
    "h.mcap": lambda path: list(read_images(path)),
    "i.mcap": read_sound,
    "a.toml": read_calibration,
    "b.toml": read_config,
    "c.toml": read_marker_map,
    "d.toml": read_panel,
    "e.toml": read_intrinsics,
    "recording.toml": lambda path: import_csv(path.parent),
    "a.c3d": read_c3d,
    "b.c3d": read_markers,
    "c.c3d": read_positions,
    "a.trc": read_trc,
    "b.trc": read_markers,
    "a.csv": lambda path: read_strict(path, ["t_s"]),
    "b.csv": read_table,
    "c.csv": read_head,
    "d.csv": read_pose_table,
    "e.csv": read_positions,
    "f.csv": lambda path: read_broadcast(path, 1e-6),
    "g.csv": lambda path: import_files([path], [ImuFiles((path,))]),
    "a.wav": read_sound,
    "a.mat": lambda path: import_utd_mhad(path, path),
    "a.png": lambda path: read_view(path, path),
    "a.bin": file_hash,
    "list.txt": lambda path: find_entries(str(path), path.parent / "study"),
}


@pytest.fixture(autouse=True)
def limited() -> Iterator[None]:
    """A reader that waits ends the test, not the whole of the tests."""

    def stop(number: int, frame: object) -> None:
        raise TimeoutError("the reader waits for a writer")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(LONGEST_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("name", READERS)
def test_a_pipe_is_refused(tmp_path: Path, name: str):
    os.mkfifo(tmp_path / name)
    with pytest.raises(UnoccludeError, match="is a pipe") as told:
        READERS[name](tmp_path / name)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("name", ["a.mcap", "f.mcap", "a.toml", "a.c3d", "a.trc", "a.csv"])
def test_a_device_by_a_link_is_refused(tmp_path: Path, name: str):
    (tmp_path / name).symlink_to("/dev/tty0" if Path("/dev/tty0").exists() else "/dev/null")
    with pytest.raises(UnoccludeError, match="a device"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("name", READERS)
def test_a_link_that_leads_nowhere_is_said_to_be_one(tmp_path: Path, name: str):
    """It was "does not exist", of a name that the folder shows."""
    (tmp_path / name).symlink_to("gone")
    for leads in ("gone", name):
        with pytest.raises(UnoccludeError, match=f"is a link to {leads}, which cannot be read") as told:
            READERS[name](tmp_path / name)
        assert "\n" not in str(told.value)
        (tmp_path / name).unlink()
        (tmp_path / name).symlink_to(name)


def test_a_list_from_a_shell_is_read(tmp_path: Path):
    """What `batch <(ls)` gives is a pipe too, with its writer there."""
    (tmp_path / "a.mcap").write_bytes(b"")
    reading, writing = os.pipe()
    os.write(writing, f"{tmp_path}/a.mcap\n".encode())
    os.close(writing)
    try:
        entries = find_entries(f"/dev/fd/{reading}", tmp_path / "study")
    finally:
        os.close(reading)
    assert [entry.path for entry in entries] == [f"{tmp_path}/a.mcap"]
