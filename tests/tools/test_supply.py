"""The list of packages agrees with the lock, and two builds of the wheel are the same bytes."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

import smoother
from smoother.runtime.packages import LEFT_OUT
from tools.sbom import locked, sbom
from tools.wheel import build, sha256

ROOT = Path(__file__).parents[2]


LOCK = (ROOT / "requirements.lock").read_text(encoding="utf-8")


def test_every_locked_package_is_listed():
    packages = locked(LOCK)
    assert len(packages) == len(re.findall(r"^\S+==", LOCK, re.MULTILINE))
    assert sum(len(package.hashes) for package in packages) == LOCK.count("--hash=sha256:")
    assert all(package.hashes for package in packages)
    listed = sbom(packages, "1.2.3")
    names = {entry["name"] for entry in listed["components"]}
    assert {"gtsam", "numpy", "protobuf", "open3d"} <= names
    references = [entry["bom-ref"] for entry in listed["components"]]
    assert len(set(references)) == len(references), "each is there once"
    assert all(re.fullmatch(r"pkg:pypi/[a-z0-9-]+@[^@/ ]+", each) for each in references)
    assert listed["bomFormat"] == "CycloneDX" and listed["specVersion"] == "1.5"
    assert json.dumps(listed) == json.dumps(sbom(locked(LOCK), "1.2.3")), "the same lock, the same bytes"


def test_a_line_that_is_not_understood():
    with pytest.raises(ValueError, match="not understood"):
        locked("gtsam @ https://example.com/gtsam.whl\n")


def required() -> dict[str, str]:
    """What pyproject.toml requires: package to version."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    split = [re.match(r"([\w-]+)([^;]*)", each) for each in project["dependencies"]]
    return {each[1]: each[2].strip() for each in split if each}


def test_the_packages_that_the_program_is_named_for_are_required():
    assert {"gtsam", "numpy", "open3d", "opencv-python-headless", "mcap"} <= required().keys()


def test_the_light_list_is_what_is_required_without_what_it_leaves_out():
    lines = (ROOT / ".ci" / "light.txt").read_text(encoding="utf-8").splitlines()
    light = {line for line in lines if line and not line.startswith("#")}
    left_out = {*LEFT_OUT.values(), "open3d", "open3d-cpu"}
    assert left_out <= required().keys()
    assert light == {name + version for name, version in required().items() if name not in left_out}


def test_the_conda_recipe_requires_the_same():
    text = (ROOT / ".ci" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    run = text.split("  run:\n")[1].split("\n\n")[0]
    found = dict(re.findall(r"^    - ([\w-]+) ([^ #\n]+)", run, re.MULTILINE))
    named = {"opencv-python-headless": "py-opencv", "libusb-package": "libusb", "open3d-cpu": "open3d"}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    expected = {named.get(name, name): version for name, version in required().items()}
    assert found.pop("python").startswith(project["requires-python"]) and found == expected
    assert f'version: "{smoother.__version__}"' in text
    assert f"{project['name']} = {project['scripts']['unocclude']}" in text


def without_packages(*arguments: str) -> subprocess.CompletedProcess[str]:
    """A command where no package is there that a light installation leaves out."""
    code = f"import sys; sys.modules.update(dict.fromkeys({list(LEFT_OUT)}))"
    code += "; from smoother.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=240
    )


def test_a_light_installation_recovers_and_makes_pages(tmp_path: Path):
    recording, result, page = ROOT / "data" / "demo.mcap", tmp_path / "out.mcap", tmp_path / "page.html"
    options = ["--draws", "0", "--processes", "1", "--report", str(page)]
    done = without_packages("smooth", str(recording), "-o", str(result), *options)
    assert done.returncode == 0 and result.exists() and page.exists(), done.stderr
    study = without_packages("batch", str(recording.parent), "-o", str(tmp_path / "study"))
    assert study.returncode == 1 and "Traceback" not in study.stderr
    assert "this needs dask, which is not installed; get it with `pip install dask`" in study.stderr


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="lists tracked files by git")
def test_two_builds_are_the_same_bytes(tmp_path: Path):
    first = build(tmp_path / "a")
    umask = os.umask(0o077)
    try:
        second = build(tmp_path / "another place")
    finally:
        os.umask(umask)
    assert sha256(first) == sha256(second)
    with zipfile.ZipFile(first) as wheel:
        names = wheel.namelist()
    assert {"smoother/cli/app.py", "calib/file.py"} <= set(names)
    assert not any(name.startswith(("tests/", "tools/", "data/")) for name in names)
