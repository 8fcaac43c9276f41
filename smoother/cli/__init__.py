"""The command line: `unocclude`."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command that the arguments name, and exit with its code."""
    # all cores are kept busy by processes; threads of the libraries inside only get in each other's way
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    from .run import run

    sys.exit(run(sys.argv[1:]))
