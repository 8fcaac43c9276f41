"""The page over a study, and the table while it runs."""

from __future__ import annotations

from collections import deque
from datetime import datetime
from io import StringIO

import numpy as np
import pyarrow as pa
import pytest
from rich.console import Console

from smoother.cli.batch_progress import headline, progress_table
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
    assert worst_first(np.array([np.nan, 0.1, 0.3, 0.2])).tolist() == [2, 3, 1, 0]


def test_the_table_while_it_runs():
    tally = Tally(10, before=2, computed=3, failed=1, recorded_s=180.0)
    tally.began -= 6.0
    assert headline(tally).startswith("6 of 10, 1 failed; 30 times real time, 0:00:06 left")
    latest = deque([row("a.mcap"), row("b.mcap", status="failed", error="it [is] broken", duration_s=None)])
    console = Console(width=120, file=StringIO())
    console.print(progress_table(tally, latest))
    shown = console.file.getvalue()
    assert "a.mcap" in shown and "2.0" in shown and "it [is] broken" in shown
