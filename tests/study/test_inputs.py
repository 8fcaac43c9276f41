"""Which recordings a study has, and what they are called."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from smoother.errors import UnoccludeError
from smoother.study.inputs import find_entries, left_out_note


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name in ("p1/a.mcap", "p1/b.mcap", "p2/a.mcap", "p2/.hidden.mcap", ".trash/x.mcap", "p2/notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    return tmp_path


def names(source: object, output: Path) -> list[str]:
    return [entry.name for entry in find_entries(str(source), output)]


def test_a_folder_with_all_below_it(tree):
    assert names(tree, tree / "out") == ["p1/a.mcap", "p1/b.mcap", "p2/a.mcap"]
    assert names(tree / "p1" / "b.mcap", tree / "out") == ["b.mcap"]


def test_a_pattern_names_from_its_first_wildcard(tree, monkeypatch):
    assert names(tree / "p*" / "a.mcap", tree / "out") == ["p1/a.mcap", "p2/a.mcap"]
    assert names(tree / "p1" / "*", tree / "out") == ["a.mcap", "b.mcap"]
    monkeypatch.chdir(tree)
    assert names("**/a.mcap", tree / "out") == ["p1/a.mcap", "p2/a.mcap"]
    assert Path(find_entries("p2/*.mcap", tree / "out")[0].path) == tree / "p2" / "a.mcap"


@pytest.mark.skipif(os.sep != "/", reason="two slashes begin a server's name on Windows")
def test_a_list_with_two_slashes_at_the_begin(tree):
    """POSIX lets them stand: as if they were another root, no name counts from."""
    rows = tree / "list.txt"
    rows.write_text(f"/{tree / 'p1' / 'a.mcap'}\n{tree / 'p2' / 'a.mcap'}\n", encoding="utf-8")
    assert names(rows, tree / "out") == ["p1/a.mcap", "p2/a.mcap"]
    rows.write_text("//.mcap\n/.m.mcap\n", encoding="utf-8")
    assert names(rows, tree / "out") == [".m.mcap", ".mcap"]
    assert names(f"/{tree}", tree / "out") == ["p1/a.mcap", "p1/b.mcap", "p2/a.mcap"]
    assert Path(find_entries(str(rows), tree / "out")[1].path) == Path("/.mcap")


def test_outputs_are_no_recordings(tree):
    for study in ("p1/out", "p1/older"):
        (tree / study / ".unocclude").mkdir(parents=True)
        (tree / study / ".unocclude" / "study").touch()
        (tree / study / "a.mcap").touch()
    assert names(tree / "p1", tree / "p1" / "out") == ["a.mcap", "b.mcap"]
    with pytest.raises(UnoccludeError, match="where results go"):
        find_entries(str(tree / "p1"), tree / "p1")


def test_a_list_and_calibrations_of_its_own(tree):
    lines = ["# the study", "", "p2/a.mcap\tp2/arm.toml", "p1/a.mcap", "p1/a.mcap"]
    (tree / "study.txt").write_text("\n".join(lines))
    first, second = find_entries(str(tree / "study.txt"), tree / "out")
    assert (first.name, first.calibration) == ("p1/a.mcap", "")
    assert (second.name, Path(second.calibration)) == ("p2/a.mcap", tree / "p2" / "arm.toml")
    # recordings elsewhere are named from the folder that they share
    (tree / "p1" / "study.txt").write_text("a.mcap\n../p2/a.mcap\n")
    assert names(tree / "p1" / "study.txt", tree / "out") == ["p1/a.mcap", "p2/a.mcap"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a.csv\n", "line 1"),
        ("p1/a.mcap\nb.mcap\tx\ty\n", "line 2"),
        ("# nothing\n", "no recording"),
        (b"\xff\xfe\x00", "not a list"),
    ],
)
def test_lists_that_cannot_be_used(tree, text, said):
    path = tree / "list.txt"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(UnoccludeError, match=said):
        find_entries(str(path), tree / "out")


@pytest.mark.parametrize("source", ["nowhere", "empty", "nothing*.mcap"])
def test_nothing_there(tree, source):
    (tree / "empty").mkdir()
    with pytest.raises(UnoccludeError, match=source.replace("*", r"\*")):
        find_entries(str(tree / source), tree / "out")


def test_hidden_recordings_are_left_out_with_a_word(tree, monkeypatch):
    """They were left out without one."""
    assert left_out_note(str(tree)) == (
        f"1 recording whose name begins with a dot is left out ({tree / 'p2' / '.hidden.mcap'}); rename it to"
        " include it"
    )
    monkeypatch.chdir(tree)
    (tree / "p1" / ".a.mcap").touch()
    assert left_out_note("p*/*.mcap").startswith(
        "2 recordings whose names begin with a dot are left out (p1/.a"
    )
    assert left_out_note("p*/a.mcap") == left_out_note("p1/a.mcap") == ""
    # what a Mac writes beside every file on a foreign disk, and an output of ours that is being written
    (tree / "p1" / ".a.mcap").unlink()
    for name in ("._a.mcap", f".a.mcap.{24 * '0'}.unocclude.tmp.mcap"):
        (tree / "p1" / name).touch()
    assert left_out_note("p1") == ""
    (tree / "only").mkdir()
    (tree / "only" / ".x.mcap").touch()
    with pytest.raises(
        UnoccludeError, match=r"no recording .* here; 1 recording whose name begins with a dot"
    ):
        find_entries("only", tree / "out")
