"""Jobs on disk, and the desk that does one after the other.

A job is a list of commands. Each command is a process that ends with this one, however that ends; a job that
was not ended by then was stopped, and can be repeated.
"""

from __future__ import annotations

import os
import queue
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..errors import UnoccludeError
from .folder import AppError, AppFolder, link_file, read_json, write_json

#: States in which a job is not over.
OPEN = ("waiting", "running")
#: Bytes of what a command printed that the page shows.
_SHOWN_BYTES = 20_000
#: So often it looks whether a command is to stop, s.
_LOOK_S = 0.1
#: Time in which a command that has to stop can remove its outputs, s.
_GRACE_S = 10.0
#: How a process runs one command of the program.
_PROGRAM = (
    *(sys.executable, "-P", "-c"),
    "from smoother.app.jobs import watch_parent; watch_parent(); from smoother.cli import main; main()",
)


def latest(folder: Path) -> Path | None:
    """The folder of a recording's latest job; None without any."""
    jobs = folder / "jobs"
    whole = [p for p in jobs.iterdir() if (p / "job.json").is_file()] if jobs.is_dir() else []
    return max((p for p in whole if p.name.isdecimal()), key=lambda p: int(p.name), default=None)


def state_of(job: Path, printed: bool = False) -> dict[str, Any]:
    """How far a job is, by its files on disk; with `printed`, what its commands printed once it has ended.

    Its state is "waiting", "running", "done", "failed", "held" (by the check: the result could not be
    trusted), "cancelled" by the user, or "stopped" with the program or the computer.
    """
    words, progress = read_json(job / "job.json"), read_json(job / "progress.json")
    steps, state = words.get("steps", []), str(words.get("state", "waiting"))
    step = min(int(words.get("step", 0)), max(len(steps) - 1, 0))
    return {
        "number": int(job.name),  # Of the recording's jobs, from 1
        "kind": str(words.get("kind", "")),  # What it is for ("describe", "recover", ..)
        "state": state,
        "step": step,  # The command that runs or was the last, from 0, and how many there are
        "steps": len(steps),
        "step_name": steps[step]["name"] if steps else "",
        "share": float(progress.get("share", -1.0)),  # Part done of it, 0 to 1; -1 where it does not say
        "text": str(progress.get("text", "")),  # What it is doing
        "sentence": str(words.get("sentence", "")),  # Why it failed, in the command's words
        "printed": _printed(job) if printed and state not in OPEN else "",
        "stamp": str(words.get("stamp", "")),  # Of what went in
    }


def refuse_busy(place: Path) -> None:
    """Refuse to change a recording whose job is not over."""
    job = latest(place)
    if job is not None and state_of(job)["state"] in OPEN:
        raise AppError("This recording is being worked on; wait for it, or cancel it.", 409)


def _printed(job: Path) -> str:
    parts = []
    for name in ("out.txt", "err.txt"):
        with suppress(OSError):
            parts.append((job / name).read_bytes()[-_SHOWN_BYTES:].decode("utf-8", "replace"))
    return "".join(parts).strip()


