"""Help, wrong use and errors in one sentence, nothing written; only the command that runs is imported."""

from __future__ import annotations

import errno
import json
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from click.testing import CliRunner
from commands import done, refused

from smoother import __version__
from smoother.cli.app import app
from smoother.cli.load import ArmInput
from smoother.cli.options import ADVANCED
from smoother.cli.run import explain, run
from smoother.config import Config
from smoother.io import write_recording
from smoother.simulation import ArmSimulation, simulate_arm


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("good") / "good.mcap"
    write_recording(simulate_arm(ArmSimulation(repetitions=1), 1).recording, path)
    return path


def test_no_arguments_show_help(capsys):
    assert run([]) in (0, 2)
    assert "Commands:" in "".join(capsys.readouterr())
    assert "No such command" in refused(capsys, "frobnicate", code=2)


@pytest.mark.parametrize("option", ["-o", "--report", "--json"])
def test_existing_output_is_refused_before_the_work(capsys, tmp_path, good, monkeypatch, option):
    import smoother.cli.load as command

    monkeypatch.setattr(command, "load_arms", lambda *_, **__: pytest.fail("the work began"))
    there = tmp_path / "there"
    there.write_text("mine")
    options = {"-o": tmp_path / "o.mcap", "--report": tmp_path / "r.html", "--json": tmp_path / "j.json"}
    options[option] = there
    arguments = [part for pair in options.items() for part in pair]
    assert "--force" in refused(capsys, "smooth", good, *arguments, code=1)
    assert there.read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


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


def test_interrupt_is_one_line(capsys, monkeypatch, tmp_path):
    import smoother.simulation as simulation

    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(simulation, "simulate_arm", stopped)
    assert "interrupted" in refused(capsys, "simulate", "arm", "-o", tmp_path / "a.mcap", code=1)
    assert list(tmp_path.iterdir()) == []


