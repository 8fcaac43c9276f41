"""A study's folder that another command is just making, or was killed while it made it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from smoother.errors import UnoccludeError
from smoother.study.folder import StudyFolder


@pytest.fixture
def folder(tmp_path: Path) -> StudyFolder:
    return StudyFolder(tmp_path / "new")


@pytest.mark.parametrize("made", range(4))
def test_what_a_killed_command_began_is_taken_up(folder: StudyFolder, made: int):
    for path in (folder.results, folder.stage, folder.rows)[:made]:
        path.mkdir(parents=True)
    word = folder.open()
    assert folder.is_the_one(word) and folder.open() == word


def test_files_of_no_study_are_refused(folder: StudyFolder):
    for name in ("thesis.txt", "results/rows.parquet"):
        folder.results.mkdir(parents=True)
        (folder.path / name).touch()
        with pytest.raises(UnoccludeError, match="not of a study; name a new folder, or --force"):
            folder.open()
        assert not folder.mark.parent.exists(), "nothing is put among them"
        (folder.path / name).unlink()
        folder.results.rmdir()
    folder.results.touch()
    with pytest.raises(UnoccludeError, match="not of a study"):
        folder.open()


def test_another_command_is_beginning(folder: StudyFolder):
    folder.stage.mkdir(parents=True)
    with folder.alone(), pytest.raises(UnoccludeError, match="another command works on"):
        folder.open()


def test_another_command_begins_and_writes_meanwhile(folder: StudyFolder, monkeypatch: pytest.MonkeyPatch):
    """Its first outputs are not taken for files of somebody else."""
    words = []

    def holds_others(self: StudyFolder) -> bool:
        monkeypatch.undo()
        words.append(self.open())
        (self.path / "a.mcap").touch()
        return self._holds_others()

    monkeypatch.setattr(StudyFolder, "_holds_others", holds_others)
    assert [folder.open()] == words


def test_many_begin_at_once(folder: StudyFolder):
    """Each gets the study's word, or hears that another one works there; nobody replaces the word."""
    at_once = Barrier(8)

    def begin(_: int) -> str:
        at_once.wait()
        try:
            return folder.open()
        except UnoccludeError as error:
            assert "another command works on" in str(error)
            return ""

    with ThreadPoolExecutor(8) as threads:
        words = set(threads.map(begin, range(8)))
    assert words - {""} == {folder.open()}
