"""TOML as Notepad and PowerShell write it, in every file that a user may give."""

from __future__ import annotations

from pathlib import Path

import pytest

from calib.file import CalibrationFile, read_calibration, write_calibration
from calib.panel.definition import read_intrinsics
from smoother.cli.config_file import read_config
from smoother.errors import UnoccludeError
from smoother.evaluation.measure_files import _detectable_of_user
from smoother.evaluation.mocap.marker_map import read_marker_map
from smoother.io.plain.folder import _describe
from smoother.runtime.file_text import toml_text

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
    assert _detectable_of_user(write("[mdc95]\nhand_reach_alpha_l = 0.1\n")) == {"hand_reach_alpha_l": 0.1}
    assert read_intrinsics(write(LENS)).fx == 500
    write('[imu.forearm_right]\nfile = "imu.csv"\n', "recording.toml")
    assert _describe(tmp_path).imu["forearm_right"].file == "imu.csv"
    path = write("[clock]\noffset_s = 0.5\n")
    assert read_calibration(path).tables["clock"]["offset_s"] == 0.5
    write_calibration(path, CalibrationFile({}, {"clock": {"offset_s": 0.7}}))
    assert path.read_text(encoding="utf-8").startswith("# \u00fc\n")  # a comment is kept
    assert read_calibration(path).tables["clock"]["offset_s"] == 0.7


@pytest.mark.parametrize("raw", [b'a = "\xe4"\n', b"\xff\xfea"])
def test_what_is_no_text_is_one_sentence(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(raw)
    with pytest.raises(ValueError, match="it is no UTF-8 text"):
        toml_text(path)
    for read in (read_config, read_marker_map, read_calibration, _detectable_of_user, read_intrinsics):
        with pytest.raises(UnoccludeError, match="no UTF-8 text"):
            read(path)
