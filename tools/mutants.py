"""Mutation testing of what must not go wrong unseen: `python -m tools.mutants --write tools/mutants.md`.

Of every file in `TESTS_OF` a seeded sample of mutants (`mutations`: one small change each) is drawn, and the
tests of that file run on each. A mutant is killed if a test fails, or if it takes three times as long as the
right program. The page gets the table, and the mutants that survived with why they may.

Each mutant is a process of its own, forked from one that has imported the libraries (numpy, scipy, gtsam) but
none of ours; there an importer answers for the mutated module, then pytest imports all else anew. So every
module and test sees the mutant, nothing is written to the tree, and a mutant costs what its tests cost.

Needs mutmut, a tool and no dependency: `.venv/bin/python -m pip install mutmut`.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import CodeType, ModuleType

ROOT = Path(__file__).parents[1]
#: Tests of each file, the quick ones first: pytest stops at the first that fails.
_ALONE = "--noconftest"  # tests that need none of its recordings, which take a second to import
_GRAPH = (
    _ALONE,
    "tests/graph/test_errors_of_factors.py",
    "tests/graph/test_answer_of_a_window.py",
    "tests/graph/test_stages.py",
)
TESTS_OF: dict[str, tuple[str, ...]] = {
    **{
        f"smoother/graph/{name}.py": _GRAPH
        for name in (
            "build",
            "error_columns",
            "factors",
            "optimise",
        )
    },
    "smoother/graph/shared_prior.py": (
        *_GRAPH,
        "tests/graph/test_gravity_axes.py",
        "tests/graph/test_lag_window.py",
    ),
    "smoother/graph/block_shifts.py": (_ALONE, "tests/graph/test_block_shifts.py"),
    "smoother/graph/error_columns.py": (*_GRAPH[1:], "tests/graph/test_clock_information.py"),
    **{
        f"smoother/graph/{name}.py": (
            *_GRAPH[1:],
            "tests/graph/test_linear_system.py",
            "tests/graph/test_sampling.py",
        )
        for name in ("linear_system", "solve")
    },
    "smoother/graph/variables.py": (_ALONE, "tests/graph/test_linear_system.py"),
    "smoother/graph/sampling.py": ("tests/graph/test_sampling.py",),
    "smoother/graph/lag_elimination.py": (
        _ALONE,
        "tests/graph/test_lag_window.py",
    ),
    "smoother/graph/lag_factors.py": (
        "tests/graph/test_lag_window.py",
        "tests/live/test_further_imus.py",
    ),
    "smoother/graph/scale.py": ("tests/graph/test_scale.py",),
    "smoother/graph/lag_window.py": (
        "tests/graph/test_lag_window.py",
        "tests/live/test_live_smoother.py",
    ),
    "smoother/selfcal/clock_fit.py": (_ALONE, "tests/selfcal/test_clock_score.py"),
    "smoother/measurements/outliers.py": (
        _ALONE,
        "tests/measurements/test_outliers.py",
    ),
    "smoother/window/pooling.py": (
        _ALONE,
        "tests/window/test_pooling.py",
    ),
    "smoother/evaluation/coverage.py": (
        _ALONE,
        "tests/evaluation/test_coverage.py",
        "tests/report/test_advice.py",
    ),
    **{
        f"smoother/io/wire/{name}.py": (_ALONE, f"tests/io/wire/test_{tests}.py")
        for name, tests in (
            ("cdr", "cdr_messages"),
            ("layout", "layout_of_messages"),
            ("protobuf_decode", "protobuf_messages"),
            ("protobuf_encode", "protobuf_messages"),
            ("schemas", "protobuf_messages"),
        )
    },
    "calib/panel/panel_graph.py": (
        _ALONE,
        "tests/calib/test_panel_errors.py",
        "tests/calib/test_panel_errors.py",
    ),
}
#: Survivors that no test can or should kill, with why.
EXPLAINED = ROOT / "tools/mutants_explained.toml"
#: A mutant may take this many times the processor time of the right program, and this much more, s.
TIMES, MORE_S = 3.0, 2.0
#: And this many times that in all: the machine may be busy with something else.
WAIT = 60.0
MEMORY = 8 << 30
#: What the tests end in where the mutated module was never imported.
NOT_IMPORTED = 97


@dataclass
class FileResult:
    """What became of a file's mutants.

    Attributes
    ----------
    mutants, run, killed, late : int
        All there are, those drawn, of these killed, and of the killed those that took too long.
    seed : int
        Of the draw.
    survived : list of str
        Changes that no test noticed.
    """

    mutants: int
    run: int = 0
    killed: int = 0
    late: int = 0
    seed: int = 0
    survived: list[str] = field(default_factory=list)


class _Importer(importlib.abc.MetaPathFinder, importlib.machinery.SourceFileLoader):
    """Answers for one module with another source."""

    def __init__(self, name: str, path: Path, source: str) -> None:
        super().__init__(name, str(path))
        self.source, self.used = source, False

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.name:
            return None
        return importlib.util.spec_from_file_location(fullname, self.path, loader=self)

    def get_code(self, fullname: str) -> CodeType:
        self.used = True
        return compile(self.source, self.path, "exec", dont_inherit=True)


def run_tests(path: str, source: str, tests: Sequence[str], cpu_s: float = 600.0) -> tuple[int, float]:
    """Run tests in a process of their own in which a module has another source.

    Parameters
    ----------
    path : str
        The module's file, from the root.
    source : str
        What is imported in its place.
    tests : sequence of str
        pytest's arguments.
    cpu_s : float, s
        Processor time that they may take.

    Returns
    -------
    code : int
        pytest's exit code; negative for a signal, which is what a process over its time ends in.
    cpu_s : float, s
        What they took.
    """
    sys.stdout.flush()
    folder = Path(tempfile.mkdtemp(prefix="mutant"))
    begun = time.monotonic()
    child = os.fork()
    if child == 0:
        try:
            code = _child(path, source, tests, cpu_s, folder)
        except BaseException:
            code = 1
        os._exit(code)
    try:
        while True:
            done, status, usage = os.wait4(child, os.WNOHANG)
            if done:
                break
            if time.monotonic() - begun > WAIT * (cpu_s + 1.0):
                os.killpg(child, signal.SIGKILL)
            time.sleep(0.02)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime


def _child(path: str, source: str, tests: Sequence[str], cpu_s: float, folder: Path) -> int:
    os.setsid()
    limit = int(cpu_s) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    out = os.open(folder / "out", os.O_WRONLY | os.O_CREAT)
    os.dup2(out, 1)
    os.dup2(out, 2)
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
    os.chdir(ROOT)
    importer = _Importer(path.removesuffix(".py").replace("/", "."), ROOT / path, source)
    sys.meta_path.insert(0, importer)
    import pytest
    from hypothesis import settings

    # the same examples for every mutant, and none remembered from another
    settings.register_profile("mutants", database=None, derandomize=True, deadline=None)
    settings.load_profile("mutants")
    options = ["-x", "-q", "--no-header", "-p", "no:cacheprovider", f"--basetemp={folder / 'pytest'}"]
    code = int(pytest.main([*options, *tests]))
    if os.environ.get("MUTANT_OUTPUT"):
        shutil.copy(folder / "out", os.environ["MUTANT_OUTPUT"])
    return code if importer.used else NOT_IMPORTED


def import_libraries() -> None:
    """Everything that the tests import and that is not ours, once for all mutants."""
    os.environ["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"
    for name in ("pytest", "hypothesis", "gtsam", "gtsam.symbol_shorthand", "numpy.testing"):
        importlib.import_module(name)
    for name in (
        "spatial.transform",
        "optimize",
        "ndimage",
        "stats",
        "sparse.linalg",
        "signal",
        "io",
        "interpolate",
    ):
        importlib.import_module(f"scipy.{name}")
    for name in (
        "pydantic",
        "tomlkit",
        "vqf",
        "mcap.writer",
        "mcap.reader",
        "google.protobuf.descriptor_pb2",
    ):
        importlib.import_module(name)
    ours = [name for name in sys.modules if name.partition(".")[0] in ("smoother", "calib")]
    assert not ours, ours


def examine(
    path: str, tests: Sequence[str], most: int, seed: int, before: FileResult | None = None
) -> FileResult:
    """Draw a file's mutants and run its tests on each; of those drawn `before` on the survivors only."""
    from tools.mutations import SourceFile

    source = (ROOT / path).read_text(encoding="utf-8")
    code, cpu_s = run_tests(path, source, tests)
    if code:
        raise SystemExit(f"{path}: the tests fail without a mutant (exit {code}): {' '.join(tests)}")
    file = SourceFile(path, source)
    result = FileResult(len(file), seed=seed)
    for mutant in file.sample(most, seed):
        result.run += 1
        if before is not None and mutant.change not in before.survived:
            result.killed += 1
            continue
        code, _ = run_tests(path, mutant.source, tests, TIMES * cpu_s + MORE_S)
        result.killed += code != 0
        result.late += code in (-signal.SIGXCPU, -signal.SIGKILL)
        if code == 0:
            result.survived.append(mutant.change)
            print(f"  survived: {mutant.change}", flush=True)
    print(f"{path}: {result.killed} of {result.run} killed ({cpu_s:.1f} s a clean run)", flush=True)
    return result


