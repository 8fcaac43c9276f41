"""`import smoother`: what a wheel holds, which names there are, and files given to `smooth`."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scenes import ALONE, moving

import smoother
from smoother.calibration import ArmCalibration, Length
from smoother.errors import UnoccludeError

ROOT = Path(__file__).parents[1]


def python(code: str, **more: object) -> str:
    """What a program in a process of its own prints."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, **more)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this tree, unpacked."""
    source, built = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("built")
    for folder in ("smoother", "calib"):
        shutil.copytree(ROOT / folder, source / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    python(f"from setuptools.build_meta import build_wheel; build_wheel({str(built)!r})", cwd=source)
    (file,) = built.glob("unocclude-*.whl")
    zipfile.ZipFile(file).extractall(built / "site")
    return built / "site"


def test_a_wheel_holds_every_module_once(wheel: Path) -> None:
    inside = {path.relative_to(wheel).as_posix() for path in wheel.rglob("*.py")}
    tree = {
        p.relative_to(ROOT).as_posix() for part in ("smoother", "calib") for p in (ROOT / part).rglob("*.py")
    }
    assert inside == tree
    assert {path.name for path in wheel.iterdir() if path.suffix != ".dist-info"} == {"smoother", "calib"}
    assert (wheel / "smoother" / "py.typed").exists()
    assert (wheel / "smoother" / "report" / "web" / "page.html").exists()


def test_the_wheel_is_imported_light(wheel: Path, tmp_path: Path) -> None:
    code = (
        "import sys, smoother\n"
        f"assert smoother.__file__.startswith({str(wheel)!r}), smoother.__file__\n"
        "assert not {'numpy', 'gtsam', 'mcap'} & set(sys.modules)\n"
        "print(smoother.__version__, smoother.Recovery.__name__)\n"
    )
    printed = python(code, cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(wheel)})
    assert printed.split() == [smoother.__version__, "Recovery"]


def test_every_public_name_is_there() -> None:
    assert set(smoother.__all__) <= set(dir(smoother))
    for name in smoother.__all__:
        getattr(smoother, name)
    with pytest.raises(AttributeError, match="module 'smoother' has no attribute 'smoth'"):
        smoother.smoth  # noqa: B018


ARM = """format = "unocclude calibration"
version = 1
[arm.right]
upper_arm_m = 0.31
upper_arm_sigma_m = 0.003
"""


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of six seconds as a file, a calibration file beside it."""
    path = tmp_path_factory.mktemp("session") / "session.mcap"
    smoother.write_recording(moving(3, "white", 6.0).recording, path)
    path.with_name("arm.toml").write_text(ARM, encoding="utf-8")
    return path


@pytest.fixture
def handed_on(monkeypatch: pytest.MonkeyPatch) -> list[tuple]:
    """What reaches the method itself."""
    calls: list[tuple] = []
    monkeypatch.setattr("smoother.smoothing.smooth", lambda *given: calls.append(given))
    return calls


def test_files_are_read_and_handed_on_and_recordings_go_as_they_are(
    session: Path, handed_on: list[tuple]
) -> None:
    for given in (str(session), session):
        smoother.smooth(given, config=ALONE, processes=1, draws=64, seed=3)
        (recording, calibration, config, progress, processes, clock, *drawing) = handed_on.pop()
        assert drawing == [64, 3]
        np.testing.assert_array_equal(recording.imu.acc, smoother.read_recording(session).imu.acc)
        assert (calibration, config, processes) == (None, ALONE, 1) and progress is clock is None
    smoother.smooth(recording)
    assert handed_on.pop()[0] is recording
    smoother.smooth(session, session.with_name("arm.toml"))
    smoother.smooth(session, ArmCalibration(side="right", upper_arm=Length(0.29, 0.01)))
    assert [calibration.upper_arm.value_m for _, calibration, *_ in handed_on] == [0.31, 0.29]


def test_what_a_person_gets_wrong_is_one_sentence(session: Path) -> None:
    recording, arm = smoother.read_recording(session), session.with_name("arm.toml")
    for given, more, sentence in (
        ([session.with_name("none.mcap")], {}, r"none\.mcap"),
        ([recording], {"side": "left"}, r"side: smooth\(\) chooses among a file's streams"),
        ([recording, arm], {}, r"arm\.toml: a calibration file belongs to the recording's file"),
        ([session], {"side": "left"}, "left"),
    ):
        with pytest.raises(UnoccludeError, match=sentence):
            smoother.smooth(*given, **more)
