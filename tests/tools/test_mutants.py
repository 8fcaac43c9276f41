"""The tools for mutation testing and fuzzing: which tests see a mutant, and what they begin with."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from resource import RUSAGE_SELF

import pytest

from smoother.errors import UnoccludeError
from tools.fuzz import __main__ as fuzzing
from tools.fuzz.corpus import seeds, write_seeds
from tools.fuzz.one import Limits, _peak_mb, _without_arrays
from tools.fuzz.targets import LONGEST, names, once, target
from tools.mutants import NOT_IMPORTED, ROOT, TESTS_OF, FileResult, explanations, page_part

SCRIPT = """
import json, sys
from tools.mutants import ROOT, import_libraries, run_tests
import_libraries()
path = "smoother/linalg.py"
source = (ROOT / path).read_text(encoding="utf-8")
other = source.replace("return R @ covariance", "return covariance @ R")
endless = source.replace('    matrix = np.zeros((*v.shape[:-1], 3, 3))', '    while True: pass')
assert other != source and endless != source
answers = {}
for name, text, test in json.loads(sys.argv[1]):
    text = {"right": source, "wrong": other, "endless": endless, "broken": "no python"}[text]
    answers[name] = run_tests(path, text, ["--noconftest", test], 2.0)[0]
print(json.dumps(answers))
"""
TESTS = {
    "test_one.py": """
import numpy as np
import smoother.linalg
from smoother.linalg import rotate_covariance, skew

def test_rotated():
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert np.allclose(rotate_covariance(turn, np.diag([1.0, 2.0, 3.0])), np.diag([2.0, 1.0, 3.0]))
    # who imports it in another way has the same one
    assert smoother.linalg.rotate_covariance is rotate_covariance

def test_skew():
    assert np.allclose(skew(np.array([1.0, 2.0, 3.0])) @ [1.0, 2.0, 3.0], 0.0)
