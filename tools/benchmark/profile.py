"""Where the time of `unocclude smooth` goes: the command itself, run inside this process and listened to.

By part, through the words that `smooth` reports its progress and through the functions that read and write;
in GTSAM, through its own methods; and, of what is left, by function, through a timer that looks where the
program is. A function that was renamed is reported as not found, and its time stays with the part around it.
"""

from __future__ import annotations

import contextlib
import inspect
import io
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any

#: Parts by the word that `smooth` prints when it begins; another word is a part by itself.
WORDS = {
    "calibrating": "calibrate",
    "first pass": "first pass",
    "recovering": "second pass",
    "joining": "join and assemble",
    "done": "join and assemble",
}
START, READ, WRITE, REST = "start and imports", "read the file", "write the file", "figures and printing"
PARTS = (START, READ, "calibrate", "first pass", "second pass", "join and assemble", WRITE, REST)
#: Functions that are a part by themselves, wherever they are called from.
FUNCTIONS = {READ: ("smoother.cli.load:load_arms",), WRITE: ("smoother.io.result.write:write_recovery",)}
SMOOTH = "smoother.smoothing:smooth"
#: GTSAM's own methods that solve: what building a graph costs is not among them, nor what our own algebra
#: makes of the linearised graph (covariances), which is found among the functions.
SOLVING: dict[str, dict[str, tuple[str, ...]]] = {
    "optimise": {
        "LevenbergMarquardtOptimizer": ("__init__", "optimize", "iterate"),
        "GaussNewtonOptimizer": ("__init__", "optimize", "iterate"),
    },
    "linearise": {
        "NonlinearFactorGraph": ("linearize", "error"),
        "GaussianFactorGraph": ("sparseJacobian_", "hessian"),
    },
}
#: The timer looks this often, s of processor time.
LOOK_S = 0.005


@dataclass
class Spent:
    """Seconds by part, processor seconds in GTSAM and by function, and what was not found.

    Attributes
    ----------
    parts : dict, s
        Wall time.
    parts_cpu : dict, s
        Processor time of the main process.
    gtsam : dict, s
        Processor seconds by kind; empty where workers solved.
    functions : dict, s
        Processor seconds outside GTSAM, by `module:function`, the innermost of our own.
    cpu_s : float, s
        Processor seconds of the main process in all.
    missing : list of str
        Names that there are none of any more.
    """

    parts: dict[str, float] = field(default_factory=dict)
    parts_cpu: dict[str, float] = field(default_factory=dict)
    gtsam: dict[str, float] = field(default_factory=dict)
    functions: dict[str, float] = field(default_factory=dict)
    cpu_s: float = 0.0
    missing: list[str] = field(default_factory=list)


def smooth_arguments(source: Path, result: Path, processes: int) -> list[str]:
    """What `unocclude` is called with; 0 processes leave the number to it."""
    some = ["--processes", str(processes)] if processes else []
    return ["smooth", str(source), "-o", str(result), "--force", *some]


def profile(source: Path, result: Path, processes: int, inside_gtsam: bool) -> Spent:
    """Run the command here and print where its time went; call it in a process of its own.

    Parameters
    ----------
    inside_gtsam : bool
        Also what GTSAM takes, and which functions; with `processes` 1 only, since workers are
        not listened to.
    """
    arguments = smooth_arguments(source, result, processes)
    spent, said, began = Spent(), io.StringIO(), time.process_time()
    clock = Clock(spent)
    clock.now(START)
    looking = _looking(spent) if inside_gtsam else contextlib.nullcontext()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), looking:
        from smoother.cli.run import run

        for part, names in FUNCTIONS.items():
            for name in names:
                _replace(name, clock.during(part), spent)
        _replace(SMOOTH, clock.listening, spent)
        if inside_gtsam:
            _watch_gtsam(spent)
        code = run(arguments)
    clock.now("")
    spent.cpu_s = time.process_time() - began
    if code:
        raise RuntimeError(said.getvalue().strip())
    return spent


