"""The live page: who may read it, what a patient sees in Chromium, and marks that reach the recording."""

from __future__ import annotations

import http.client
import json
import time
from dataclasses import replace
from urllib.parse import urlsplit

import numpy as np
import pytest
from browser import Browser, chromium

from smoother.live.answers import LiveEstimate, LiveOutput, LiveState
from smoother.live.arm_angles import live_angles
from smoother.recording import CameraFrame
from smoother.streams.arrivals import FrameRows, SourceInfo
from smoother.streams.page_server import LivePage, light_of

INFO = SourceInfo("wrist", "kinect", "right", ("shoulder", "elbow", "wrist"), 0, CameraFrame.OPTICAL)
WAIT_S = 20.0


def answer(t_s: float, bent_deg: float, state: LiveState = LiveState.VISIBLE) -> LiveOutput:
    """An upper arm that hangs, and a forearm bent so far in the camera's plane."""
    bent = np.radians(bent_deg)
    shoulder = np.array([0.0, 0.0, 2.0])
    elbow = shoulder + np.array([0.0, 0.3, 0.0])
    wrist = elbow + 0.25 * np.array([np.sin(bent), np.cos(bent), 0.0])
    joints = {"shoulder": shoulder, "elbow": elbow, "wrist": wrist}
    spread = dict.fromkeys(joints, 1e-4 * np.eye(3))
    estimate = LiveEstimate(
        t_s, "now", state, None if state is LiveState.VISIBLE else t_s - 0.5, wrist,
        np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), 1e-4 * np.eye(6), joints, spread, np.zeros(3),
    )  # fmt: skip
    return LiveOutput(t_s, state, estimate)


@pytest.fixture
def page():
    page = LivePage(INFO, 0)
    yield page
    page.close()


def asked(page: LivePage, path: str, method: str = "GET", body: str = "", **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=WAIT_S)
    try:
        connection.request(
            method, path, body or None, {key.replace("_", "-"): v for key, v in headers.items()}
        )
        reply = connection.getresponse()
        return reply.status, reply.read().decode()
    finally:
        connection.close()


def test_angles_and_their_sigmas_agree_with_drawn_joints():
    output = answer(1.0, 70.0)
    angles = live_angles(output.now, np.array([0.0, 1.0, 0.0]))
    assert angles["elbow_flexion"][0] == pytest.approx(70.0, abs=1e-6)
    assert angles["shoulder_elevation"][0] == pytest.approx(0.0, abs=1e-6)
    assert angles["forearm_elevation"][0] == pytest.approx(-20.0, abs=1e-6)
    rng, drawn = np.random.default_rng(1), []
    for _ in range(2000):
        joints = {joint: at + rng.normal(0.0, 0.01, 3) for joint, at in output.now.joints.items()}
        drawn.append(live_angles(replace(output.now, joints=joints), None)["elbow_flexion"][0])
    assert angles["elbow_flexion"][1] == pytest.approx(np.std(drawn), rel=0.08)  # 2000 draws: 1.6 %
    assert set(live_angles(output.now, None)) == {"elbow_flexion"}


def test_light_says_how_good_the_answer_is():
    assert light_of(answer(1.0, 10.0)) == "seen"
    assert light_of(answer(1.0, 10.0, LiveState.GAP)) == "recovered"
    assert light_of(replace(answer(1.0, 10.0), doubt="the camera is left out")) == "unsure"
    assert light_of(LiveOutput(1.0, LiveState.LOST)) == "lost"
    assert light_of(LiveOutput(1.0, LiveState.CALIBRATING)) == "wait"


