"""Sections side by side in processes, on one BLAS thread: the same answer, byte for byte."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from pool_jobs import answer_half, die_always, wait_long
from scenes import point
from studies import is_alive, until
from threadpoolctl import threadpool_info, threadpool_limits

from smoother.cli.run import explain
from smoother.errors import UnoccludeError
from smoother.runtime import pool
from smoother.runtime.pool import THREADS, Pool, one_blas_thread
from smoother.smoothing import smooth


@pytest.mark.slow
def test_two_processes_give_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = replace(point(5, duration_s=130.0).recording, truth=None)  # two sections
    alone = smooth(recording, processes=1)
    monkeypatch.setattr(pool, "WORTH_FRAMES", 10)
    together = smooth(recording, processes=2)
    for name in ("position", "quaternion", "pose_covariance"):
        assert getattr(alone, name).tobytes() == getattr(together, name).tobytes(), name


def test_a_small_job_starts_no_process() -> None:
    with Pool(2, 100) as pool:
        assert pool._executor is None
    with Pool(1, 10**6) as pool:
        assert pool._executor is None


SCRIPT = """
from dataclasses import replace

import smoother.runtime.pool
from smoother import Config
from smoother.smoothing import smooth
from smoother.simulation import ArmSimulation, simulate_arm

print("begun")
smoother.runtime.pool.WORTH_FRAMES = 10
recording = replace(simulate_arm(ArmSimulation(protocol="random", duration_s=12.0), 5).recording, truth=None)
recovery = smooth(recording, None, Config.model_validate({"windows": {"processes": 2}}))
print("recovered", len(recovery))
"""


@pytest.mark.slow
@pytest.mark.parametrize("how", ["file", "stdin"])
def test_a_plain_script_without_a_guard(how: str, tmp_path: Path) -> None:
    """No `if __name__ == "__main__"`: the workers must not run the script again."""
    script = tmp_path / "plain.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, str(script) if how == "file" else "-"],
        input=None if how == "file" else SCRIPT,
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["begun", "recovered", "960"]
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
@pytest.mark.parametrize("job", [die_always, answer_half])
def test_a_worker_that_was_killed_is_one_sentence(tmp_path: Path, job: Callable[[str], object]):
    """Also in the middle of its answer, whose rest never comes; all hung before."""
    with pytest.raises(UnoccludeError, match=r"was killed.*--processes") as error, Pool(2, 10**6) as pool:
        list(pool.map(job, [str(tmp_path / name) for name in "abc"]))
    assert "BrokenProcessPool" not in explain(error.value)[0]


@pytest.mark.skipif(os.name != "posix", reason="kills by signals")
def test_an_error_does_not_wait_for_workers(tmp_path: Path):
    began = 0.0

    def items():
        nonlocal began
        yield str(tmp_path / "a")
        until(lambda: (tmp_path / "a").exists())
        began = time.monotonic()  # on a busy machine workers take half a minute to start
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), Pool(2, 10**6) as pool:
        list(pool.map(wait_long, items()))
    assert time.monotonic() - began < 30
    until(lambda: not is_alive(int((tmp_path / "a").read_text())))


def _with_helpers() -> dict[str, str]:
    """The environment of a script that uses the tests' helpers."""
    helpers = Path(__file__).parents[1] / "helpers"
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(helpers), os.environ.get("PYTHONPATH", "")])}


ORPHANS = """
import sys
from pool_jobs import wait_long
from smoother.runtime.pool import Pool
with Pool(2, 10**6) as pool:
    list(pool.map(wait_long, [sys.argv[1] + "/a", sys.argv[1] + "/b"]))
"""


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="reads /proc")
@pytest.mark.parametrize("number", ["SIGKILL", "SIGTERM"])
def test_workers_end_with_their_parent(tmp_path: Path, number: str):
    """Killed outright, so that nothing of its own can tidy up; workers waited for ever before."""
    program = subprocess.Popen([sys.executable, "-c", ORPHANS, str(tmp_path)], env=_with_helpers())
    try:
        until(lambda: len([mark for mark in tmp_path.iterdir() if mark.stat().st_size]) == 2, 60.0)
        workers = [int(mark.read_text()) for mark in tmp_path.iterdir()]
    finally:
        program.send_signal(getattr(signal, number))
        program.wait(20)
    until(lambda: not any(is_alive(worker) for worker in workers), 2.0)


DEMO = Path(__file__).parents[2] / "data" / "demo.mcap"
CODE = """
import hashlib
from smoother import read_recording
from smoother.smoothing import smooth
print(hashlib.sha256(smooth(read_recording({path!r})).position.tobytes()).hexdigest())
"""


def threads_now() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


@pytest.mark.slow
def test_a_notebook_gives_the_bytes_of_the_command():
    """A notebook has NumPy with a thread a core; two are asked for here, whatever the machine has."""
    inherited = {name: value for name, value in os.environ.items() if name not in THREADS}
    printed = [
        subprocess.run(
            [sys.executable, "-c", CODE.format(path=str(DEMO))],
            env=inherited | dict.fromkeys(THREADS, threads),
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    ]
    assert printed[0] == printed[1] and len(printed[0]) == 65


def test_the_limit_ends_with_the_last_one_inside(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pool, "_ONE_FROM_THE_START", False)
    first, second = one_blas_thread(), one_blas_thread()
    with threadpool_limits(2, user_api="blas"):
        before = threads_now()
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert threads_now() == {1}
        second.__exit__(None, None, None)
        assert threads_now() == before
        with pytest.raises(ValueError), one_blas_thread():
            raise ValueError
        assert threads_now() == before
