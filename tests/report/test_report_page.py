"""Pages: self-contained, there for odd results, what they say and play, red where nothing is trusted."""

from __future__ import annotations

import json
import math
import re
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from arms import LEVERS, make_joint_truth, make_recording, make_recovery, make_truth, path, turn, write_page
from commands import done
from made_measures import made_measure, made_measures, person
from measured_arms import simulated, with_draws
from plotly.offline import get_plotlyjs
from results import made

from smoother.angles import JOINT_ANGLES
from smoother.errors import UnoccludeError
from smoother.evaluation.methods import METHODS
from smoother.evaluation.progress import PersonProgress
from smoother.evaluation.validate import validate
from smoother.evaluation.words import measure_words
from smoother.io import read_recovery, write_recovery
from smoother.measurements.visibility import Gap
from smoother.measures import BothArms, measure
from smoother.measures.definitions import MEASURED_ANGLES, definitions
from smoother.recording import CameraFrame, JointState, Recording
from smoother.report import write_report
from smoother.report.pages import curves, measures_page, progress_page
from smoother.report.player import MOST_BYTES, packed, played_arm, player, upwards, view_of
from smoother.report.sheet import PLOTLY, Html, data_block
from smoother.report.summary import summary
from smoother.report.traces import UNTRUSTED, coordinates, decimate, uncertainty
from smoother.result import Estimates, Pairing, Recovery, SelfCheck, UntrustedInterval


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
    write_page(recovery, path, **options)
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
        "Gaps",
        "Errors against the reference",
        "Coordinates over time",
        "How certain the answer is",
        "Rejected camera samples",
        *("Values", "Lever arms", "Lengths", "Clock offsets", "Frames"),
        "What the recording did not determine",
        "Notes",
        "Settings",
    ]
    assert text.count('class="plot"') == 3
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
    return recovery, make_joint_truth(np.arange(0, 20, 0.01))


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


@pytest.fixture(scope="module")
def hidden() -> Recovery:
    recording = make_recording()
    hidden = (recording.arm.t_s > 8) & (recording.arm.t_s < 9.5)
    return make_recovery(replace(recording, arm=recording.arm.hide(hidden)), error_m=0.004, sigma_m=0.004)


def joints_only(off_m: float = 0.0):
    """A reference without the sensor: markers at the joints alone."""
    truth = make_joint_truth(np.arange(0, 20, 0.01))
    joints = {name: truth.joints[name] + off_m for name in LEVERS}
    nothing = np.full_like(truth.position, np.nan)
    return replace(truth, position=nothing, quaternion=np.full_like(truth.quaternion, np.nan), joints=joints)


def test_joints_alone_are_compared_in_the_headline_and_leave_no_table_of_dashes(hidden, tmp_path):
    truth = joints_only()
    found = validate(hidden, truth)
    said = " ".join(summary(hidden, found))
    each = r"0\.\d cm at the \w+ \(95 % below \d\.\d cm\)"
    assert re.search(f"the error in the gaps is, root mean square, {each}, {each} and {each}", said)
    assert "no position to compare" not in said
    write_page(hidden, tmp_path / "r.html", validation=found, truth=truth)
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    rows = re.findall(r"<tr><td>[^<]*</td>(?:<td>–</td>)+</tr>", text)
    assert rows == []
    assert "The reference has joints only." in text


def test_errors_of_joints_beyond_their_sigma_are_said(hidden):
    said = summary(hidden, validate(hidden, joints_only(off_m=0.03)))
    assert any("times as large as the stated uncertainty allows" in text for text in said)
    assert not any("In 95 of 100 cases" in text for text in said)


def test_an_answer_that_the_camera_contradicts_is_doubted():
    recovery = replace(make_recovery(make_recording()), estimates=Estimates(camera_sigma_m={"wrist": 0.003}))
    text = " ".join(summary(recovery, None))
    assert "Result and camera disagree more than stated: of the wrist samples" in text
    assert "95 of 100 cases" not in text


def test_time_without_any_answer_outside_the_gaps_is_said(hidden):
    assert "without a result: 0.0 s" in summary(hidden, None)[0]
    away = (hidden.t_s > 12.0) & (hidden.t_s < 15.0)
    position = np.where(away[:, None], np.nan, hidden.position)
    (said,) = [text for text in summary(replace(hidden, position=position), None) if "lasts" in text]
    assert re.search(r": 1, 1\.\d s in all, .* without a result: [23]\.\d s\.$", said)


