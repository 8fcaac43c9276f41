"""The checks of accuracy by name: `python -m tools.accuracy NAME [options]`, `--help` for what each measures.

A new one is a function from its options to the lines that are printed, marked as a `check`. What takes
recordings of others needs the data sets' folder in UNOCCLUDE_DATASETS.
"""

from __future__ import annotations

import argparse

from tools.accuracy import (  # noqa: F401
    calibrations,
    live,
    measures,
    oracle,
    pairing,
)
from tools.accuracy.check import CHECKS


def main() -> None:
    """Run the check that is named, and print its rows as they come."""
    parser = argparse.ArgumentParser(prog="python -m tools.accuracy", description=__doc__)
    commands = parser.add_subparsers(dest="check", required=True, metavar="NAME")
    for name, (rows, options) in CHECKS.items():
        about = (rows.__doc__ or "").strip().replace("%", "%%")
        command = commands.add_parser(name, help=about, description=about)
        for names, settings in options:
            command.add_argument(*names, **settings)
    wanted = parser.parse_args()
    for row in CHECKS[wanted.check][0](wanted):
        print(row, flush=True)


if __name__ == "__main__":
    main()
