"""The WebSocket that Foxglove connects to: a result's topics and schemas, this computer's programs alone."""

from __future__ import annotations

import asyncio
import json
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_engine import CameraEcho
from made_recordings import make

from smoother.errors import UnoccludeError
from smoother.io import write_recording
from smoother.io.wire.schemas import message_class
from smoother.measurements.visibility import Gap
from smoother.streams.arrivals import LiveStep
from smoother.streams.foxglove import LiveMessages, is_allowed
from smoother.streams.replay import Replay
from smoother.streams.session import LiveSession

LAYOUT = Path(__file__).parents[2] / "docs" / "unocclude.foxglove-layout.json"
SETTLED = ("skeleton", "forearm")
NAMES = ("skeleton", "forearm", "arm", "beads", "tf", "joints", "camera", "arm_camera", "gaps", "log")
TOPICS = {f"/unocclude/{name}" for name in NAMES} | {f"/unocclude/{name}/settled" for name in SETTLED}


class Kept(list):
    send = list.append


@pytest.fixture
def played(tmp_path) -> tuple[Replay, LiveStep]:
    """A source, and the last step of it: its frames, a gap that ended, and an event."""
    write_recording(make(6.0), tmp_path / "original.mcap")
    source, kept = Replay(tmp_path / "original.mcap", speed=0.0), Kept()
    session = LiveSession(source, [CameraEcho()], receivers=[kept])
    session.run(lambda: source.now_s() > 2.5)
    frames = source.arms[0].frames.select(slice(60, 62))
    return source, replace(kept[-1], frames=frames, gap=Gap(1.0, 1.8), events=("the camera is back",))


def test_messages_are_those_of_a_result(played):
    source, step = played
    messages, output = LiveMessages(source.infos[0]), step.output
    sent = [
        *messages.arm(output.now, TOPICS.__contains__, step.frames, 0.012),
        *messages.arm(output.settled, TOPICS.__contains__),
        *messages.gap(step.gap),
        messages.line("the camera is back", 2.0),
    ]
    by_topic = {m.topic: message_class(m.schema).FromString(m.data) for m in sent}
    assert by_topic.keys() == TOPICS
    skeleton, origin = by_topic["/unocclude/skeleton"], source.infos[0].origin_ns
    assert [joint.name for joint in skeleton.joints] == ["shoulder_right", "elbow_right", "wrist_right"]
    wrist = skeleton.joints[2].position
    np.testing.assert_allclose([wrist.x, wrist.y, wrist.z], output.now.joints["wrist"])
    assert skeleton.joints[2].position_covariance[0] == pytest.approx(1e-4)
    stamp = round(output.now.t_s * 1e9) + origin
    assert skeleton.timestamp.ToNanoseconds() == stamp
    settled = by_topic["/unocclude/skeleton/settled"].timestamp.ToNanoseconds()
    assert stamp - settled == pytest.approx(0.2e9, abs=2)
    camera = by_topic["/unocclude/camera"].timestamp.ToNanoseconds()
    assert camera == pytest.approx(step.frames.t_s[-1] * 1e9 + 0.012e9 + origin, abs=512)
    assert len(by_topic["/unocclude/arm"].entities) == 1
    assert by_topic["/unocclude/gaps"].end_time.ToNanoseconds() - origin == 1_800_000_000
    assert by_topic["/unocclude/tf"].transforms[1].parent_frame_id == "world"


def test_the_layout_of_a_result_has_all_its_topics_live():
    shown = set(re.findall(r'"(/unocclude/\w+)', LAYOUT.read_text(encoding="utf-8")))
    assert len(shown) > 5
    assert shown - {"/unocclude/residuals"} <= TOPICS


async def received(address: str, send) -> tuple[set[str], dict[str, bytes]]:
    """What the server advertises, and a message a topic, of a client as Foxglove is one."""
    from tornado.httpclient import HTTPClientError, HTTPRequest
    from tornado.websocket import websocket_connect

    with pytest.raises(HTTPClientError, match="403"):
        await websocket_connect(HTTPRequest(address, headers={"Origin": "https://evil.example"}))
    client = await websocket_connect(HTTPRequest(address), subprotocols=["foxglove.sdk.v1"])
    channels: dict[int, str] = {}
    while len(channels) < len(TOPICS):
        said = json.loads(await asyncio.wait_for(client.read_message(), 5))
        channels |= {c["id"]: c["topic"] for c in said.get("channels", ())}
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
                    messages[channels[number - 1000]] = data[13:]
        except TimeoutError:
            continue
        break
    client.close()
    return set(channels.values()), messages


def test_a_client_reads_the_arm_and_nothing_is_made_where_nobody_looks(played, monkeypatch):
    pytest.importorskip("foxglove", reason="foxglove-sdk, of the extra `live`, is not installed")
    from smoother.streams.foxglove import FoxgloveServer

    source, step = played
    server = FoxgloveServer(source.infos, 0)
    try:
        assert server.address.startswith("ws://127.0.0.1:")
        server.send(step)  # announces all topics
        with monkeypatch.context() as patched:
            patched.setattr(LiveMessages, "arm", lambda *_: pytest.fail("made for nobody"))
            server._drawn_s = [-1.0]
            server.send(step)

        def send() -> None:
            server._drawn_s = [-1.0]
            server.send(step)

        topics, messages = asyncio.run(received(server.address, send))
        port = int(server.address.rpartition(":")[2])
        with pytest.raises(UnoccludeError, match=f"port {port} of 127.0.0.1 cannot be used"):
            FoxgloveServer(source.infos, port)
    finally:
        server.close()
    assert topics == TOPICS
    skeleton = message_class("unocclude.Skeleton").FromString(messages["/unocclude/skeleton"])
    assert skeleton.joints[2].position.x == pytest.approx(step.output.now.joints["wrist"][0])


# Which pages may connect


def head(*lines: str) -> bytes:
    return "\r\n".join(["GET / HTTP/1.1", *lines]).encode()


@pytest.mark.parametrize(
    "lines, allowed",
    [
        (("Host: 127.0.0.1:8765",), True),  # a program
        (("Host: localhost:8765", "Origin: https://app.foxglove.dev"), True),
        (("Host: localhost:8765", "Origin: file://"), True),
        (("host: 127.0.0.1", "oRIGIN: http://localhost:3000"), True),
        (("Host: 127.0.0.1:8765", "Origin: https://evil.example"), False),
        (("Host: 127.0.0.1", "Origin: https://app.foxglove.dev", "Origin: https://evil.example"), False),
        (("Host: localhost:8765", "Origin: file://"), True),
        (("Host: 127.0.0.1:8765", "Origin: https://app.foxglove.dev.evil.example"), False),
        (("Host: 127.0.0.1:8765", "Origin: null"), False),
        (("Host: evil.example:8765",), False),  # a name that points at this computer
        ((), False),
    ],
)
def test_who_may_connect(lines, allowed):
    assert is_allowed(head(*lines)) is allowed
