"""A study that is damaged, limited, oddly named, or of earlier versions."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import dataset, parquet
from studies import BROKEN, NAMES, batch

from smoother.study.cluster import run_local
from smoother.study.folder import DONE, FAILED, Row, rows_table, schema
from smoother.study.inputs import find_entries
from smoother.study.job import Job, Limits, StudySettings, TimeUp, limited, run_job
from smoother.study.ledger import Ledger
from smoother.study.run import study_folder


def only_the_first(recordings: Path) -> None:
    for name in (*NAMES[1:], BROKEN):
        (recordings / name).unlink()


def test_rows_tell_nothing_of_the_machine(in_here: None, recordings: Path, tmp_path: Path):
    """Neither the paths nor the machine's name are in rows and JSON, in failures' sentences neither."""
    out, figures = tmp_path / "out", tmp_path / "figures.json"
    assert batch(recordings, "-o", out, "--processes", 1, "--json", figures) == 1
    rows = [row for file in out.glob("results/*.parquet") for row in parquet.read_table(file).to_pylist()]
    listed = json.loads(figures.read_text())
    assert len(rows) == len(listed["rows"]) == len(NAMES) + 1
    assert {row["host"] for row in [*rows, *listed["rows"]]} == {""}
    for text in (json.dumps(rows, default=str), figures.read_text()):
        assert BROKEN in text and NAMES[0] in text
        assert str(tmp_path) not in text and os.sep + "tmp" not in text
        changed = [str((recordings / name).stat().st_mtime_ns) for name in (*NAMES, BROKEN)]
        assert not any(time_ns in text for time_ns in changed)  # the day of the recording, mostly
    kept = tmp_path / "kept"
    assert batch(recordings, "-o", kept, "--processes", 1, "--keep-paths", "--json", figures, "--force") == 1
    listed = json.loads(figures.read_text())
    assert {row["host"] for row in listed["rows"]} == {socket.gethostname()}
    assert listed["rows"][0]["input"] == str(recordings / listed["rows"][0]["recording"])


@pytest.mark.skipif(sys.platform != "linux", reason="limits the memory as Linux does")
@pytest.mark.parametrize("megabytes", [150, 340])
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


@pytest.mark.parametrize("earlier", [False, True])
def test_it_is_known_again_without_its_path(job: Job, earlier: bool):
    """A row of an earlier version has the time of change itself."""
    row = run_job(job)
    folder = study_folder(Path(job.folder))
    if earlier:
        (left,) = folder.rows.glob("*.json")
        of_then = json.loads(left.read_text()) | {"input_mtime_ns": Path(job.source).stat().st_mtime_ns}
        left.write_text(json.dumps({name: value for name, value in of_then.items() if name != "input_state"}))
    settings = (job.config_hash, "", job.version)
    ledger = Ledger(folder)
    assert ledger.find(job.name, job.source, settings)[0] == row["id"]
    elsewhere = job.source + "x"
    shutil.copy2(job.source, elsewhere)
    try:
        assert ledger.find(job.name, elsewhere, settings)[0] == ""
    finally:
        os.unlink(elsewhere)


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


@pytest.mark.parametrize("lost", ["stage", "rows", "study", "word"])
def test_what_the_program_needs_was_removed(in_here: None, recordings: Path, tmp_path: Path, lost: str):
    only_the_first(recordings)
    out = tmp_path / "out"
    assert batch(recordings, "-o", out, "--processes", 1) == 0
    if lost == "word":
        (out / ".unocclude" / "study").write_bytes(b"\xff\xfe damaged")
    elif lost == "study":
        (out / ".unocclude" / "study").unlink()
    else:
        shutil.rmtree(out / ".unocclude" / lost)
    (recordings / NAMES[0]).touch()
    assert batch(recordings, "-o", out, "--processes", 1, *(["--force"] if lost == "study" else [])) == 0


@pytest.mark.parametrize("how", ["cut", "rubbish", "empty"])
def test_a_damaged_ledger(
    in_here: None, recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], how: str
):
    """A file of rows that cannot be read is put aside and said; its recordings are done again."""
    only_the_first(recordings)
    out = tmp_path / "out"
    assert batch(recordings, "-o", out, "--processes", 1) == 0
    files = sorted(out.glob("results/*.parquet"))
    content = files[0].read_bytes()
    files[0].write_bytes({"cut": content[: len(content) // 2], "rubbish": os.urandom(500), "empty": b""}[how])
    waiting = out / ".unocclude" / "rows"
    rows = (
        "{",
        "[1]",
        '{"id": 3}',
        "[" * 100_000,
        json.dumps(dict.fromkeys(["id", "status", "finished"], 1)),
    )
    for number, text in enumerate(rows):
        (waiting / f"{number}.json").write_text(text)
    capsys.readouterr()
    assert batch(recordings, "-o", out, "--processes", 1) == 0
    assert "was damaged" in " ".join(capsys.readouterr().out.split())
    assert len(list((out / ".unocclude" / "damaged").iterdir())) == 1
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


def slow(seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        sum(range(1000))


def test_a_time_limit_interrupts():
    began = time.monotonic()
    with pytest.raises(TimeUp), limited(Limits(time_s=0.2)):
        slow(20.0)
    assert time.monotonic() - began < 5
    with limited(Limits(time_s=5.0)):
        pass
    slow(0.01)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux limits memory")
def test_a_memory_limit_refuses_and_lets_go():
    with pytest.raises(MemoryError), limited(Limits(memory_bytes=200_000_000)):
        np.ones(50_000_000)
    assert np.ones(50_000_000)[-1] == 1.0


def wasteful(job: Job) -> Row:
    """A worker's work, with recordings that take all memory, or all time."""
    import smoother.study.job as module

    if job.name in OVER:
        limits = job.settings.limits
        module._recover = lambda *_: slow(60.0) if limits.time_s else [np.ones(10**8) for _ in range(9)]
    return run_job(job)


