"""One target by atheris: `python -m tools.fuzz.one TARGET CORPUS [options of libFuzzer]`."""

from __future__ import annotations

import dis
import operator
import sys
from pathlib import Path
from typing import Any

from tools.fuzz.limits import Limits

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