def test_the_bundle_is_of_the_locked_plotly():
    version = re.search(r"plotly\.js v([\d.]+)", get_plotlyjs()[:200])
    bundle = resources.files("smoother.report").joinpath("web", PLOTLY).read_text(encoding="utf-8")
    assert version is not None
    assert f"(basic - minified) v{version.group(1)}" in bundle[:200], (
        f"Plotly was updated: run `npm pack plotly.js-basic-dist-min@{version.group(1)}` and put"
        f" plotly-basic.min.js into smoother/report/web, its LICENSE beside it as plotly-basic.license.txt"
    )


def test_an_angle_has_one_name():
    for angle in JOINT_ANGLES:
        if angle.name in MEASURED_ANGLES:
            assert definitions()[f"{angle.name}_range_deg"].name == f"{angle.title}, range"
    assert definitions()["shoulder_plane_range_deg"].name == "plane of shoulder elevation, range"


RANGE = made_measure("elbow_flexion_range_deg", 62.0, 2.0)


def test_the_unit_stands_once_and_the_interval_only_where_there_is_one() -> None:
    text = measure_words(RANGE)
    assert text == "62.0° (58.1 to 65.9°)"
    alone = measure_words(replace(RANGE, low=math.nan, high=math.nan))
    assert alone == "62.0°"
    speed = replace(RANGE, unit="m/s", value=0.812, low=0.75, high=0.87)
    side = measure_words(made_measure("hand_path_length_m_symmetry_percent", 4.0, 3.0))
    assert side == "+4.0 (−1.9 to +9.9)\u00a0%", "positive: the right one has more"
    assert measure_words(speed).count("m/s") == 1 and " to " in measure_words(speed)


def test_long_lines_keep_ends_and_gaps():
    important = np.zeros(300_000, bool)
    important[1000:1200] = True
    important[200_000:200_400] = True
    index = decimate(important, 6000)
    assert len(index) <= 6000
    assert index[0] == 0
    assert index[-1] == 299_999
    assert set(np.flatnonzero(important)) <= set(index)
    assert (np.diff(index) > 0).all()


BODY = UntrustedInterval(9.0, 12.0, ("another <person's> joints",))
CHECK = SelfCheck(8, 1, 1.7, 0.011, 0.010, 0.96, 1.4, 1.1)
CAUSE = "the skeleton seems mirrored (x); run again with --mirror x"
SOUND = Estimates(trusted=True, self_check=CHECK, pairing=Pairing(True, 1e-4, 120.0))
PARTLY = replace(SOUND, cautions=("gap 2 is not to be trusted",), untrusted=(BODY,))
WRONG = Estimates(
    trusted=False,
    reasons=(CAUSE, "gravity is 80 degrees off"),
    cause=CAUSE,
    remedies=("--mirror x",),
    self_check=replace(CHECK, rms_m=0.21),
    pairing=Pairing(False, 0.2, 12.0),
)


def page(folder: Path, estimates: Estimates) -> str:
    recovery = replace(made(), estimates=estimates)
    write_page(recovery, folder / "page.html", recording=make_recording(), force=True)
    text = (folder / "page.html").read_text(encoding="utf-8")
    return re.sub(r"<script>.*?</script>|<style>.*?</style>", "", text, flags=re.DOTALL)


def first_sentences(text: str) -> list[str]:
    block = re.search(r'<div class="summary[^"]*">(.*?)</div>', text, re.DOTALL)
    assert block is not None
    return re.findall('<p(?: class="large")?>(.*?)</p>', block[1])


def test_a_sound_page_is_calm_and_has_the_self_check(tmp_path: Path) -> None:
    text = page(tmp_path, SOUND)
    assert '<div class="summary good">' in text
    assert first_sentences(text) == ["✓ Usable", CHECK.sentence], "one figure of the error"
    assert text.index("The arm in motion") < text.index("The recording lasts"), "all else is below"
    assert "not to be trusted" not in text
    assert "How certain the answer is" in text


