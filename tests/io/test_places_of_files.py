"""recording.toml reads files of its own folder, and a message never shows a line of another file."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from smoother.errors import UnoccludeError
from smoother.io import open_csv

IMU = "t_s,ax,ay,az,gx,gy,gz\n" + "".join(f"{i / 100},0,0,9.81,0,0,0\n" for i in range(50))
SECRET = "admin:c0rrect-horse:battery,staple\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "secret.csv").write_text(SECRET)
    (tmp_path / "imu.csv").write_text(IMU)
    (tmp_path / "rec").mkdir()
    return tmp_path / "rec"


def describe(folder: Path, keys: str) -> None:
    (folder / "recording.toml").write_text(f"[imu.forearm_right]\n{keys}\n")


@pytest.mark.parametrize(
    "keys",
    [
        'file = "../imu.csv"',
        'file = "{outside}/imu.csv"',
        'file = ["imu.csv", "../imu.csv"]',
        'file = "link.csv"',
        'file = "deeper/../../imu.csv"',
        'file = "imu.csv"\n[truth]\nfile = "../imu.csv"',
        'file = "imu.csv"\n[camera]\nframe = "kinect"\nskeleton = "../imu.csv"',
    ],
)
def test_files_elsewhere_need_a_word(folder: Path, keys: str):
    (folder / "imu.csv").write_text(IMU)
    (folder / "link.csv").symlink_to("../imu.csv")
    describe(folder, keys.format(outside=folder.parent))
    with pytest.raises(UnoccludeError, match=r"lies outside its folder.*--outside"):
        open_csv(folder)


def test_with_the_word_they_are_read(folder: Path):
    describe(folder, 'file = "../imu.csv"')
    assert len(open_csv(folder, outside=True).imus[0].stamp_ns) == 50


def test_a_folder_named_by_a_link_is_its_own(folder: Path):
    (folder / "imu.csv").write_text(IMU)
    describe(folder, 'file = "imu.csv"')
    (folder.parent / "other").symlink_to(folder)
    assert len(open_csv(folder.parent / "other").imus) == 1


@pytest.mark.parametrize("more", ["", "skip_rows = 0", 'separator = ","', "rate_hz = 100.0"])
def test_no_line_of_another_file_is_shown(folder: Path, more: str):
    describe(folder, f'file = "../secret.csv"\n{more}')
    with pytest.raises(UnoccludeError) as told:
        open_csv(folder, outside=True)
    assert "secret.csv" in str(told.value)
    assert not any(word in str(told.value) for word in ("admin", "horse", "battery", "staple"))


@pytest.mark.parametrize("more", ["", "skip_rows = 0", "rate_hz = 100.0"])
def test_a_pipe_or_device_is_refused(folder: Path, more: str):
    os.mkfifo(folder / "imu.csv")
    describe(folder, f'file = "imu.csv"\n{more}')
    with pytest.raises(UnoccludeError, match="is a pipe"):
        open_csv(folder)
    describe(folder, f'file = "/dev/zero"\n{more}')
    with pytest.raises(UnoccludeError, match="is a pipe"):
        open_csv(folder, outside=True)


def test_a_name_with_nul(folder: Path):
    describe(folder, 'file = "imu\\u0000.csv"')
    with pytest.raises(UnoccludeError, match="not a file's name"):
        open_csv(folder)
