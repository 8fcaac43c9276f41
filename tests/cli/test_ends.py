"""How commands end: without a reader, interrupted while libraries load, in words that fit the caller."""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from smoother import smooth
from smoother.cli.imports import imu_files
from smoother.cli.run import run
from smoother.errors import SolveError, UnoccludeError
from smoother.io import read_recording
from smoother.runtime.outputs import check_output

DEMO = Path(__file__).parents[2] / "data" / "demo.mcap"
UNOCCLUDE = [sys.executable, "-c", "from smoother.cli import main; main()"]


def test_what_nobody_reads_does_not_cost_the_result(tmp_path: Path):
    """`cut .. | head`: the reader is gone before the first word is printed."""
    output = tmp_path / "part.mcap"
    words = [*UNOCCLUDE, "cut", str(DEMO), "--from", "10", "--to", "15", "-o", str(output)]
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True, timeout=120)
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "") and output.is_file()


@pytest.mark.parametrize(
    "words",
    [
        ("import", "formats"),
        ("import", "describe", "{folder}"),
        ("import", "describe", "{folder}/one.csv"),
        ("config",),
        ("simulate", "arm", "-o", "{folder}/arm.mcap", "--set", "protocol=random", "--set", "duration_s=2"),
        ("simulate", "people", "-o", "{folder}/people.mcap", "--set", "duration_s=2"),
        ("repair", str(DEMO), "-o", "{folder}/whole.mcap"),
    ],
    ids=" ".join,
)
def test_figures_are_written_before_anything_is_printed(words: tuple[str, ...], tmp_path: Path, monkeypatch):
    class Full(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    rows = (f"{k / 100},0.1,0.2,9.8,0.01,0.02,0.03\n" for k in range(50))
    (tmp_path / "one.csv").write_text("t,ax,ay,az,gx,gy,gz\n" + "".join(rows))
    monkeypatch.setattr(sys, "stdout", Full())
    figures = tmp_path / "figures.json"
    assert run([*(word.format(folder=tmp_path) for word in words), "--json", str(figures)]) == 1
    assert json.loads(figures.read_text())


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX'")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_for_an_import(tmp_path: Path, number: int):
    """A library that is interrupted while it loads says "initialization failed", or is taken for missing."""
    (tmp_path / "slow_library.py").write_text(
        "import os, time\n"
        f"os.kill(os.getpid(), {int(number)})\n"
        "try:\n    time.sleep(0.3)\n"
        "except KeyboardInterrupt as error:\n    raise ImportError('initialization failed') from error\n"
        "print('loaded')\n"
    )
    code = (
        "import sys, time, smoother.cli.app as app\nfrom smoother.cli import main\n"
        "def command(*_, **__):\n    import slow_library\n    time.sleep(5)\n"
        "app.app = command\nmain()"
    )
    path = os.pathsep.join([str(tmp_path), str(DEMO.parents[1])])
    begin = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        timeout=60,
    )
    assert done.stdout == "loaded\n" and done.returncode == 1
    assert done.stderr == "unocclude: interrupted; no output is left half written\n"
    assert time.monotonic() - begin < 30


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        *(
            ("forearm_rigth", "forearm_right"),
            ("forarm_left", "forearm_left"),
            ("upperarm_rigt", "upper_arm_right"),
        ),
        *(("hnad_left", "hand_left"), ("Wrist_Rihgt", "wrist_right")),
        *(
            (name, "")
            for name in ("forearm_right", "hand_l", "wrist", "dot_3", "trunk", "sensor", "forearm_right_2")
        ),
    ],
)
def test_a_misspelled_place_is_refused(name: str, meant: str):
    if not meant:
        assert imu_files(f"{name}=dot.csv").name == name
        return
    with pytest.raises(UnoccludeError, match=f"did you mean {meant}"):
        imu_files(f"{name}=dot.csv")


def test_an_output_that_exists_is_named_for_its_caller(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(UnoccludeError, match="or force=True"):
        check_output(DEMO)
    (tmp_path / "config.json").touch()
    assert run(["config", "--json", str(tmp_path / "config.json")]) == 1
    assert "or --force to overwrite it" in capsys.readouterr().err


@pytest.mark.parametrize(("factor", "unit"), [(1000, "millimetres"), (100, "centimetres")])
def test_a_wrong_unit_is_named(factor: int, unit: str):
    from dataclasses import replace

    recording = read_recording(DEMO)
    arm = replace(recording.arm, position=recording.arm.position * factor)
    with pytest.raises(SolveError, match=f"they seem to be {unit}: divide them by {factor}"):
        smooth(replace(recording, arm=arm))


def test_a_result_against_its_own_export_says_so():
    from arms import make_recording, make_recovery

    from smoother.evaluation.validate import validate
    from smoother.recording import Truth

    recovery = make_recovery(make_recording())
    own = Truth(recovery.t_s, recovery.position, recovery.quaternion, recovery.answered)
    said = "The reference is this result itself"
    assert any(note.startswith(said) for note in validate(recovery, own).notes)
    other = Truth(recovery.t_s, recovery.position + 0.003, recovery.quaternion, recovery.answered)
    assert not any(note.startswith(said) for note in validate(recovery, other).notes)


def test_the_demo_knows_no_true_lever_arms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """It recovers as a user's own first recording is recovered."""
    given: list[object] = []

    def stop(recordings: object, name: object, calibrations: object, *_: object) -> None:
        given.append(calibrations)
        raise UnoccludeError("enough")

    monkeypatch.setattr("smoother.cli.smooth.recover_arms", stop)
    assert run(["demo", "-o", str(tmp_path / "demo")]) == 1 and given == [[None]]
