"""Drawings of pages: the forearm and its sensor, the grey person, the strap in the picture."""

from __future__ import annotations

from base64 import b64decode
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from arms import make_recording, make_recovery
from scipy.spatial.transform import Rotation

from calib.motion.motion_calibration import ArmEstimates, found_in
from smoother.calibration import ArmCalibration, LeverArm
from smoother.measurements.visibility import Reason
from smoother.recording import JOINTS
from smoother.report import write_report
from smoother.report.forearm import directions, ellipse, mount
from smoother.report.strap import brightness, side_by_side
from smoother.report.summary import summary
from smoother.report.truth_comparison import timeline
from smoother.result import Estimates


def an_arm(levers: dict[str, list[float]], turn: Rotation | None = None) -> ArmEstimates:
    turn = turn or Rotation.identity()
    recovery = make_recovery(make_recording(4.0))
    calibration = ArmCalibration(
        "right",
        {joint: LeverArm(turn.apply(place), np.full(3, 0.004)) for joint, place in levers.items()},
    )
    found = found_in(replace(recovery, calibration=calibration))
    assert found is not None
    return found


WHOLE = {"elbow": [-0.035, -0.20, 0.0], "wrist": [-0.035, 0.05, 0.0], "hand": [-0.03, 0.13, 0.0]}


@pytest.mark.parametrize("seed", range(3))
def test_the_drawing_does_not_turn_with_the_sensors_axes(seed):
    turn = Rotation.random(random_state=seed)
    found = an_arm(WHOLE, turn)
    along, away = directions(found)
    np.testing.assert_allclose(turn.inv().apply([along, away]), [[0, 1, 0], [1, 0, 0]], atol=1e-12)
    figure = mount(found)
    elbow = next(trace for trace in figure.data if trace.name == "elbow")
    np.testing.assert_allclose([elbow.x[0], elbow.y[0]], [-20.0, -3.5], atol=1e-9)
    texts = [note.text for note in figure.layout.annotations]
    assert "25.0 ± 1.1 cm" in texts
    assert "3.5 ± 0.8 cm from the forearm's axis" in texts
    assert "8.0 cm" in texts


@pytest.mark.parametrize(
    "levers",
    [
        {"wrist": [0.0, 0.05, 0.01]},
        {"strap": [0.0, 0.0, 0.0]},
        {"elbow": [0.0, -0.2, 0.0], "wrist": [0.0, 0.05, 0.0]},
    ],
)
def test_odd_mountings(levers):
    found = an_arm(levers)
    along, away = directions(found)
    assert np.linalg.norm(along) == pytest.approx(1) and np.linalg.norm(away) == pytest.approx(1)
    assert along @ away == pytest.approx(0, abs=1e-12)
    assert mount(found) is not None


def test_nothing_to_draw():
    assert mount(None) is None
    assert mount(an_arm({})) is None


def test_ellipse_holds_95_of_100_cases_of_two_coordinates():
    lever = LeverArm(np.array([0.1, 0.2, 0.0]), np.array([0.01, 0.02, 0.03]))
    edge = ellipse(lever, np.eye(3)[:2])
    np.testing.assert_allclose(edge.max(axis=0), [12.448, 24.896], atol=0.04)
    np.testing.assert_allclose(edge.min(axis=0), [7.552, 15.104], atol=0.04)


def test_the_page_tells_what_was_set_aside(tmp_path):
    recovery = make_recovery(make_recording())
    kept = recovery.residuals
    assert kept is not None
    reason, used = kept.reason.copy(), kept.used.copy()
    reason[30:90, JOINTS.index("wrist")] = 1
    used[30:90, JOINTS.index("wrist")] = False
    kept = replace(kept, reason=reason, reasons=(Reason(""), Reason("frozen", "<it> stands")), used=used)
    figures = {"max_sigma_m": 0.005, "camera_sigma_m": {"wrist": 0.008, "elbow": 0.008}}
    recovery = replace(recovery, residuals=kept, estimates=Estimates.from_plain(figures))
    drawn = timeline(recovery)
    assert drawn is not None
    frozen = next(trace for trace in drawn.data if trace.name == "frozen")
    assert len(frozen.x) == 60 and set(frozen.y) == {"wrist"}
    assert timeline(make_recovery(make_recording())) is None
    write_report(recovery, tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "<td>&lt;it&gt; stands</td><td>wrist</td><td>60</td>" in text
    assert "% of the camera&#x27;s samples" in text or "% of the camera's samples" in text
    assert f"<td>{len(recovery)} (above 0.5 cm)</td>" in text
    assert "samples repeated the one before" in text  # the advice
    assert "too near to tell on which side" in text  # hand-made lever arms lie in a line
    assert "disagree more than stated" not in text


def test_an_answer_that_the_camera_contradicts_is_doubted():
    recovery = replace(make_recovery(make_recording()), estimates=Estimates(camera_sigma_m={"wrist": 0.003}))
    text = " ".join(summary(recovery, None))
    assert "Result and camera disagree more than stated: of the wrist samples" in text
    assert "95 of 100 cases" not in text


def test_what_the_camera_did_not_see_stays_empty():
    t = np.array([0.0, 0.1, 0.2, 1.2, 1.3, 1.4])
    table = np.tile(10.0 * np.arange(1, 7), (5, 1))
    (start, end), png = side_by_side(t, table)
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture.shape == (5, 15, 4)
    np.testing.assert_allclose([start, end], [-0.05, 1.45])
    at = start + (np.arange(15) + 0.5) * (end - start) / 15
    empty = picture[0, :, 3] == 0
    np.testing.assert_array_equal(empty, (at > 0.35) & (at < 1.05))
    np.testing.assert_array_equal(picture[0, [0, 1, 2, 12, 13, 14], 0], 10 * np.arange(1, 7))


def test_dots_lie_on_the_dark_line():
    part = np.linspace(0.05, 1.03, 100)
    profile = np.where(np.abs(part - 0.62) < 0.05, 20.0, 200.0)
    found = SimpleNamespace(
        profiles=[(0.1 * k, profile) for k in range(5)],
        reasons=["", "", "no depth image", "", ""],
        t_s=0.1 * np.arange(5),
        along=np.full(5, 0.8),  # of the seen surface: elsewhere, for a camera from the side
        in_profile=np.full(5, 0.62),
    )
    drawn = brightness(found)
    image, dots = drawn.layout.images[0], drawn.data[0]
    assert len(dots.x) == 4
    grey = cv2.imdecode(np.frombuffer(b64decode(image.source.split(",")[1]), np.uint8), cv2.IMREAD_UNCHANGED)
    share = (image.y - np.asarray(dots.y, float)) / image.sizey  # from the picture's top
    rows = (share * grey.shape[0]).astype(int)
    assert (grey[rows, 0, 0] == 20).all()
