"""What comes in: TOML as editors write it, requests to a local server, rows of CSV, packages of an extra."""

from __future__ import annotations

import csv
import io
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest

from calib.file import CalibrationFile, read_calibration, write_calibration
from calib.intrinsics import read_intrinsics
from smoother.cli.config import read_config
from smoother.errors import UnoccludeError
from smoother.evaluation.mocap.motion import read_marker_map
from smoother.evaluation.progress import read_detectable
from smoother.io.tables.recording_toml import read_description
from smoother.runtime.csv_rows import read_cell, write_rows
from smoother.runtime.inputs import toml_text
from smoother.runtime.local_requests import is_token, joined, refusal
from smoother.runtime.packages import extra_module
from smoother.study.inputs import _rows

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
    assert read_detectable(write("[mdc95]\nhand_reach_alpha_l = 0.1\n")) == {"hand_reach_alpha_l": 0.1}
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
    for read in (read_config, read_marker_map, read_calibration, read_detectable, read_intrinsics):
        with pytest.raises(UnoccludeError, match="not UTF-8 text"):
            read(path)


READERS = (read_config, read_marker_map, read_calibration, read_detectable, read_intrinsics)


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


OWN = {"host": "127.0.0.1:8080", "origin": "http://127.0.0.1:8080"}


@pytest.mark.parametrize(
    ("headers", "changes", "by_address", "expected"),
    [
        (OWN, True, False, ""),
        ({"host": "localhost:8080"}, False, False, ""),
        ({"host": "localhost:8080"}, True, False, "site"),
        ({"host": "127.0.0.1:8081"}, False, False, "host"),
        ({"host": "evil.example:8080"}, False, True, "host"),
        ({}, False, False, "host"),
        (OWN | {"origin": "http://localhost:8080"}, True, False, "site"),
        (OWN | {"origin": "https://evil.example"}, False, True, "site"),
        (OWN | {"origin": "null"}, True, False, "site"),
        (OWN | {"sec-fetch-site": "cross-site"}, False, False, "site"),
        (OWN | {"sec-fetch-site": "same-site"}, True, False, "site"),
        ({"host": OWN["host"], "sec-fetch-site": "cross-site"}, False, True, ""),
    ],
)
def test_a_page_of_ones_own(headers, changes, by_address, expected):
    assert refusal(headers, 8080, changes, by_address) == expected


def test_a_header_that_repeats_fits_no_value():
    headers = joined([("Host", "127.0.0.1:8080"), ("HOST", "evil.example"), (" Origin ", " null ")])
    assert headers == {"host": "127.0.0.1:8080, evil.example", "origin": "null"}
    assert refusal(headers, 8080, changes=False) == "host"


def test_tokens():
    assert is_token("secret", "secret")
    assert not any(is_token(given, "secret") for given in ("", "secre", "secret ", "\ud800", "sécret"))


FORMULAS = ('=HYPERLINK("http://x")', "+1+cmd", "-2+3", "@SUM(A1)", "\t=1", " =1", "'=1")
NO_FORMULAS = ("-2.5", "+1e-3", -2.5, "a=b", "", None, "'a")


@pytest.mark.parametrize("value", [*FORMULAS, *NO_FORMULAS])
def test_a_formula_is_a_text(value: object):
    file = io.StringIO()
    write_rows(file, [["x", value]])
    ((_, cell),) = csv.reader(io.StringIO(file.getvalue(), newline=""))
    text = "" if value is None else str(value)
    assert cell == (f"'{text}" if value in FORMULAS else text) and read_cell(cell) == text


def test_tables_of_a_study(tmp_path: Path):
    with (tmp_path / "sessions.csv").open("w") as file:
        write_rows(file, [("file", "person", "session"), ("a.mcap", "=p", "-s1")])
    ((_, cells),) = _rows(tmp_path / "sessions.csv")
    assert (cells["person"], cells["session"]) == ("=p", "-s1"), "names are the same again"


@pytest.mark.parametrize("submodules", [(), ("blueprint",)])
def test_what_is_missing_is_asked_for(submodules: tuple[str, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", ModuleType("rerun") if submodules else None)
    with pytest.raises(UnoccludeError) as error:
        extra_module("rerun", "rerun-sdk", "view", submodules=submodules)
    sentence = (
        "this needs rerun-sdk, which is not installed; get it with `pip install '.[view]'` in the program's"
    )
    assert str(error.value) == f"{sentence} folder"


@pytest.mark.parametrize("version, said", [("0.9", "foxglove-sdk 0.9"), (None, "foxglove-sdk")])
def test_what_is_too_old_is_said(version: str | None, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    old = ModuleType("foxglove")
    old.Context = object  # type: ignore[attr-defined]
    if version is not None:
        old.__version__ = version  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "foxglove", old)
    assert extra_module("foxglove", "foxglove-sdk", "live", ["Context"]) is old
    with pytest.raises(UnoccludeError) as error:
        extra_module("foxglove", "foxglove-sdk", "live", ["Context", "start_server"])
    assert str(error.value) == f"{said} is too old; `pip install -U '.[live]'` in the program's folder"
