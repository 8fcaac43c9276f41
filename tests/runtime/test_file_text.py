"""TOML as Notepad and PowerShell write it, in every file that a user may give."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from calib.file import CalibrationFile, read_calibration, write_calibration
from calib.intrinsics import read_intrinsics
from smoother.cli.config import read_config
from smoother.errors import UnoccludeError
from smoother.evaluation.measure_agreement import read_mdc_toml
from smoother.evaluation.mocap.motion import read_marker_map
from smoother.io.tables.recording_toml import read_description
from smoother.runtime.inputs import toml_text

ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-32")
LENS = "width = 640\nheight = 480\nfx = 500\nfy = 500\ncx = 320\ncy = 240\n"


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_reader_takes_it(tmp_path: Path, encoding: str) -> None:
    def write(text: str, name: str = "a.toml") -> Path:
        path = tmp_path / name
        path.write_bytes(("# \u00fc\r\n" + text.replace("\n", "\r\n")).encode(encoding))
        return path

    assert read_config(write("[windows]\nmargin_s = 2.5\n")).windows.margin_s == 2.5
    assert read_marker_map(write('[markers]\nwrist = ["RAD", "ULN"]\n')).joints["wrist"] == ("RAD", "ULN")
    assert read_mdc_toml(write("[mdc95]\nhand_reach_alpha_l = 0.1\n")) == {"hand_reach_alpha_l": 0.1}
    assert read_intrinsics(write(LENS)).fx == 500
    write('[imu.forearm_right]\nfile = "imu.csv"\n', "recording.toml")
    assert read_description(tmp_path).imu["forearm_right"].file == "imu.csv"
    path = write("[clock]\noffset_s = 0.5\n")
    assert read_calibration(path).tables["clock"]["offset_s"] == 0.5
    write_calibration(path, CalibrationFile({}, {"clock": {"offset_s": 0.7}}))
    assert path.read_text(encoding="utf-8").startswith("# \u00fc\n")  # a comment is kept
    assert read_calibration(path).tables["clock"]["offset_s"] == 0.7


@pytest.mark.parametrize("raw", [b'a = "\xe4"\n', b"\xff\xfea"])
def test_what_is_no_text_is_one_sentence(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(raw)
    with pytest.raises(ValueError, match="it is not UTF-8 text"):
        toml_text(path)
    for read in (read_config, read_marker_map, read_calibration, read_mdc_toml, read_intrinsics):
        with pytest.raises(UnoccludeError, match="not UTF-8 text"):
            read(path)


READERS = (read_config, read_marker_map, read_calibration, read_mdc_toml, read_intrinsics)


def refused(folder: Path, text: str, said: str) -> None:
    path = folder / "recording.toml"
    path.write_text(text, encoding="utf-8")
    for read in (*READERS, lambda path: read_description(path.parent)):
        began = time.monotonic()
        with pytest.raises(UnoccludeError, match=said):
            read(path)
        assert time.monotonic() - began < 2


def test_a_key_of_many_parts_is_refused_at_once(tmp_path: Path) -> None:
    """One of 20,000 parts took 26 s and ended in a RecursionError."""
    many = ".".join(["a"] * 20_000)
    for text in (f"{many} = 1\n", f"[{many}]\n", f"[[ {many} ]]\n", f"b = {{ {many} = 1 }}\n"):
        refused(tmp_path, "# first\n" + text, "tables within tables")
    quoted = ". ".join(["'a = b'", '"c\\".d"'] * 10_000)
    refused(tmp_path, f"{quoted} = 1\n", "tables within tables")
    for depth in (40, 3000):
        refused(tmp_path, f"a = {depth * '['}{depth * ']'}\n", "tables within tables")
        refused(tmp_path, f"a = {depth * '{a = '}1{depth * '}'}\n", "tables within tables")


def test_a_file_that_is_no_settings_is_not_read_whole(tmp_path: Path) -> None:
    """TOML of 2 GB was read into memory."""
    path = tmp_path / "recording.toml"
    with open(path, "wb") as file:
        file.truncate(2_000_000_000)  # a hole: no disk is used
    began = time.monotonic()
    for read in (*READERS, lambda path: read_description(path.parent)):
        with pytest.raises(UnoccludeError, match="longer than 1 MB"):
            read(path)
    assert time.monotonic() - began < 2
