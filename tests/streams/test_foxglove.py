"""The WebSocket that Foxglove connects to: the topics and schemas of a result, on this computer alone."""

from __future__ import annotations

import asyncio
import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest
from live_engine import CameraEcho
from made_recordings import make

from smoother.errors import UnoccludeError
from smoother.io import write_recording
from smoother.io.wire.schemas import message_class
from smoother.live.answers import LiveOutput
from smoother.measurements.visibility import Gap
from smoother.streams.arrivals import FrameRows
from smoother.streams.foxglove import TOPICS, LiveMessages
from smoother.streams.replay import Replay
from smoother.streams.session import LiveSession

LAYOUT = Path(__file__).parents[2] / "docs" / "unocclude.foxglove-layout.json"


@pytest.fixture
def source(tmp_path) -> Replay:
    write_recording(make(6.0), tmp_path / "original.mcap")
    return Replay(tmp_path / "original.mcap", speed=0.0)


def last_output(source) -> tuple[LiveOutput, FrameRows]:
    engine = CameraEcho()
    session = LiveSession(source, engine)
    session.run(lambda: source.now_s() > 2.5, lambda _: None)
    frames = source._frames.select(slice(60, 62))
    return engine.step(source.now_s()), frames


def decoded(messages) -> dict:
    return {m.topic: message_class(m.schema).FromString(m.data) for m in messages}


def test_messages_are_those_of_a_result(source):
    output, frames = last_output(source)
    messages = LiveMessages(source.info)
    sent = [
        *messages.estimate(output.now),
        *messages.estimate(output.settled),
        *messages.frames(frames, 0.012),
        *messages.gap(Gap(1.0, 1.8)),
        messages.line("the camera is back", 2.0),
    ]
    assert {(m.topic, m.schema) for m in sent} == set(TOPICS.items())
    by_topic = decoded(sent)
    skeleton = by_topic["/unocclude/skeleton"]
    assert [joint.name for joint in skeleton.joints] == ["shoulder_right", "elbow_right", "wrist_right"]
    wrist = skeleton.joints[2]
    np.testing.assert_allclose(
        [wrist.position.x, wrist.position.y, wrist.position.z], output.now.joints["wrist"]
    )
    assert wrist.position_covariance[0] == pytest.approx(1e-4)
    stamp = round(output.now.t_s * 1e9) + source.info.origin_ns
    assert skeleton.timestamp.ToNanoseconds() == stamp
    settled = by_topic["/unocclude/skeleton/settled"].timestamp.ToNanoseconds()
    assert stamp - settled == pytest.approx(0.2e9, abs=2)
    camera = by_topic["/unocclude/camera"].timestamp.ToNanoseconds()
    assert camera == pytest.approx(frames.t_s[-1] * 1e9 + 0.012e9 + source.info.origin_ns, abs=512)
    assert len(by_topic["/unocclude/arm"].entities) == 1
    assert by_topic["/unocclude/gaps"].end_time.ToNanoseconds() - source.info.origin_ns == 1_800_000_000
    assert by_topic["/unocclude/tf"].transforms[1].parent_frame_id == "world"


def test_the_layout_of_a_result_has_all_its_topics_live():
    shown = set(re.findall(r'"(/unocclude/\w+)', LAYOUT.read_text(encoding="utf-8")))
    assert len(shown) > 5
    assert shown - {"/unocclude/residuals"} <= TOPICS.keys()


async def received(address: str, send) -> tuple[dict, dict]:
    """What the server advertises, and a message a topic, of a client as Foxglove is one."""
    from tornado.httpclient import HTTPRequest
    from tornado.websocket import websocket_connect

    client = await websocket_connect(HTTPRequest(address), subprotocols=["foxglove.sdk.v1"])
    channels: dict[int, dict] = {}
    while len(channels) < len(TOPICS):
        said = json.loads(await asyncio.wait_for(client.read_message(), 5))
        channels |= {c["id"]: c for c in said.get("channels", ())}
    wanted = [{"id": 1000 + number, "channelId": number} for number in channels]
    await client.write_message(json.dumps({"op": "subscribe", "subscriptions": wanted}))
    messages: dict[str, bytes] = {}
    for _ in range(100):
        await asyncio.sleep(0.02)
        await asyncio.to_thread(send)
        try:
            while len(messages) < 6:
                data = await asyncio.wait_for(client.read_message(), 0.05)
                if isinstance(data, bytes) and data[0] == 1:
                    number, _stamp = struct.unpack_from("<IQ", data, 1)
                    messages[channels[number - 1000]["topic"]] = data[13:]
        except TimeoutError:
            continue
        break
    client.close()
    return {c["topic"]: c["schemaName"] for c in channels.values()}, messages


def test_a_client_reads_the_arm(source):
    pytest.importorskip("foxglove", reason="foxglove-sdk, of the extra `live`, is not installed")
    from smoother.streams.foxglove import FoxgloveServer

    output, frames = last_output(source)
    server = FoxgloveServer(source.info, 0)
    try:
        assert server.address.startswith("ws://127.0.0.1:")

        def send() -> None:
            server._drawn_s = -1.0
            server.send(output, frames, None, ())

        topics, messages = asyncio.run(received(server.address, send))
    finally:
        server.close()
    assert topics == TOPICS
    skeleton = message_class("unocclude.Skeleton").FromString(messages["/unocclude/skeleton"])
    assert skeleton.joints[2].position.x == pytest.approx(output.now.joints["wrist"][0])


def test_nothing_is_made_where_nobody_looks(source, monkeypatch):
    pytest.importorskip("foxglove", reason="foxglove-sdk, of the extra `live`, is not installed")
    from smoother.streams.foxglove import FoxgloveServer

    output, frames = last_output(source)
    server = FoxgloveServer(source.info, 0)
    monkeypatch.setattr(LiveMessages, "estimate", lambda *_: pytest.fail("made for nobody"))
    try:
        server.send(output, frames, None, ("an event",))
        port = int(server.address.rpartition(":")[2])
        with pytest.raises(UnoccludeError, match=f"port {port} of 127.0.0.1 cannot be used"):
            FoxgloveServer(source.info, port)
    finally:
        server.close()