def test_an_untrusted_page_is_red_and_withdraws_its_figures(tmp_path: Path) -> None:
    text = page(tmp_path, WRONG)
    assert '<div class="summary alarm">' in text
    said = first_sentences(text)
    assert said[0] == "✕ Not to be trusted" and said[1].lower() == f"{CAUSE}.".lower()
    assert "not shown" in said[-1] and not any(" cm" in each for each in said)
    below = text[text.index("The arm in motion") :]
    assert "<p>Evidence: gravity is 80 degrees off.</p>" in below
    assert WRONG.self_check is not None and f"<p>{WRONG.self_check.sentence}</p>" in below
    assert "How certain the answer is" not in text
    assert "is known to about" not in text and "standard deviations, the shaded band" not in text
    rows = re.findall("<tr>(.*?)</tr>", text[text.index(">Gaps</h2>") :], re.DOTALL)[1:3]
    assert all(row.count("<td>–</td>") == 3 and "not to be trusted" in row for row in rows)
    for word in ("even light", "sleeves", "20 s of lively motion"):
        assert word not in text


def test_a_partly_untrusted_page_names_the_gap(tmp_path: Path) -> None:
    text = page(tmp_path, PARTLY)
    assert '<div class="summary care">' in text
    said = first_sentences(text)
    assert said[0] == "! Usable with care"
    named = next(each for each in said if each.startswith("Not to be trusted, and red on this page: gap 2 ("))
    assert "another &lt;person&#39;s&gt; joints" in named
    assert "<p>In the other gaps the sensor" in text
    first, second = re.findall("<tr>(.*?)</tr>", text[text.index(">Gaps</h2>") :], re.DOTALL)[1:3]
    assert "not to be trusted" not in first and "<td>–</td>" not in first
    assert "not to be trusted</span>" in second and "another &lt;person&#39;s&gt; joints" in second
    assert second.count("<td>–</td>") == 3
    assert "How certain the answer is" in text and "No changes recommended" not in text


def red(figure) -> list[np.ndarray]:
    return [np.array(trace.x)[np.isfinite(trace.y)] for trace in figure.data if trace.line.color == UNTRUSTED]


def test_curves_are_red_there_and_have_no_band() -> None:
    recovery = replace(made(), estimates=PARTLY)
    figure = coordinates(recovery, None, None)
    assert red(figure)
    for x in red(figure):
        assert x.min() + 0.1 >= 9.0 and x.max() <= 12.0 + 0.1
    for trace in figure.data:
        if trace.fill == "toself":
            x = np.array(trace.x, float)
            assert not ((x > 9.05) & (x < 11.95)).any()
    assert len(figure.layout.shapes) == 2, "gaps, and what is not to be trusted"
    whole = replace(recovery, estimates=WRONG)
    lines = [t.name for t in coordinates(whole, None, None).data if t.mode == "lines" and t.name]
    assert set(lines) == {"not to be trusted"}
    assert not red(coordinates(replace(recovery, estimates=SOUND), None, None))
    assert uncertainty(replace(recovery, estimates=WRONG), None) is None


def test_the_player_is_told() -> None:
    sound, partly, wrong = (
        played_arm(replace(made(), estimates=each), None, MOST_BYTES) for each in (SOUND, PARTLY, WRONG)
    )
    assert sound["untrusted"] == [] and partly["untrusted"] == [[9.0, 12.0]]
    assert wrong["untrusted"] == [[wrong["start"], pytest.approx(19.9875)]]
    assert "sigma" in partly and "sigma" not in wrong
    assert json.dumps(wrong)


def test_several_arms_begin_with_the_one_that_is_wrong(tmp_path: Path) -> None:
    arms = [replace(made(side), estimates=each) for side, each in (("left", SOUND), ("right", WRONG))]
    write_report([(None, arm, None, None) for arm in arms], tmp_path / "arms.html")
    text = (tmp_path / "arms.html").read_text(encoding="utf-8")
    assert '<div class="summary alarm">' in text
    assert first_sentences(text)[0].startswith("✕ Right arm: not to be trusted")
    assert '<span class="word wrong">' in text


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
def played():
    recording = make_recording(12.0)
    hidden = (recording.arm.t_s > 5) & (recording.arm.t_s < 7)
    recording = replace(recording, arm=recording.arm.hide(hidden), camera_frame=CameraFrame.KINECT)
    return recording, make_recovery(recording, sigma_m=0.02)


def test_the_arm_is_where_the_recovery_has_it(played):
    recording, recovery = played
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


def test_the_cameras_skeleton_is_gone_in_the_gap_and_a_guess_is_marked(played):
    _, recovery = played
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


BADGES = re.compile(r'<span class="word [a-z]+">(?:\S )?([^<]+)</span>')


def words_of(page: Path) -> list[str]:
    return BADGES.findall(page.read_text(encoding="utf-8"))