def test_only_the_page_itself_may_read_and_mark(page):
    token = urlsplit(page.address).query
    assert asked(page, f"/?{token}")[0] == 200
    assert asked(page, "/")[0] == 403
    assert asked(page, "/?token=guessed")[0] == 403
    assert asked(page, "/events")[0] == 403
    assert asked(page, f"/?{token}", Host=f"evil.example:{page.port}")[0] == 403  # a name set to 127.0.0.1
    assert asked(page, f"/?{token}", Origin="https://evil.example")[0] == 403
    assert asked(page, f"/?{token}", Sec_Fetch_Site="cross-site")[0] == 403
    assert asked(page, f"/../session.py?{token}")[0] == 404
    own = f"http://127.0.0.1:{page.port}"
    assert asked(page, f"/mark?{token}", "POST", "tired")[0] == 403  # no Origin: not the page
    assert asked(page, f"/mark?{token}", "POST", "tired", Origin="https://evil.example")[0] == 403
    assert asked(page, f"/mark?{token}", "POST", "x" * 3000, Origin=own)[0] == 400
    assert asked(page, f"/mark?{token}", "POST", "tired\x1b[2J", Origin=own)[0] == 200
    assert page.marks() == ["tired [2J"]


def test_a_slow_browser_holds_nobody_up(page):
    token = urlsplit(page.address).query
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=WAIT_S)
    connection.request("GET", f"/events?{token}")  # and never reads
    began = time.monotonic()
    for k in range(2000):
        page.send(answer(0.001 * k, 50.0), FrameRows.none(), None, ())
    assert time.monotonic() - began < 5.0
    connection.close()


@pytest.mark.skipif(chromium() is None, reason="Chromium is not installed")
def test_a_patient_trains_with_it(page):
    program = chromium()
    assert program is not None
    browser = Browser(program)
    try:
        for width, height in ((1280, 800), (390, 800)):
            browser.size(width, height, phone=width < 500)
            browser.call("Page.navigate", url=page.address)
            browser.wait("document.body?.dataset?.angles && document.getElementById('angle')?.options.length")
            counted = browser.run("document.getElementById('repetitions').textContent")
            assert counted == "0"
            for bent in (20.0, 70.0, 20.0, 75.0, 20.0):  # into the target of 60 to 90 degrees, twice
                shown(page, browser, answer(1.0, bent), f"{bent:.0f}°")
            assert browser.run("document.getElementById('repetitions').textContent") == "2"
            shown(page, browser, answer(2.0, 70.0, LiveState.GAP), "70°")
            assert browser.run("document.getElementById('light').textContent") == "recovered"
            assert "hidden for 0.5 s" in browser.run("document.getElementById('sigma').textContent")
            drawn = "[...document.getElementById('arm').getContext('2d').getImageData(0, 0, 2000, 2000).data]"
            assert browser.run(f"{drawn}.some((value) => value > 0)")
            assert browser.run("document.documentElement.scrollWidth <= window.innerWidth")
        browser.run("document.getElementById('pause').click()")
        shown(page, browser, answer(3.0, 20.0), "20°")
        shown(page, browser, answer(3.1, 70.0), "70°")
        assert (
            browser.run("document.getElementById('repetitions').textContent") == "3"
        )  # of the gap; not more
        until = time.monotonic() + WAIT_S
        marks: list[str] = []
        while not marks and time.monotonic() < until:
            marks = page.marks()
            time.sleep(0.02)
        assert marks == ["pause"]
        page.send(LiveOutput(4.0, LiveState.LOST, doubt=""), FrameRows.none(), None, ())
        until_text(browser, "light", "lost")
        assert browser.run("document.getElementById('value').textContent") == "–"  # no old angle stays
        page.send(LiveOutput(4.1, LiveState.CALIBRATING), FrameRows.none(), None, ())
        browser.wait("document.getElementById('say').textContent.includes('Move your arm slowly')")
        assert not browser.complaints()
        assert all(url.startswith(f"http://127.0.0.1:{page.port}/") for url in browser.loaded())
    finally:
        browser.close()


def shown(page: LivePage, browser: Browser, output: LiveOutput, value: str) -> None:
    """Send an answer until the page shows its angle."""
    until = time.monotonic() + WAIT_S
    while browser.run("document.getElementById('value').textContent") != value:
        page.send(output, FrameRows.none(), None, ("something happened",))
        assert time.monotonic() < until, value
        time.sleep(0.02)


def until_text(browser: Browser, name: str, text: str) -> None:
    browser.wait(f"document.getElementById({json.dumps(name)}).textContent === {json.dumps(text)}")
