"""A study on a Dask scheduler and its workers, on loopback."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from studies import BROKEN, NAMES, batch, query, start_batch, state, until_stopped

from smoother.errors import UnoccludeError
from smoother.study import cluster
from smoother.study.inputs import find_entries
from smoother.study.job import Job, StudySettings, run_job
from smoother.study.run import run_study, study_folder


@pytest.fixture(scope="module")
def scheduler() -> Iterator[object]:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", protocol="tcp://", silence_logs=50
    ) as started:
        yield started


def test_the_same_bytes_as_here_with_a_worker_killed(scheduler, recordings, tmp_path):
    entries = find_entries(str(recordings), tmp_path / "out")
    killed = []

    def heard(tally, row):
        if not killed and os.name == "posix":  # while it works on a recording
            killed.append(next(iter(scheduler.workers.values())).pid)
            os.kill(killed[0], signal.SIGKILL)

    def work(jobs):
        return cluster.run_cluster(jobs, scheduler.scheduler_address)

    folder = study_folder(tmp_path / "out")
    tally, rows = run_study(entries, folder, StudySettings(), work, heard)
    assert killed and (tally.computed, tally.failed) == (4, 1)
    assert rows["recording"].to_pylist() == sorted([*NAMES, BROKEN])
    here = study_folder(tmp_path / "here")
    run_study(entries, here, StudySettings(), lambda jobs: (run_job(job) for job in jobs), lambda *_: None)
    ours, theirs = state(here.path), state(folder.path)
    assert set(ours) == set(theirs) == set(NAMES)
    assert all(ours[name][1] == theirs[name][1] for name in NAMES)
    # what the cluster did is not done again here
    assert batch(recordings, "-o", folder.path, "--processes", 1) == 1
    assert state(folder.path) == theirs


@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_a_killed_client(scheduler, recordings, tmp_path):
    out = tmp_path / "out"
    again = [recordings, "-o", out, "--scheduler", scheduler.scheduler_address]
    client = start_batch(*again, stop_after=2)
    try:
        until_stopped(client)
    finally:
        client.kill()
        client.communicate()
    before = state(out)
    assert len(query(out)) == 2
    assert batch(*again) == 1
    after = query(out)
    assert sorted(row[0] for row in after) == sorted([*NAMES, BROKEN]), "no recording twice"
    outputs = state(out)
    assert before.items() <= outputs.items() and set(outputs) == set(NAMES)


def test_no_worker(monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(cluster, "FIRST_WORKER_S", 0.3)
    with (
        LocalCluster(n_workers=0, dashboard_address=":0", protocol="tcp://", silence_logs=50) as empty,
        pytest.raises(UnoccludeError, match="has no worker; start some"),
    ):
        list(cluster.run_cluster(iter(()), empty.scheduler_address))


def test_a_scheduler_that_goes_away(monkeypatch, tmp_path, capfd):
    from distributed import LocalCluster

    monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0", protocol="tcp://"
    ) as leaving:
        address = leaving.scheduler_address

        def jobs():
            for number in range(100):
                if number == 5:
                    leaving.close()
                yield Job(f"{number}.mcap", "/nowhere.mcap", str(tmp_path), "", StudySettings(), "")

        with pytest.raises(UnoccludeError, match="went away; the same command continues"):
            list(cluster.run_cluster(jobs(), address))
    assert "Traceback" not in capfd.readouterr().err


def test_without_any_process_a_study_gives_up(monkeypatch):
    """Where memory is too little for a worker to start, nothing ever answers."""

    class NoWorkers:
        status = "running"

        def nthreads(self) -> dict[str, int]:
            return {}

        def submit(self, work: object, job: object, key: str, pure: bool) -> object:
            return SimpleNamespace(key=key, add_done_callback=lambda done: None)

    monkeypatch.setattr(cluster, "_LOOK_S", 0.05)
    jobs = iter([SimpleNamespace(key="a")])
    with pytest.raises(UnoccludeError, match="no process for the recordings could start within 1 s"):
        for row in cluster._run(NoWorkers(), jobs, 0, "gone", 0.6):
            assert row is None
