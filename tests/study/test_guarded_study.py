"""A study that is killed, damaged, limited, oddly named, or of earlier versions: nothing twice or half."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import pyarrow as pa
import pytest
from pyarrow import parquet
from studies import (
    BROKEN,
    NAMES,
    Instead,
    batch,
    children,
    ended,
    is_alive,
    query,
    start_batch,
    state,
    until,
    until_stopped,
)

from smoother.runtime.outputs import temporary_name
from smoother.study import run as workers
from smoother.study.folder import DONE, FAILED, StudyFolder, schema
from smoother.study.inputs import find_entries
from smoother.study.run import Job, StudySettings, run_job, run_study, study_folder


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


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_a_killed_client(recordings, tmp_path):
    out = tmp_path / "out"
    client = start_batch(recordings, "-o", out, "--processes", 2, stop_after=2)
    try:
        until_stopped(client)
        rows, processes = query(out), children(client.pid)  # asked while its workers run
        before = {name: state(out)[name] for name, status, *_ in rows if status == DONE}
    finally:
        client.kill()
        client.communicate()
    until(lambda: not any(is_alive(each) for each in processes), 20.0)  # nobody would hear of their work
    assert len(processes) == 2 and len(rows) >= 2
    half = temporary_name(out / NAMES[0], GONE)
    half.parent.mkdir(parents=True, exist_ok=True)
    half.touch()
    assert batch(recordings, "-o", out, "--processes", 1) == 1
    after = query(out)
    assert {row for row in rows if row[1] == DONE} <= set(after)
    assert sorted(row[0] for row in after) == sorted([*NAMES, BROKEN])
    outputs = state(out)
    assert before.items() <= outputs.items() and set(outputs) == set(NAMES)
    assert not half.exists(), "what is left half written is swept up"


#: No process has this number.
GONE = 2**30


def others_too(job: Job, made: Path, monkeypatch: pytest.MonkeyPatch, what: str) -> list[dict]:
    """The rows of four recordings and of one in which a process does something else."""
    monkeypatch.setattr(workers, "run_job", Instead("other.mcap", what))
    jobs = [replace(job, name=name, source=str(made / name), settings=StudySettings()) for name in NAMES]
    jobs.insert(2, replace(job, name="other.mcap"))
    with workers.local(2) as ready:
        return [row for row in workers.rows_of(iter(jobs), ready) if row is not None]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
@pytest.mark.parametrize(
    ("settings", "what", "said"),
    [
        ({}, "os.kill(os.getpid(), signal.SIGKILL)", "died one after the other"),
        ({"time_limit_s": 10.0}, "time.sleep(100)", "--time-limit"),
        ({}, "(_ for _ in ()).throw(MemoryError)", "not enough memory"),
    ],
)
def test_a_recording_that_ends_its_process_fails_alone(job, made, monkeypatch, settings, what, said):
    job = replace(job, settings=StudySettings(**settings))
    rows = {row["recording"]: row for row in others_too(job, made, monkeypatch, what)}
    assert {name: row["status"] for name, row in rows.items()} == dict.fromkeys(NAMES, DONE) | {
        "other.mcap": FAILED
    }
    row = rows["other.mcap"]
    assert said in row["error"] and row["error"].count(".") == 0, "one sentence"


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_a_process_that_dies_once(job, made, tmp_path, monkeypatch):
    """Its recording is done by another process."""
    mark = tmp_path / "died"
    what = f"not os.path.exists({str(mark)!r}) and (open({str(mark)!r}, 'w'), os._exit(1))"
    rows = others_too(job, made, monkeypatch, what)
    assert mark.exists() and [row["status"] for row in rows] == [DONE] * 5


def test_an_end_sweeps_what_its_workers_left(in_here, job, made):
    """They are ended in the middle of an output, and the next command may never come."""
    folder = study_folder(Path(job.folder))
    entries = find_entries(str(made), folder.path)
    half = [temporary_name(each, GONE) for each in (folder.results / "x.parquet", folder.output(NAMES[0]))]

    def interrupt(*_):
        for path in half:
            path.parent.mkdir(exist_ok=True)
            path.touch()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(entries, folder, StudySettings(), workers.local(1), interrupt)
    assert not any(path.exists() for path in half)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C as a signal")
@pytest.mark.parametrize("after_s", [0.0, 0.9])
def test_ctrl_c(recordings, tmp_path, after_s):
    """As a terminal sends it: to the command and to all of its processes, early and late."""
    for copy in range(20):  # more than is done by then
        shutil.copytree(recordings / "day1", recordings / f"copy{copy}")
    out = tmp_path / "out"
    client = start_batch(recordings, "-o", out, "--processes", 2)
    until(lambda: (out / ".unocclude" / "study").exists())
    time.sleep(after_s)
    os.killpg(client.pid, signal.SIGINT)
    said = ended(client)
    assert client.returncode == 1 and "the same command continues" in said and said.count("\n") == 1, said


@pytest.mark.slow
def test_cut_off_between_output_and_row(job):
    """Whatever step a worker had come to, what is whole is taken up and nothing else."""
    row = run_job(job)
    assert row["status"] == DONE and row["seconds"] > 0
    folder = study_folder(Path(job.folder))
    output = folder.output(job.name)
    (file,) = folder.results.iterdir()
    assert folder.row(job.name)["finished"] == row["finished"]
    # the same content again is not computed; nor is it where its file was touched
    os.utime(job.source)
    assert run_job(job)["finished"] == row["finished"]
    again = []
    for spoil in (
        lambda: output.unlink(),  # the output was moved away
        lambda: output.write_bytes(b"x" * row["output_bytes"]),  # another output is in its place
        lambda: file.unlink(),  # the row was not written
        lambda: file.write_bytes(b"x"),  # the row is damaged
    ):
        spoil()
        again.append(run_job(job))
    assert len({each["finished"] for each in [row, *again]}) == 5
    assert {each["output_hash"] for each in again} == {row["output_hash"]}


def test_a_worker_that_is_not_set_up(job, tmp_path):
    for broken, said in (
        (replace(job, source="/nowhere/a.mcap"), f"does not see {job.name}; share the recordings"),
        (replace(job, word="another"), "does not see the study's folder"),
        (replace(job, folder=str(tmp_path / "none")), "does not see the study's folder"),
        (replace(job, version="9.9"), "install the same version"),
        (replace(job, calibration="/nowhere/c.toml"), "does not see the calibration"),
    ):
        row = run_job(broken)
        assert row["status"] == FAILED and said in row["error"]
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_a_full_disk_is_tried_again(in_here, job, made, monkeypatch, capsys):
    import smoother.io

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "out.mcap")

    write = smoother.io.write_recovery
    monkeypatch.setattr(smoother.io, "write_recovery", full)
    row = run_job(job)
    assert row["status"] == FAILED
    assert row["error"] == "out.mcap: no space left on the disk; make room and run again"
    assert batch(made / NAMES[0], "-o", job.folder, "--processes", 1) == 1
    monkeypatch.setattr(smoother.io, "write_recovery", write)
    assert batch(made / NAMES[0], "-o", job.folder, "--processes", 1) == 0
    assert "1 recovered now" in capsys.readouterr().out
