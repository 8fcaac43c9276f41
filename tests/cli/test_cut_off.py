"""A file that was cut off is said by every command that reads it, on the terminal and in the figures."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from smoother.cli.run import run

WORDS = "the file ends in the middle of the recording"


def call(*arguments: object) -> int:
    return run([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording and its result, and both without their last part."""
    folder = tmp_path_factory.mktemp("cut")
    options = ("--protocol", "random", "--duration-s", 20, "--seed", 4)
    assert call("simulate", "arm", *options, "-o", folder / "whole.mcap") == 0
    assert (
        call("smooth", folder / "whole.mcap", "-o", folder / "result.mcap", "--processes", 1, "--draws", 0)
        == 0
    )
    (folder / "study").mkdir()
    for name, to in (("whole", "cut"), ("whole", "study/cut"), ("result", "cut_result")):
        content = (folder / f"{name}.mcap").read_bytes()
        (folder / f"{to}.mcap").write_bytes(content[: int(0.85 * len(content))])
    return folder


COMMANDS = (
    ("info", "cut.mcap"),
    ("smooth", "cut.mcap", "-o", "out.mcap", "--processes", "1", "--draws", "0"),
    ("gaps", "cut.mcap", "--lengths", "0.5", "--gaps-per-run", "1", "--processes", "1"),
    ("compare", "cut.mcap", "--methods", "hold", "--processes", "1"),
    ("calibrate", "motion", "cut.mcap", "-o", "arm.toml", "--processes", "1"),
    ("export", "cut_result.mcap", "--format", "csv", "-o", "out.csv"),
    ("validate", "cut_result.mcap", "--truth", "whole.mcap"),
    ("batch", "study", "-o", "answers", "--processes", "1"),
)


@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda arguments: arguments[0])
def test_it_is_said(
    folder: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
):
    monkeypatch.chdir(folder)
    assert call(*arguments, "--json", "figures.json", "--force") == 0
    assert WORDS in capsys.readouterr().out
    assert WORDS in json.dumps(json.loads((folder / "figures.json").read_text()))


def test_a_whole_file_is_not_called_cut(folder: Path, capsys: pytest.CaptureFixture[str]):
    assert call("validate", folder / "result.mcap", "--truth", folder / "whole.mcap") == 0
    assert call("info", folder / "whole.mcap") == 0
    assert WORDS not in capsys.readouterr().out
