"""The page: self-contained, whole, and there for odd results too."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from arms import make_recording, make_recovery, make_truth

from smoother.errors import UnoccludeError
from smoother.evaluation.validate import validate
from smoother.measurements.visibility import Gap
from smoother.recording import CameraFrame, Recording
from smoother.report import write_report
from smoother.report.summary import summary
from smoother.result import Estimates, Recovery


class Page(HTMLParser):
    """Collects headings, attributes that load something, and figures."""

    def __init__(self, text: str):
        super().__init__()
        self.loaded: list[str] = []
        self.headings: list[str] = []
        self.open: list[str] = []
        self.cells: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        self.loaded += [
            value for name, value in attrs if name in ("src", "href", "srcset", "data", "action") and value
        ]
        assert tag not in ("link", "iframe", "object", "embed", "base", "img")

    def handle_data(self, data):
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)
        if self.open and self.open[-1] in ("td", "p", "li"):
            self.cells.append(data)

    def handle_endtag(self, tag):
        if tag in self.open:
            while self.open.pop() != tag:
                pass


def occluded(duration_s: float = 20.0) -> tuple[Recording, Recovery]:
    recording = make_recording(duration_s)
    t = recording.arm.t_s
    recording = replace(
        recording,
        arm=recording.arm.hide((t > 5) & (t < 7)),
        camera_frame=CameraFrame.KINECT,
        notes=("A & <b>",),
    )
    return recording, make_recovery(recording, error_m=0.005, sigma_m=0.005)


def written(path, recovery, **options) -> tuple[Page, str]:
    write_report(recovery, path, **options)
    text = path.read_text(encoding="utf-8")
    return Page(text), text


def own_part(text: str) -> str:
    """The page without plotly's own code."""
    return re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)


def test_whole_page(tmp_path):
    recording, recovery = occluded()
    found = validate(recovery, recording.truth)
    page, text = written(
        tmp_path / "r.html", recovery, recording=recording, validation=found, truth=recording.truth
    )
    assert [url for url in page.loaded if not url.startswith("#")] == []
    assert "http" not in own_part(text).lower().replace("http-equiv", "")
    assert page.headings == [
        "Joint angles",
        "The arm in motion",
        "For the next recording",
        "Gaps",
        "Errors against the reference",
        "Error over time",
        "Errors in the layout of table I",
        "The path, flat",
        "Coordinates over time",
        "How certain the answer is",
        "Camera residuals",
        "Whether sigma is consistent with the errors",
        "Rejected camera samples",
        "Sensor mounting on the arm",
        "Figures",
        "Notes",
        "Settings",
    ]
    assert text.count('class="plot"') >= 6
    words = " ".join(page.cells)
    assert "The camera lost the forearm once, for 2." in words
    assert "camera.joint_sigma_m" in words
    assert "A & <b>" in words  # shown, not obeyed
    assert "The path was made by hand." in words
    assert "x (left), m" in text
    assert len(text) < 6e6


def test_name_is_escaped(tmp_path):
    _, recovery = occluded()
    _, text = written(tmp_path / "r.html", replace(recovery, name="</title><script>alert(1)</script>"))
    assert "<script>alert" not in text


def test_an_hour_still_opens(tmp_path):
    recording = make_recording(3600.0)
    t = recording.arm.t_s
    recording = replace(recording, arm=recording.arm.hide(t % 10 < 1.5))
    _, text = written(
        tmp_path / "r.html", make_recovery(recording), recording=recording, truth=recording.truth
    )
    assert len(text) < 15e6
    assert "The recording is long" in text


@pytest.mark.parametrize(
    "what", ["no gap", "no covariance", "no joints", "no answer", "open", "bare", "one", "none"]
)
def test_odd_results(tmp_path, what):
    _, recovery = occluded()
    count = len(recovery)
    nan = np.full((count, 3), np.nan)
    recovery = {
        "no gap": lambda: replace(recovery, gaps=(), occluded=np.zeros(count, bool)),
        "no covariance": lambda: replace(
            recovery, pose_covariance=np.full((count, 6, 6), np.nan), joint_covariance={}
        ),
        "no joints": lambda: replace(recovery, joints={}, joint_covariance={}),
        "no answer": lambda: replace(
            recovery,
            position=nan,
            quaternion=np.full((count, 4), np.nan),
            joints={"wrist": nan, "elbow": nan},
        ),
        "open": lambda: replace(
            recovery, gaps=(Gap(0.0, 3.0, open_start=True), Gap(18.0, 20.0, open_end=True))
        ),
        "bare": lambda: replace(
            recovery,
            residuals=None,
            calibration=None,
            config={},
            notes=(),
            gravity_direction=np.full(3, np.nan),
            clock_offset_s=float("nan"),
            clock_offset_sigma_s=float("nan"),
            estimates=Estimates(
                further={"bias": np.arange(3.0), "worst": np.float64(2.5), "deep": {"a": [1, None]}}
            ),
        ),
        "one": lambda: cut(recovery, 1),
        "none": lambda: cut(recovery, 0),
    }[what]()
    page, text = written(tmp_path / "r.html", recovery)
    assert [url for url in page.loaded if not url.startswith("#")] == []
    assert "Gaps" in page.headings
    assert "NaN ms" not in text
    if what == "open":
        assert "one side only" in text
    if what == "none":
        assert "has no sample" in text


def cut(recovery: Recovery, count: int) -> Recovery:
    return replace(
        recovery,
        t_s=recovery.t_s[:count],
        occluded=recovery.occluded[:count],
        position=recovery.position[:count],
        quaternion=recovery.quaternion[:count],
        velocity=recovery.velocity[:count],
        pose_covariance=recovery.pose_covariance[:count],
        velocity_covariance=recovery.velocity_covariance[:count],
        joints={name: value[:count] for name, value in recovery.joints.items()},
        joint_covariance={name: value[:count] for name, value in recovery.joint_covariance.items()},
        gaps=(),
    )


def test_an_uncertain_gap_is_named(tmp_path):
    recording, _ = occluded()
    recovery = make_recovery(recording, sigma_m=0.08)
    page, _ = written(tmp_path / "r.html", recovery)
    assert any("the gap at 5.0 s with care" in text for text in page.cells)


def test_dishonest_sigma_is_said(tmp_path):
    recording, _ = occluded()
    recovery = make_recovery(recording, error_m=0.03, sigma_m=0.01)
    found = validate(recovery, make_truth(np.arange(0, 20, 0.01)))
    page, _ = written(tmp_path / "r.html", recovery, validation=found)
    words = " ".join(page.cells)
    assert (
        "about 3.0 times as large as the stated" in words
        or "about 2.9 times" in words
        or "3.1 times" in words
    )
    assert not any("95 of 100 cases" in text for text in summary(recovery, found))


def test_existing_page_needs_force(tmp_path):
    _, recovery = occluded()
    path = tmp_path / "r.html"
    path.write_text("mine")
    with pytest.raises(UnoccludeError, match="--force"):
        write_report(recovery, path)
    assert path.read_text() == "mine"
    write_report(recovery, path, force=True)
    assert path.stat().st_size > 1e6
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]
