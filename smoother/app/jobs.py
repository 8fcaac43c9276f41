"""Jobs on disk, and the desk that starts two of them at a time."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import UnoccludeError
from .folder import AppError, AppFolder, read_json, write_json

#: Jobs that run at a time; a command takes all cores by itself.
AT_A_TIME = 2
#: States in which a job is not over.
OPEN = ("waiting", "running")
#: A job's process takes its lock within this after its start, s.
_START_S = 30.0
#: Bytes of what a command printed that the page shows.
_SHOWN_BYTES = 20_000


@dataclass(frozen=True)
class JobState:
    """How far a job is."""

    number: int  # Of the recording's jobs, from 1
    kind: str  # What it is for ("describe", "recover", ..)
    # "waiting", "running", "done", "failed", "held" (by the check, the result could not be trusted),
    # "cancelled" by the user, or "stopped" with the program or the computer
    state: str
    step: int  # The command that runs or was the last, from 0, and how many there are
    steps: int  # The command that runs or was the last, from 0, and how many there are
    step_name: str
    share: float  # Part done of that command, 0 to 1; -1 where it does not say
    text: str  # What it is doing
    sentence: str  # Why it failed, in the command's words
    printed: str  # What its commands printed, where that was asked for; empty while it runs
    stamp: str  # Of what went in


def latest(folder: Path) -> Path | None:
    """The folder of a recording's latest job; None without any."""
    jobs = folder / "jobs"
    whole = [p for p in jobs.iterdir() if (p / "job.json").is_file()] if jobs.is_dir() else []
    return max((p for p in whole if p.name.isdecimal()), key=lambda p: int(p.name), default=None)


def state_of(job: Path, printed: bool = False) -> JobState:
    """How far a job is, by its files on disk."""
    words, state = read_json(job / "job.json"), read_json(job / "state.json")
    steps = words.get("steps", [])
    step = min(int(state.get("step", 0)), max(len(steps) - 1, 0))
    how = state.get("state", "waiting")
    if how == "waiting" and (begun := read_json(job / "begun.json")):
        lost = time.time() - begun.get("at_s", 0.0) > _START_S and not is_locked(job)
        how = "stopped" if lost else "running"
    elif how == "running" and not is_locked(job):
        state = read_json(job / "state.json")  # it may have ended in between
        how = state.get("state", how)
        how = "stopped" if how == "running" else how
    for word in ("cancelled", "stopped"):
        how = word if how == "waiting" and (job / word).exists() else how
    progress = read_json(job / "progress.json")
    return JobState(
        int(job.name),
        str(words.get("kind", "")),
        how,
        step,
        len(steps),
        steps[step]["name"] if steps else "",
        float(progress.get("share", -1.0)),
        str(progress.get("text", "")),
        str(state.get("sentence", "")),
        _printed(job) if printed and how not in OPEN else "",
        str(words.get("stamp", "")),
    )


def _printed(job: Path) -> str:
    parts = []
    for name in ("out.txt", "err.txt"):
        with suppress(OSError):
            parts.append((job / name).read_bytes()[-_SHOWN_BYTES:].decode("utf-8", "replace"))
    return "".join(parts).strip()


def is_locked(job: Path) -> bool:
    """Whether a process works on a job."""
    from filelock import FileLock, Timeout

    if not (job / "lock").exists():
        return False
    try:
        with FileLock(job / "lock", timeout=0):
            return False
    except Timeout:
        return True
    except OSError:
        return False


class JobDesk:
    """Starts jobs in the order in which they came, and stops them."""

    def __init__(self, folder: AppFolder) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._queue: list[Path] = []
        self._running: dict[Path, subprocess.Popen[bytes] | None] = {}
        self._adopt()

    def _adopt(self) -> None:
        """Take over what an earlier server left: jobs that wait, and those that still run."""
        places = [self.folder.of(name) for name in self.folder.recordings()]
        places += [self.folder.comparison(name) for name in self.folder.comparisons()]
        for place in places:
            if (job := latest(place)) is None:
                continue
            state = state_of(job).state
            if state == "running":
                self._running[job] = None
            elif state == "waiting":
                self._queue.append(job)

    def add(self, place: Path, kind: str, steps: list[dict[str, Any]], stamp: str = "") -> int:
        """Put a job at the end of the queue; its number."""
        with self._lock:
            last = latest(place)
            if last is not None and state_of(last).state in OPEN:
                raise AppError("This recording is being worked on; wait for it, or cancel it.", 409)
            jobs = place / "jobs"
            jobs.mkdir(exist_ok=True)
            number = 1 + max((int(p.name) for p in jobs.iterdir() if p.name.isdecimal()), default=0)
            job = jobs / f"{number:04d}"  # one without job.json was left by a full disk: its number is passed
            job.mkdir()
            try:
                write_json(job / "job.json", {"kind": kind, "steps": steps, "stamp": stamp})
            except BaseException:
                shutil.rmtree(job, ignore_errors=True)
                raise
            self._queue.append(job)
        self.tick()
        return number

    def tick(self) -> None:
        """Start what may start; called often."""
        with self._lock:
            for job, process in list(self._running.items()):
                over = not is_locked(job) if process is None else process.poll() is not None
                if over:
                    del self._running[job]
            while self._queue and len(self._running) < AT_A_TIME:
                job = self._queue[0]
                if (job / "job.json").is_file() and state_of(job).state == "waiting":
                    try:
                        self._running[job] = _start(job)
                    except (OSError, UnoccludeError):  # a full disk: it is tried again
                        return
                self._queue.pop(0)

    def cancel(self, place: Path) -> None:
        """Stop a recording's job, or take it from the queue."""
        job = latest(place)
        if job is not None and state_of(job).state in OPEN:
            _say(job, "cancelled")

    def close(self, patience_s: float = 15.0) -> None:
        """Stop all that runs; what waits is started the next time."""
        with self._lock:
            running = dict(self._running)
            self._queue.clear()
        for job in running:
            _say(job, "stopped")
        end = time.monotonic() + patience_s
        for process in running.values():
            if process is not None:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(max(end - time.monotonic(), 0.1))


def _say(job: Path, word: str) -> None:
    with suppress(OSError):
        (job / word).touch()


def _start(job: Path) -> subprocess.Popen[bytes]:
    """Start a job's process; it continues when this one ends."""
    root = str(Path(__file__).parents[2])
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, (root, environment.get("PYTHONPATH"))))
    write_json(job / "begun.json", {"at_s": time.time()})
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "smoother.app.runner", str(job)],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
