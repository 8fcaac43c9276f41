"""One target by atheris: `python -m tools.fuzz.one TARGET CORPUS [options of libFuzzer]`."""

from __future__ import annotations

import dis
import operator
import sys
import time
from pathlib import Path
from typing import Any

#: An input may take so long on the processor, s: the wall's clock says more of what else the machine does.
_MOST_S = 10.0
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

    (atheris 3.0: a comparison of 65,536 numbers leaks 64 kB, 3 GB in some minutes.)
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

    shift = atheris.version_dependent.CMP_OP_SHIFT_AMOUNT
    atheris._trace_cmp = _without_arrays(atheris._trace_cmp, shift)
    name, corpus = sys.argv.pop(1), Path(sys.argv[1])
    with atheris.instrument_imports(include=["smoother", "calib", "pyxdf", "rosbags"]):
        from tools.fuzz.targets import once

        for path in sorted(corpus.glob("seed_*")):  # readers are imported when they are first needed
            once(name, path.read_bytes())

    def test_one_input(data: bytes) -> None:
        begun = time.process_time()
        once(name, data)
        taken = time.process_time() - begun
        if taken > _MOST_S:
            raise TimeoutError(f"{taken:.1f} s on the processor for {len(data)} bytes")

    atheris.Setup(sys.argv, test_one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
