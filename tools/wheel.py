"""Build the wheel so that the same commit gives the same bytes anywhere: `python -m tools.wheel -o dist`.

Tracked files only, copied with fixed modes, built without a network by the locked setuptools, with the
commit's time as SOURCE_DATE_EPOCH. `--check` builds twice, in other folders and under another umask.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
_BUILD = "import sys; from setuptools import build_meta; print(build_meta.build_wheel(sys.argv[1]))"
#: What a wheel is made of.
_PARTS = ("smoother", "calib", "pyproject.toml", "README.md", "LICENSE")


def tracked_files(root: Path = ROOT) -> list[str]:
    """The files of the working tree that git knows, and that a wheel is made of."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--", *_PARTS], cwd=root, check=True, capture_output=True, text=True
    )
    return sorted(name for name in listed.stdout.split("\0") if name)


def commit_time(root: Path = ROOT) -> str:
    """When the last commit was made, in seconds since 1970."""
    shown = subprocess.run(
        ["git", "log", "-1", "--format=%ct"], cwd=root, check=True, capture_output=True, text=True
    )
    return shown.stdout.strip()


def build(folder: Path, root: Path = ROOT) -> Path:
    """Build the wheel into a folder.

    Parameters
    ----------
    folder : Path
        Where the wheel goes.
    root : Path
        The working tree.

    Returns
    -------
    wheel : Path
    """
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        tree = Path(name) / "tree"
        for file in tracked_files(root):
            copy = tree / file
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / file, copy)
            copy.chmod(0o644)
        environment = {
            **os.environ,
            "SOURCE_DATE_EPOCH": commit_time(root),
            "PYTHONHASHSEED": "0",
            "TZ": "UTC",
        }
        built = subprocess.run(
            [sys.executable, "-c", _BUILD, folder.resolve()],
            umask=0o022,
            cwd=tree,
            env=environment,
            check=True,
            capture_output=True,
            text=True,
        )
    return folder / built.stdout.strip().splitlines()[-1]


def sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def main() -> None:
    """Build, or compare two builds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=ROOT / "dist")
    parser.add_argument("--check", action="store_true", help="build twice and compare")
    options = parser.parse_args()
    wheel = build(options.output)
    print(f"{sha256(wheel)}  {wheel}")
    if options.check:
        with tempfile.TemporaryDirectory() as name:
            os.umask(0o077)
            again = build(Path(name) / "another folder")
            print(f"{sha256(again)}  the second build")
            sys.exit(0 if sha256(again) == sha256(wheel) else "the two builds differ")


if __name__ == "__main__":
    main()
