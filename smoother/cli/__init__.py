"""The command line: `unocclude`."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the command that the arguments name, and exit with its code."""
    from .run import run

    sys.exit(run(sys.argv[1:]))
