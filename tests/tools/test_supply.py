"""The list of packages agrees with the lock, and two builds of the wheel are the same bytes."""

from __future__ import annotations

import json
import os
import re
import zipfile
from pathlib import Path

import pytest

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