class JobDesk:
    """Does jobs in the order in which they came, and stops them."""

    def __init__(self, folder: AppFolder) -> None:
        self._lock = threading.Lock()
        self._queue: queue.SimpleQueue[Path | None] = queue.SimpleQueue()
        self._running: Path | None = None
        self._cancelled: set[Path] = set()
        self._closing = threading.Event()
        places = [folder.of(name) for name in folder.recordings()]
        places += [folder.comparison(name) for name in folder.comparisons()]
        for job in filter(None, map(latest, places)):  # what an earlier server left
            if state_of(job)["state"] in OPEN:
                with suppress(OSError, UnoccludeError):
                    write_json(job / "job.json", read_json(job / "job.json") | {"state": "stopped"})
        self._thread = threading.Thread(target=self._work, name="jobs", daemon=True)
        self._thread.start()

    def add(self, place: Path, kind: str, steps: list[dict[str, Any]], stamp: str = "") -> int:
        """Put a job at the end of the queue; its number."""
        with self._lock:
            refuse_busy(place)
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
            self._queue.put(job)
        return number

    def cancel(self, place: Path) -> None:
        """Stop a recording's job, or take it from the queue."""
        job = latest(place)
        with self._lock:
            if job is not None and job == self._running:
                self._cancelled.add(job)
            elif job is not None and state_of(job)["state"] == "waiting":
                write_json(job / "job.json", read_json(job / "job.json") | {"state": "cancelled"})

    def close(self, patience_s: float = 15.0) -> None:
        """Stop what runs, and what waits."""
        self._closing.set()
        self._queue.put(None)
        self._thread.join(patience_s)

    def _note(self, job: Path, **changes: Any) -> None:
        """Change what is kept of a job; while the disk is full, it is tried again."""
        while True:
            with suppress(OSError, UnoccludeError):
                write_json(job / "job.json", read_json(job / "job.json") | changes)
                return
            if self._closing.wait(_LOOK_S):
                return

    def _work(self) -> None:
        while (job := self._queue.get()) is not None and not self._closing.is_set():
            with self._lock:
                if state_of(job)["state"] != "waiting":
                    continue
                self._running = job
            self._note(job, state="running")
            try:
                state, sentence = self._run(job)
            except OSError as error:
                state, sentence = "failed", f"{error.strerror or error}; make room and run again."
            self._note(job, state=state, sentence=sentence)
            self._running = None

    def _run(self, job: Path) -> tuple[str, str]:
        """Do a job; its end, and why it failed."""
        for at, step in enumerate(read_json(job / "job.json")["steps"]):
            self._note(job, step=at)
            with suppress(OSError):
                (job / "progress.json").unlink()
            if "link" in step:
                source, target = (job.parents[1] / name for name in step["link"])
                link_file(source, target)
                continue
            code = self._command(job, step["argv"])
            if why := self._asked_to_stop(job):
                return why, ""
            if code in step.get("held", []):
                return "held", ""
            if code not in step.get("ok", [0]):
                return "failed", _last_words(job / "err.txt") or f"The command ended with {code}."
        return "done", ""

    def _asked_to_stop(self, job: Path) -> str:
        """Why a job is to stop: "cancelled" by the user, "stopped" with the server, or ""."""
        return "cancelled" if job in self._cancelled else "stopped" if self._closing.is_set() else ""

    def _command(self, job: Path, words: list[str]) -> int:
        """Run a command in the recording's folder; its exit code."""
        root = str(Path(__file__).parents[2])
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH")))),
            "UNOCCLUDE_PROGRESS": str(job / "progress.json"),
            "PYTHONIOENCODING": "utf-8",
        }
        with open(job / "out.txt", "ab") as out, open(job / "err.txt", "ab") as err:
            process = subprocess.Popen(
                [*_PROGRAM, *words],
                cwd=job.parents[1],
                env=environment,
                stdin=subprocess.PIPE,  # closed with this process, however it ends; see watch_parent
                stdout=out,
                stderr=err,
                start_new_session=True,  # a signal for it reaches its workers, and none for us does
            )
            with process:
                while process.poll() is None:
                    if self._asked_to_stop(job):
                        _end(process)
                    with suppress(subprocess.TimeoutExpired):
                        process.wait(_LOOK_S)
        return process.returncode


def _last_words(path: Path) -> str:
    """The sentence that a command ended with."""
    with suppress(OSError):
        lines = path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        mine = [line for line in lines if line.startswith("unocclude: ")]
        return (mine or lines or [""])[-1].removeprefix("unocclude: ")
    return ""


def watch_parent() -> None:
    """In a command: end it and its workers when the process that started it is gone, even by kill -9."""
    pipe = os.dup(0)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)

    def watch() -> None:
        while os.read(pipe, 1):
            pass
        for number in (signal.SIGTERM, getattr(signal, "SIGKILL", signal.SIGTERM)):
            os.killpg(0, number) if hasattr(os, "killpg") else os.kill(os.getpid(), number)
            time.sleep(_GRACE_S)

    threading.Thread(target=watch, daemon=True).start()


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a command and its workers: asked to first, then at once."""
    for number in (signal.SIGTERM, getattr(signal, "SIGKILL", signal.SIGTERM)):
        with suppress(OSError):
            os.killpg(process.pid, number) if hasattr(os, "killpg") else process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(_GRACE_S)
            return