""",
    "test_two.py": "def test_nothing():\n    assert True\n",
}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="mutants run in forked processes")
def test_tests_see_the_mutant_and_nothing_else(tmp_path: Path) -> None:
    for name, text in TESTS.items():
        (tmp_path / name).write_text(text)
    one, two = (str(tmp_path / name) for name in TESTS)
    before = (ROOT / "smoother/linalg.py").read_bytes()
    cases = [
        ("right", "right", one),
        ("wrong", "wrong", one),
        ("endless", "endless", one),
        ("broken", "broken", one),
        ("again", "right", one),
        ("elsewhere", "wrong", two),
    ]
    command = [sys.executable, "-c", SCRIPT, json.dumps(cases)]
    made = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    answers = json.loads(made.stdout.splitlines()[-1])
    assert answers["right"] == answers["again"] == 0
    assert answers["wrong"] == 1 and answers["broken"] == 2
    assert answers["endless"] < 0  # ended by the limit of its processor time
    assert answers["elsewhere"] == NOT_IMPORTED  # tests that never import the file prove nothing
    assert (ROOT / "smoother/linalg.py").read_bytes() == before


def test_every_file_and_test_is_there() -> None:
    for path, tests in TESTS_OF.items():
        assert (ROOT / path).is_file()
        assert all((ROOT / test).exists() for test in tests if not test.startswith("-"))
    for package in ("smoother/graph", "smoother/io/wire"):
        for file in (ROOT / package).glob("*.py"):
            if file.name != "__init__.py" and not file.name.endswith("_pb2.py"):
                assert f"{package}/{file.name}" in TESTS_OF


def test_explanations_are_of_files_that_are_mutated() -> None:
    """And of lines that are still there."""
    for (path, change), why in explanations().items():
        before = change.partition(" -> ")[0]
        assert path in TESTS_OF and why
        assert before in " ".join((ROOT / path).read_text(encoding="utf-8").split()), change


def test_the_table_counts_and_lists() -> None:
    (known, why), *_ = explanations().items()
    results = {
        known[0]: FileResult(100, run=10, killed=8, survived=[known[1], "a | b -> a"]),
        "smoother/other.py": FileResult(7, run=5, killed=5),
    }
    table = page_part(results).splitlines()
    assert f"| `{known[0]}` | 100 | 10 | 8 | 80 % | 1 | 1 |" in table
    assert "| all | 107 | 15 | 13 | 87 % | 1 | 1 |" in table
    assert any(why in line for line in table)
    assert f"| `{Path(known[0]).name}` | `a \\| b -> a` | not explained |" in table


SOURCE = '''"""Words."""
from itertools import chain

Name = dict[str, int]
LIMIT = 3


def f(a: int, b: int | None = 2) -> int:
    """Words."""
    if len([a]) < 1:
        raise ValueError("no " + "number")
    for x, y in zip([a], [b], strict=True):
        return x + LIMIT if y else 0
    return -1
'''


def test_what_is_mutated() -> None:
    pytest.importorskip("mutmut", reason="mutmut is a tool, no dependency")
    from tools.mutations import SourceFile

    file = SourceFile("x.py", SOURCE)
    mutants = file.sample(1000, 1)
    changes = {mutant.change for mutant in mutants}
    assert "LIMIT = 3 -> LIMIT = 4" in changes
    assert "return x + LIMIT if y else 0 -> return x - LIMIT if y else 0" in changes
    assert "if len([a]) < 1: -> if len([a]) <= 1:" in changes
    assert "return -1 -> return +1" in changes
    assert not any(word in change for change in changes for word in ("Words", "ValueError", "Name", "chain"))
    assert all("strict=True" in change.partition("->")[2] for change in changes if "zip" in change)
    assert len({mutant.source for mutant in mutants}) == len(mutants) <= len(file)
    assert all(mutant.source != SOURCE for mutant in mutants)
    few = file.sample(4, 1)
    assert len(few) == 4 and [each for each in mutants if each in few] == few  # in the source's order
    assert few == SourceFile("x.py", SOURCE).sample(4, 1) and few != file.sample(4, 2)


SEEDS = seeds()


def test_every_reader_has_inputs():
    assert set(SEEDS) == set(names())
    assert {"container", "device-xdf", "device-axivity"} <= set(names())


@pytest.mark.parametrize("name", sorted(names()))
def test_the_first_inputs_are_read(name: str):
    """A target that refuses all of them would fuzz nothing but the refusal."""
    refused = []
    for data in SEEDS[name]:
        assert 0 < len(data) <= LONGEST
        try:
            target(name)(data)
        except UnoccludeError as error:
            refused.append(str(error))
        once(name, data[: len(data) // 2])
    # MetaMotion's accelerometer asks for its gyroscope's file; a picture of eight bits is no depth.
    assert len(refused) < len(SEEDS[name]) or name == "device-metamotion", refused


def test_seeds_and_words_are_written(tmp_path: Path):
    write_seeds(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {*names(), "words.txt"}
    assert all(line.startswith('"\\x') for line in (tmp_path / "words.txt").read_text().splitlines())


def test_arrays_are_compared_past_atheris():
    import numpy as np

    compare = _without_arrays(lambda *_: "traced", 0)
    assert compare(1, 2, 0, 0, False) == "traced"
    np.testing.assert_array_equal(compare(np.arange(3), 1, 4, 0, False), [False, False, True])  # ">"


def test_an_input_that_takes_too_much_is_a_finding(monkeypatch: pytest.MonkeyPatch):
    """Memory counts from what the process held before: what earlier inputs left there is not this one's."""
    held: list[bytearray] = []
    limits = Limits(lambda data: held.append(bytearray(b"1") * int(data)))
    limits(b"10")
    freed_mb = _peak_mb(RUSAGE_SELF) - limits.resting_mb  # an earlier test of this process may have held it
    monkeypatch.setattr("tools.fuzz.one.MOST_MB", freed_mb + 100.0)
    limits(b"%d" % int(1e6 * (freed_mb + 50.0)))
    with pytest.raises(MemoryError, match="MB for 9 bytes"):
        limits(b"120000000")
    limits(b"10")  # the peak stays where it was
    monkeypatch.setattr("tools.fuzz.one.MOST_S", -1.0)
    with pytest.raises(TimeoutError, match="processor"):
        limits(b"10")


@pytest.mark.skipif(find_spec("atheris") is not None, reason="atheris is here")
def test_without_atheris_one_sentence(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr(sys, "argv", ["fuzz"])
    assert fuzzing.main() == 2
    assert "pip install atheris" in capsys.readouterr().err


def test_a_finding_is_named_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setattr(fuzzing, "find_spec", lambda name: object())
    monkeypatch.setattr(fuzzing, "fuzz", lambda name, *_: fuzzing.Count(7, 3, 1.5, [f"{name}/crash-1"]))
    words = ["fuzz", "--only", "trc", "--folder", str(tmp_path), "--counts", str(tmp_path / "counts.json")]
    for executions in (7, 14):
        monkeypatch.setattr(sys, "argv", words)
        assert fuzzing.main() == 1
        assert fuzzing._read(tmp_path / "counts.json")["trc"].executions == executions
    assert "found: trc/crash-1" in capsys.readouterr().out
