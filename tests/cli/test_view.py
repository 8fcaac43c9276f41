"""`unocclude view`: what is run, where it listens, and whom it speaks to."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from commands import done
from results import made

from smoother.cli import export as viewer
from smoother.errors import UnoccludeError
from smoother.io import write_recovery


@pytest.fixture
def result(tmp_path) -> Path:
    write_recovery(made("right"), tmp_path / "out.mcap")
    return tmp_path / "out.mcap"


@pytest.fixture
def needs_rerun():
    pytest.importorskip("rerun", reason="rerun-sdk, the extra `view`, is not installed")


def test_the_viewer_binds_to_the_loopback_address(needs_rerun):
    arguments = viewer.window(Path("a.rrd"))
    assert arguments[arguments.index("--bind") + 1] == "127.0.0.1"
    assert Path(arguments[0]).is_file()
    assert arguments[-1] == "a.rrd"


def test_the_viewer_speaks_to_nobody_else(monkeypatch):
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    monkeypatch.setenv("https_proxy", "http://proxy.example:3128")
    monkeypatch.delenv("CI", raising=False)
    variables = viewer.environment()
    assert variables["CI"] == "true"
    assert "FORCE_RERUN_ANALYTICS" not in variables
    ways_out = {value for name, value in variables.items() if name.lower() in ("https_proxy", "all_proxy")}
    assert ways_out == {"http://127.0.0.1:9"}
    assert variables["NO_PROXY"] == "127.0.0.1,localhost"
    assert variables["PATH"] == os.environ["PATH"]


def test_a_file_is_shown_and_goes(needs_rerun, result, monkeypatch):
    shown = []

    def show(arguments):
        file = Path(arguments[-1])
        shown.append((file, file.stat().st_size))

    monkeypatch.setattr(viewer, "show_window", show)
    done("view", result)
    ((file, size),) = shown
    assert file.name == "out.rrd"
    assert size > 10_000
    assert not file.exists()


def test_a_viewer_that_fails_says_why():
    with pytest.raises(UnoccludeError, match="no display here"):
        viewer.show_window([sys.executable, "-c", "print('no display here'); raise SystemExit(3)"])
    viewer.show_window([sys.executable, "-c", "print('all is well')"])
