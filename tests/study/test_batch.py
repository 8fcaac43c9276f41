"""`unocclude batch`: recordings, outputs, rows, sessions and measures, a begun folder, the same bytes."""

from __future__ import annotations

import json
import os
import shutil
import socket
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import duckdb
import pytest
from commands import done
from studies import BROKEN, NAMES, batch, query, state

from calib.file import CalibrationFile, read_calibration, write_calibration
from smoother import __version__
from smoother.calibration import ArmCalibration, Length
from smoother.cli.run import run
from smoother.config import Config
from smoother.errors import UnoccludeError
from smoother.io import read_recording, write_recording
from smoother.study.folder import MEASURE_FIELDS, StudyFolder
from smoother.study.inputs import file_hash, find_entries, relative_day, with_sessions
from smoother.study.run import run_job
from tools.accuracy.pairing import made_session, trials_of


@pytest.mark.slow
def test_a_study_and_what_is_done_again(recordings, tmp_path, capsys):
    out = tmp_path / "out"
    again = [recordings, "-o", out, "--processes", 2]
    assert batch(*again, "--report", "--json", tmp_path / "study.json") == 1
    printed = capsys.readouterr()
    assert printed.err == "" and "4 recovered now" in printed.out and BROKEN in printed.out
    figures = json.loads((tmp_path / "study.json").read_text())
    assert (figures["recordings"], figures["done"], figures["failed"]) == (5, 4, 1)
    assert [row["recording"] for row in figures["rows"]] == sorted([*NAMES, BROKEN])
    assert figures["failures"][0]["recording"] == BROKEN
    check_rows(recordings, out, figures["rows"])
    check_page((out / "report.html").read_text(encoding="utf-8"))
    first, rows = state(out), query(out)
    assert set(first) == set(NAMES) and len(rows) == 5
    assert {path.name for path in (out / ".unocclude").iterdir()} == {"study", "lock"}

    # the command `smooth` gives the same bytes, but for the motions that it draws
    one = tmp_path / "one.mcap"
    done("smooth", recordings / NAMES[0], "-o", one, "--processes", "1", "--draws", "0")
    assert one.read_bytes() == first[NAMES[0]][1]

    # nothing is computed twice; the failure is tried again
    capsys.readouterr()
    assert batch(*again) == 1
    assert "0 recovered now" in capsys.readouterr().out
    assert state(out) == first and {row for row in rows if row[0] != BROKEN} < set(query(out))

    # a recording that was touched is the same by its content; one that was changed, and an output that is
    # gone, are computed again
    os.utime(recordings / NAMES[0], ns=(1, 1))
    (recordings / NAMES[1]).write_bytes((recordings / NAMES[2]).read_bytes())
    (out / NAMES[3]).unlink()
    (recordings / BROKEN).unlink()
    assert batch(*again) == 0
    second = state(out)
    assert {name for name in NAMES if second[name] != first[name]} == {NAMES[1], NAMES[3]}
    assert second[NAMES[3]][1] == first[NAMES[3]][1]
    assert [row[0] for row in query(out)] == sorted([*NAMES, BROKEN]), "a row for each"


def check_rows(recordings, out, rows):
    for row in rows:
        assert row["version"] == __version__ and len(row["config_hash"]) == 64
        assert row["calibration_hash"] == "" and row["seconds"] > 0
        assert row["input_hash"] == file_hash(recordings / row["recording"])
        if row["recording"] == BROKEN:
            assert row["status"] == "failed" and "is not an MCAP file" in row["error"]
            continue
        assert row["output_hash"] == file_hash(out / row["output"])
        assert 5.5 < row["duration_s"] < 6.5 and row["gaps"] == 1 and 0.5 < row["occluded_s"] < 1.1
        assert 0.001 < row["sigma_max_m"] < 0.05 and abs(row["clock_offset_s"]) < 0.2
        assert row["notes"] == len(row["note_texts"])
    assert len({row["id"] for row in rows}) == len(rows)


def check_page(page):
    assert all(f'href="{name}"' in page for name in NAMES)
    assert "Recordings</h2>" in page and "is not an MCAP file" in page
    assert "4 of 5 recordings were recovered, 1 failed" in page


@pytest.mark.slow
def test_other_settings_are_other_results(in_here, made, tmp_path, capsys):
    (tmp_path / "list.txt").write_text(f"{made / NAMES[0]}\n")
    (tmp_path / "c.toml").write_text("[windows]\nmargin_s = 1.0\n")
    (tmp_path / "processes.toml").write_text("[windows]\nprocesses = 7\n")
    arm = ArmCalibration(side="right", upper_arm=Length(0.31, 0.01))
    write_calibration(tmp_path / "arm.toml", CalibrationFile({"right": arm}))
    out, source = tmp_path / "out", tmp_path / "list.txt"
    found = []
    for more, computed in (
        ([], 1),
        (["--config", tmp_path / "processes.toml"], 0),  # says nothing of the result
        (["--config", tmp_path / "c.toml"], 1),
        ([], 1),  # the output is that of the other settings by now
        ([], 0),
        (["--force"], 1),
        (["--calibration", tmp_path / "arm.toml"], 1),
    ):
        capsys.readouterr()
        assert batch(source, "-o", out, "--processes", 1, *more) == 0
        assert f"{computed} recovered now" in capsys.readouterr().out
        found += query(out, "config_hash, calibration_hash")
    assert len(found) == 7 and len(set(found)) == 3


