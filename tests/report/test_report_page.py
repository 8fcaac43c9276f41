"""The page: self-contained, whole, there for odd results, compared, drawn and exported."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from arms import LEVERS, make_recording, make_recovery, make_truth, path, turn
from commands import done
from measured_arms import simulated, with_draws

from smoother.errors import UnoccludeError
from smoother.evaluation.validate import validate
from smoother.io import read_recovery, write_recovery
from smoother.measurements.visibility import Gap
from smoother.measures import measure
from smoother.recording import CameraFrame, Recording
from smoother.report import write_report
from smoother.report.summary import summary
from smoother.report.traces import uncertainty
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
        "The arm in motion",
        "Joint angles",
        "For the next recording",
        "Gaps",
        "Errors against the reference",
        "Error gap by gap",
        "Coordinates over time",
        "How certain the answer is",
        "Camera residuals",
        "Whether sigma is consistent with the errors",
        "Rejected camera samples",
        *("Values", "Lever arms", "Lengths", "Clock offsets", "Frames"),
        "What the recording did not determine",
        "Figures",
        "Notes",
        "Settings",
    ]
    assert text.count('class="plot"') >= 4
    words = " ".join(page.cells)
    assert "did not see the forearm: 1, 2." in words
    assert "camera.joint_sigma_m" in words
    assert "A & <b>" in words  # shown, not obeyed
    assert "The path was made by hand." in words
    assert "x (left), m" in text
    assert len(text) < 6e6


#: Of a result that states nothing of itself.
BARE = dict.fromkeys(("residuals", "calibration")) | dict.fromkeys(
    ("clock_offset_s", "clock_offset_sigma_s"), np.nan
)
BARE |= {"config": {}, "notes": (), "gravity_direction": np.full(3, np.nan)}
BARE["estimates"] = Estimates(
    further={"bias": np.arange(3.0), "worst": np.float64(2.5), "deep": {"a": [1, None]}}
)


@pytest.mark.slow
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
        "bare": lambda: replace(recovery, **BARE),
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
    return replace(recovery.rows(slice(count)), gaps=())


def test_an_uncertain_gap_is_named(tmp_path):
    recording, _ = occluded()
    recovery = make_recovery(recording, sigma_m=0.08)
    page, _ = written(tmp_path / "r.html", recovery)
    assert "take with care" in page.cells


def test_dishonest_sigma_is_said(tmp_path):
    recording, _ = occluded()
    recovery = make_recovery(recording, error_m=0.03, sigma_m=0.01)
    found = validate(recovery, make_truth(np.arange(0, 20, 0.01)))
    page, _ = written(tmp_path / "r.html", recovery, validation=found)
    words = " ".join(page.cells)
    assert re.search(r"about (2\.9|3\.0|3\.1) times as large as the stated", words)
    assert not any("95 of 100 cases" in text for text in summary(recovery, found))


@pytest.fixture(scope="module")
def pair():
    """A recovery with a gap and R_F_A, and a truth with joints."""
    recording = make_recording()
    hidden = (recording.arm.t_s > 8) & (recording.arm.t_s < 9.5)
    recovery = make_recovery(replace(recording, arm=recording.arm.hide(hidden)), error_m=0.004)
    recovery = replace(recovery, calibration=replace(recovery.calibration, R_F_A=np.eye(3)))
    t = np.arange(0, 20, 0.01)
    joints = {name: path(t) + turn(t).apply(lever) for name, lever in LEVERS.items()}
    joints["shoulder"] = np.tile([0.0, 0.3, 2.1], (len(t), 1))
    return recovery, replace(make_truth(t), joints=joints)


def test_what_is_drawn_are_the_errors(pair):
    recovery, truth = pair
    figure = uncertainty(recovery, truth)
    assert figure is not None
    drawn = {trace.name: np.asarray(trace.y, float) for trace in figure.data if trace.yaxis == "y"}
    error = 100 * np.linalg.norm(recovery.position - path(recovery.t_s), axis=1)
    np.testing.assert_allclose(drawn["error against the reference"], error, atol=0.01)
    assert "wrist, error" in drawn and len(figure.layout.shapes) == 1


@pytest.fixture(scope="module")
def recovery() -> Recovery:
    return simulated(0, protocol="random", duration_s=8.0, occlusion_lengths_s=(0.8,))


def test_a_figure_has_curves_bands_and_shaded_gaps(recovery: Recovery, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    figure = recovery.plot(["elbow_flexion", "wrist"], width_cm=8.5)
    flexion, wrist = figure.axes
    assert figure.get_size_inches()[0] == pytest.approx(8.5 / 2.54)
    assert flexion.get_ylabel() == "elbow flexion, deg" and len(wrist.lines) == 3
    drawn = flexion.lines[0].get_ydata()
    np.testing.assert_allclose(drawn, recovery.angles().values["elbow_flexion"], atol=1e-9)
    starts = np.flatnonzero(np.diff(recovery.occluded.astype(int), prepend=0) == 1)
    assert len(flexion.patches) == len(starts) > 0
    figure.savefig(tmp_path / "figure.pdf")
    assert (tmp_path / "figure.pdf").stat().st_size > 5000
    part = recovery.plot(["wrist"], from_s=2.0, to_s=4.0)
    assert part.axes[0].get_xlim() == pytest.approx((2.0, 4.0), abs=0.02)


def test_what_cannot_be_drawn_says_why(recovery: Recovery) -> None:
    pytest.importorskip("matplotlib")
    with pytest.raises(UnoccludeError, match="nose cannot be drawn: the recovery has elbow_flexion"):
        recovery.plot(["nose"])
    with pytest.raises(UnoccludeError, match="no sample to draw between 100"):
        recovery.plot(from_s=100.0)


def test_an_export_is_that_of_the_command(recovery: Recovery, tmp_path: Path) -> None:
    write_recovery(recovery, tmp_path / "a.mcap")
    [read] = read_recovery(tmp_path / "a.mcap")
    done("export", tmp_path / "a.mcap", "--format", "csv", "-o", tmp_path / "b.csv")
    read.export(tmp_path / "c.csv")
    assert (tmp_path / "c.csv").read_text() == (tmp_path / "b.csv").read_text()
    with pytest.raises(UnoccludeError, match="exists"):
        read.export(tmp_path / "c.csv")


def test_an_ending_that_is_no_format_lists_those_that_are(recovery: Recovery, tmp_path: Path) -> None:
    with pytest.raises(UnoccludeError, match=r"its ending names no format; endings: \.mcap, \.csv"):
        recovery.export(tmp_path / "a.docx")


def test_measures_as_a_dataframe(recovery: Recovery) -> None:
    pandas = pytest.importorskip("pandas")
    found = measure(with_draws(recovery, count=20))
    frame = found.to_dataframe()
    assert isinstance(frame, pandas.DataFrame) and list(frame.columns) == found.to_table().column_names
    row = frame[(frame["key"] == "elbow_flexion_range_deg") & (frame["scope"] == "session")].iloc[0]
    assert row["value"] == found.by_key["elbow_flexion_range_deg"].value
