"""A study whose client or workers are killed: it continues, nothing twice, nothing half-written."""

from __future__ import annotations

import json
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
from studies import BROKEN, NAMES, batch, is_alive, query, start_batch, state, until

from smoother.config import Config
from smoother.study.columns import DONE, FAILED
from smoother.study.fingerprint import Fingerprint, config_hash
from smoother.study.job import Job, Known, run_job
from smoother.study.ledger import Ledger
from smoother.study.local import run_local
from smoother.study.lock import alone
from smoother.study.run import study_folder


@pytest.fixture
def job(made: Path, tmp_path: Path) -> Job:
    folder = study_folder(tmp_path / "out")
    word = folder.open()
    config, choice = Config(), Fingerprint()
    source, hashed = str(made / NAMES[0]), config_hash(config, choice)
    return Job(NAMES[0], source, str(folder.path), word, config, choice, hashed)


@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_a_killed_client(recordings, tmp_path):
    out = tmp_path / "out"
    client = start_batch(recordings, "-o", out, "--processes", 1)
    try:
        until(lambda: len(query(out)) >= 2)  # asked while it runs
    finally:
        workers = [
            int(each) for each in Path(f"/proc/{client.pid}/task/{client.pid}/children").read_text().split()
        ]
        client.send_signal(signal.SIGKILL)
        client.communicate()
    until(lambda: not any(is_alive(each) for each in workers), 10.0)  # nobody would hear of their work
    before, rows = state(out), query(out)
    assert 2 <= len(rows) < 5
    assert batch(recordings, "-o", out, "--processes", 1) == 1
    after = query(out)
    assert set(rows) <= set(after) and sorted(row[0] for row in after) == sorted([*NAMES, BROKEN])
    outputs = state(out)
    assert before.items() <= outputs.items() and set(outputs) == set(NAMES)
    assert not list((out / ".unocclude" / "stage").glob(f"*~{workers[0]}")), "what it left is swept up"


@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_a_killed_worker(job):
    """Its recording is done by another process."""
    import multiprocessing

    rows, killed = [], 0
    for row in run_local(iter([job]), 1):
        if row is not None:
            rows.append(row)
        elif not killed:
            (worker,) = multiprocessing.active_children()
            os.kill(worker.pid, signal.SIGKILL)
            killed += 1
    assert killed == 1 and [row["status"] for row in rows] == [DONE]


@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_a_recording_that_kills_its_workers(job):
    import multiprocessing

    rows = []
    for row in run_local(iter([job]), 1):
        rows += [row] if row is not None else []
        for worker in multiprocessing.active_children():
            os.kill(worker.pid, signal.SIGKILL)
    (row,) = rows
    assert row["status"] == FAILED and row["retry"] and "died 2 times (signal 9)" in row["error"]


@pytest.mark.skipif(os.name != "posix", reason="Ctrl-C as a signal")
def test_ctrl_c(recordings, tmp_path):
    out = tmp_path / "out"
    client = start_batch(recordings, "-o", out, "--processes", 1)
    until(lambda: (out / ".unocclude" / "study").exists())
    time.sleep(0.3)
    client.send_signal(signal.SIGINT)
    said, _ = client.communicate(timeout=20)
    assert client.returncode == 1 and "the same command continues" in said and said.count("\n") == 1


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
        (replace(job, source="/nowhere/a.mcap"), "does not see /nowhere/a.mcap; share the recordings"),
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
    with alone(folder):
        assert batch(made, "-o", folder.path, "--processes", 1) == 1
        assert "another command works on" in capsys.readouterr().err
        assert not query(folder.path)
    with alone(folder):
        pass
