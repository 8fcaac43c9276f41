"""The session in Rerun: what was answered of the present, and what is sent to a viewer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from live_engine import CameraEcho
from made_recordings import make

from smoother.io import write_recording
from smoother.streams.arrivals import LiveStep, SourceInfo
from smoother.streams.replay import Replay
from smoother.streams.session import LiveSession
from smoother.streams.viewer import RerunView, recovery_of


class Kept(list):
    send = list.append


@pytest.fixture
def played(tmp_path) -> tuple[SourceInfo, list[LiveStep]]:
    """What a session is of, and its first seconds: it calibrates, then follows the arm."""
    write_recording(make(6.0), tmp_path / "original.mcap")
    source, kept = Replay(tmp_path / "original.mcap", speed=0.0), Kept()
    LiveSession(source, [CameraEcho()], receivers=[kept]).run(lambda: source.now_s() > 2.5)
    return source.infos[0], kept


def test_what_is_shown_is_what_was_answered_and_seen(played):
    info, steps = played
    part = steps[-20:]
    shown, answers = recovery_of(info, part), [step.output.now for step in part]
    np.testing.assert_array_equal(shown.t_s, [each.t_s for each in answers])
    np.testing.assert_array_equal(shown.joints["wrist"], [each.joints["wrist"] for each in answers])
    assert not shown.occluded.any() and shown.origin_ns == info.origin_ns
    np.testing.assert_allclose(shown.arm.t_s, np.concatenate([s.frames.t_s for s in part]) + 0.012)
    assert (len(recovery_of(info, steps[:1])), len(recovery_of(info, steps[:1]).arm)) == (0, 0)


def test_a_viewer_is_sent_the_arm_the_curves_and_what_happened(played, tmp_path, monkeypatch):
    rr = pytest.importorskip("rerun", reason="rerun-sdk, of the extra `view`, is not installed")
    monkeypatch.setattr(rr.RecordingStream, "connect_grpc", lambda self, _: self.save(tmp_path / "sent.rrd"))
    info, steps = played
    view = RerunView([info], "an address")
    for step in steps:
        view.send(replace(step, events=("the camera is back",)) if step is steps[-1] else step)
    lost = steps[-1].output
    for at in range(10):  # frames without an answer
        view.send(replace(steps[-1], output=replace(lost, now_s=lost.now_s + 0.05 * at, now=None)))
    view.close()
    sent = (tmp_path / "sent.rrd").read_bytes()
    for words in (b"scene/camera/right/after", b"curves/wrist_x", b"elbow_flexion", b"the camera is back"):
        assert words in sent
