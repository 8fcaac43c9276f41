from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from made_recordings import make, plain_texts

from smoother.recording import Recording


@pytest.fixture(scope="session")
def datasets() -> Path:
    folder = os.environ.get("UNOCCLUDE_DATASETS")
    if not folder:
        pytest.skip("UNOCCLUDE_DATASETS is not set: the recordings that others made are not here")
    return Path(folder)


@pytest.fixture
def recording() -> Recording:
    return make()


@pytest.fixture
def plain_folder(tmp_path: Path) -> Callable[..., Path]:
    """Write a folder of plain files; keyword arguments replace the text of a file by its stem."""

    def write(**texts: str) -> Path:
        folder = tmp_path / "plain"
        folder.mkdir(exist_ok=True)
        for stem, text in (plain_texts() | texts).items():
            name = "recording.toml" if stem == "recording" else f"{stem}.csv"
            (folder / name).write_text(text, encoding="utf-8", newline="")
        return folder

    return write
