"""A few tiny recordings, and one that is none."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from studies import BROKEN, NAMES

from smoother.io import write_recording
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.study.inputs import config_hash
from smoother.study.run import Job, StudySettings, run_job, study_folder


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of 6 s with a gap each."""
    folder = tmp_path_factory.mktemp("recordings")
    settings = ArmSimulation.preset(
        "white", protocol="random", duration_s=6.0, occlusion_lengths_s=(0.8,), occlusion_every_s=4.0
    )
    for seed, name in enumerate(NAMES):
        (folder / name).parent.mkdir(exist_ok=True)
        write_recording(simulate_arm(settings, seed).recording, folder / name)
    return folder


@pytest.fixture
def recordings(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may change, with a broken file."""
    shutil.copytree(made, tmp_path / "in")
    (tmp_path / "in" / BROKEN).write_bytes(b"this is not a recording")
    return tmp_path / "in"


@pytest.fixture
def job(made: Path, tmp_path: Path) -> Job:
    """The first recording's job in a study of its own."""
    folder = study_folder(tmp_path / "out")
    word = folder.open()
    settings = StudySettings()
    source, hashed = str(made / NAMES[0]), config_hash(settings.config, settings.selection)
    return Job(NAMES[0], source, str(folder.path), word, settings, hashed)


@pytest.fixture
def in_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Do a study's jobs here: what is tested is not the processes."""
    monkeypatch.setattr("smoother.study.run.run_apart", run_job)
