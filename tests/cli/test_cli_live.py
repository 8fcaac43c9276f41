"""`unocclude live` on a recording that is played: what it prints, writes and refuses."""

from __future__ import annotations

import json
import os
import re
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from commands import done, refused
from live_engine import INFO, CameraEcho
from made_recordings import make

import smoother.live.smoother
from smoother.cli.live import Lines, words
from smoother.cli.run import run
from smoother.io import read_recording, write_recording
from smoother.live.answers import LiveOutput, LiveState
from smoother.streams.lsl import lsl_module
from smoother.streams.session import SessionFigures


@pytest.fixture(autouse=True)
def echo(monkeypatch):
    monkeypatch.setattr(smoother.live.smoother, "LiveSmoother", CameraEcho)


@pytest.fixture
def recording(tmp_path) -> Path:
    write_recording(make(6.0), tmp_path / "original.mcap")
    return tmp_path / "original.mcap"


@pytest.mark.slow
def test_a_recording_is_played_recorded_and_summed_up(recording, tmp_path, capsys):
    session, figures = tmp_path / "session.mcap", tmp_path / "session.json"
    done("live", "--replay", recording, "--speed", "0", "--record", session, "--json", figures)
    said, errors = capsys.readouterr()
    assert not errors
    assert "right arm of /skeleton (shoulder, elbow, wrist)" in said
    assert "Frames arrive 0.1 s after their stamps." in said
    assert re.search(r"visible; IMU \d+\.\d /s|calibrating \(move the arm\)", said)
    assert f"try: unocclude smooth {session} -o {tmp_path / 'session_recovered.mcap'}" in said
    assert len(read_recording(session).imu) == len(read_recording(recording).imu)
    values = json.loads(figures.read_text())
    assert values["gaps"] == 1
    assert values["longest_gap_s"] == pytest.approx(0.6, abs=0.1)
    assert values["imu"]["count"] == 600
    assert values["skeleton"]["delay_s"] == pytest.approx(0.1)
    assert values["state_s"]["calibrating"] == pytest.approx(1.1, abs=0.2)


@pytest.fixture
def ctrl_c_is_heard():
    """A shell that starts tests in the background has them ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.slow
def test_ctrl_c_leaves_a_whole_recording(ctrl_c_is_heard, recording, tmp_path, capsys):
    def interrupt() -> None:
        time.sleep(2.5)
        os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    threading.Thread(target=interrupt).start()
    session = tmp_path / "session.mcap"
    slowly = ["--speed", "0.25"]  # a machine that is busy for some seconds does not reach the recording's end
    done("live", "--replay", recording, *slowly, "--record", session)
    assert signal.getsignal(signal.SIGINT) is before
    recorded = read_recording(session)
    assert 0.05 < recorded.imu.t_s[-1] - recorded.imu.t_s[0] < 4.0
    assert not [note for note in recorded.notes if "ends in the middle" in note]
    assert "written: " in capsys.readouterr().out


def test_what_a_killed_session_left_is_kept(recording, tmp_path, capsys):
    growing = tmp_path / "killed.recording.mcap"
    growing.write_bytes(b"precious")
    record = ("--record", tmp_path / "killed.mcap", "--force")
    said = refused(capsys, "live", "--replay", recording, *record)
    assert f"unocclude repair {growing}" in said
    assert growing.read_bytes() == b"precious"


def test_streams_that_never_overlap(tmp_path, capsys):
    made = make(4.0)
    import dataclasses

    late = dataclasses.replace(made.arm, t_s=made.arm.t_s + 100.0)
    write_recording(dataclasses.replace(made, arm=late, truth=None), tmp_path / "apart.mcap")
    assert "do not overlap in time" in refused(capsys, "live", "--replay", tmp_path / "apart.mcap")


@pytest.mark.parametrize(
    ("option", "package", "extra"), [("--imu=a", "pylsl", "live"), ("--view", "rerun-sdk", "view")]
)
def test_an_extra_that_is_missing_is_asked_for(option, package, extra, recording, monkeypatch, capsys):
    lsl_module.cache_clear()
    for name in ("pylsl", "rerun"):
        monkeypatch.setitem(sys.modules, name, None)  # as if it were not there
    replay = [] if package == "pylsl" else ["--replay", str(recording)]
    assert run(["live", option, *replay]) == 1
    said = capsys.readouterr().err
    assert f"{package}, which is not installed; get it with `pip install '.[{extra}]'`" in said
    lsl_module.cache_clear()


def watched(output: LiveOutput | None) -> SessionFigures:
    """A session whose last step answered this: 100 samples a second, 3 missing, and 30 frames."""
    figures = SessionFigures(INFO)
    t = np.delete(np.arange(0.0, 5.0, 0.01), [100, 200, 300])
    for part in np.array_split(t, 100):
        figures.imu.take(part, part + 0.004)
    for t_s in np.arange(0.0, 5.0, 1 / 30):
        figures.skeleton.take(np.array([t_s]), np.array([t_s + 0.13]))
    figures.now_s, figures.output = 5.0, output
    return figures


def answered(state: LiveState, since_s: float | None = None, **changes) -> LiveOutput:
    engine = CameraEcho()
    from smoother.live.buffers import SkeletonFrame

    for t in (0.0, 5.0):
        engine.add_frame(SkeletonFrame(t, t, np.zeros((5, 3)), np.full(5, 2, np.int8)))
    import dataclasses

    output = engine.step(5.0)
    now = dataclasses.replace(output.now, state=state, since_s=since_s)
    return dataclasses.replace(output, state=state, now=now, **changes)


def test_a_line_says_what_matters():
    gap = watched(answered(LiveState.GAP, 4.2, dropped={"backlog_frames": 2}, step_ms=7.0))
    assert words(gap)[0] == "gap since 0.8 s"
    rest = "; ".join(words(gap))
    assert re.search(r"IMU 9\d\.\d /s, delay 4 ms, 3 missing; camera (29|30)\.\d /s, delay 100 ms;", rest)
    assert "sigma 1.7 cm, 1.0 degrees; clock offset +12.0 +- 1.0 ms; 2 dropped; step 7.0 ms; load" in rest
    calibrating = LiveOutput(1.0, LiveState.CALIBRATING, calibration="move \x1b the arm")
    assert words(watched(calibrating))[0] == "calibrating (move \\x1b the arm)"
    lost = watched(answered(LiveState.LOST))
    assert words(lost)[0] == "no answer: catching up with the streams"
    lost.skeleton.look(9.0)
    assert words(lost)[0] == "a stream is lost: no answer"
    assert "camera: nothing comes" in words(lost)
    assert words(watched(None))[0] == "nothing has come yet"


def test_lines_tell_each_event_once(capsys):
    figures = watched(None)
    with Lines() as lines:
        for happened in (["one happened"], [], ["two happened"], ["two happened"]):
            figures.event(1.0, happened)
            lines.show(figures)
    said = capsys.readouterr().out
    assert said.count("one happened") == 1
    assert said.count("two happened") == 2