#: Recordings that go over a limit, and the option that their sentence names.
OVER = {
    "day3/long.mcap": (Limits(time_s=3.0), "--time-limit"),
    "day3/large.mcap": (Limits(memory_bytes=1_500_000_000), "--memory-limit"),
}


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="Linux limits memory")
def test_a_recording_over_its_limits_fails_alone(job: Job, made: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("smoother.study.cluster.run_job", wasteful)
    others = [replace(job, name=name, source=str(made / name)) for name in NAMES[:2]]
    settings = {name: StudySettings(limits=limits) for name, (limits, _) in OVER.items()}
    killers = [replace(job, name=name, settings=own) for name, own in settings.items()]
    rows = [row for row in run_local(iter([*others, *killers]), 2) if row is not None]
    expected = dict.fromkeys(NAMES[:2], DONE) | dict.fromkeys(OVER, FAILED)
    assert {row["recording"]: row["status"] for row in rows} == expected
    for row in rows:
        if row["recording"] in OVER:
            assert OVER[row["recording"]][1] in row["error"] and row["retry"]


#: So many bytes beside what the child has when it begins: too few for a thread, for some, for all.
SPARE_MB = (0, 12, 64)
SHORT_OF_MEMORY = """
import resource, sys
from pathlib import Path
import pyarrow.parquet
from smoother.study.folder import rows_table
used = int(Path("/proc/self/status").read_text().split("VmData:")[1].split()[0]) << 10
resource.setrlimit(resource.RLIMIT_DATA, (used + (int(sys.argv[1]) << 20),) * 2)
try:
    print(rows_table(sys.argv[2:]).num_rows)
except MemoryError:
    print("memory")
"""


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    """Three files of two rows each; the second lacks a column, the third has one more."""
    rows = [[{"id": f"{file}{row}", "recording": "a"} for row in range(2)] for file in range(3)]
    tables = [pa.Table.from_pylist(each, schema=schema()) for each in rows]
    tables[1] = tables[1].drop_columns(["version"])
    tables[2] = tables[2].append_column("later", pa.array([1, 2]))
    places = [str(tmp_path / f"rows-{number}.parquet") for number in range(3)]
    for table, place in zip(tables, places, strict=True):
        parquet.write_table(table, place, compression="zstd")
    return places


@pytest.mark.parametrize("columns", [None, ("recording", "id"), ("version",)])
def test_as_a_data_set_reads_them(files: list[str], columns: tuple[str, ...] | None):
    wanted = None if columns is None else list(columns)
    expected = dataset.dataset(files, schema=schema(), format="parquet").to_table(columns=wanted)
    assert rows_table(files, columns).equals(expected)


def test_no_files_are_no_rows():
    assert rows_table([]).equals(schema().empty_table())


@pytest.mark.skipif(sys.platform != "linux", reason="the limit is Linux's")
@pytest.mark.parametrize("spare_mb", SPARE_MB)
def test_it_ends_however_little_memory_there_is(files: list[str], spare_mb: int):
    command = [sys.executable, "-c", SHORT_OF_MEMORY, str(spare_mb), *files]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() in ("6", "memory") or "Memory" in done.stderr, (done.stdout, done.stderr)
    if spare_mb == SPARE_MB[-1]:
        assert done.stdout.strip() == "6"