def explanations() -> dict[tuple[str, str], str]:
    """Why a survivor may live, by file and change."""
    entries = tomllib.loads(EXPLAINED.read_text(encoding="utf-8")).get("survivor", [])
    return {(entry["file"], entry["change"]): entry["why"] for entry in entries}


def page_part(results: dict[str, FileResult]) -> str:
    """The table by file, and the survivors with why, as Markdown."""
    why = explanations()
    lines = [
        "| file | mutants | run | killed | | survived, explained | survived |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    total = FileResult(0)
    listed: list[str] = []
    explained_all = 0
    for path, result in results.items():
        explained = sum((path, change) in why for change in result.survived)
        explained_all += explained
        lines.append(_row(f"`{path}`", result, explained))
        for name in ("mutants", "run", "killed"):
            setattr(total, name, getattr(total, name) + getattr(result, name))
        for change in result.survived:
            text = why.get((path, change), "not explained")
            listed.append(f"| `{Path(path).name}` | `{change.replace('|', chr(92) + '|')}` | {text} |")
    lines.append(_row("all", total, explained_all))
    table = "\n".join(lines)
    if listed:
        table += "\n\n" + "\n".join(
            ["| file | change that no test notices | why |", "|---|---|---|", *listed]
        )
    return table


def _row(name: str, result: FileResult, explained: int) -> str:
    share = f"{100 * result.killed / max(result.run, 1):.0f} %"
    left = result.run - result.killed - explained
    return f"| {name} | {result.mutants} | {result.run} | {result.killed} | {share} | {explained} | {left} |"


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", nargs="*", default=[""], help="parts of files' names; all files if none")
    parser.add_argument("--most", type=int, default=40, help="most mutants of a file")
    parser.add_argument("--seed", type=int, default=1, help="of the draw")
    parser.add_argument("--store", type=Path, default=ROOT / "out/mutants.json", help="results so far")
    parser.add_argument("--write", type=Path, help="page whose marked part is replaced")
    parser.add_argument("--again", action="store_true", help="run the last survivors only: tests were added")
    parser.add_argument("--table-only", action="store_true", help="write the page from the results so far")
    options = parser.parse_args()
    stored = json.loads(options.store.read_text()) if options.store.exists() else {}
    results = {path: FileResult(**values) for path, values in stored.items() if path in TESTS_OF}
    chosen = [path for path in TESTS_OF if any(part in path for part in options.only)]
    if not options.table_only:
        import_libraries()
        for path in chosen:
            before = results.get(path) if options.again else None
            most, seed = (before.run, before.seed) if before else (options.most, options.seed)
            results[path] = examine(path, TESTS_OF[path], most, seed, before)
            options.store.parent.mkdir(parents=True, exist_ok=True)
            options.store.write_text(
                json.dumps({name: asdict(each) for name, each in results.items()}, indent=1)
            )
    made = page_part({path: results[path] for path in TESTS_OF if path in results})
    if options.write is None:
        print(made)
        return 0
    begin, end = "<!-- tools/mutants.py -->\n", "\n<!-- end -->"
    head, _, rest = options.write.read_text(encoding="utf-8").partition(begin)
    _, _, tail = rest.partition(end)
    options.write.write_text(f"{head}{begin}{made}{end}{tail}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
