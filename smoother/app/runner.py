"""A job's own process: runs its commands one after the other, and writes down how far it is.

It outlives the page, the tab and the server. It keeps a file locked as long as it works; a job that was
begun, is not ended and is not locked was stopped with the computer.

    python -P -m smoother.app.runner FOLDER/ID/jobs/0001
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

#: So often it looks whether it is to stop, s.
_LOOK_S = 0.1
#: Time in which a command that has to stop can remove its outputs, s.
_GRACE_S = 10.0
#: Whoever looks whether a job is locked holds its lock for a moment, s.
_LOCK_S = 5.0
#: How a process runs one command of the program.
_PROGRAM = (
    *(sys.executable, "-P", "-c"),
    "from smoother.app.runner import watch_parent; watch_parent(); from smoother.cli import main; main()",
)


def main(folder: Path) -> int:
    """Run the job of a folder; 0 where all its commands did."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    try:
        with FileLock(folder / "lock", timeout=_LOCK_S):
            return _run(folder, job)
    except Timeout:
        return 1  # another process runs it already


def _run(folder: Path, job: dict[str, Any]) -> int:
    stop: list[str] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.append("stopped"))
    state: dict[str, Any] = {"state": "running", "step": 0, "started_s": time.time(), "pid": os.getpid()}
    for at, step in enumerate(job["steps"]):
        state["step"] = at
        write(folder / "state.json", state)
        with suppress(OSError):
            (folder / "progress.json").unlink()
        code = _link(folder, step) if "link" in step else _command(folder, step, stop)
        if stop:
            return _ended(folder, state, stop[0], code)
        if code not in step.get("ok", [0]):
            return _ended(folder, state, "held" if code in step.get("held", []) else "failed", code)
    return _ended(folder, state, "done", 0)


def _ended(folder: Path, state: dict[str, Any], how: str, code: int) -> int:
    state |= {"state": how, "code": code, "sentence": "", "ended_s": time.time()}
    if how == "failed":
        state["sentence"] = _last_words(folder / "err.txt") or f"The command ended with {code}."
    write(folder / "state.json", state)
    return 0 if how == "done" else 1


def _last_words(path: Path) -> str:
    """The sentence that a command ended with."""
    with suppress(OSError):
        lines = path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        mine = [line for line in lines if line.startswith("unocclude: ")]
        return (mine or lines or [""])[-1].removeprefix("unocclude: ")
    return ""


def _link(folder: Path, step: dict[str, Any]) -> int:
    """A file under a second name, without a copy where the disk allows."""
    place = folder.parents[1]
    source, target = (place / name for name in step["link"])
    beside = target.with_name(f".{target.name}.new")
    with suppress(OSError):
        beside.unlink()
    try:
        try:
            os.link(source, beside)
        except OSError:
            shutil.copyfile(source, beside)
        os.replace(beside, target)
    except OSError as error:
        (folder / "err.txt").write_text(f"unocclude: {source.name}: {error.strerror}\n", encoding="utf-8")
        return 1
    return 0


def _command(folder: Path, step: dict[str, Any], stop: list[str]) -> int:
    place = folder.parents[1]
    root = str(Path(__file__).parents[2])
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, (root, environment.get("PYTHONPATH"))))
    environment["UNOCCLUDE_PROGRESS"] = str(folder / "progress.json")
    environment["PYTHONIOENCODING"] = "utf-8"
    with open(folder / "out.txt", "ab") as out, open(folder / "err.txt", "ab") as err:
        process = subprocess.Popen(
            [*_PROGRAM, *step["argv"]],
            cwd=place,
            env=environment,
            stdin=subprocess.PIPE,  # closed with this process, however it ends; see watch_parent
            stdout=out,
            stderr=err,
            start_new_session=True,  # a signal for it reaches its workers, and none for us does
        )
        try:
            while True:
                with suppress(subprocess.TimeoutExpired):
                    return process.wait(_LOOK_S)
                if not stop and (why := _asked_to_stop(folder)):
                    stop.append(why)
                if stop:
                    end(process)
                    return process.returncode
        finally:
            if process.poll() is None:
                end(process, 0.0)
            if process.stdin is not None:
                process.stdin.close()


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


def _asked_to_stop(folder: Path) -> str:
    """Why it is to stop: "cancelled" by the user, "stopped" with the server, or ""."""
    return next((word for word in ("cancelled", "stopped") if (folder / word).exists()), "")


def end(process: subprocess.Popen[bytes], grace_s: float = _GRACE_S) -> None:
    """End a command and its workers: asked to first, then at once."""
    for number, wait_s in ((signal.SIGTERM, grace_s), (getattr(signal, "SIGKILL", signal.SIGTERM), _GRACE_S)):
        with suppress(OSError):
            if hasattr(os, "killpg"):
                os.killpg(process.pid, number)
            elif number == signal.SIGTERM:
                process.terminate()
            else:
                process.kill()
        with suppress(subprocess.TimeoutExpired):
            process.wait(wait_s)
            return


def write(path: Path, values: dict[str, Any]) -> None:
    """Write an object, whole or not at all."""
    beside = path.with_name(f"{path.name}.new")
    beside.write_text(json.dumps(values), encoding="utf-8")
    os.replace(beside, path)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
