"""docs/exports.md: its links lead somewhere and its examples work."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
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
    table, arm = re.findall(r"^```python\n(.*?)^```", text(), re.DOTALL | re.MULTILINE)
    exec(compile(table, "exports.md", "exec"), {})
    assert capsys.readouterr().out.split() == ["b'm'", "graph"]
    # Rerun itself is not needed to see that the lines go through: what they log is.
    logged = []

    class Rerun:
        def init(self, *_, **__):
            pass

        set_time = init

        def log(self, name, strips):
            logged.append((name, strips))

        def LineStrips3D(self, strips, colors, radii):
            return np.array(strips), colors, radii

    names = {"__name__": "example"}
    monkeypatch.setitem(__import__("sys").modules, "rerun", Rerun())
    exec(compile(arm, "exports.md", "exec"), names)
    assert len(logged) == len(recovery)
    strips, colors, _ = logged[400][1]
    wrist = recovery.joints["wrist"][400]
    np.testing.assert_array_equal(strips[0][2], wrist)
    assert colors == [[230, 115, 13]] if recovery.occluded[400] else [[26, 115, 191]]