class Clock:
    """Charges time to the part that is going on; parts that are functions interrupt the others."""

    def __init__(self, spent: Spent) -> None:
        self._spent = spent
        self._part = ""
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def now(self, part: str) -> str:
        """What is done from here on; what it was before."""
        wall, cpu = time.perf_counter(), time.process_time()
        if self._part:
            parts, parts_cpu = self._spent.parts, self._spent.parts_cpu
            parts[self._part] = parts.get(self._part, 0.0) + wall - self._wall
            parts_cpu[self._part] = parts_cpu.get(self._part, 0.0) + cpu - self._cpu
        before, self._part, self._wall, self._cpu = self._part, part, wall, cpu
        return before

    def during(self, part: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
        """What makes a function a part of its own."""

        def wrap(function: Callable[..., Any]) -> Callable[..., Any]:
            def timed(*arguments: Any, **options: Any) -> Any:
                before = self.now(part)
                try:
                    return function(*arguments, **options)
                finally:
                    # after reading or writing by the command itself come figures and printing
                    self.now(REST if before in (START, REST) else before)

            return timed

        return wrap

    def listening(self, smooth: Callable[..., Any]) -> Callable[..., Any]:
        """`smooth`, its progress heard."""

        def heard(*arguments: Any, **options: Any) -> Any:
            call = inspect.signature(smooth).bind(*arguments, **options)
            to_user = call.arguments.get("progress")

            def progress(fraction: float, word: str) -> None:
                self.now(WORDS.get(word, word))
                if to_user is not None:
                    to_user(fraction, word)

            call.arguments["progress"] = progress
            self.now("calibrate")  # taking the recording apart
            try:
                return smooth(*call.args, **call.kwargs)
            finally:
                self.now(REST)

        return heard


def _replace(name: str, wrap: Callable[[Callable[..., Any]], Callable[..., Any]], spent: Spent) -> None:
    """Wrap a function in its module and wherever it was imported to."""
    home, _, function_name = name.partition(":")
    try:
        function = getattr(import_module(home), function_name)
    except (ImportError, AttributeError):
        spent.missing.append(name)
        return
    wrapped = wrap(function)
    for module in list(sys.modules.values()):
        if getattr(module, "__name__", "").partition(".")[0] in ("smoother", "calib"):
            for key, value in list(vars(module).items()):
                if value is function:
                    setattr(module, key, wrapped)


#: True while one of GTSAM's methods runs: they call each other.
_in_gtsam = False


def _watch_gtsam(spent: Spent) -> None:
    """Count the processor time of GTSAM's solving methods."""
    gtsam = import_module("gtsam")

    def counted(kind: str, method: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **options: Any) -> Any:
            global _in_gtsam
            if _in_gtsam:
                return method(*arguments, **options)
            _in_gtsam, since = True, time.process_time()
            try:
                return method(*arguments, **options)
            finally:
                _in_gtsam = False
                spent.gtsam[kind] = spent.gtsam.get(kind, 0.0) + time.process_time() - since

        return run

    for kind, classes in SOLVING.items():
        spent.gtsam[kind] = 0.0
        for class_name, methods in classes.items():
            for method_name in methods:
                method = getattr(getattr(gtsam, class_name, None), method_name, None)
                if method is None:
                    spent.missing.append(f"gtsam.{class_name}.{method_name}")
                else:
                    setattr(getattr(gtsam, class_name), method_name, counted(kind, method))


@contextlib.contextmanager
def _looking(spent: Spent) -> Any:
    """Look every `LOOK_S` where the program is, and charge it the processor time since the last look.

    Python hears a signal between two of its own steps, so a long call into a library is charged, whole, to
    the function that made it.
    """
    if not hasattr(signal, "SIGPROF"):
        spent.missing.append("signal.SIGPROF")
        yield
        return
    state = {"last": time.process_time(), "gtsam": sum(spent.gtsam.values())}

    def look(number: int, frame: FrameType | None) -> None:
        if _in_gtsam:  # its time is not counted yet: the next look has both
            return
        now, inside = time.process_time(), sum(spent.gtsam.values())
        passed = now - state["last"] - (inside - state["gtsam"])  # what GTSAM took is counted already
        state["last"], state["gtsam"] = now, inside
        while frame is not None and not _ours(frame):
            frame = frame.f_back
        name = "elsewhere"
        if frame is not None:
            function = frame.f_code.co_name
            if function in ("<module>", "__getattr__"):
                name = "imports"
            else:
                name = f"{frame.f_globals['__name__']}:{function}"
        spent.functions[name] = spent.functions.get(name, 0.0) + max(passed, 0.0)

    previous = signal.signal(signal.SIGPROF, look)
    signal.setitimer(signal.ITIMER_PROF, LOOK_S, LOOK_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, previous)


def _ours(frame: FrameType) -> bool:
    return str(frame.f_globals.get("__name__", "")).partition(".")[0] in ("smoother", "calib")
