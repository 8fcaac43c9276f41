"""Parts of a recording: by time, by a table of trials, and in Python."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from commands import done
from mcap.reader import make_reader

from smoother.cli.run import run
from smoother.errors import RecordingError
from smoother.io import read_recording, write_recording
from smoother.io.recording.cut_file import CUT, read_trials
from smoother.recording import Recording
from smoother.simulation import ArmSimulation, simulate_arm

DEMO = Path(__file__).parents[2] / "data" / "demo.mcap"


def table(folder: Path, text: str) -> Path:
    path = folder / "trials.csv"
    path.write_text(text, encoding="utf-8")
    return path


def same_times(part: Recording, whole: Recording, from_s: float, to_s: float) -> None:
    """Every stream of the part is that of the whole between two times."""
    for mine, all_of_it in ((part.imu, whole.imu), (part.arm, whole.arm), (part.truth, whole.truth)):
        assert mine is not None and all_of_it is not None
        inside = (all_of_it.t_s >= from_s) & (all_of_it.t_s < to_s)
        np.testing.assert_allclose(mine.t_s, all_of_it.t_s[inside], atol=1e-9)
    inside = (whole.imu.t_s >= from_s) & (whole.imu.t_s < to_s)
    np.testing.assert_array_equal(part.imu.acc, whole.imu.acc[inside])
    inside = (whole.arm.t_s >= from_s) & (whole.arm.t_s < to_s)
    np.testing.assert_array_equal(part.arm.position, whole.arm.position[inside])


def test_a_part_is_read_as_the_recording_and_says_what_it_is_of(tmp_path: Path) -> None:
    part = tmp_path / "part.mcap"
    figures = tmp_path / "cut.json"
    command = ["cut", str(DEMO), "--from", "10", "--to", "20.5", "-o", str(part), "--json", str(figures)]
    done(*command)
    same_times(read_recording(part), read_recording(DEMO), 10.0, 20.5)
    with open(part, "rb") as file, open(DEMO, "rb") as source:
        records = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
        before = {record.name: record.metadata for record in make_reader(source).iter_metadata()}
    assert records.pop(CUT) == {"source": "demo.mcap", "name": "part", "from_s": "10.0", "to_s": "20.5"}
    assert records == before
    [stated] = json.loads(figures.read_text())["parts"]
    assert stated["messages"]["/imu/simulated"] == len(read_recording(part).imu)
    assert run(command) == 1, "what exists needs --force"
    done(*command, "--force")


def test_trials_are_files_by_name_and_chosen_by_label(tmp_path: Path, capsys) -> None:
    trials = table(
        tmp_path, "name;start_s;end_s;label\nreach;0;12;arm up\nreach;12,5;24;arm up\nrest;24;31;still\n"
    )
    done("cut", DEMO, "--trials", trials, "-o", tmp_path / "all")
    names = sorted(path.name for path in (tmp_path / "all").iterdir())
    assert names == ["reach_1.mcap", "reach_2.mcap", "rest.mcap"]
    same_times(read_recording(tmp_path / "all" / "reach_2.mcap"), read_recording(DEMO), 12.5, 24.0)
    done("cut", DEMO, "--trials", trials, "--label", "still", "-o", tmp_path / "b")
    assert [path.name for path in (tmp_path / "b").iterdir()] == ["rest.mcap"]
    said = capsys.readouterr().out
    assert "reach_1" in said and "12.50" in said


def test_rows_of_a_truth_that_are_scored_are_those_of_the_part(tmp_path: Path) -> None:
    made = simulate_arm(ArmSimulation(protocol="random", duration_s=6.0), 1).recording
    assert made.truth is not None
    made.truth.score[:] = (made.truth.t_s > 1.0) & (made.truth.t_s < 4.0)
    write_recording(made, tmp_path / "a.mcap")
    done("cut", tmp_path / "a.mcap", "--from", "3", "-o", tmp_path / "b.mcap")
    truth = read_recording(tmp_path / "b.mcap").truth
    assert truth is not None
    np.testing.assert_array_equal(truth.score, truth.t_s < 4.0)


def test_crop_is_the_same_in_python() -> None:
    whole = read_recording(DEMO)
    part = whole.crop(10.0, 20.5)
    same_times(part, whole, 10.0, 20.5)
    assert part.origin_ns == whole.origin_ns and part.side == whole.side
    assert len(whole.crop(from_s=20.0).imu) + len(whole.crop(to_s=20.0).imu) == len(whole.imu)
    with pytest.raises(RecordingError, match=r"between 90 and inf s; .* from 0\.0 to 31\.7 s"):
        whole.crop(90.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("start_s,end_s\n1,2\n", "has no column name; a table of name, start_s, end_s is needed"),
        ("name,start_s,end_s\n../a,1,2\n", "row 1: '../a' is not a valid file name"),
        ("name,start_s,end_s\na,1,x\n", "line 2: 'x' in column end_s is not a number"),
        ("name,start_s,end_s\na,4,2\n", "row 1: a ends at 2 s, before it starts"),
        ("name,start_s,end_s\n", "has a header and has no rows"),
    ],
)
def test_what_is_wrong_with_a_table_of_trials(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(RecordingError, match=re.escape(says)):
        read_trials(table(tmp_path, text), tmp_path)