def test_no_scheduler(made, tmp_path, capsys):
    assert batch(made, "-o", tmp_path / "out", "--scheduler", "nonsense") == 1
    said = capsys.readouterr().err
    assert "no Dask scheduler responds" in said and said.count("\n") == 1


def test_a_page_that_somebody_else_wrote_is_kept(in_here, recordings, tmp_path, capsys):
    for name in (*NAMES[1:], BROKEN):
        (recordings / name).unlink()
    page, figures = tmp_path / "mine.html", tmp_path / "mine.json"
    words = [recordings, "-o", tmp_path / "out", "--processes", 1, "--report", page, "--json", figures]
    for mine in (page, figures):
        mine.write_text("mine")
        assert batch(*words) == 1
        assert f"{mine} exists already" in capsys.readouterr().err and mine.read_text() == "mine"
        mine.unlink()
    assert batch(*words) == 0
    assert batch(*words) == 0, "what the study wrote itself is renewed"
    assert json.loads(figures.read_text())["done_before"] == 1


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
def test_what_is_no_file_stops_no_other(in_here, recordings, tmp_path, capsys):
    """With a page or figures to write, a pipe called x.mcap stopped the whole study."""
    folder = tmp_path / "study"
    folder.mkdir()
    shutil.copy(recordings / NAMES[0], folder / "a.mcap")
    os.mkfifo(folder / "pipe.mcap")
    (folder / "device.mcap").symlink_to(os.devnull)
    (folder / "gone.mcap").symlink_to("nowhere")
    (folder / "loop.mcap").symlink_to("loop.mcap")
    (folder / "folder.mcap").mkdir()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(folder / "socket.mcap"))
    figures = tmp_path / "study.json"
    again = ["-o", tmp_path / "out", "--processes", 1, "--report", "--json", figures]
    assert batch(f"{folder}/*.mcap", *again) == 1
    printed = capsys.readouterr()
    assert printed.err == ""
    rows = {row["recording"]: row for row in json.loads(figures.read_text())["rows"]}
    assert rows.pop("a.mcap")["status"] == "done"
    said = {
        **dict.fromkeys(("pipe.mcap", "device.mcap", "socket.mcap"), "is a pipe, a socket or a device"),
        "gone.mcap": "is a link to nowhere, which cannot be read",
        "loop.mcap": "is a link to loop.mcap, which cannot be read",
        "folder.mcap": "is a folder",
    }
    assert set(rows) == set(said)
    assert all(words in rows[name]["error"] for name, words in said.items())


@pytest.fixture
def folder(tmp_path: Path) -> StudyFolder:
    return StudyFolder(tmp_path / "new")


@pytest.mark.parametrize("made", range(3))
def test_what_a_killed_command_began_is_taken_up(folder: StudyFolder, made: int):
    for path in (folder.results, folder.mark.parent)[:made]:
        path.mkdir(parents=True)
    word = folder.open()
    assert folder.word() == word == folder.open()


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
    folder.mark.parent.mkdir(parents=True)
    with folder.alone(), pytest.raises(UnoccludeError, match="another command works on"):
        folder.open()


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


@pytest.fixture(scope="module")
def study(made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording, measured with a few draws."""
    out = tmp_path_factory.mktemp("measured") / "out"
    with pytest.MonkeyPatch.context() as patch:  # others take longer to start than the work takes
        patch.setattr("smoother.study.run.run_apart", run_job)
        assert batch(made / NAMES[0], "-o", out, "--processes", 1, "--measures", "--draws", 20) == 0
    return out


@pytest.mark.slow
def test_rows_hold_the_measures_of_each_session(study: Path):
    rows = duckdb.sql(
        f"SELECT recording, unnest(measures, recursive := true) FROM '{study}/results/*.parquet'"
    )
    assert rows.columns == ["recording", *(name for name, *_ in MEASURE_FIELDS)]
    found = {(row[0], row[4]): dict(zip(rows.columns, row, strict=True)) for row in rows.fetchall()}
    flexion = found["a.mcap", "elbow_flexion_range_deg"]
    assert flexion["unit"] == "deg" and flexion["side"] == "right" and flexion["n_draws"] == 20
    assert flexion["low"] < flexion["high"] and 0 < flexion["sigma"] < 20
    assert 0 <= flexion["recovered_share"] <= 1
    assert len(query(study, "trusted, recorded_day")) == 1


def test_the_result_is_the_one_without_measures(study: Path, made: Path, tmp_path: Path):
    one = tmp_path / "one.mcap"
    done("smooth", made / NAMES[0], "-o", one, "--processes", "1", "--draws", "0")
    assert one.read_bytes() == state(study)["a.mcap"][1]


def test_measures_that_are_there_are_not_measured_again(in_here: None, study: Path, made: Path, capsys):
    again = [made / NAMES[0], "-o", study, "--processes", 1, "--measures", "--draws", 20]
    assert batch(*again) == 0
    assert "0 recovered now" in capsys.readouterr().out
    assert len(query(study)) == 1


def test_days_are_relative_to_a_secret_one():
    day_ns = 86_400 * 10**9
    origin = 20_000 * day_ns
    first = relative_day("word", "p1", origin)
    assert first is not None and abs(first - 20_000) > 1e-3
    assert relative_day("word", "p1", origin + 14 * day_ns) - first == pytest.approx(14)
    assert relative_day("word", "p2", origin) != first != relative_day("other", "p1", origin)
    assert relative_day("word", "p1", 0) is None  # a clock that knows no date


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
