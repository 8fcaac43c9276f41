"""What a page tells of samples that were set aside, and of an answer that the camera contradicts."""

from __future__ import annotations

from dataclasses import replace

from arms import make_recording, make_recovery

from smoother.measurements.visibility import Reason
from smoother.recording import JOINTS
from smoother.report import write_report
from smoother.report.summary import summary
from smoother.report.traces import residuals
from smoother.result import Estimates


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
    drawn = residuals(recovery)
    assert drawn is not None
    (crosses,) = (trace for trace in drawn.data if trace.name == "rejected")
    assert len(crosses.x) == 60 and "&lt;it&gt; stands" in crosses.text[0]
    write_report(recovery, tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "<td>&lt;it&gt; stands</td><td>wrist</td><td>60</td>" in text
    assert "<td>camera&#39;s wrist</td>" in text
    assert f"<td>too uncertain</td><td>{len(recovery)}</td>" in text
    assert "samples repeated the one before" in text  # the advice
    assert "too near to tell on which side" in text  # hand-made lever arms lie in a line
    assert "disagree more than stated" not in text


def test_an_answer_that_the_camera_contradicts_is_doubted():
    recovery = replace(make_recovery(make_recording()), estimates=Estimates(camera_sigma_m={"wrist": 0.003}))
    text = " ".join(summary(recovery, None))
    assert "Result and camera disagree more than stated: of the wrist samples" in text
    assert "95 of 100 cases" not in text
