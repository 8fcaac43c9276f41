"""Sessions while recordings are played: every byte that matters comes back, of one arm or both."""

from __future__ import annotations

import dataclasses
import json
import threading
from pathlib import Path

import numpy as np
import pytest
from live_engine import CameraEcho
from made_recordings import make
from scenes import ALONE, arm

import smoother.live.smoother
from smoother.cli.run import run
from smoother.errors import UnoccludeError
from smoother.io import open_recording, read_recording, write_recording
from smoother.io.mcap.merge import repair_container
from smoother.smoothing import smooth
from smoother.streams import session_recording
from smoother.streams.replay import Replay
from smoother.streams.session import LiveSession
from smoother.streams.session_recording import (
    SessionRecording,
    check_recording,
    growing_name,
)


@pytest.fixture
def original(tmp_path):
    write_recording(make(6.0), tmp_path / "original.mcap")
    return tmp_path / "original.mcap"


def never() -> bool:
    return False


def begun(path, record, **options) -> tuple[Replay, SessionRecording, LiveSession]:
    source = Replay(path, speed=0.0)
    recording = SessionRecording(record, source.infos, **options)
    return source, recording, LiveSession(source, [CameraEcho()], recording=recording)


def same(one, other) -> None:
    for stream, names in (("imu", ("t_s", "acc", "gyro", "mag")), ("arm", ("t_s", "position", "state"))):
        for name in names:
            np.testing.assert_array_equal(*(getattr(getattr(each, stream), name) for each in (one, other)))
    assert (one.side, one.camera_frame, one.origin_ns) == (other.side, other.camera_frame, other.origin_ns)
    if one.gravity_hint is not None:
        np.testing.assert_allclose(one.gravity_hint, other.gravity_hint)


def test_what_is_recorded_is_what_was_played(original, tmp_path):
    _, recording, session = begun(original, tmp_path / "session.mcap", patient=True)
    session.run(never)
    recording.close()
    same(read_recording(original), read_recording(tmp_path / "session.mcap"))
    assert not growing_name(tmp_path / "session.mcap").exists()


@pytest.mark.slow
def test_the_growing_file_can_be_read_at_any_moment_and_says_at_last_what_was_done(original, tmp_path):
    source, recording, session = begun(original, tmp_path / "session.mcap")
    (arm,) = source.arms
    imu = arm.imus["forearm"]
    stepped = dataclasses.replace(imu, t_s=imu.t_s + np.where(imu.t_s > 3.0, 3.0, 0.0))
    source.play([dataclasses.replace(arm, imus={"forearm": stepped})])
    session.run(lambda: source.now_s() >= 5.0)
    # nothing is closed: as kill -9 leaves it
    growing = growing_name(tmp_path / "session.mcap")
    read = read_recording(growing)
    assert read.imu.t_s[-1] > 3.5  # a second may wait in memory
    assert len(read.arm) > 100
    report = repair_container(growing, tmp_path / "whole.mcap")
    assert sum(report["messages"].values()) > 400
    assert read_recording(tmp_path / "whole.mcap").imu.t_s[-1] == read.imu.t_s[-1]
    with pytest.raises(UnoccludeError, match=r"session.recording.mcap was left by a session that was killed"):
        check_recording(tmp_path / "session.mcap", force=True)
    recording.close()
    assert len(read_recording(tmp_path / "session.mcap").imu) > len(read.imu)
    file = open_recording(tmp_path / "session.mcap")
    assert any("stepped by +3.0" in note for note in file.notes)
    assert json.loads(file.metadata["unocclude.recording"]["gravity"]) == [0.0, -1.0, 0.0]


def test_a_session_without_samples_leaves_no_file(original, tmp_path):
    _, recording, _ = begun(original, tmp_path / "session.mcap")
    recording.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["original.mcap"]


@pytest.mark.slow
def test_recorded_out_of_order_and_smoothed_offline_it_is_the_same_answer(tmp_path):
    """A tenth of samples and frames come up to 0.4 s late: the answer of the original, within 0.02 sigma."""
    made = arm(seed=0, preset="realistic", duration_s=15.0)
    write_recording(made.recording, tmp_path / "original.mcap")
    source, recording, session = begun(tmp_path / "original.mcap", tmp_path / "session.mcap", patient=True)
    rng = np.random.default_rng(0)

    def disordered(rows):
        late = np.where(rng.random(len(rows)) < 0.1, rng.uniform(0, 0.4, len(rows)), 0.0)
        return dataclasses.replace(rows, arrival_s=rows.arrival_s + late)

    source.play([arm.by_row(disordered) for arm in source.arms])
    session.run(never)
    recording.close()
    assert session.figures[0].imu.late > 100
    original, recorded = (read_recording(tmp_path / name) for name in ("original.mcap", "session.mcap"))
    same(original, recorded)
    one, other = smooth(original, config=ALONE), smooth(recorded, config=ALONE)
    difference = np.abs(one.position - other.position) / one.sigma_m
    assert np.isfinite(difference).any()
    assert np.nanmax(difference) < 0.02


