"""What the player is given: packed, in time with the arm, small."""

from __future__ import annotations

import json
import re
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest
from arms import LEVERS, make_recording, make_recovery, path, turn

from smoother.recording import CameraFrame, JointState
from smoother.report.player import MOST_BYTES, packed, played_arm, player, upwards, view_of
from smoother.report.sheet import Html, data_block


def unpacked(track: dict) -> np.ndarray:
    """As the page's own program reads it."""
    raw = np.frombuffer(b64decode(track["data"]), "<i2").reshape(-1, len(track["offset"]))
    return np.where(raw == -32768, np.nan, raw * track["scale"] + np.array(track["offset"]))


def test_packed_numbers_come_back():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(500, 3)) * [0.3, 2.0, 0.01] + [0.0, 5.0, -1.0]
    values[7], values[9, 1] = np.nan, np.nan
    back = unpacked(packed(values))
    np.testing.assert_array_equal(np.isnan(back), np.isnan(values))
    # half a step of 16 bits over the widest column, here some 13 m
    assert np.nanmax(np.abs(back - values)) < 13.0 / 64000
    nothing = unpacked(packed(np.full((4, 3), np.nan)))
    assert np.isnan(nothing).all() and nothing.shape == (4, 3)
    assert np.isfinite(unpacked(packed(np.ones((2, 3))))).all()


@pytest.fixture(scope="module")
def pair():
    recording = make_recording(12.0)
    hidden = (recording.arm.t_s > 5) & (recording.arm.t_s < 7)
    recording = replace(recording, arm=recording.arm.hide(hidden), camera_frame=CameraFrame.KINECT)
    return recording, make_recovery(recording, sigma_m=0.02)


def test_the_arm_is_where_the_recovery_has_it(pair):
    recording, recovery = pair
    arm = played_arm(recovery, recording.truth, MOST_BYTES)
    t = arm["start"] + arm["step"] * np.arange(arm["count"])
    assert arm["step"] == pytest.approx(1 / 30, rel=0.02) and t[-1] == pytest.approx(recovery.t_s[-1])
    assert arm["names"] == ["shoulder", "elbow", "wrist", "hand"] and arm["tip"] == "wrist"
    joints = unpacked(arm["joints"]).reshape(len(t), 4, 3)
    wrist = path(t) + turn(t).apply(LEVERS["wrist"])
    # straight lines between samples 12.5 ms apart of a motion of 2 m/s^2: 0.04 mm, and half a step of 16 bits
    np.testing.assert_allclose(joints[:, 2], wrist, atol=2e-4)
    np.testing.assert_allclose(unpacked(arm["sensor"]), path(t), atol=2e-4)
    assert arm["gaps"] == [[gap.start_s, gap.end_s] for gap in recovery.gaps]
    roots = unpacked(arm["sigma"])
    np.testing.assert_allclose(roots[:, [0, 2, 5]], 0.02, atol=1e-4)
    np.testing.assert_allclose(roots[:, [1, 3, 4]], 0.0, atol=1e-4)


def test_the_cameras_skeleton_is_gone_in_the_gap_and_a_guess_is_marked(pair):
    _, recovery = pair
    arm = recovery.arm
    state = arm.state.copy()
    state[:30] = JointState.INFERRED
    recovery = replace(recovery, arm=replace(arm, state=state))
    plain = played_arm(recovery, None, MOST_BYTES)
    t = plain["start"] + plain["step"] * np.arange(plain["count"])
    camera = unpacked(plain["camera"]).reshape(len(t), 4, 3)
    tracked = np.frombuffer(b64decode(plain["tracked"]), np.uint8)
    inside = (t > 5.1) & (t < 6.9)
    assert np.isnan(camera[inside, 1:]).all() and np.isfinite(camera[(t > 1) & (t < 4.9)]).all()
    assert (tracked[t < 0.9] == 0).all() and (tracked[(t > 1.5) & (t < 4.5)] == 0b1111).all()


def test_a_long_recording_gets_fewer_frames_and_several_arms_share():
    recording = make_recording(900.0, truth=False)
    recovery = make_recovery(recording)
    arm = played_arm(recovery, None, 200_000)
    size = sum(len(arm[name]["data"]) for name in ("joints", "camera", "sensor", "sigma"))
    assert 0.7 * 200_000 < size * 3 / 4 + arm["count"] <= 200_000
    shown = player("Arms", Html("two"), [(recovery, None), (replace(recovery, side="left"), None)], None)
    assert shown is not None and shown.player is not None
    assert len(data := shown.player["data"]) < MOST_BYTES * 4 / 3 + 10_000
    assert re.findall(r'"name":"(\w+)"', data) == ["right", "left"]


def test_up_is_where_gravity_says():
    leaning = np.array([0.0, -0.8, 0.6])
    np.testing.assert_allclose(upwards(CameraFrame.KINECT, leaning), [0.0, 0.8, -0.6])
    np.testing.assert_allclose(upwards(CameraFrame.OPTICAL, np.full(3, np.nan)), [0.0, -1.0, 0.0])
    np.testing.assert_allclose(upwards(None), [0.0, 0.0, 1.0])


def test_one_outlier_does_not_make_the_arm_small():
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.3, 0.3, (2000, 3)) + np.array([0.0, 0.0, 2.0])
    points[5] = [40.0, 0.0, 0.0]
    view = view_of(points, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, -1.0]))
    assert view["radius"] < 0.6 and np.linalg.norm(np.subtract(view["center"], [0, 0, 2])) < 0.05


def test_json_cannot_end_its_block():
    block = data_block({"name": "</script><!-- \u2028 &amp;"})
    inside = block.removeprefix('<script type="application/json">').removesuffix("</script>")
    assert "<" not in inside and "\u2028" not in inside
    assert json.loads(inside) == {"name": "</script><!-- \u2028 &amp;"}
