"""A study whose client or workers are killed: it continues, nothing twice, nothing half-written."""

from __future__ import annotations

import os
import shutil
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest
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
from smoother.study.folder import DONE, FAILED
from smoother.study.inputs import find_entries
from smoother.study.run import Job, StudySettings, run_job, run_study, study_folder


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
    assert set(rows) <= set(after) and sorted(row[0] for row in after) == sorted([*NAMES, BROKEN])
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
    assert said in row["error"] and row["retry"] and row["error"].count(".") == 0, "one sentence"


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
        assert row["status"] == FAILED and row["retry"] and said in row["error"]
    assert not (tmp_path / "none").exists()


@pytest.mark.slow
def test_a_full_disk_is_tried_again(in_here, job, made, monkeypatch, capsys):
    import smoother.io

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "out.mcap")

    write = smoother.io.write_recovery
    monkeypatch.setattr(smoother.io, "write_recovery", full)
    row = run_job(job)
    assert row["status"] == FAILED and row["retry"]
    assert row["error"] == "out.mcap: no space left on the disk; make room and run again"
    assert batch(made / NAMES[0], "-o", job.folder, "--processes", 1) == 1
    monkeypatch.setattr(smoother.io, "write_recovery", write)
    assert batch(made / NAMES[0], "-o", job.folder, "--processes", 1) == 0
    assert "1 recovered now" in capsys.readouterr().out


def test_one_command_at_a_time(job, made, capsys):
    folder = study_folder(Path(job.folder))
    with folder.alone():
        assert batch(made, "-o", folder.path, "--processes", 1) == 1
        assert "another command works on" in capsys.readouterr().err
        assert not query(folder.path)
    with folder.alone():
        pass
