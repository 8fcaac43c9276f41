"""References on disk, and two side by side: which parts of which cases differ, and their first lines."""

from __future__ import annotations

import difflib
import hashlib
import json
import platform
import subprocess
import zipfile
from collections import Counter
from dataclasses import dataclass, field
from importlib.metadata import version
from itertools import islice
from pathlib import Path

from tools.reference.renderings import PROJECT
from tools.reference.running import Records

STATES = ("same", "differs", "new", "missing")
#: This many lines from the first difference on are looked at for a diff; difflib is slow on long texts.
_WINDOW = 300
#: A line of a diff is cut at this many characters.
_WIDTH = 160


@dataclass(frozen=True)
class Finding:
    """One part of a case."""

    case: str  # Such as `demo: smooth ..`, and `stdout` or a file's name
    part: str  # Such as `demo: smooth ..`, and `stdout` or a file's name
    state: str  # One of `STATES`

    @property
    def group(self) -> str:
        """The case's group."""
        return self.case.partition(":")[0]


def findings(old: Reference, new: Reference, only: str = "") -> list[Finding]:
    """Every part of every case that is in one of both."""
    found = []
    for case in dict.fromkeys([*old.hashes, *new.hashes]):
        if only not in case:
            continue
        before, after = old.hashes.get(case, {}), new.hashes.get(case, {})
        for part in dict.fromkeys([*before, *after]):
            if part not in after:
                state = "missing"
            elif part not in before:
                state = "new"
            else:
                state = "same" if before[part] == after[part] else "differs"
            found.append(Finding(case, part, state))
    return found


def table(found: list[Finding]) -> str:
    """Parts by group and state, in columns."""
    counts: dict[str, Counter[str]] = {}
    for finding in found:
        counts.setdefault(finding.group, Counter())[finding.state] += 1
    width = max((len(name) for name in counts), default=0)
    lines = [f"{'':{width}}" + "".join(f"{state:>9}" for state in STATES)]
    total: Counter[str] = Counter()
    for name, states in counts.items():
        total += states
        lines.append(f"{name:{width}}" + "".join(f"{states[state]:9}" for state in STATES))
    lines.append(f"{'all':{width}}" + "".join(f"{total[state]:9}" for state in STATES))
    return "\n".join(lines)


def first_difference(before: str, after: str, most: int) -> list[str]:
    """A unified diff from the first line that differs on."""
    old, new = before.split("\n"), after.split("\n")
    start = next(
        (k for k, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), min(len(old), len(new))
    )
    start = max(start - 2, 0)
    diff = difflib.unified_diff(
        old[start : start + _WINDOW], new[start : start + _WINDOW], "reference", "now", n=2, lineterm=""
    )
    lines = [_cut(line) for line in islice(diff, 3, 3 + most)]
    return [f"line {start + 1} of {len(old)} (now {len(new)}):", *lines]


def _cut(line: str) -> str:
    return line if len(line) <= _WIDTH else f"{line[:_WIDTH]} .. ({len(line)} characters)"


def differences(
    found: list[Finding], old: Reference, new: Reference, most_parts: int, most_lines: int
) -> str:
    """Every part that is not the same, the first ones with a diff."""
    lines = []
    other = [finding for finding in found if finding.state != "same"]
    for number, finding in enumerate(other):
        lines.append(f"{finding.state}: {finding.case} | {finding.part}")
        if number < most_parts and finding.state == "differs":
            before = old.texts[old.hashes[finding.case][finding.part]]
            after = new.texts[new.hashes[finding.case][finding.part]]
            lines += [f"    {line}" for line in first_difference(before, after, most_lines)]
    return "\n".join(lines)


def other_versions(old: Reference, new: Reference) -> str:
    """What else may be why bytes differ: other libraries, another machine; empty where nothing is."""
    keys = dict.fromkeys([*old.made_on, *new.made_on])
    other = [
        f"{key} {old.made_on.get(key)} (now {new.made_on.get(key)})"
        for key in keys
        if key != "commit" and old.made_on.get(key) != new.made_on.get(key)
    ]
    return f"made with {', '.join(other)}: bytes may differ for that alone" if other else ""


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
    """Hashes of every case's parts, and their texts."""

    hashes: dict[str, dict[str, str]] = field(default_factory=dict)  # By case, by part
    texts: dict[str, str] = field(default_factory=dict)  # By hash
    made_on: dict[str, str] = field(default_factory=dict)  # Versions and the commit

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
