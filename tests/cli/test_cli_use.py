"""Help, wrong use and errors in one sentence, nothing written; only the command that runs is imported."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import typer
from click.testing import CliRunner

from smoother import __version__
from smoother.cli.app import CommandSpec, LazyCommands, app
from smoother.cli.load import AS_RECORDED, SetUp
from smoother.cli.options import with_groups
from smoother.cli.run import explain, run
from smoother.config import Config
from smoother.io import write_recording
from smoother.simulation import ArmSimulation, simulate_arm

COMMANDS = [
    ["demo"],
    ["info"],
    ["check"],
    ["smooth"],
    ["validate"],
    ["gaps"],
    ["calibrate", "motion"],
    ["import", "csv"],
    ["import", "broad"],
    ["import", "utd-mhad"],
    ["export"],
    ["simulate", "arm"],
    ["config"],
    ["doctor"],
]


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("good") / "good.mcap"
    write_recording(simulate_arm(ArmSimulation(repetitions=1), 1).recording, path)
    return path


def failed(capsys, arguments: list[object], code: int, sentence: str) -> None:
    """Run a command that must fail, and check what it says."""
    assert run([str(argument) for argument in arguments]) == code
    captured = capsys.readouterr()
    assert captured.err.startswith("unocclude: ")
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    assert sentence in captured.err, captured.err


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_help_with_an_example(capsys, command):
    assert run([*command, "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"Example: unocclude {' '.join(command)}" in text
    assert "--json FILE" in text


def test_no_arguments_show_help(capsys):
    assert run([]) in (0, 2)
    assert "Commands:" in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["frobnicate"], "No such command"),
        (["smooth"], "Missing argument"),
        (["smooth", "a.mcap"], "Missing option"),
        (["smooth", "a.mcap", "-o", "b.mcap", "--frob"], "No such option"),
        (
            ["smooth", "a.mcap", "-o", "b.mcap", "--method", "magic"],
            "there is no method 'magic'; methods: graph",
        ),
        (["smooth", "a.mcap", "-o", "b.mcap", "--side", "up"], "--side is left or right, not 'up'"),
        (["smooth", "a.mcap", "-o", "b.mcap", "--processes", "-1"], "--processes"),
        (["smooth", "a.mcap", "-o", "b.mcap", "--max-sigma-m", "0"], "above zero"),
        (["smooth", "a.mcap", "-o", "b.mcap", "--body", "one"], "valid integer"),
        (["smooth", "a.mcap", "-o", "b.mcap", "--mirror", "left"], "mirrored along x, y or z, not 'left'"),
        (["check", "a.mcap", "--swap", "elbow"], "two joints of shoulder, elbow, wrist, hand"),
        (["gaps", "a.mcap", "--negate", "magnetometer"], "accelerometer and gyroscope can be negated"),
        (["compare", "a.mcap", "--camera-frame", "up"], "--camera-frame is one of kinect, optical, zup"),
        (["smooth", "a.mcap", "-o", "b.mcap", "--report", "r.pdf"], "HTML page; name it r.html"),
        (["validate", "a.mcap"], "--truth"),
        (["gaps", "a.mcap", "--lengths", "0.5,long"], "--lengths takes seconds"),
        (["gaps", "a.mcap", "--lengths", "-1"], "--lengths takes seconds"),
        (["gaps", "a.mcap", "--methods", "graph,magic"], "there is no method 'magic'"),
        (["export", "a.mcap", "--format", "bvh", "-o", "b.bvh"], "'bvh' is not available; formats: csv"),
        (["export", "a.mcap", "--format", "csv", "-o", "b.trc"], "name it b.csv, or --format trc"),
        (["simulate", "arm", "-o", "a.mcap", "--preset", "ugly"], "no preset 'ugly'; presets: clean, white"),
        (["simulate", "arm", "-o", "a.mcap", "--imu-rate-hz", "1"], "imu_rate_hz"),
        (["simulate", "arm", "-o", "a.mcap", "--occlusion-lengths-s", "1,x"], "takes numbers"),
        (["simulate", "arm", "-o", "a.mcap", "--protocol", "dance"], "protocol"),
        (["simulate", "leg", "-o", "a.mcap"], "No such command"),
        (["import", "broad", "a.mat", "-o", "a.mcap", "--noise-m", "-3"], "--noise-m is between"),
    ],
)
def test_wrong_use_is_2(capsys, tmp_path, monkeypatch, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    failed(capsys, arguments, 2, sentence)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["info", "missing.mcap"], "missing.mcap"),
        (["smooth", "missing.mcap", "-o", "out.mcap"], "missing.mcap"),
        (["smooth", "text.mcap", "-o", "out.mcap"], "text.mcap"),
        (["smooth", "empty.mcap", "-o", "out.mcap"], "empty.mcap"),
        (["smooth", "folder", "-o", "out.mcap"], "folder"),
        (["smooth", "text.mcap", "-o", "nowhere/out.mcap"], "nowhere does not exist"),
        (["smooth", "text.mcap", "-o", "text.mcap", "--force"], "is read by this command"),
        (["smooth", "text.mcap", "-o", "a.mcap", "--report", "a.mcap"], "two outputs"),
        (["smooth", "text.mcap", "-o", "out.mcap", "--config", "missing.toml"], "missing.toml"),
        (
            ["smooth", "text.mcap", "-o", "out.mcap", "--config", "broken.toml"],
            "broken.toml: not a TOML file",
        ),
        (["smooth", "text.mcap", "-o", "out.mcap", "--config", "unknown.toml"], "no setting 'camera.frob'"),
        (["smooth", "text.mcap", "-o", "out.mcap", "--config", "range.toml"], "'camera.cauchy' = -1"),
        (["smooth", "text.mcap", "-o", "out.mcap", "--config", "binary.toml"], "not UTF-8 text"),
        (["smooth", "text.mcap", "-o", "out.mcap", "--calibration", "missing.toml"], "missing.toml"),
        (["simulate", "arm", "-o", "a.txt"], "the output is MCAP; name it a.mcap"),
        (["simulate", "people", "-o", "a.csv"], "the output is MCAP; name it a.mcap"),
        (["repair", "text.mcap", "-o", "a.json"], "the output is MCAP; name it a.mcap"),
        (["validate", "text.mcap", "--truth", "t.csv"], "text.mcap"),
        (["gaps", "text.mcap"], "text.mcap"),
        (["export", "text.mcap", "--format", "csv", "-o", "out.csv"], "text.mcap"),
        (["import", "csv", "folder", "-o", "out.mcap"], "recording.toml"),
        (["import", "broad", "missing.mat", "-o", "out.mcap"], "missing.mat"),
        (["import", "utd-mhad", "a_inertial.mat", "-o", "out.mcap"], "no skeleton file was found beside it"),
        (["config", "--config", "unknown.toml"], "no setting 'camera.frob'"),
        (["config", "--json", "nowhere/c.json"], "nowhere does not exist"),
        (["doctor", "--json", "text.mcap"], "exists already"),
    ],
)
def test_what_cannot_be_done_is_1(capsys, tmp_path, monkeypatch, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    Path("text.mcap").write_text("this is not a recording\n" * 10)
    Path("empty.mcap").touch()
    Path("folder").mkdir()
    Path("broken.toml").write_text("[camera\n")
    Path("unknown.toml").write_text("[camera]\nfrob = 1\n")
    Path("range.toml").write_text("[camera]\ncauchy = -1\n")
    Path("binary.toml").write_bytes(b"\xff\xfe\x00")
    before = sorted(path.name for path in tmp_path.iterdir())
    failed(capsys, arguments, 1, sentence)
    assert sorted(path.name for path in tmp_path.iterdir()) == before


@pytest.mark.parametrize("option", ["-o", "--report", "--json"])
def test_existing_output_is_refused_before_the_work(capsys, tmp_path, good, monkeypatch, option):
    import smoother.cli.smooth as command

    monkeypatch.setattr(command, "load_arms", lambda *_, **__: pytest.fail("the work began"))
    there = tmp_path / "there"
    there.write_text("mine")
    options = {"-o": tmp_path / "o.mcap", "--report": tmp_path / "r.html", "--json": tmp_path / "j.json"}
    options[option] = there
    arguments = [part for pair in options.items() for part in pair]
    failed(capsys, ["smooth", good, *arguments], 1, "--force")
    assert there.read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


@pytest.mark.parametrize("lacking", ["imu", "skeleton", "forearm"])
def test_a_recording_that_lacks_something(capsys, tmp_path, good, lacking):
    from smoother.io import open_recording

    file = open_recording(good)
    if lacking == "imu":
        file.imus = []
    elif lacking == "skeleton":
        file.arms = []
    else:
        for arm in file.arms:
            arm.state[:] = 0
    path = tmp_path / "part.mcap"
    write_recording(file, path)
    assert run(["smooth", str(path), "-o", str(tmp_path / "out.mcap")]) == 1
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "unexpected" not in captured.err
    assert not (tmp_path / "out.mcap").exists()
    assert run(["info", str(path)]) == 0  # a recording that cannot be smoothed can still be looked at


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "x.mcap"), "x.mcap: no space left on the disk"),
        (PermissionError(errno.EACCES, "Permission denied", "x"), "x: permission denied"),
        (FileNotFoundError(errno.ENOENT, "No such file", "x"), "x: there is no such file"),
        (MemoryError(), "not enough memory"),
        (RuntimeError("can't start new thread"), "not enough memory"),
        (ZeroDivisionError("division\nby zero"), "unexpected error, ZeroDivisionError"),
    ],
)
def test_errors_have_sentences(error, sentence):
    text, code = explain(error)
    assert sentence in text
    assert code == 1


def test_full_disk_leaves_nothing(capsys, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    output = tmp_path / "sim.mcap"
    failed(capsys, ["simulate", "arm", "-o", output, "--repetitions", 1], 1, "no space left on the disk")
    assert list(tmp_path.iterdir()) == []


def test_interrupt_is_one_line(capsys, monkeypatch, tmp_path):
    import smoother.simulation as simulation

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation, "simulate_arm", stopped)
    failed(capsys, ["simulate", "arm", "-o", tmp_path / "a.mcap"], 1, "interrupted")
    assert list(tmp_path.iterdir()) == []


def test_debug_shows_the_traceback(capsys, monkeypatch):
    monkeypatch.setenv("UNOCCLUDE_DEBUG", "1")
    assert run(["info", "missing.mcap"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_config_is_toml_that_reads_back(capsys, tmp_path):
    assert run(["config", "--json", str(tmp_path / "c.json")]) == 0
    text = capsys.readouterr().out
    assert Config.model_validate(tomllib.loads(text)) == Config()
    assert "# white noise of a joint, m per axis" in text
    assert json.loads((tmp_path / "c.json").read_text()) == Config().model_dump(mode="json")
    changed = tmp_path / "c.toml"
    changed.write_text("[windows]\nmargin_s = 2.5\n")
    assert run(["config", "--config", str(changed)]) == 0
    assert tomllib.loads(capsys.readouterr().out)["windows"]["margin_s"] == 2.5


def test_doctor(capsys, tmp_path):
    assert run(["doctor", "--json", str(tmp_path / "d.json")]) == 0
    found = json.loads((tmp_path / "d.json").read_text())
    assert found["solver"]["ok"]
    assert found["point clouds"]["ok"]
    assert {"python", "gtsam", "numpy", "cores", "memory"} <= set(found)


def test_doctor_names_what_is_missing(capsys, monkeypatch):
    import smoother.cli.demo as doctor

    monkeypatch.setattr(doctor, "PACKAGES", ("no-such-package",))
    monkeypatch.setattr(doctor, "use_open3d", lambda: "skipped")
    assert run(["doctor"]) == 1
    assert "no-such-package" in capsys.readouterr().err


def test_version(capsys):
    assert run(["--version"]) == 0
    assert capsys.readouterr().out == f"unocclude {__version__}\n"


def test_help_imports_nothing_heavy():
    code = (
        "import sys; from smoother.cli.run import run; run(['--help']);heavy = {'gtsam', 'scipy', 'plotly',"
        " 'numpy', 'open3d', 'cv2'} & set(sys.modules);sys.exit(f'imported {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_reader_that_goes_away_is_no_error(tmp_path):
    command = f"{sys.executable} -c 'from smoother.cli import main; main()' config | head -n 1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr


LOADED = (
    "import sys; from smoother.cli.run import run; code = run(sys.argv[1:]);"
    "print(*(name for name in sys.modules), file=sys.stderr); sys.exit(code)"
)


def all_places() -> dict[str, CommandSpec]:
    """Every command's place, by all its words."""
    group = typer.main.get_command(app)
    commands = {}
    for name in group.commands:
        if name in group.commands._specs:
            commands[name] = group.commands._specs[name]
        else:
            below = group.commands[name].commands._specs
            commands |= {f"{name} {command}": place for command, place in below.items()}
    return commands


