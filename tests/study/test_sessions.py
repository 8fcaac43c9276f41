"""A folder of short trials: calibrated together by `batch` and `smooth --session`, once."""

from __future__ import annotations

from pathlib import Path

import pytest

from calib.file import read_calibration
from smoother.cli.run import run
from smoother.config import Config
from smoother.io import read_recording, write_recording
from smoother.study.folder import StudyFolder
from smoother.study.inputs import find_entries, with_sessions
from tools.accuracy.pairing import made_session, trials_of

COUNT, SEED = 6, 3


@pytest.fixture(scope="module")
def trials(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trials")
    for number, (trial, *_) in enumerate(trials_of(made_session(SEED, COUNT), COUNT, SEED)):
        write_recording(trial, folder / f"trial_{number + 1}.mcap")
    (folder / "broken.mcap").write_bytes(b"no recording")
    return folder


@pytest.mark.slow
def test_trials_get_the_calibration_that_they_share_once(trials: Path, tmp_path: Path) -> None:
    assert read_recording(trials / "trial_1.mcap").clocks_unrelated
    folder = StudyFolder((tmp_path / "out").absolute())
    entries = find_entries(str(trials), folder.path)
    own, notes = with_sessions(entries, folder, {}, Config(), "1")
    files = {Path(entry.calibration) for entry in own if entry.calibration}
    assert len(files) == 1
    assert sum(bool(entry.calibration) for entry in own) >= 5
    assert not next(entry for entry in own if "broken" in entry.path).calibration
    (note,) = notes
    assert "one strap" in note
    assert "of 6 trials" in note
    arm = read_calibration(files.pop()).arms["right"]
    true = made_session(SEED, COUNT).calibration.lever_arms["wrist"].position_m
    assert arm.lever_arms["wrist"].position_m == pytest.approx(true, abs=0.015)
    before = {path: path.stat().st_mtime_ns for path in (folder.path / "sessions").iterdir()}
    assert with_sessions(entries, folder, {}, Config(), "1") == (own, notes)
    assert before == {path: path.stat().st_mtime_ns for path in (folder.path / "sessions").iterdir()}
    assert with_sessions(entries, folder, {}, Config(), "2")[0] != own  # another version's are made anew


@pytest.mark.slow
@pytest.mark.parametrize("command", ["smooth", "check"])
@pytest.mark.parametrize("as_list", [False, True], ids=["folder", "list"])
def test_a_trial_is_proved_by_its_session(
    command: str, as_list: bool, trials: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "trials.txt" if as_list else trials
    if as_list:
        session.write_text("".join(f"{trials / f'trial_{number}.mcap'}\n" for number in (1, 3, 4, 5, 6)))
    words = [command, str(trials / "trial_2.mcap")]
    words += ["-o", str(tmp_path / "out.mcap")] if command == "smooth" else []
    assert run([*words, "--session", str(session)]) == 0
    said = capsys.readouterr().out
    assert "share their calibration" in said
    assert "Usable" in said
    assert run([*words, "--session", str(tmp_path / "none"), *(["--force"] if "-o" in words else [])]) == 1
    assert "name a folder" in capsys.readouterr().err


@pytest.mark.slow
def test_a_recording_with_one_clock_needs_no_session(
    trials: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    alone = tmp_path / "alone.mcap"
    write_recording(made_session(SEED, COUNT).recording, alone)
    assert run(["check", str(alone), "--session", str(trials)]) == 0
    assert "stands for itself" in capsys.readouterr().out
