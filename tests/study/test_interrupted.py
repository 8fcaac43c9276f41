"""A study whose client or workers are killed: it continues, nothing twice, nothing half-written."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from studies import (
    BROKEN,
    NAMES,
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

from smoother.errors import UnoccludeError
from smoother.runtime.outputs import temporary_name
from smoother.study import cluster
from smoother.study.cluster import run_local
from smoother.study.folder import DONE, FAILED, Row
from smoother.study.inputs import find_entries
from smoother.study.job import Job, Known, StudySettings, run_job
from smoother.study.ledger import Ledger
from smoother.study.run import run_study, study_folder


@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_a_killed_client(recordings, tmp_path):
    out = tmp_path / "out"
    client = start_batch(recordings, "-o", out, "--processes", 2, stop_after=2)
    try:
        until_stopped(client)
        before, rows, workers = state(out), query(out), children(client.pid)  # asked while it runs
    finally:
        client.kill()
        client.communicate()
    until(lambda: not any(is_alive(each) for each in workers), 10.0)  # nobody would hear of their work
    assert len(workers) >= 2 and len(rows) == 2
    half = out / ".unocclude" / "stage" / f"{socket.gethostname()}~{client.pid}" / "half.mcap"
    half.parent.mkdir()
    half.touch()
    assert batch(recordings, "-o", out, "--processes", 1) == 1
    after = query(out)
    assert set(rows) <= set(after) and sorted(row[0] for row in after) == sorted([*NAMES, BROKEN])
    outputs = state(out)
    assert before.items() <= outputs.items() and set(outputs) == set(NAMES)
    assert not half.parent.exists(), "what is left half written is swept up"


def kill_workers() -> list[int]:
    """Kill the processes of `run_local` that have a recording, and say which they were."""
    import multiprocessing

    workers = [worker.pid for worker in multiprocessing.active_children()]
    for worker in workers:
        os.kill(worker, signal.SIGKILL)
    return workers


@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_a_killed_worker(job, monkeypatch):
    """Its recording is done by another process."""
    monkeypatch.setattr(cluster, "_TICK_S", 0.02)  # a recording of some seconds is done before half a second
    rows, killed = [], []
    for row in run_local(iter([job]), 1):
        if row is not None:
            rows.append(row)
        elif not killed:
            killed = kill_workers()
    assert len(killed) == 1 and [row["status"] for row in rows] == [DONE]


@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_a_recording_that_kills_its_workers(job, made, monkeypatch):
    """It fails alone: what waits for the same process, or runs beside it, is done."""
    monkeypatch.setattr("smoother.study.cluster.run_job", die_of_broken)
    killer = replace(job, name=BROKEN)
    others = [replace(job, name=name, source=str(made / name)) for name in NAMES]
    rows = [row for row in run_local(iter([*others[:2], killer, *others[2:]]), 2) if row is not None]
    assert sorted(row["recording"] for row in rows if row["status"] == DONE) == sorted(NAMES)
    (row,) = (row for row in rows if row["status"] == FAILED)
    assert row["recording"] == BROKEN and row["retry"] and "died one after the other" in row["error"]
    assert row["error"].count(".") == 0, "one sentence"


def die_of_broken(job: Job) -> Row:
    """A worker's work, with a recording that is the end of it."""
    if job.name == BROKEN:
        os.kill(os.getpid(), signal.SIGKILL)
    return run_job(job)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (RuntimeError("Nanny failed to start."), r"Nanny failed to start\."),
        (AssertionError(), "one of them ended as it began"),  # of a nanny that is asked a second time
    ],
)
def test_a_worker_that_is_killed_as_it_starts(job, monkeypatch, error, said):
    """The processes are begun once more, and no oftener."""
    import distributed

    begun, start = [], distributed.LocalCluster

    def fail_once(**options):
        begun.append(options)
        if len(begun) < 2:
            raise error
        return start(**options)

    monkeypatch.setattr(distributed, "LocalCluster", fail_once)
    assert [row["status"] for row in run_local(iter([job]), 1) if row is not None] == [DONE]
    monkeypatch.setattr(distributed, "LocalCluster", lambda **options: fail_once(times=begun.clear()))
    with pytest.raises(UnoccludeError, match=f"could not be started: {said}"):
        list(run_local(iter([job]), 1))


