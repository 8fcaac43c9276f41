"""The documents, README included: links, commands, options, quoted sentences."""

from __future__ import annotations

import ast
import re
import shlex
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from markdown_it import MarkdownIt
from markdown_it.token import Token
from typer.exceptions import TyperException

from calib import read_calibration
from smoother.io.result.write import write_recovery
from smoother.io.tables.recording_toml import _Description
from smoother.result import Draws, Recovery

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (
        *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "data/README.md")),
        *(path for path in (ROOT / "docs").rglob("*.md") if "generated" not in path.parts),
    )
)


def text_of(document: str | Path) -> str:
    return (ROOT / document).read_text(encoding="utf-8")


@cache
def tokens(text: str) -> list[Token]:
    """All of a document, flat, as CommonMark has it."""
    parsed = MarkdownIt().enable("table").parse(text)
    return [each for token in parsed for each in (token, *(token.children or ()))]


def blocks(text: str, *languages: str) -> list[str]:
    """Fenced blocks in some languages."""
    return [each.content for each in tokens(text) if each.type == "fence" and each.info.strip() in languages]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_links_lead_somewhere(document: str) -> None:
    links = [each for each in tokens(text_of(document)) if each.type in ("link_open", "image")]
    for target in (str(each.attrs.get("href", each.attrs.get("src"))) for each in links):
        if re.match(r"[a-z]+:", target):  # another site: not followed, but an address all the same
            assert re.fullmatch(r"https://[a-z0-9.-]+\.[a-z]+(/\S*)?", target), f"{document}: {target}"
            continue
        name, _, anchor = target.partition("#")
        path = (ROOT / document).parent / name if name else ROOT / document
        assert path.exists(), f"{document} links to {target}: there is no such file"
        if anchor and not document.startswith("docs/"):  # the site's build checks its own pages
            titles = re.findall(r"^#+ (.+)", path.read_text(encoding="utf-8").lower(), re.MULTILINE)
            assert anchor in [re.sub(r"[^\w\- ]", "", each).replace(" ", "-") for each in titles], target


def code_lines(text: str) -> Iterator[str]:
    """Lines of code in a document: fenced, indented, and between backticks on a line of text."""
    for each in tokens(text):
        if each.type == "fence" and each.info.strip() in ("", "sh", "{code-cell} ipython3"):
            yield from (line.strip() for line in re.sub(r"\\\n\s*", " ", each.content).splitlines())
        elif each.type == "code_block":
            yield from each.content.splitlines()
        elif each.type == "code_inline":
            yield " ".join(each.content.split())


@cache
def cli() -> Any:
    from smoother.cli.app import app

    return typer.main.get_command(app)


def parse(words: list[str]) -> None:
    """As the command line does, as far as names go: an error where one does not exist."""
    command = cli()
    while words and words[0] not in ("..", "NAME") and hasattr(command, "resolve_command"):
        _, command, words = command.resolve_command(typer.Context(command), words)
    command.make_parser(typer.Context(command)).parse_args(words)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_commands_and_options_exist(document: str):
    for line in code_lines(text_of(document)):
        match = re.match(r"\s*(?:TMPDIR=\S+ )?!?unocclude (.*)", line)
        try:
            words = shlex.split(match[1] if match else "", comments=True)
        except ValueError:
            words = match[1].split()
        if not words or not re.fullmatch(r"[a-z][\w-]*", words[0]):
            continue
        try:
            parse(words)
        except TyperException as error:  # an option that is named alone lacks its value
            assert "requires an argument" in str(error), f"{document}: {line.strip()}: {error}"


