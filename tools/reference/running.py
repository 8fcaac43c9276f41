"""Cases run in forked processes, a folder and a process a group; what they printed and wrote, as texts."""

from __future__ import annotations

import importlib
import os
import pickle
import re
import shlex
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from smoother.cli.run import run
from tools.reference.renderings import PROJECT, broken_lines, masked, rendering

#: What a case is made of: its exit code, what it printed, its files; by name.
Parts = dict[str, str]
#: By the case's name.
Records = dict[str, Parts]

#: What is the same wherever it runs.
ENVIRONMENT = {
    "COLUMNS": "110",
    "LINES": "40",
    "TERM": "dumb",
    "NO_COLOR": "1",
    "TZ": "UTC",
    "LC_ALL": "C.UTF-8",
}
#: A group may take this long, s; one that hangs must not hold the others up.
MOST_S = 900
#: Imported once, before processes are forked.
_PRELOADED = (
    *("gtsam", "scipy.optimize", "scipy.stats", "scipy.signal", "scipy.spatial", "plotly.graph_objects"),
    *("smoother.cli.app", "smoother.cli.smooth", "smoother.cli.gaps", "smoother.cli.validate"),
    *("smoother.smoothing", "smoother.simulation", "smoother.io", "smoother.report"),
)


@dataclass(frozen=True)
class Step:
    """One command."""

    words: tuple[str, ...]  # Of the command line, run in `folder`
    folder: Path
    name: str = ""  # In the reference, beside the group's; the command line if not given
    prepare: Callable[[], None] | None = None  # Puts inputs into the folder

    @property
    def title(self) -> str:
        """What it is called in its group."""
        return self.name or shlex.join(self.words)


@dataclass(frozen=True)
class Group:
    """Commands that build on each other, in a folder of their own."""

    name: str
    lines: str = ""  # A command a line, without the program's name. Paths are relative
    inputs: Callable[[Path], None] | None = None  # Puts files into the folder first
    # Gives the steps by itself, from the folder, instead of `lines`
    steps: Callable[[Path], Iterator[Step]] | None = None

    @property
    def commands(self) -> list[str]:
        """The lines that contain one."""
        return [line.strip() for line in self.lines.splitlines() if line.strip()]

    def last_wanted(self, only: str) -> int:
        """How many of the commands have to be run for those whose name contains `only`."""
        numbers = [number for number, line in enumerate(self.commands, 1) if only in f"{self.name}: {line}"]
        return max(numbers, default=0)

    def is_wanted(self, only: str) -> bool:
        """Whether any of it is asked for."""
        if self.steps is not None:
            return only.split(":")[0] in self.name
        return self.last_wanted(only) > 0

    def all_steps(self, folder: Path, only: str) -> Iterator[Step]:
        """What is to be run in the folder."""
        if self.steps is not None:
            yield from (step for step in self.steps(folder) if only in f"{self.name}: {step.title}")
            return
        if self.inputs is not None:
            self.inputs(folder)
        for line in self.commands[: self.last_wanted(only)]:
            yield Step(tuple(shlex.split(line)), folder)


def run_step(step: Step) -> Parts:
    """Run a command in this process; what it printed and wrote, masked."""
    if step.prepare is not None:
        step.prepare()
    os.chdir(step.folder)
    before = _files(step.folder)
    words = [word.replace("PROJECT/", f"{PROJECT}/") for word in step.words]
    with tempfile.TemporaryDirectory(prefix="printed_") as printed:
        code = _captured(words, Path(printed))
        texts = {
            name: (Path(printed) / name).read_text(encoding="utf-8", errors="backslashreplace")
            for name in ("stdout", "stderr")
        }
    parts = {"exit code": f"{code}\n"}
    parts |= {name: masked(broken_lines(text), step.folder) for name, text in texts.items()}
    for path, state in _files(step.folder).items():
        if before.get(path) != state:
            name = masked(path.relative_to(step.folder).as_posix(), step.folder)
            name = next(n for n in _numbered(name) if n not in parts)
            parts[name] = rendering(path, step.folder)
    return parts


def _numbered(name: str) -> Iterator[str]:
    """The name, and names for more files that are called so once masked."""
    yield name
    number = 2
    while True:
        yield f"{name} ({number})"
        number += 1


def _captured(words: Sequence[str], printed: Path) -> int:
    """Run with both streams into files, those of libraries in C too."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2), sys.stdout, sys.stderr
    try:
        for number, name in ((1, "stdout"), (2, "stderr")):
            file = os.open(printed / name, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(file, number)
            os.close(file)
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
        try:
            return run(words)
        except SystemExit as ended:
            return ended.code if isinstance(ended.code, int) else 1
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
    finally:
        os.dup2(kept[0], 1)
        os.dup2(kept[1], 2)
        os.close(kept[0])
        os.close(kept[1])
        sys.stdout, sys.stderr = kept[2:]


def _files(folder: Path) -> dict[Path, tuple[int, int]]:
    """All files at any depth, with size and time; hidden ones too, which a command must not leave."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            about = path.stat()
            found[path] = (about.st_size, about.st_mtime_ns)
    return found


def _run_group(group: Group, folder: Path, only: str, log: Path) -> None:
    """In the forked process: run the steps and append each one's parts to the log."""
    signal.alarm(MOST_S)
    with log.open("ab") as stream:
        for step in group.all_steps(folder, only):
            name = f"{group.name}: {step.title}"
            parts = run_step(step)
            if only in name:
                pickle.dump((name, parts), stream)
                stream.flush()


def _fork(group: Group, folder: Path, only: str, log: Path) -> int:
    """The process that runs a group."""
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        _run_group(group, folder, only, log)
        code = 0
    except BaseException as error:
        print(f"{group.name}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
    finally:
        os._exit(code)


def _read_log(log: Path) -> Records:
    records: Records = {}
    if log.exists():
        with log.open("rb") as stream:
            while stream.peek(1):
                name, parts = pickle.load(stream)
                records[name] = parts
    return records


def run_groups(groups: Sequence[Group], processes: int, only: str = "", shown: bool = True) -> Records:
    """Run all groups, some at a time."""
    os.environ.update(ENVIRONMENT)
    time.tzset()
    for module in _PRELOADED:
        importlib.import_module(module)
    wanted = [group for group in groups if group.is_wanted(only)]
    running: dict[int, tuple[int, float]] = {}
    ended: dict[int, int] = {}
    with tempfile.TemporaryDirectory(prefix="reference_") as name:
        top = Path(name).resolve()
        waiting = list(range(len(wanted)))
        while waiting or running:
            while waiting and len(running) < max(processes, 1):
                number = waiting.pop(0)
                folder = top / f"{number:03d}" / "work"
                folder.mkdir(parents=True)
                child = _fork(wanted[number], folder, only, folder.parent / "log")
                running[child] = (number, time.monotonic())
            child, status = os.wait()
            if child in running:
                number, began = running.pop(child)
                ended[number] = os.waitstatus_to_exitcode(status)
                if shown:
                    took = f"{wanted[number].name}: {time.monotonic() - began:.0f} s"
                    print(f"{took}, {len(ended)} of {len(wanted)} groups", file=sys.stderr, flush=True)
        records: Records = {}
        for number, group in enumerate(wanted):
            records |= _read_log(top / f"{number:03d}" / "log")
            if ended[number]:
                records[f"{group.name}: (its process)"] = {"exit code": f"{ended[number]}\n"}
    return {re.sub(r"\s+", " ", name): parts for name, parts in records.items()}
