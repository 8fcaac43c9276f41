"""One target by atheris: `python -m tools.fuzz.one TARGET CORPUS [options of libFuzzer]`."""

from __future__ import annotations

import sys


def main() -> None:
    """Fuzz until the time is over, or something unexpected leaves the target."""
    import atheris

    name = sys.argv.pop(1)
    with atheris.instrument_imports(include=["smoother", "calib"]):
        from tools.fuzz.targets import once

    def test_one_input(data: bytes) -> None:
        once(name, data)

    atheris.Setup(sys.argv, test_one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
