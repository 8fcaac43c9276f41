from __future__ import annotations

import errno
import importlib
import os
import pkgutil
from pathlib import Path

import pytest

from smoother.errors import UnoccludeError
from smoother.io import write_recording
from smoother.recording import Recording
from smoother.runtime.outputs import writing


def test_an_output_appears_whole(tmp_path: Path) -> None:
    with writing(tmp_path / "out") as temporary:
        temporary.write_text("new")
        assert temporary.parent == tmp_path
        assert not (tmp_path / "out").exists()
    assert (tmp_path / "out").read_text() == "new"
    assert os.listdir(tmp_path) == ["out"]


def test_an_older_output_needs_force(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("old")
    with pytest.raises(UnoccludeError, match="--force"), writing(tmp_path / "out"):
        raise AssertionError("not reached")
    with writing(tmp_path / "out", force=True) as temporary:
        temporary.write_text("new")
    assert (tmp_path / "out").read_text() == "new"


@pytest.mark.parametrize("error", [ValueError("x"), KeyboardInterrupt()])
def test_a_failure_leaves_the_older_output(tmp_path: Path, error: BaseException) -> None:
    (tmp_path / "out").write_text("old")
    with pytest.raises(type(error)), writing(tmp_path / "out", force=True) as temporary:
        temporary.write_text("half")
        raise error
    assert os.listdir(tmp_path) == ["out"]
    assert (tmp_path / "out").read_text() == "old"


def test_a_full_disk(tmp_path: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UnoccludeError, match=r"out\.mcap could not be written: no space left on the disk"):
        write_recording(recording, tmp_path / "out.mcap")
    assert os.listdir(tmp_path) == []


def test_a_failure_in_the_middle_of_writing(
    tmp_path: Path, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    from smoother.io.mcap.chunks import ChunkedFile

    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(ChunkedFile, "messages", fail)
    with pytest.raises(UnoccludeError, match="Input/output error"):
        write_recording(recording, tmp_path / "out.mcap")
    assert os.listdir(tmp_path) == []


def test_places_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(UnoccludeError, match="is a folder"), writing(tmp_path):
        pass
    with pytest.raises(UnoccludeError, match="does not exist"), writing(tmp_path / "no" / "out"):
        pass


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root writes everywhere")
def test_a_folder_of_somebody_else(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(UnoccludeError, match="folder of your own"), writing(tmp_path / "out") as temporary:
        temporary.write_text("x")
    tmp_path.chmod(0o700)


@pytest.mark.skipif(os.name != "posix", reason="links")
def test_a_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to("real")
    with writing(tmp_path / "link", force=True) as temporary:
        temporary.write_text("new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "real").read_text() == "new"


@pytest.mark.parametrize("package", ["smoother", "smoother.io"])
def test_no_lazy_name_is_a_module(package: str) -> None:
    """Python binds a submodule over a name that is looked up late, so the two must differ."""
    module = importlib.import_module(package)
    modules = {found.name for found in pkgutil.iter_modules(module.__path__)}
    assert not modules & set(module.__all__)
