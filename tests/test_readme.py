"""The README and the documents do what they say."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib import read_calibration
from smoother.io.plain.folder import _Description
from smoother.io.result.write import write_recovery
from smoother.result import Draws, Recovery

ROOT = Path(__file__).parents[1]


def blocks(path: str, language: str) -> list[str]:
    """Code blocks of a document."""
    text = (ROOT / path).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def test_the_first_two_commands():
    lines = [line for block in blocks("README.md", "sh") for line in block.splitlines() if line.strip()]
    assert lines[:2] == ["make demo", "make test"]


def test_the_readme_is_one_screen():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 90
    assert "CITATION.cff" in text and "What this is not" in text


def test_notebook_in_six_lines(monkeypatch):
    (code,) = blocks("docs/api.md", "python")
    statements = [line for line in code.splitlines() if line.strip()]
    assert len(statements) <= 6
    monkeypatch.chdir(ROOT)
    names: dict = {}
    exec(compile(code, "docs/api.md", "exec"), names)
    assert isinstance(names["recovery"], Recovery)
    assert len(names["hidden_wrist"]) > 100
    assert np.isfinite(names["hidden_wrist"]).all()
    assert 0 < names["largest_sigma"] < 0.1


def test_examples_of_files(tmp_path):
    description, calibration = blocks("docs/formats.md", "toml")
    assert _Description.model_validate(tomllib.loads(description)).camera.frame == "kinect"
    (tmp_path / "cal.toml").write_text(calibration, encoding="utf-8")
    arm = read_calibration(tmp_path / "cal.toml").arm("right")
    assert arm.upper_arm is not None and arm.R_F_A is not None and "elbow" in arm.lever_arms


def test_topics_and_columns(tmp_path, monkeypatch):
    from mcap.reader import make_reader

    from smoother import read_recording, smooth
    from smoother.config import Config
    from smoother.io.export.csv import csv_columns
    from smoother.result.segment_motion import SegmentMotion, TrunkMotion

    text = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    recording = read_recording(ROOT / "data" / "demo.mcap")
    recovery = smooth(recording, None, Config.model_validate({"windows": {"processes": 1}}))
    own = (recovery.position, recovery.quaternion, recovery.pose_covariance)
    # as if with IMUs on the upper arm, the hand and the trunk
    trunk = TrunkMotion(recovery.quaternion, recovery.pose_covariance[:, 3:, 3:], np.eye(3), np.zeros(3))
    recovery = replace(
        recovery, segments=dict.fromkeys(("upper_arm", "hand"), SegmentMotion(*own, np.zeros(3))), trunk=trunk
    )
    still = np.zeros((20, 2, 3), np.float32)
    ends = recovery.t_s[[0, -1]]
    draws = Draws(ends, 0, still, still, dict.fromkeys(recovery.joints, still), {"upper_arm": still})
    write_recovery(replace(recovery, draws=draws), tmp_path / "out.mcap")
    with open(tmp_path / "out.mcap", "rb") as file:
        channels = make_reader(file).get_summary().channels.values()
    assert {channel.topic for channel in channels} == set(re.findall(r"`(/unocclude/\w+)`", text))
    families = {re.sub(r"_?(q[wxyz]|[xyz])$", "", name) for name in csv_columns(recovery)[0]}
    families.discard("v")
    for family in families:
        assert f"`{family}" in text, family


def test_version_is_the_same_everywhere():
    from smoother import __version__

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert project["dynamic"] == ["version"]  # of smoother/__init__.py, and nowhere else
    assert f"version: {__version__}\n" in citation
    assert project["authors"][0]["name"] in citation


def test_every_dependency_is_explained():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    page = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8").lower()
    for dependency in project["dependencies"]:
        name = re.match(r"[a-z0-9-]+", dependency.lower())[0].removesuffix("-cpu")
        assert {"opencv-python-headless": "opencv"}.get(name, name) in page, name