def test_a_full_disk_ends_the_recording_and_not_the_session(original, tmp_path, monkeypatch):
    source, recording, session = begun(original, tmp_path / "session.mcap", patient=True)
    write, written = recording._output.write, []

    def filling(*arguments):
        written.append(1)
        if len(written) > 200:
            raise OSError(28, "No space left on device")
        write(*arguments)

    with monkeypatch.context() as patched:
        patched.setattr(recording._output, "write", filling)
        session.run(never)
        recording.close()
    assert source.ended
    (said,) = [sentence for _, sentence in session.figures[0].events if "recording has ended" in sentence]
    assert "the session continues" in said and "unocclude repair" in said and "session.recording.mcap" in said
    assert not recording.is_whole


def test_a_disk_that_does_not_take_the_end_is_said(original, tmp_path, monkeypatch):
    """The end mark was dropped silently, and the file closed while it was being written."""
    source, recording, session = begun(original, tmp_path / "session.mcap")
    hangs = threading.Event()
    monkeypatch.setattr(session_recording, "_CLOSE_S", 0.2)
    monkeypatch.setattr(recording._output, "write", lambda *_: hangs.wait(30.0))
    session.run(lambda: source.now_s() > 1.0)
    recording.close()
    hangs.set()
    said = [sentence for _, sentence in session.figures[0].events if "has no end" in sentence]
    assert len(said) == 1 and "unocclude repair" in said[0]
    assert not recording.is_whole and not (tmp_path / "session.mcap").exists()


def test_a_slow_disk_delays_no_answer(original, tmp_path, monkeypatch):
    """It takes nothing until the last answer is given, then all."""
    source, recording, session = begun(original, tmp_path / "session.mcap")
    write, answered = recording._output.write, threading.Event()

    def slow(*arguments):
        assert answered.wait(30.0), "an answer waits for the disk"
        write(*arguments)

    monkeypatch.setattr(recording._output, "write", slow)
    session.run(never, lambda *_: source.ended and answered.set())
    recording.close()
    same(read_recording(original), read_recording(tmp_path / "session.mcap"))


SIDES = ("right", "left")


@pytest.fixture(scope="module")
def both(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("both") / "both.mcap"
    made = [*("--arms", "both", "--set", "imus=wrist,upper-arm", "--set", "protocol=random")]
    assert run(["simulate", "arm", "-o", str(path), "--seed", "3", *made, "--set", "duration_s=6"]) == 0
    return path


@pytest.mark.slow
def test_one_recording_one_file_of_figures_and_every_line_names_its_arm(both, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(smoother.live.smoother, "LiveSmoother", CameraEcho)
    session, figures = tmp_path / "session.mcap", tmp_path / "session.json"
    arguments = ["--arms", "both", "--speed", "0", "--record", str(session), "--json", str(figures)]
    assert run(["live", "--replay", str(both), *arguments]) == 0
    said, errors = capsys.readouterr()
    assert not errors
    for side in SIDES:
        assert f"IMU /imu/upper_arm_{side} on the upper arm" in said
        assert f"s  {side} arm: calibrating" in said
        assert f"{side} arm, " in said
        played, kept = (read_recording(path, side=side) for path in (both, session))
        upper = [each.further_imus["upper_arm"] for each in (kept, played)]
        for own, names in (
            ((kept.imu, played.imu), ("acc", "t_s")),
            (upper, ("gyro",)),
            ((kept.arm, played.arm), ("t_s", "position", "state")),
        ):
            for name in names:
                np.testing.assert_array_equal(*(getattr(each, name) for each in own))
    arms = {each["side"]: each for each in json.loads(figures.read_text())["arms"]}
    assert list(arms) == list(SIDES)
    assert arms["left"]["skeleton"]["count"] == arms["right"]["skeleton"]["count"] > 100
