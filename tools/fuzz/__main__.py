"""Every reader fuzzed in turn: `make fuzz MINUTES=10`, or `python -m tools.fuzz --minutes 10 --only trc`.

Needs atheris, a tool that the project does not depend on: `.venv/bin/python -m pip install atheris`. What is
found is in `out/fuzz/TARGET/crash-..`; `python -m tools.fuzz --again FILE --only TARGET` runs it once more.
A finding becomes a test beside the reader's.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import subprocess
import sys
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from tools.fuzz.corpus import write_seeds
from tools.fuzz.one import Limits
from tools.fuzz.targets import LONGEST, names, once

#: An input may take this long on the wall, s, and the process with atheris this much memory, MB; what
#: an input may take by itself: `limits`.
_MOST_S, _MOST_MB = 200, 6000
#: What libFuzzer calls its findings.
_KINDS = ("crash-", "timeout-", "oom-", "leak-")


@dataclass
class Count:
    """What one target did.

    Attributes
    ----------
    executions, edges : int
        Inputs tried, and branches that they reached.
    processor_s : float, s
        Time on the processor, of the process and of its children.
    findings : list of str
        Files with an input that left the target in another way than by a sentence.
    """

    executions: int = 0
    edges: int = 0
    processor_s: float = 0.0
    findings: list[str] = field(default_factory=list)

    def add(self, other: Count) -> None:
        """Add what was done later."""
        self.executions += other.executions
        self.edges = max(self.edges, other.edges)
        self.processor_s += other.processor_s
        self.findings += other.findings


def fuzz(target: str, seconds: int, folder: Path) -> Count:
    """Fuzz one target for some time; it ends at its first finding."""
    corpus = folder / target
    before = _findings(corpus)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    words = [sys.executable, "-m", "tools.fuzz.one", target, str(corpus)]
    limits = [f"-max_total_time={seconds}", f"-timeout={_MOST_S}", f"-rss_limit_mb={_MOST_MB}"]
    more = [f"-max_len={LONGEST}", f"-artifact_prefix={corpus}/", "-print_final_stats=1", "-verbosity=1"]
    path = os.pathsep.join(filter(None, sys.path))  # as here, so that a light environment finds its packages
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path}
    words += [*limits, *more, f"-dict={folder / 'words.txt'}"]
    log = folder / f"{target}.txt"
    with log.open("wb") as stream:  # not a pipe, which a child that stays behind would keep open
        ended = subprocess.run(words, stdout=stream, stderr=stream, env=environment, check=False)
    said = log.read_text(encoding="utf-8", errors="replace")
    executions = re.search(r"number_of_executed_units:\s*(\d+)", said)
    edges = re.findall(r"cov: (\d+)", said)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    taken = after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime
    findings = sorted(_findings(corpus) - before)
    if ended.returncode and not findings:  # it did not begin, or ended without a word: that is one too
        findings = [str(log)]
    return Count(
        int(executions.group(1)) if executions else 0, int(edges[-1]) if edges else 0, taken, findings
    )


def _findings(corpus: Path) -> set[str]:
    return {str(path) for path in corpus.iterdir() if path.name.startswith(_KINDS)}


def main() -> int:
    """Fuzz all targets, or run one input again; 1 where anything was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="for all targets together")
    parser.add_argument("--only", choices=names(), action="append")
    parser.add_argument("--folder", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--counts", type=Path, help="add what was done to this JSON")
    parser.add_argument("--again", type=Path, help="run this input once, in this process")
    options = parser.parse_args()
    targets = options.only or list(names())
    if options.again:
        for target in targets:
            Limits(partial(once, target))(options.again.read_bytes())
        return 0
    if find_spec("atheris") is None:
        print(
            "atheris is not here; install it with: .venv/bin/python -m pip install atheris", file=sys.stderr
        )
        return 2
    write_seeds(options.folder)
    counts = _read(options.counts)
    total = Count()
    print(_HEAD)
    for target in targets:
        count = fuzz(target, max(round(60 * options.minutes / len(targets)), 1), options.folder)
        print(_line(target, count), flush=True)
        total.add(count)
        counts.setdefault(target, Count()).add(count)
        if options.counts:
            plain = {name: asdict(each) for name, each in counts.items()}
            options.counts.write_text(json.dumps(plain, indent=1) + "\n", encoding="utf-8")
    print(_line("all", total))
    for finding in total.findings:
        print(f"found: {finding}")
    return int(bool(total.findings))


_HEAD = f"{'target':26} {'executions':>10} {'edges':>6} {'processor, s':>12} {'findings':>8}"


def _line(target: str, count: Count) -> str:
    return (
        f"{target:26} {count.executions:10,} {count.edges:6} {count.processor_s:12.1f}"
        f" {len(count.findings):8}"
    )


def _read(path: Path | None) -> dict[str, Count]:
    """Counts of earlier rounds."""
    if path is None or not path.exists():
        return {}
    return {name: Count(**each) for name, each in json.loads(path.read_text(encoding="utf-8")).items()}


if __name__ == "__main__":
    sys.exit(main())