def test_words_of_progress_need_an_interval(tmp_path: Path):
    progress_page(person()).write(tmp_path / "a.html")
    words = words_of(tmp_path / "a.html")
    assert words[0] == "clearly more" and words.count("no clear change") > 5
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "not a diagnosis" in text and "day 14" in text
    assert "by chance alone; clear after correction for that (Holm): elbow flexion, range" in text
    progress_page(person(draws=False)).write(tmp_path / "b.html")
    assert set(words_of(tmp_path / "b.html")) == {"cannot be assessed"}
    assert "without drawn motions" in (tmp_path / "b.html").read_text(encoding="utf-8")


def test_one_session_and_none(tmp_path: Path):
    progress_page(person(1)).write(tmp_path / "one.html")
    text = (tmp_path / "one.html").read_text(encoding="utf-8")
    assert words_of(tmp_path / "one.html") == [] and "one session only" in text
    nothing = PersonProgress("p", (), (), (), ("session 1: the result is not to be trusted",))
    progress_page(nothing).write(tmp_path / "none.html")
    text = (tmp_path / "none.html").read_text(encoding="utf-8")
    assert "No session can be used" in text and "not to be trusted" in text


def test_arms_are_compared_only_where_both_are_to_be_trusted(tmp_path: Path):
    left, right = made_measures("left", change={"elbow_flexion_range_deg": -20.0}), made_measures("right")
    measures_page([left, right]).write(tmp_path / "both.html")
    assert "right against left" not in (tmp_path / "both.html").read_text(encoding="utf-8")
    both = BothArms(left, right, (made_measure("elbow_flexion_range_deg_symmetry_percent", 22.7, 3.0),))
    measures_page([left, right], [both]).write(tmp_path / "indices.html")
    text = (tmp_path / "indices.html").read_text(encoding="utf-8")
    assert text.count("+22.7 (+16.8 to +28.6)\u00a0%") == 1 and "right against left, in percent" in text
    bad = replace(left, trusted=False, verdict="A strap slipped.")
    measures_page([bad, right], [replace(both, left=bad)]).write(tmp_path / "bad.html")
    text = (tmp_path / "bad.html").read_text(encoding="utf-8")
    assert "A strap slipped. Do not use these numbers." in text and "22.7" not in text


def test_what_was_reached_needs_draws_that_agree(tmp_path: Path):
    measures_page([made_measures()]).write(tmp_path / "a.html")
    assert words_of(tmp_path / "a.html") == ["reached", "not reached", "not reached"]
    measures_page([made_measures(draws=False)]).write(tmp_path / "b.html")
    assert words_of(tmp_path / "b.html") == ["cannot be assessed"] * 3
    assert "smooth --draws 64" in (tmp_path / "b.html").read_text(encoding="utf-8")
    unsure = made_measures()
    which, parts = "hand_to_mouth_reached", {"low": 0.0, "high": 1.0, "sigma": 0.4}
    rows = tuple(replace(row, **parts) if row.key == which else row for row in unsure.rows)
    measures_page([replace(unsure, rows=rows)]).write(tmp_path / "c.html")
    assert words_of(tmp_path / "c.html")[0] == "cannot be assessed"


def test_each_method_has_a_line_of_its_own():
    spread = {"median_m": 0.02, "low_m": 0.01, "high_m": 0.03}
    lines = [trace.line for trace in curves({1.0: dict.fromkeys(METHODS, spread)}).data]
    assert len({(line.color, line.dash) for line in lines}) == len(METHODS) == len(lines)


def test_nothing_known_is_said(tmp_path: Path):
    nothing = made_measures(movements=0)
    unknown = dict.fromkeys(("value", "low", "high"), np.nan) | {"note": "The hand is not known."}
    rows = tuple(replace(row, **unknown) for row in nothing.rows)
    measures_page([replace(nothing, rows=rows)]).write(tmp_path / "a.html")
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "Nothing could be measured" in text and "The hand is not known." in text
    arms = [replace(nothing, side=side, rows=rows) for side in ("left", "right")]
    measures_page(arms).write(tmp_path / "both.html")
    text = (tmp_path / "both.html").read_text(encoding="utf-8")
    assert text.count("eft arm, not measured: ") == text.count("ight arm, not measured: ") == 1
    measures_page([]).write(tmp_path / "b.html")
    with pytest.raises(UnoccludeError, match="force=True"):
        measures_page([]).write(tmp_path / "b.html")
