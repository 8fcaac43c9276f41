"""`gaps --live` and `compare --live`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from smoother.cli.methods import GRAPH, LIVE_METHODS
from smoother.cli.run import run


def call(*arguments: object) -> int:
    return run([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("live") / "rec.mcap"
    options = ("--protocol", "random", "--duration-s", 20, "--occlusion-lengths-s", 1, "--seed", 2)
    assert call("simulate", "arm", "--preset", "realistic", *options, "-o", path) == 0
    return path


def test_what_was_shown_beside_the_offline_answer(recording: Path, tmp_path: Path):
    figures = tmp_path / "c.json"
    options = ("--methods", GRAPH, "--live", "--processes", 1, "--json", figures)
    assert call("compare", recording, *options) == 0
    methods = json.loads(figures.read_text())["methods"]
    assert set(methods) == {GRAPH, *LIVE_METHODS}
    assert all(each["failure"] == "" for each in methods.values())
    visible = {name: each["visible"]["position_rms_m"] for name, each in methods.items()}
    # the live smoother sees no future, and the last velocity going on no IMU
    assert visible[GRAPH] < visible["live-now"] < visible["constant-velocity"]
    # no answer is late: 0.1 s of latency is predicted away
    assert abs(methods["live-now"]["lag_s"]) < 0.02


def test_by_the_time_since_the_last_frame(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    figures = tmp_path / "g.json"
    options = ("--lengths", 0.5, "--gaps-per-run", 2, "--live", "--processes", 1, "--json", figures)
    assert call("gaps", recording, *options) == 0
    assert "since the last frame" in capsys.readouterr().out
    rows = json.loads(figures.read_text())["since_last_frame"]
    assert {row["method"] for row in rows} >= {GRAPH, "autoregressive", "constant-velocity"}
    assert all(row["to_s"] <= 1.0 and row["samples"] > 0 for row in rows)
    display = [row["rms_m"] for row in rows if row["method"] == "constant-velocity"]
    assert display == sorted(display)  # it knows less and less


def test_without_live_nothing_is_added(recording: Path, tmp_path: Path):
    figures = tmp_path / "g.json"
    options = ("--lengths", 0.5, "--gaps-per-run", 1, "--processes", 1, "--json", figures)
    assert call("gaps", recording, *options) == 0
    assert "since_last_frame" not in json.loads(figures.read_text())


@pytest.mark.parametrize("latency", ["-0.1", "1.5", "soon"])
def test_a_latency_that_is_none(recording: Path, latency: str, capsys: pytest.CaptureFixture[str]):
    assert call("gaps", recording, "--live", "--latency", latency) == 2
    assert "--latency" in capsys.readouterr().err