def loaded(*arguments: str) -> set[str]:
    """Modules that a command has imported when it is done."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return set(done.stderr.split())


def others(command: str) -> set[str]:
    """Modules that hold other commands only."""
    commands = all_places()
    return {f"smoother.cli.{place.module}" for place in commands.values()} - {
        f"smoother.cli.{commands[command].module}"
    }


def test_smooth_imports_nothing_that_it_does_not_use(tmp_path: Path) -> None:
    """SciPy alone takes a tenth of the time that half a minute of recording takes in all."""
    demo = Path(__file__).parents[2] / "data" / "demo.mcap"
    modules = loaded("smooth", str(demo), "-o", str(tmp_path / "out.mcap"), "--processes", "1")
    assert (tmp_path / "out.mcap").exists() and "smoother.cli.smooth" in modules
    assert not modules & {"scipy", "plotly", "pandas", "h5py", "open3d", "cv2", "dask"}
    assert len(others("smooth")) > 15
    assert not modules & others("smooth")
    # what only they need: the server of `view`, the graphs' live window, the importers of devices
    beside = (
        "http.server",
        "smoother.live",
        "smoother.streams",
        "smoother.simulation",
        "smoother.io.devices",
        "smoother.io.tables",
    )
    assert not {name for name in modules if name.startswith(beside)}


@pytest.mark.parametrize("command", ["info", "config", "batch", "import describe", "calibrate motion"])
def test_the_help_of_a_command_imports_no_other_one(command: str) -> None:
    assert not loaded(*command.split(), "--help") & others(command)


def test_the_version_imports_no_command() -> None:
    assert not {name for name in loaded("--version") if name.startswith("smoother.cli.smooth")}


def test_the_help_of_all_starts_no_server() -> None:
    assert not loaded("--help") & {"http.server", "ssl", "numpy", "pydantic", "smoother.cli.imports"}


def test_every_place_has_its_command() -> None:
    commands = all_places()
    assert len(commands) > 30
    for words, place in commands.items():
        command = place.command(words.split()[-1])
        assert command.help and command.name == words.split()[-1]
        assert place.epilog.startswith(f"Example: unocclude {words}")


def test_a_command_is_made_once_and_only_when_it_is_looked_up() -> None:
    commands = LazyCommands(
        {"config": CommandSpec("demo", ""), "none": CommandSpec("no_such_module", "")}, {"more": "group"}
    )
    assert list(commands) == ["config", "none", "more"] and len(commands) == 3
    assert commands["config"] is commands["config"] and commands["more"] == "group"
    assert commands.get("frobnicate") is None
    with pytest.raises(ModuleNotFoundError):
        commands["none"]


@pytest.mark.parametrize(
    "words, meant",
    [(["smoth"], "smooth"), (["calibrate", "wrld"], "world"), (["simulate", "peple"], "people")],
)
def test_a_mistake_in_a_name_is_seen_through(
    words: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(words) == 2
    assert f"Did you mean {meant!r}" in capsys.readouterr().err


@dataclass(frozen=True)
class Size:
    width: Annotated[int, typer.Option("--width", help="Of the box.")] = 3
    name: Annotated[str | None, typer.Option("--name")] = None


SMALL = Size()


def test_a_group_reaches_the_command_as_one_value() -> None:
    got: list[object] = []

    def box(path: Annotated[Path, typer.Argument()], size: Size = SMALL, deep: bool = False) -> None:
        """Make a box."""
        got.append((path, size, deep))

    app = typer.Typer(add_completion=False)
    app.command()(with_groups(box))
    command = typer.main.get_command(app)
    assert [each.name for each in command.params] == ["path", "width", "name", "deep"]
    assert command.help == "Make a box."
    for words, expected in (
        (["a"], (Path("a"), Size(3, None), False)),
        (["--width", "5", "a", "--name", "x", "--deep"], (Path("a"), Size(5, "x"), True)),
    ):
        result = CliRunner().invoke(command, words)
        assert result.exit_code == 0, result.output
        assert got.pop() == expected


@pytest.mark.parametrize("command", ["smooth", "check", "gaps", "compare"])
def test_four_commands_share_the_set_up(command: str, capsys) -> None:
    assert run([command, "--help"]) == 0
    shown = capsys.readouterr().out
    options = ("--mirror", "--swap", "--negate", "--camera-frame", "--clock-offset", "--clock-sigma")
    commands = [shown.index(option) for option in options]
    assert commands == sorted(commands)


def test_a_set_up_undoes_what_its_options_say() -> None:
    assert AS_RECORDED.remedy()[0].options == "" and AS_RECORDED.remedy()[1] is False
    remedy, swap_sides = SetUp(mirror="x", swap="left,right", negate="gyroscope").remedy()
    assert "--mirror x" in remedy.options and "--negate gyroscope" in remedy.options and swap_sides
    with pytest.raises(typer.BadParameter, match="--camera-frame is one of"):
        SetUp(camera_frame="upside").remedy()
