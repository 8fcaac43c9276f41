"""The fuzzer's targets take what they begin with, and its table is right; atheris itself is a tool."""

from __future__ import annotations

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
