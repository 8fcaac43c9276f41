"""docs/exports.md: its links lead somewhere and its examples work."""

from __future__ import annotations

import re
from pathlib import Path

from results import made

from smoother.cli.export import FORMATS
from smoother.io import prepare_export

DOCUMENT = Path(__file__).parents[3] / "docs" / "exports.md"


def text() -> str:
    return DOCUMENT.read_text(encoding="utf-8")


def test_links_lead_somewhere():
    for target in re.findall(r"\]\(([^)#:]+)(?:#[\w-]*)?\)", text()):
        assert (DOCUMENT.parent / target).exists(), target
    for anchor in re.findall(r"\]\(#([\w-]+)\)", text()):
        assert re.search(rf"^#+ {anchor}$", text().lower(), re.MULTILINE), anchor


def test_every_format_is_described():
    for name in FORMATS:
        assert f"| `{name}` |" in text()


def test_the_columns_are_those_that_are_written(tmp_path):
    ready = prepare_export(made(), "mot")
    ready.write(tmp_path / "a.mot", False)
    columns = (tmp_path / "a.mot").read_text().partition("endheader\n")[2].partition("\n")[0].split("\t")
    for name in columns[1:]:
        assert f"| `{name}` |" in text()


def test_examples_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recovery = made()
    prepare_export(recovery, "parquet").write(Path("out.parquet"), False)
    (table,) = re.findall(r"^```python\n(.*?)^```", text(), re.DOTALL | re.MULTILINE)
    exec(compile(table, "exports.md", "exec"), {})
    assert capsys.readouterr().out.split() == ["b'm'", "graph"]
