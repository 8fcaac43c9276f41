"""A study on a Dask scheduler and its workers, on loopback."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest
from studies import BROKEN, NAMES, batch, state

from smoother.errors import UnoccludeError
from smoother.study import run as workers
from smoother.study.inputs import find_entries
from smoother.study.run import Job, StudySettings, run_study, study_folder


@pytest.fixture(scope="module")
def scheduler() -> Iterator[object]:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=":0", protocol="tcp://", silence_logs=50
    ) as started:
        yield started


@pytest.mark.slow
def test_the_same_bytes_as_here_with_a_worker_killed(scheduler, recordings, tmp_path):
    entries = find_entries(str(recordings), tmp_path / "out")
    killed = []

    def heard(tally, row):
        if not killed and os.name == "posix":  # while it works on a recording
            killed.append(next(iter(scheduler.workers.values())).pid)
            os.kill(killed[0], signal.SIGKILL)

    folder = study_folder(tmp_path / "out")
    tally, rows = run_study(
        entries, folder, StudySettings(), workers.cluster(scheduler.scheduler_address), heard
    )
    assert killed and (tally.computed, tally.failed) == (4, 1)
    assert rows["recording"].to_pylist() == sorted([*NAMES, BROKEN])
    here = study_folder(tmp_path / "here")
    run_study(entries, here, StudySettings(), workers.local(1), lambda *_: None)
    ours, theirs = state(here.path), state(folder.path)
    assert set(ours) == set(theirs) == set(NAMES)
    assert all(ours[name][1] == theirs[name][1] for name in NAMES)
    # what the cluster did is not done again here
    assert batch(recordings, "-o", folder.path, "--processes", 1) == 1
    assert state(folder.path) == theirs


def test_no_worker(monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(workers, "FIRST_WORKER_S", 0.3)
    with (
        LocalCluster(n_workers=0, dashboard_address=":0", protocol="tcp://", silence_logs=50) as empty,
        pytest.raises(UnoccludeError, match="has no worker; start some"),
        workers.cluster(empty.scheduler_address),
    ):
        pass


def test_a_scheduler_that_goes_away(monkeypatch, tmp_path, capfd):
    from distributed import LocalCluster

    monkeypatch.setattr(workers, "CONNECT_S", 1.0)
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0", protocol="tcp://"
    ) as leaving:
        address = leaving.scheduler_address

        def jobs():
            for number in range(100):
                if number == 5:
                    leaving.close()
                yield Job(f"{number}.mcap", "/nowhere.mcap", str(tmp_path), "", StudySettings(), "")

        with (
            pytest.raises(UnoccludeError, match="went away; the same command continues"),
            workers.cluster(address) as ready,
        ):
            list(workers.rows_of(jobs(), ready))
    assert "Traceback" not in capfd.readouterr().err
