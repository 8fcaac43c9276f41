"""The checks of accuracy by name: `python -m tools.accuracy NAME [options]`, `--help` for what each measures.

A new one is a function from its options to the lines that are printed, and a `Check` in the `CHECKS` of its
module. What takes recordings of others needs the data sets' folder in UNOCCLUDE_DATASETS.
"""

from __future__ import annotations

import argparse
import sys

from tools.accuracy import (
    angles,
    calibrations,
    cameras,
    live,
    magnetometer,
    measures,
    oracle,
    pairing,
    panel,
    sessions,
)

MODULES = (
    oracle,
    sessions,
    pairing,
    cameras,
    angles,
    measures,
    live,
    magnetometer,
    calibrations,
    panel,
)
#: Every check by name.
CHECKS = {check.name: check for module in MODULES for check in module.CHECKS}


def option_parser() -> argparse.ArgumentParser:
    """A command for each check, with the check's options."""
    parser = argparse.ArgumentParser(prog="python -m tools.accuracy", description=__doc__)
    commands = parser.add_subparsers(dest="check", required=True, metavar="NAME")
    for check in CHECKS.values():
        command = commands.add_parser(
            check.name, help=check.about.replace("%", "%%"), description=check.about
        )
        for option in check.options:
            command.add_argument(*option.names, **option.settings)
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Run the check that is named, and print its rows as they come."""
    options = option_parser().parse_args(arguments)
    for row in CHECKS[options.check].rows(options):
        print(row, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
