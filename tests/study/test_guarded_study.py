"""A study that is damaged, limited, oddly named, or of earlier versions."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import parquet
from studies import BROKEN, NAMES, batch

from smoother.study.folder import StudyFolder, schema
from smoother.study.inputs import find_entries


def only_the_first(recordings: Path) -> None:
    for name in (*NAMES[1:], BROKEN):
        (recordings / name).unlink()


@pytest.mark.slow
def test_rows_tell_nothing_of_the_machine(in_here: None, recordings: Path, tmp_path: Path):
    """Neither the paths nor the machine's name are in rows and JSON, in failures' sentences neither."""
    out, figures = tmp_path / "out", tmp_path / "figures.json"
    assert batch(recordings, "-o", out, "--processes", 1, "--json", figures) == 1
    rows = [row for file in out.glob("results/*.parquet") for row in parquet.read_table(file).to_pylist()]
    listed = json.loads(figures.read_text())
    assert len(rows) == len(listed["rows"]) == len(NAMES) + 1
    assert socket.gethostname() not in json.dumps([*rows, *listed["rows"]], default=str)
    for text in (json.dumps(rows, default=str), figures.read_text()):
        assert BROKEN in text and NAMES[0] in text
        assert str(tmp_path) not in text and os.sep + "tmp" not in text
        changed = [str((recordings / name).stat().st_mtime_ns) for name in (*NAMES, BROKEN)]
        assert not any(time_ns in text for time_ns in changed)  # the day of the recording, mostly


@pytest.mark.skipif(sys.platform != "linux", reason="limits the memory as Linux does")
@pytest.mark.parametrize("megabytes", [150])
def test_too_little_memory_for_any_process(recordings: Path, tmp_path: Path, megabytes: int):
    """Its processes would start and never answer: it says so before."""
    program = (
        f"import resource; resource.setrlimit(resource.RLIMIT_DATA, ({megabytes} << 20,) * 2);"
        "from smoother.cli import main; main()"
    )
    words = [sys.executable, "-c", program, "batch", str(recordings), "-o", str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1 and f"{megabytes} MB per process here (ulimit -d)" in done.stderr


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="names as bytes")
def test_a_name_that_is_no_utf8(
    in_here: None, recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for name in (b"p\xff.mcap", b"p%FF.mcap", b"p\x1b[31m.mcap"):
        shutil.copy(recordings / NAMES[0], os.fsencode(recordings) + b"/" + name)
    os.rename(recordings / BROKEN, os.fsencode(recordings) + b"/broken\xfe.mcap")
    entries = find_entries(str(recordings), tmp_path / "out")
    assert {"p%FF.mcap", "p%1B[31m.mcap", "broken%FE.mcap"} < {entry.name for entry in entries}
    assert len({entry.name for entry in entries}) == len(entries)
    json_file = tmp_path / "f.json"
    assert batch(recordings, "-o", tmp_path / "out", "--processes", 1, "--json", json_file) == 1
    figures = json.loads(json_file.read_text(encoding="utf-8"))
    assert figures["done"] == len(entries) - 1 and figures["failed"] == 1, figures["failures"]
    assert "\x1b" not in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("lost", ["results", "study", "word"])
def test_what_the_program_needs_was_removed(in_here: None, recordings: Path, tmp_path: Path, lost: str):
    only_the_first(recordings)
    out = tmp_path / "out"
    assert batch(recordings, "-o", out, "--processes", 1) == 0
    if lost == "word":
        (out / ".unocclude" / "study").write_bytes(b"\xff\xfe damaged")
    elif lost == "study":
        (out / ".unocclude" / "study").unlink()
    else:
        shutil.rmtree(out / lost)
    (recordings / NAMES[0]).touch()
    assert batch(recordings, "-o", out, "--processes", 1, *(["--force"] if lost == "study" else [])) == 0


@pytest.mark.slow
@pytest.mark.parametrize("how", ["cut", "rubbish", "empty"])
def test_a_damaged_row(
    in_here: None, recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], how: str
):
    """A file of rows that cannot be read is said; its recording is done again."""
    only_the_first(recordings)
    out = tmp_path / "out"
    assert batch(recordings, "-o", out, "--processes", 1) == 0
    files = sorted(out.glob("results/*.parquet"))
    content = files[0].read_bytes()
    files[0].write_bytes({"cut": content[: len(content) // 2], "rubbish": os.urandom(500), "empty": b""}[how])
    capsys.readouterr()
    assert batch(recordings, "-o", out, "--processes", 1) == 0
    assert "was damaged" in " ".join(capsys.readouterr().out.split())
    assert batch(recordings, "-o", out, "--processes", 1) == 0


@pytest.mark.skipif(os.name != "posix", reason="links")
def test_a_result_never_replaces_its_recording(in_here: None, recordings: Path, tmp_path: Path):
    """The folder of results leads back to the recordings by a link."""
    only_the_first(recordings)
    out = tmp_path / "out"
    assert batch(recordings, "-o", out, "--processes", 1) == 0
    before = (recordings / NAMES[0]).read_bytes()
    folder = (out / NAMES[0]).parent
    shutil.rmtree(folder) if folder != out else (out / NAMES[0]).unlink()
    if folder != out:
        folder.symlink_to((recordings / NAMES[0]).parent)
    else:
        (out / NAMES[0]).symlink_to(recordings / NAMES[0])
    assert batch(recordings, "-o", out, "--processes", 1) == 1
    assert (recordings / NAMES[0]).read_bytes() == before


def test_rows_of_earlier_and_later_versions(tmp_path: Path):
    """One file lacks a column, one has one more; of each recording the latest row counts."""
    folder = StudyFolder(tmp_path)
    folder.results.mkdir()
    assert folder.rows().equals(schema().empty_table())
    for number, name in enumerate("aab"):
        row = {"id": str(number), "recording": name, "finished": datetime(2026, 1, 3 - number)}
        table = pa.Table.from_pylist([row], schema=schema())
        table = table.drop_columns(["version"]) if number == 1 else table.append_column("later", [[1]])
        parquet.write_table(table, folder.results / f"rows-{number}.parquet")
    assert folder.rows()["id"].to_pylist() == ["0", "2"]
    assert folder.rows(("recording", "finished")).column_names == ["recording", "finished"]