def test_debug_shows_the_traceback(capsys, monkeypatch):
    monkeypatch.setenv("UNOCCLUDE_DEBUG", "1")
    assert run(["info", "missing.mcap"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_config_is_toml_that_reads_back(capsys, tmp_path):
    done("config", "--json", tmp_path / "c.json")
    text = capsys.readouterr().out
    assert Config.model_validate(tomllib.loads(text)) == Config()
    assert "# white noise of a joint, m per axis" in text
    assert json.loads((tmp_path / "c.json").read_text()) == Config().model_dump(mode="json")
    changed = tmp_path / "c.toml"
    changed.write_text("[windows]\nmargin_s = 2.5\n")
    done("config", "--config", changed)
    assert tomllib.loads(capsys.readouterr().out)["windows"]["margin_s"] == 2.5


@pytest.mark.slow
def test_doctor(tmp_path):
    done("doctor", "--json", tmp_path / "d.json")
    found = json.loads((tmp_path / "d.json").read_text())
    assert found["solver"]["ok"]
    assert found["point clouds"]["ok"]
    assert {"python", "gtsam", "numpy", "cores"} <= set(found)


def test_doctor_names_what_is_missing(capsys, monkeypatch):
    import smoother.cli.config as doctor

    monkeypatch.setattr(doctor, "PACKAGES", ("no-such-package",))
    monkeypatch.setattr(doctor, "use_open3d", lambda: "skipped")
    assert "no-such-package" in refused(capsys, "doctor")


def test_version(capsys):
    done("--version")
    assert capsys.readouterr().out == f"unocclude {__version__}\n"


ROOT: Any = typer.main.get_command(app)
LOADED = (
    "import sys; from smoother.cli.run import run; code = run(sys.argv[1:]);"
    "print(*(name for name in sys.modules), file=sys.stderr); sys.exit(code)"
)


def loaded(*arguments: str) -> set[str]:
    """Modules that a command has imported when it is done."""
    done = subprocess.run(
        [sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return set(done.stderr.split())


def others(module: str) -> set[str]:
    """Modules that hold other commands only."""
    groups = [ROOT, *ROOT.commands.values()]
    modules = {place for group in groups for place in getattr(type(group), "modules", ())}
    return {f"smoother.cli.{place}" for place in modules - {module, "config"}}  # all read settings


@pytest.mark.slow
def test_smooth_imports_nothing_that_it_does_not_use(tmp_path: Path) -> None:
    demo = Path(__file__).parents[2] / "data" / "demo.mcap"
    modules = loaded("smooth", str(demo), "-o", str(tmp_path / "out.mcap"), "--processes", "1")
    assert (tmp_path / "out.mcap").exists() and "smoother.cli.smooth" in modules
    assert not modules & {"plotly", "pandas", "h5py", "open3d", "cv2", "dask"}
    assert len(others("smooth")) > 6 and not modules & others("smooth")
    # what only they need: the graphs' live window, simulations, the importers of devices
    beside = "live", "streams", "simulation", "io.registry", "io.tables.columns"
    others_need = ("http.server", *(f"smoother.{name}" for name in beside))
    assert not {name for name in modules if name.startswith(others_need)}


@pytest.mark.slow
@pytest.mark.parametrize(
    "words, module", [("info", "recordings"), ("config", "config"), ("calibrate motion", "calibrate")]
)
def test_the_help_of_a_command_imports_no_other_one(words: str, module: str) -> None:
    assert not loaded(*words.split(), "--help") & others(module)


@pytest.mark.parametrize("words", ["--version", "--help", "smooth --help", "simulate --help"])
def test_the_command_line_starts_light(words: str) -> None:
    heavy = {"gtsam", "open3d", "cv2", "plotly", "scipy", "vqf", "mcap", "numpy", "http.server", "ssl"}
    assert not loaded(*words.split()) & heavy


@pytest.mark.parametrize(
    "words, meant",
    [(["smoth"], "smooth"), (["calibrate", "wrld"], "world"), (["simulate", "peple"], "people")],
)
def test_a_mistake_in_a_name_is_seen_through(
    words: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert f"Did you mean {meant!r}" in refused(capsys, *words, code=2)


def test_a_set_up_undoes_what_its_options_say() -> None:
    assert ArmInput().remedy.options == "" and not ArmInput().swaps_sides
    source = ArmInput(mirror="x", swap="left,right", negate="gyroscope")
    assert source.remedy.options == "--mirror x --negate gyroscope" and source.swaps_sides


def leaves(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    if not hasattr(command, "list_commands"):
        yield words, command
        return
    context = typer.Context(command)
    for name in command.list_commands(context):
        yield from leaves(command.get_command(context, name), (*words, name))


LEAVES = dict(leaves(ROOT))


def shown(*words: str, width: int = 80) -> str:
    result = CliRunner().invoke(ROOT, [*words, "--help"], prog_name="unocclude", terminal_width=width)
    assert result.exit_code == 0
    return result.output


@pytest.mark.parametrize("group", [(), ("import",), ("calibrate",), ("simulate",)], ids=" ".join)
def test_the_list_has_whole_sentences_on_a_line_each(group: tuple[str, ...]):
    listed = shown(*group).partition("Commands:\n")[2].partition("\n\n")[0].splitlines()
    sentences = [line.split(maxsplit=1)[1] for line in listed]
    context = typer.Context(ROOT)
    here = ROOT if not group else ROOT.get_command(context, group[0])
    assert len(sentences) == len(here.list_commands(context))
    assert all(sentence.endswith(".") and "..." not in sentence for sentence in sentences), sentences


@pytest.mark.parametrize("words", LEAVES, ids=" ".join)
def test_every_option_is_shown_once_and_rare_ones_last(words: tuple[str, ...]):
    text = shown(*words).partition("\n  Example: ")[0]
    text = text[text.index("Options:") :]
    flags = [max(each.opts, key=len) for each in LEAVES[words].params if each.param_type_name == "option"]
    for flag in flags:
        starts = [line.split()[0:2] for line in text.splitlines() if line.startswith("  -")]
        assert sum(flag in [word.rstrip(",") for word in start] for start in starts) == 1, flag
    assert f"Example: unocclude {' '.join(words)}" in " ".join(shown(*words).split())
    head, found, rare = text.partition(f"{ADVANCED}:\n")
    assert text.startswith("Options:\n") and "--help" in head
    assert not found or "Options:\n" not in rare
    assert shown(*words, width=100).count("\n") <= 51, "it fits on a screen"


def test_settings_of_a_simulation_by_key_and_from_a_file(tmp_path: Path, capsys) -> None:
    done("simulate", "arm", "-o", tmp_path / "none.mcap", "--set", "list")
    said = capsys.readouterr().out
    assert "imu_rate_hz" in said and "tremor_rad" in said and not (tmp_path / "none.mcap").exists()
    (tmp_path / "there.mcap").write_bytes(b"kept")
    done("simulate", "arm", "-o", tmp_path / "there.mcap", "--set", "list")
    assert (tmp_path / "there.mcap").read_bytes() == b"kept"
    (tmp_path / "mine.toml").write_text('preset = "clean"\nimu_rate_hz = 50\nocclusion_lengths_s = [0.5]\n')
    usual = ("--set", "protocol=random", "--set", "duration_s=4", "--seed", 3, "-o")
    done("simulate", "arm", "--preset", tmp_path / "mine.toml", *usual, tmp_path / "a.mcap")
    by_key = ("--set", "imu-rate-hz=50", "--set", "occlusion_lengths_s=0.5")
    done("simulate", "arm", "--preset", "clean", *by_key, *usual, tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    (tmp_path / "wrong.toml").write_text("warp = 9\n")
    assert (
        run(["simulate", "arm", "--preset", str(tmp_path / "wrong.toml"), "-o", str(tmp_path / "c.mcap")])
        == 2
    )
    assert "there is no setting warp" in capsys.readouterr().err
