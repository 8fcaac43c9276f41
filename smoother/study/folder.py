"""A study's folder: results, outputs, and what workers leave on the way.

::

    DIR/results/*.parquet     rows, written once and never changed
    DIR/day1/a.mcap           outputs, named as the recordings
    DIR/.unocclude/study      a word by which a worker knows that it sees this very folder
    DIR/.unocclude/stage/     outputs that are being written
    DIR/.unocclude/rows/      rows of recordings that are done, until they are among the results
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..errors import UnoccludeError
from ..runtime.outputs import remove_stale_tempfiles, writing


@dataclass(frozen=True)
class StudyFolder:
    """Names in a study's folder; `path` is absolute."""

    path: Path

    @property
    def results(self) -> Path:
        """Where the rows lie."""
        return self.path / "results"

    @property
    def stage(self) -> Path:
        """Where outputs are written before they are moved to their place."""
        return self.path / ".unocclude" / "stage"

    @property
    def rows(self) -> Path:
        """Where a row waits until it is among the results."""
        return self.path / ".unocclude" / "rows"

    @property
    def mark(self) -> Path:
        """The file with the study's word."""
        return self.path / ".unocclude" / "study"

    def output(self, name: str) -> Path:
        """Where the result of a recording lies."""
        return self.path / name

    def open(self, force: bool = False) -> str:
        """Make the folder or take up one that holds a study.

        Parameters
        ----------
        force : bool
            Also use a folder that holds other files.

        Returns
        -------
        word : str
            By which a worker knows that it sees this folder.

        Raises
        ------
        UnoccludeError
            The folder holds files that no study wrote, cannot be made, or another process works on it.
        """
        if self.path.exists() and not self.path.is_dir():
            raise UnoccludeError(f"{self.path} is a file; name a folder for the results")
        # Asked again behind the look: another command may have begun this very study meanwhile.
        if not force and not self.mark.exists() and self._holds_others() and not self.mark.exists():
            raise UnoccludeError(
                f"{self.path} holds files that are not of a study; name a new folder, or --force"
            )
        self._make_folders()  # of an older study, some may have been removed
        with self.alone():  # two that begin at once would each give it a word
            if not self.mark.exists():
                with writing(self.mark) as temporary:
                    temporary.write_text(secrets.token_hex(16), encoding="ascii")
            self.remove_stale_tempfiles()
            return self._word()

    def _holds_others(self) -> bool:
        """Whether there is more than what a study has before its mark, which may be just beginning."""
        if not self.path.is_dir():
            return False
        others = {path.name for path in self.path.iterdir()} - {self.results.name, self.mark.parent.name}
        return bool(others) or not _is_empty(self.results)

    def _make_folders(self) -> None:
        for folder in (self.results, self.stage, self.rows):
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise UnoccludeError(f"{folder} cannot be made: {error.strerror or error}.") from error

    def _word(self) -> str:
        """The study's word; a new one where the file was damaged."""
        for _ in range(2):
            try:
                word = self.mark.read_text(encoding="ascii")
            except UnicodeDecodeError:
                word = ""
            if re.fullmatch("[0-9a-f]{32}", word):
                return word
            with writing(self.mark, force=True) as temporary:
                temporary.write_text(secrets.token_hex(16), encoding="ascii")
        raise UnoccludeError(f"{self.mark} cannot be read; give another folder")

    def is_the_one(self, word: str) -> bool:
        """Whether this machine sees the folder that has this word, not another of its name."""
        try:
            return self.mark.read_text(encoding="ascii") == word
        except (OSError, UnicodeDecodeError):
            return False

    def staged(self, row: str) -> Path:
        """A name that no other process uses, to write an output to."""
        mine = self.stage / f"{socket.gethostname()}~{os.getpid()}"
        mine.mkdir(parents=True, exist_ok=True)
        return mine / f"{row}-{secrets.token_hex(4)}.mcap"

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Keep a second command from doing the same work; the system lets go when this process ends, however.

        Raises
        ------
        UnoccludeError
            Another process works on this study.
        """
        from filelock import FileLock, Timeout

        try:
            lock = FileLock(self.path / ".unocclude" / "lock").acquire(blocking=False)
        except Timeout as error:
            raise UnoccludeError(
                f"another command works on {self.path}; wait for it, or give another folder"
            ) from error
        except (NotImplementedError, OSError):
            # a file system without locks: two commands would do work twice, but spoil nothing
            yield
            return
        with lock:
            yield

    def remove_stale_tempfiles(self) -> None:
        """Remove what processes of this machine that are gone left half written."""
        remove_stale_tempfiles(self.rows, again=True)
        for folder in self.stage.iterdir():
            host, _, process = folder.name.rpartition("~")
            if host == socket.gethostname() and process.isdigit() and not _alive(int(process)):
                shutil.rmtree(folder, ignore_errors=True)


def _is_empty(folder: Path) -> bool:
    """Whether there is nothing of this name, or an empty folder."""
    return not any(folder.iterdir()) if folder.is_dir() else not folder.exists()


def _alive(process: int) -> bool:
    if os.name == "nt":
        return True  # signal 0 would end it there
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