def test_an_end_sweeps_what_its_workers_left(job, made):
    """They are ended in the middle of an output, and the next command may never come."""
    folder = study_folder(Path(job.folder))
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    half = [
        folder.stage / f"{socket.gethostname()}~{dead.pid}" / "half.mcap",
        temporary_name(folder.rows / "row.json"),
    ]

    def work(jobs):
        next(jobs)
        half[0].parent.mkdir()
        for path in half:
            path.touch()
        raise KeyboardInterrupt
        yield

    entries = find_entries(str(made), folder.path)
    with pytest.raises(KeyboardInterrupt):
        run_study(entries, folder, StudySettings(), work, lambda *_: None)
    assert not half[0].parent.exists() and not half[1].exists()


@pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="reads /proc")
def test_nobody_listens_to_the_network(job, monkeypatch):
    """Client and processes listen on 127.0.0.1, and only there."""
    import multiprocessing

    monkeypatch.setattr(cluster, "_TICK_S", 0.02)
    opened = []
    for row in run_local(iter([job]), 1):
        if not opened and row is None:
            here = [os.getpid(), *(worker.pid for worker in multiprocessing.active_children())]
            opened = [address for process in here for address in listening(process)]
    assert len(opened) >= 3 and set(opened) == {"0100007F"}


def listening(process: int) -> list[str]:
    """The addresses at which a process listens, as Linux writes them: 0100007F is 127.0.0.1."""
    sockets = set()
    for link in Path(f"/proc/{process}/fd").iterdir():
        with suppress(OSError):
            sockets.add(os.readlink(link))
    lines = [
        line.split()
        for table in ("tcp", "tcp6")
        for line in Path(f"/proc/{process}/net/{table}").read_text().splitlines()[1:]
    ]
    return [
        line[1].partition(":")[0] for line in lines if line[3] == "0A" and f"socket:[{line[9]}]" in sockets
    ]


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


def test_cut_off_between_output_and_results(job):
    """Whatever step a worker had come to, the study takes up what is whole and nothing else."""
    row = run_job(job)
    assert row["status"] == DONE and row["seconds"] > 0
    folder = study_folder(Path(job.folder))
    waiting = folder.rows / f"{row['id']}.json"
    settings = (job.config_hash, "", job.version)
    assert json.loads(waiting.read_text()) == json.loads(json.dumps(row))
    # the row was written, the output not yet in its place
    output = folder.output(job.name)
    output.rename(output.with_suffix(".away"))
    assert Ledger(folder).find(job.name, job.source, settings) == ("", ())
    assert not query(folder.path) and waiting.exists()
    # another output is in its place
    output.write_bytes(b"x" * row["output_bytes"])
    assert Ledger(folder).find(job.name, job.source, settings) == ("", ())
    # the output is in its place, the row not yet among the results
    output.with_suffix(".away").replace(output)
    known = (Known(row["id"], row["output_hash"]),)
    assert Ledger(folder).find(job.name, job.source, settings) == (row["id"], known)
    assert len(query(folder.path)) == 1 and not waiting.exists()
    # the row is among the results, and its first copy was not yet removed
    waiting.write_text(json.dumps(row))
    Ledger(folder)
    assert len(query(folder.path)) == 1 and not waiting.exists()
    # a worker that is sent the same content again does not compute it
    same = run_job(replace(job, known=known))
    assert (same["status"], same["id"]) == ("same", row["id"]) and not waiting.exists()


def test_a_worker_that_is_not_set_up(job, tmp_path):
    for broken, said in (
        (replace(job, source="/nowhere/a.mcap"), f"does not see {job.name}; share the recordings"),
        (replace(job, word="another"), "does not see the study's folder"),
        (replace(job, folder=str(tmp_path / "none")), "does not see the study's folder"),
        (replace(job, version="9.9"), "install the same version"),
        (replace(job, calibration="/nowhere/c.toml"), "does not see the calibration"),
    ):
        row = run_job(broken)
        assert row["status"] == FAILED and row["retry"] and said in row["error"]
    assert not (tmp_path / "none").exists()


def test_a_full_disk_is_tried_again(job, monkeypatch):
    import smoother.io

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "out.mcap")

    monkeypatch.setattr(smoother.io, "write_recovery", full)
    row = run_job(job)
    assert row["status"] == FAILED and row["retry"] and row["error"] == "out.mcap: No space left on device"
    folder = study_folder(Path(job.folder))
    settings = (job.config_hash, "", job.version)
    assert Ledger(folder).find(job.name, job.source, settings) == ("", ())
    monkeypatch.undo()
    assert run_job(job)["status"] == DONE
    assert Ledger(folder).find(job.name, job.source, settings)[0] == row["id"]


def test_one_command_at_a_time(job, made, capsys):
    folder = study_folder(Path(job.folder))
    with folder.alone():
        assert batch(made, "-o", folder.path, "--processes", 1) == 1
        assert "another command works on" in capsys.readouterr().err
        assert not query(folder.path)
    with folder.alone():
        pass
