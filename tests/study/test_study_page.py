"""The page over a study, and the table while it runs."""

from __future__ import annotations

import json
from collections import deque
from datetime import datetime
from io import StringIO

import numpy as np
import pyarrow as pa
import pytest
from rich.console import Console

from smoother.cli.batch import headline, progress_table
from smoother.cli.run import NOT_TRUSTED, run
from smoother.errors import UnoccludeError
from smoother.report.study import worst_first, write_study
from smoother.study.columns import COLUMNS, schema
from smoother.study.run import Tally


def row(name: str, **more: object) -> dict:
    empty = {column: None for column, *_ in COLUMNS}
    done = {"recording": name, "output": name, "status": "done", "duration_s": 60.0, "seconds": 2.0}
    figures = {"gaps": 2, "gap_longest_s": 1.5, "occluded_s": 2.0, "sigma_max_m": 0.02, "sigma_max_deg": 1.0}
    rest = {"clock_offset_s": 0.03, "notes": 1, "note_texts": ["the <b> camera"], "finished": datetime.now()}
    return empty | done | figures | rest | more


def test_worst_first_and_links(tmp_path):
    names = ["a.mcap", "day 1/b&c.mcap", "d.mcap", "e.mcap"]
    sigmas = [0.01, 0.09, None, 0.03]
    rows = [row(name, sigma_max_m=sigma) for name, sigma in zip(names, sigmas, strict=True)]
    rows.append(row("f.mcap", status="failed", error="f.mcap is <empty>", output=None))
    (tmp_path / "pages").mkdir()
    page = tmp_path / "pages" / "study.html"
    write_study(pa.Table.from_pylist(rows, schema=schema()), page, tmp_path / "out")
    text = page.read_text(encoding="utf-8")
    links = [
        text.index(f'href="../out/{name}"') for name in ("day%201/b%26c.mcap", "e.mcap", "a.mcap", "d.mcap")
    ]
    assert links == sorted(links), "by their largest sigma, the one without a gap last"
    assert "4 of 5 recordings were recovered, 1 failed" in text and "f.mcap is &lt;empty&gt;" in text
    assert "4 x: the &lt;b&gt; camera" in text and "30 times real time" in text
    with pytest.raises(UnoccludeError, match="--force"):
        write_study(pa.Table.from_pylist(rows, schema=schema()), page, tmp_path / "out")


def test_a_study_of_failures_alone(tmp_path):
    rows = [row("a.mcap", status="failed", error="it is broken", duration_s=None, sigma_max_m=None)]
    write_study(pa.Table.from_pylist(rows, schema=schema()), tmp_path / "page.html", tmp_path)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "0 of 1 recordings were recovered, 1 failed" in text and "it is broken" in text


def test_order_with_gapless_recordings_last():
    judged = np.ones(4), np.zeros(4)
    assert worst_first(np.array([np.nan, 0.1, 0.3, 0.2]), *judged).tolist() == [2, 3, 1, 0]


def test_what_is_not_to_be_trusted_stands_first():
    sigma = np.array([0.3, 0.1, 0.2, np.nan, 0.05])
    trusted, untrusted = np.array([1, np.nan, 0, 0, 1.0]), np.array([0, 0, 2, 0, 1.0])
    assert worst_first(sigma, trusted, untrusted).tolist() == [2, 3, 4, 0, 1]


def test_the_page_of_a_study_with_untrusted_results(tmp_path):
    mirrored = {"trusted": False, "verdict": "Not to be trusted: <mirrored>.", "gaps_untrusted": 2}
    rows = [
        row("a.mcap", sigma_max_m=0.0912, trusted=True, gaps_untrusted=0),
        row("b.mcap", sigma_max_m=0.0123, **mirrored),
        row("c.mcap", sigma_max_m=0.0456, trusted=True, gaps_untrusted=1),
    ]
    write_study(pa.Table.from_pylist(rows, schema=schema()), tmp_path / "page.html", tmp_path)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert '<div class="summary alarm">' in text and "1 result is not to be trusted" in text
    assert "1 result has gaps that are not to be trusted" in text
    table = text[text.index("<tbody>") : text.index("</tbody>")]
    links = [table.index(f'href="{name}.mcap"') for name in "bca"]
    assert links == sorted(links)
    assert "not to be trusted</span> &lt;mirrored&gt;." in table and "1 of 2 gaps not</span>" in table
    assert "9.12" in table and "4.56" in table and "1.23" not in table, "its sigma is withdrawn"
    sound = [row("a.mcap", trusted=True, gaps_untrusted=0)]
    write_study(pa.Table.from_pylist(sound, schema=schema()), tmp_path / "sound.html", tmp_path)
    assert '<div class="summary">' in (tmp_path / "sound.html").read_text(encoding="utf-8")


def test_the_end_of_batch_names_them_first(tmp_path, monkeypatch, capsys):
    rows = [
        row("a.mcap", sigma_max_m=0.09, trusted=True, gaps_untrusted=0),
        row(
            "b.mcap",
            sigma_max_m=0.01,
            trusted=False,
            verdict="Not to be trusted: mirrored.",
            gaps_untrusted=2,
        ),
    ]

    def end(rows: list[dict], *options: str) -> tuple[int, dict, str]:
        table = pa.Table.from_pylist(rows, schema=schema())
        monkeypatch.setattr("smoother.study.run.run_study", lambda *rest: (Tally(len(rows)), table))
        monkeypatch.setattr("smoother.study.inputs.find_entries", lambda *rest: [])
        capsys.readouterr()
        code = run(["batch", "x", "-o", str(tmp_path), "--json", str(tmp_path / "j.json"), *options])
        return code, json.loads((tmp_path / "j.json").read_text()), capsys.readouterr().out

    code, figures, said = end(rows)
    assert code == 0 and figures["not_trusted"] == 1 and figures["partly_trusted"] == 0
    assert figures["untrusted"] == [{"recording": "b.mcap", "verdict": "Not to be trusted: mirrored."}]
    assert said.index("b.mcap") < said.index("a.mcap")
    assert "1 of 2 results are not to be trusted:\n  b.mcap: Not to be trusted: mirrored.\n" in said
    assert end(rows, "--strict")[0] == NOT_TRUSTED
    assert end(rows[:1], "--strict")[0] == 0
    failed = row("c.mcap", status="failed", error="it is broken", output=None, sigma_max_m=None)
    assert end([*rows, failed], "--strict")[0] == 1, "what failed counts first"


def test_the_table_while_it_runs():
    tally = Tally(10, before=2, computed=3, failed=1, recorded_s=180.0)
    tally.began -= 6.0
    assert headline(tally).startswith("6 of 10, 1 failed; 30 times real time, 0:00:06 left")
    latest = deque(
        [
            row("a.mcap"),
            row("w.mcap", trusted=False),
            row("b.mcap", status="failed", error="it [is] broken", duration_s=None),
        ]
    )
    console = Console(width=120, file=StringIO())
    console.print(progress_table(tally, latest))
    shown = console.file.getvalue()
    assert "not to be trusted" in shown
    assert "a.mcap" in shown and "2.0" in shown and "it [is] broken" in shown
