"""A byte reference for rebuilding the code: `python -m tools.reference write`, then `compare`.

`write` runs every case of `tools.reference.cases` and keeps, of its exit code, of what it printed and of each
file that it wrote, a hash and the text, without what changes from run to run; `compare` runs them again and
shows what differs. A reference holds for one machine and its libraries: floating point differs between them.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from pathlib import Path

from tools.reference.cases import GROUPS
from tools.reference.comparison import Reference, differences, findings, other_versions, table
from tools.reference.running import run_groups

DEFAULT = Path("out/reference.zip")


def main(arguments: list[str] | None = None) -> int:
    """Write or compare; 1 where anything differs."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.reference", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("what", choices=("write", "compare", "list"))
    parser.add_argument("file", nargs="?", type=Path, default=DEFAULT, help="default: out/reference.zip")
    parser.add_argument(
        "--only", default="", metavar="PATTERN", help="cases whose name, GROUP: COMMAND, holds this"
    )
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1, help="groups at a time")
    parser.add_argument("--parts", type=int, default=8, help="show the diffs of this many parts")
    parser.add_argument("--lines", type=int, default=14, help="lines of each diff")
    options = parser.parse_args(arguments)
    if options.what == "list":
        print(
            "\n".join(f"{group.name}: {line}" for group in GROUPS for line in group.commands or ["(drawn)"])
        )
        return 0
    if options.what == "compare" and not options.file.exists():
        parser.error(f"there is no {options.file}; `python -m tools.reference write` makes it")
    began = time.monotonic()
    file = options.file.resolve()
    now = Reference.of(run_groups(GROUPS, options.processes, options.only))
    parts = sum(map(len, now.hashes.values()))
    took = f"{len(now.hashes)} cases, {parts} parts, {time.monotonic() - began:.0f} s"
    if not now.hashes:
        parser.error(f"no case holds '{options.only}'; `python -m tools.reference list` shows them")
    if options.what == "write":
        now.write(file)
        codes = Counter(now.texts[parts["exit code"]].strip() for parts in now.hashes.values())
        ends = ", ".join(f"{count} with {code}" for code, count in sorted(codes.items()))
        print(f"{options.file}: {took}; ended {ends}")  # many that fail make a poor reference
        return 0
    old = Reference.read(file)
    found = findings(old, now, options.only)
    print(table(found))
    print(f"{took}; the reference is of {old.made_on.get('commit')}")
    if all(finding.state == "same" for finding in found):
        return 0
    for text in (other_versions(old, now), differences(found, old, now, options.parts, options.lines)):
        if text:
            print(text)
    return 1


if __name__ == "__main__":
    sys.exit(main())
