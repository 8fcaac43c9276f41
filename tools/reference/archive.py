"""The reference on disk: a zip with hashes by case and part, and the texts themselves, each once."""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
import zipfile
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

from tools.reference.masks import PROJECT
from tools.reference.running import Records

_LIBRARIES = ("numpy", "scipy", "gtsam", "plotly", "pyarrow", "mcap", "rich", "typer")


def sha256(text: str) -> str:
    """Of the masked text."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def made_on() -> dict[str, str]:
    """What the bytes may depend on besides the code, and the code's state."""
    words = ["git", "-C", str(PROJECT), "describe", "--always", "--dirty"]
    commit = subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()
    about = {"commit": commit, "Python": platform.python_version(), "machine": platform.machine()}
    return about | {"system": platform.system()} | {name: version(name) for name in _LIBRARIES}


@dataclass
class Reference:
    """Hashes of every case's parts, and their texts.

    Attributes
    ----------
    hashes : dict
        By case, by part.
    texts : dict
        By hash.
    made_on : dict
        Versions and the commit.
    """

    hashes: dict[str, dict[str, str]] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    made_on: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, records: Records) -> Reference:
        """Of what was run just now."""
        reference = cls(made_on=made_on())
        for case, parts in records.items():
            reference.hashes[case] = {part: sha256(text) for part, text in parts.items()}
            reference.texts |= {sha256(text): text for text in parts.values()}
        return reference

    def write(self, path: Path) -> None:
        """Write it, through a file beside it."""
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.with_name(f".{path.name}.tmp")
        about = {"made_on": self.made_on, "cases": self.hashes}
        with zipfile.ZipFile(beside, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("reference.json", json.dumps(about, indent=1, ensure_ascii=False))
            for name, text in sorted(self.texts.items()):
                archive.writestr(f"texts/{name}.txt", text.encode("utf-8", "surrogatepass"))
        beside.replace(path)

    @classmethod
    def read(cls, path: Path) -> Reference:
        """Read what `write` wrote."""
        with zipfile.ZipFile(path) as archive:
            about = json.loads(archive.read("reference.json"))
            texts = {
                Path(name).stem: archive.read(name).decode("utf-8", "surrogatepass")
                for name in archive.namelist()
                if name.startswith("texts/")
            }
        return cls(about["cases"], texts, about["made_on"])
