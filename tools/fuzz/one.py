"""One target by atheris: `python -m tools.fuzz.one TARGET CORPUS [options of libFuzzer]`."""

from __future__ import annotations

import dis
import operator
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

#: Processor time, s: wall time depends on what else the machine does.
MOST_S = 10.0
#: Of memory above what the process holds anyway, MB.
MOST_MB = 1500.0
#: What the process holds anyway is measured anew after this many inputs: atheris keeps new inputs.
_ANEW = 1000
#: Bytes of `ru_maxrss`.
_UNIT = 1 if sys.platform == "darwin" else 1024


class Limits:
    """Runs inputs one by one and raises where one takes too much.

    Attributes
    ----------
    resting_mb : float, MB
        What the process holds between two inputs.

    Parameters
    ----------
    run : callable
        Takes the bytes of an input.
    """

    def __init__(self, run: Callable[[bytes], None]):
        self._run = run
        self._count = 0
        self.resting_mb = _held_mb()

    def __call__(self, data: bytes) -> None:
        """Run one input.

        Raises
        ------
        TimeoutError, MemoryError
            It takes too long, or too much memory, here or in a process of its own.
        """
        if self._count % _ANEW == 0:
            self.resting_mb = _held_mb()
        self._count += 1
        peak, child = _peak_mb(resource.RUSAGE_SELF), _peak_mb(resource.RUSAGE_CHILDREN)
        begun = time.process_time()
        self._run(data)
        seconds = time.process_time() - begun
        if seconds > MOST_S:
            raise TimeoutError(f"{seconds:.1f} s on the processor for {len(data)} bytes")
        for before, who in ((peak, resource.RUSAGE_SELF), (child, resource.RUSAGE_CHILDREN)):
            after = _peak_mb(who)
            if after > before and after - self.resting_mb > MOST_MB:
                raise MemoryError(f"{after - self.resting_mb:.0f} MB for {len(data)} bytes")


def _peak_mb(who: int) -> float:
    """The most that a process, or the largest of its children, has ever held."""
    return resource.getrusage(who).ru_maxrss * _UNIT / 1e6


def _held_mb() -> float:
    """What this process holds; its peak where the system does not report it."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except OSError:
        return _peak_mb(resource.RUSAGE_SELF)
    return pages * resource.getpagesize() / 1e6


_OPERATORS = {
    "<": operator.lt,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    ">=": operator.ge,
}


def _without_arrays(trace: Any, shift: int) -> Any:
    """Atheris' trace of comparisons, past which arrays go: it learns nothing of them and keeps the answer.

    (atheris 3.0 never frees what a comparison answers: 64 kB for one of 65,536 numbers, GB in some minutes.)
    """
    plain = (int, float, str, bytes, type(None))

    def compare(left: Any, right: Any, code: int, counter: int, is_const: bool) -> Any:
        if isinstance(left, plain) and isinstance(right, plain):
            return trace(left, right, code, counter, is_const)
        return _OPERATORS[dis.cmp_op[code >> shift]](left, right)

    return compare


def main() -> None:
    """Fuzz until the time is over, or something unexpected leaves the target."""
    import atheris

    name, corpus = sys.argv.pop(1), Path(sys.argv[1])
    with atheris.instrument_imports(include=["smoother", "calib", "pyxdf", "rosbags"]):
        from tools.fuzz.targets import once

        for path in sorted(corpus.glob("seed_*")):  # readers are imported when they are first needed
            once(name, path.read_bytes())
    limits = Limits(lambda data: once(name, data))
    patched: Any = None

    def test_one_input(data: bytes) -> None:
        nonlocal patched
        if atheris._trace_cmp is not patched:  # `Fuzz` puts its own there when it begins
            shift = atheris.version_dependent.CMP_OP_SHIFT_AMOUNT
            patched = atheris._trace_cmp = _without_arrays(atheris._trace_cmp, shift)
        limits(data)

    atheris.Setup(sys.argv, test_one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
