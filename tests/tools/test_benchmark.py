"""The benchmark in miniature: every measure once, on a recording of eighteen seconds."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import typer
from mcap.reader import make_reader

from smoother.cli.app import app
from smoother.io import read_recording
from tools.benchmark import __main__ as program
from tools.benchmark.isolated import PrivatePeak, Stopped, isolated
from tools.benchmark.profile import PARTS, READ, WRITE, profile
from tools.benchmark.tables import growth, table, waiting
from tools.benchmark.whole import (
    IMAGE_TOPIC,
    Made,
    Waited,
    commands,
    make,
    read_truth,
    run_method,
    run_smooth,
)

MINUTES, IMAGE_KB = 0.3, 2.0
TIMES = {"check": 1.0, "smooth": 5.0, "gaps": 20.0}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    return make(tmp_path_factory.mktemp("made"), MINUTES, "white", 0, True, IMAGE_KB)


def test_images_are_between_the_same_messages(made):
    assert made.with_images is not None
    counts = []
    for path in (made.path, made.with_images):
        with path.open("rb") as file:
            topics: dict[str, list[tuple[int, bytes]]] = {}
            for _, channel, message in make_reader(file).iter_messages():
                topics.setdefault(channel.topic, []).append((message.log_time, message.data))
            counts.append(topics)
    images = counts[1].pop(IMAGE_TOPIC)
    assert counts[0] == counts[1]
    assert len(images) == made.frames
    # as heavy on disk as they are said to be: what compresses away would not weigh on a reader
    extra = made.with_images.stat().st_size - made.path.stat().st_size
    assert extra > 0.95 * 1000 * IMAGE_KB * made.frames


def test_the_truth_beside_is_the_truth_inside(made):
    inside = read_recording(made.path).truth
    beside = read_truth(made.truth, 0)
    assert inside is not None
    np.testing.assert_allclose(beside.t_s, inside.t_s, atol=1e-9)
    np.testing.assert_allclose(beside.position, inside.position, atol=1e-12)


def test_plain_graphs_answer_the_same_question(made, tmp_path):
    """Modelled as well, one graph over the whole is as exact as windows are; held samples are not."""
    kept = tmp_path / "told"
    ours = run_smooth(made, 1, kept)
    same, batch, grown = (
        run_method(made, f"plain graph, {way}", kept) for way in ("same job", "batch", "isam2")
    )
    assert ours.exact.samples == same.exact.samples == batch.exact.samples > 100
    assert ours.exact.rms_cm < 1.0 and same.exact.rms_cm < 1.0
    assert same.from_smooth_cm < 1.0
    assert same.exact.rms_cm < batch.exact.rms_cm < 8.0
    # the same graph solved in another way: what is left of linearising once in ten frames
    assert grown.exact.rms_cm == pytest.approx(batch.exact.rms_cm, rel=0.05)
    assert same.steps["nodes"] == made.frames and same.steps["iterations"] > 1
    assert 0 < same.own_s < same.all_s


def test_the_command_is_listened_to(made, tmp_path):
    spent = isolated(profile, made.path, tmp_path / "out.mcap", 1, True)
    assert spent.missing == []
    assert set(spent.parts) <= set(PARTS) and spent.parts[READ] > 0 and spent.parts[WRITE] > 0
    assert all(seconds > 0 for seconds in spent.gtsam.values())
    outside = sum(spent.functions.values())
    # looked at from a timer: all of it but what passes before the first look and after the last
    assert outside + sum(spent.gtsam.values()) == pytest.approx(spent.cpu_s, rel=0.15)


def test_a_limit_stops():
    began = time.monotonic()
    with pytest.raises(Stopped, match="stopped after 1 s") as why:
        isolated(time.sleep, 60.0, limit_s=1.0)
    assert time.monotonic() - began < 20.0 and why.value.seconds > 1.0
    with pytest.raises(Stopped, match=r"stopped at 0\.3 GB"):
        isolated(_fill, limit_gb=0.3)
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        isolated(divmod, 1, 0)


def _fill() -> None:
    kept = bytearray(b"x" * 400_000_000)
    time.sleep(60.0)
    del kept


def test_the_peak_is_this_process(made):
    if not Path("/proc/self/status").exists():
        pytest.skip("no /proc here")
    peak = PrivatePeak()
    before = peak.mb()
    np.ones(25_000_000)  # 200 MB
    assert peak.mb() > before + 100.0
    mapped = np.memmap(made.path, mode="r")
    assert mapped.sum() > 0 and peak.workers == 0 and peak.worker_mb() == 0.0


def test_the_whole_program(monkeypatch, capsys, tmp_path):
    figures = tmp_path / "figures.json"
    arguments = f"--minutes {MINUTES} --only whole parts --json {figures} --folder {tmp_path}".split()
    monkeypatch.setattr(sys, "argv", ["benchmark", *arguments])
    program.main()
    said = capsys.readouterr().out
    kept = json.loads(figures.read_text())
    (run,) = kept["whole"]
    assert f"{run['length_s'] / run['seconds']:.0f}" in said and run["main_mb"] > 50
    assert 0 < run["exact"]["rms_cm"] < 1.0 and run["exact"]["gaps"] > 0
    assert "second pass" in said


def test_what_a_person_waits_for():
    commands = [asdict(Waited(name, seconds, name == "smooth")) for name, seconds in TIMES.items()]
    lines = waiting(commands, 5.0)
    assert lines[-1].endswith(": gaps.")  # it alone is slow and says nothing
    assert ["check", "1.0", "0.20", "no"] in [line.split() for line in lines]


def test_every_command_a_person_waits_for_is_one(made, tmp_path):
    group = typer.main.get_command(app)
    for name, arguments in commands(made, tmp_path):
        command = group.commands[arguments[0]]
        command.make_context(name, arguments[1:])


def test_another_installation_beside(monkeypatch, capsys, tmp_path):
    arguments = f"--minutes {MINUTES} --against {sys.executable} --runs 1 --processes 1".split()
    monkeypatch.setattr(sys, "argv", ["benchmark", *arguments, "--folder", str(tmp_path)])
    monkeypatch.setattr(program, "help_seconds", lambda: 0.1)  # the whole program measures it
    program.main()
    said = capsys.readouterr().out
    assert f"of {sys.executable} over ours" in said and "End to end" not in said


def test_growth_is_level_where_a_part_is_linear():
    spent = {1.0: {READ: 0.5, "new word": 1.0}, 10.0: {READ: 5.0, "new word": 20.0}}
    lines = growth(spent, {1.0: 60.0, 10.0: 600.0}, "title")
    ends = {name: line.split()[-1] for name in (READ, "new word") for line in lines if f"  {name}" in line}
    assert ends == {READ: "1.00", "new word": "2.00"}
    assert table("t", ("a", "b"), [("x", "1")]) == ["", "t", "  a  b", "  x  1"]
