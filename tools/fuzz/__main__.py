"""Every reader fuzzed in turn: `make fuzz MINUTES=10`, or `python -m tools.fuzz --minutes 10 --only trc`.

Needs atheris, a tool that the project does not depend on: `.venv/bin/python -m pip install atheris`. What is
found lies in `out/fuzz/TARGET/crash-..`; `python -m tools.fuzz --again FILE --only TARGET` runs it once more.
A finding becomes a test beside the reader's.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import subprocess
import sys
from pathlib import Path

from tools.fuzz.corpus import write_seeds
from tools.fuzz.targets import LONGEST, TARGETS, once

#: An input may take so long, s, and so much memory, MB.
_MOST_S, _MOST_MB = 20, 3000


def fuzz(target: str, seconds: int, folder: Path) -> tuple[int, int, float, list[Path]]:
    """Fuzz one target: runs, edges covered, processor time, findings."""
    corpus = folder / target
    before = set(corpus.glob("*-*"))
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-m", "tools.fuzz.one", target, str(corpus)]
    limits = [f"-max_total_time={seconds}", f"-timeout={_MOST_S}", f"-rss_limit_mb={_MOST_MB}"]
    more = [f"-max_len={LONGEST}", f"-artifact_prefix={corpus}/", "-print_final_stats=1", "-verbosity=1"]
    path = os.pathsep.join(filter(None, sys.path))  # as here, so that a light environment finds its packages
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path}
    done = subprocess.run(
        [*words, *limits, *more], capture_output=True, text=True, env=environment, check=False
    )
    runs = re.search(r"number_of_executed_units:\s*(\d+)", done.stderr)
    edges = re.findall(r"cov: (\d+)", done.stderr)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    taken = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
    met = sorted(set(corpus.glob("*-*")) - before)
    if done.returncode and not met:
        print(done.stderr[-2000:], file=sys.stderr)
    return int(runs.group(1)) if runs else 0, int(edges[-1]) if edges else 0, taken, met


def main() -> int:
    """Fuzz all targets, or run one input again; 1 where anything was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="for all targets together")
    parser.add_argument("--only", choices=TARGETS, action="append")
    parser.add_argument("--folder", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--again", type=Path, help="run this input once, in this process")
    options = parser.parse_args()
    targets = options.only or list(TARGETS)
    if options.again:
        for target in targets:
            once(target, options.again.read_bytes())
        return 0
    write_seeds(options.folder)
    print(f"{'target':12} {'runs':>9} {'edges':>7} {'processor, s':>13}  found")
    count = 0
    for target in targets:
        runs, edges, taken, met = fuzz(
            target, max(round(60 * options.minutes / len(targets)), 1), options.folder
        )
        count += len(met)
        listed = ", ".join(map(str, met)) or "nothing"
        print(f"{target:12} {runs:9} {edges:7} {taken:13.1f}  {listed}", flush=True)
    return int(bool(count))


if __name__ == "__main__":
    sys.exit(main())