@cache
def sentences() -> str:
    """Every text in the program, formatted values as {}, on one line each."""
    texts = []
    for path in sorted(path for folder in ("smoother", "calib") for path in (ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = [v.value if isinstance(v, ast.Constant) else "{}" for v in node.values]
                texts.append(" ".join("".join(map(str, parts)).split()))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(" ".join(node.value.split()))
    return "\n".join(texts)


def quoted(document: str) -> list[str]:
    """What a document's tables say that the program prints: italics in the first two columns."""
    rows = [line.split("|")[1:3] for line in text_of(document).splitlines() if line.startswith("|")]
    return [
        text for row in rows for cell in row for text in re.findall(r"(?<![*\w])\*([^*]+)\*(?![*\w])", cell)
    ]


@pytest.mark.slow
def test_troubleshooting_quotes_the_program():
    texts = quoted("docs/troubleshooting.md")
    assert len(texts) > 40
    missing = [text for text in texts if text.strip() not in sentences()]
    assert not missing, f"docs/troubleshooting.md quotes what the program does not say: {missing}"


def numberless(text: str) -> str:
    """A text whose numbers do not count, on one line."""
    return " ".join(re.sub(r"\d+(\.\d+)?", "N", text).split())


@pytest.mark.slow
def test_the_tutorial_runs_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any):
    from smoother.cli.run import run

    text, _ = text_of("docs/tutorial.md").split("## 8.")
    monkeypatch.chdir(tmp_path)
    lines = [line for line in code_lines(text) if line.startswith("unocclude ") and "doctor" not in line]
    commands = [shlex.split(line, comments=True)[1:] for line in lines]
    assert [words[0] for words in commands][:4] == ["simulate", "info", "smooth", "validate"]
    for words in commands:
        assert run(words) == 0, words
    printed = numberless(capsys.readouterr().out)
    answers = [line for block in blocks(text, "text") for line in block.splitlines()]
    assert len(answers) >= 3
    for answer in answers:
        assert numberless(answer) in printed, answer


def test_figures_of_the_readme_are_those_of_the_results():
    rows = [
        line.split("|", 2)[2] for line in text_of("README.md").splitlines() if re.match(r"\|.* cm \|", line)
    ]
    figures = [re.findall(r"\d+\.\d+", row) for row in rows]
    results = [re.findall(r"\d+\.\d+", line) for line in text_of("docs/results.md").splitlines()]
    assert len(figures) >= 6
    for row in figures:
        assert row and any(Counter(row) <= Counter(other) for other in results), row


@pytest.mark.slow
def test_notebook_in_six_lines(monkeypatch):
    (code,) = blocks(text_of("docs/api.md"), "python")
    statements = [line for line in code.splitlines() if line.strip()]
    assert len(statements) <= 6
    monkeypatch.chdir(ROOT)
    names: dict = {}
    exec(compile(code, "docs/api.md", "exec"), names)
    assert isinstance(names["recovery"], Recovery)
    assert len(names["hidden_wrist"]) > 100
    assert np.isfinite(names["hidden_wrist"]).all()
    assert 0 < names["largest_sigma"] < 0.1


def test_examples_of_files(tmp_path):
    description, calibration = blocks(text_of("docs/formats.md"), "toml")
    assert _Description.model_validate(tomllib.loads(description)).camera.frame == "kinect"
    (tmp_path / "cal.toml").write_text(calibration, encoding="utf-8")
    arm = read_calibration(tmp_path / "cal.toml").arm("right")
    assert arm.upper_arm is not None and arm.R_F_A is not None and "elbow" in arm.lever_arms


def test_topics_and_columns(tmp_path):
    from mcap.reader import make_reader

    from smoother import read_recording
    from smoother.config import Config
    from smoother.io.export.prepare import file_columns
    from smoother.result import SegmentMotion, TrunkMotion
    from smoother.smoothing import smooth

    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    recording = read_recording(ROOT / "data" / "demo.mcap")
    recovery = smooth(recording, None, Config.model_validate({"windows": {"processes": 1}}))
    own = (recovery.position, recovery.quaternion, recovery.pose_covariance)
    # as if with IMUs on the upper arm, the hand and the trunk
    trunk = TrunkMotion(recovery.quaternion, recovery.pose_covariance[:, 3:, 3:], np.eye(3), np.zeros(3))
    recovery = replace(
        recovery, segments=dict.fromkeys(("upper_arm", "hand"), SegmentMotion(*own, np.zeros(3))), trunk=trunk
    )
    still = np.zeros((20, 2, 3), np.float32)
    ends = recovery.t_s[[0, -1]]
    draws = Draws(ends, 0, still, still, dict.fromkeys(recovery.joints, still), {"upper_arm": still})
    write_recovery(replace(recovery, draws=draws), tmp_path / "out.mcap")
    with open(tmp_path / "out.mcap", "rb") as file:
        channels = make_reader(file).get_summary().channels.values()
    assert {channel.topic for channel in channels} == set(re.findall(r"`(/unocclude/\w+)`", text))
    families = {re.sub(r"_?(q[wxyz]|[xyz])$", "", name) for name, *_ in file_columns(recovery)}
    families.discard("v")
    for family in families:
        assert f"`{family}" in text, family


def test_version_is_the_same_everywhere():
    from smoother import __version__

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert project["dynamic"] == ["version"]  # of smoother/__init__.py, and nowhere else
    assert f"version: {__version__}\n" in citation
    assert project["authors"][0]["name"] in citation
