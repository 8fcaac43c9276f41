"""What commands print and which figures they write: each file of `outputs/` is a session, in order.

Numbers are shown as #, so that wording and structure are compared alone. After a change, write the files
again and review the diff: `UNOCCLUDE_WRITE_MESSAGES=1 python -m pytest tests/cli/test_printed.py`.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from smoother.cli import output
from smoother.cli.run import run

SESSIONS = sorted((Path(__file__).parent / "outputs").glob("*.txt"))
DATA = Path(__file__).parents[2] / "data"


def keys(value: Any, path: str = "", depth: int = 0) -> Iterator[str]:
    """The keys of some figures and of what is in them; of lists and large tables those of the first."""
    if isinstance(value, list) and value:
        yield from keys(value[0], f"{path}[]", depth)
    elif isinstance(value, dict) and value and depth < 2:
        for key in sorted(value)[: 1 if depth and len(value) > 40 else None]:
            yield from keys(value[key], f"{path}.{key}".lstrip("."), depth + 1)
    else:
        yield path


def without_numbers(text: str) -> str:
    """A text whose numbers are #, and whose tables have no widths."""
    text = re.sub(r"[+-]?\d+(\.\d+)?(e-?\d+)?", "#", text)
    text = re.sub(r"#(,#)+", "#", re.sub(r" +", " ", re.sub(r"[━─]+", "─", text)))
    return "\n".join(line.rstrip() for line in text.splitlines()).strip()


@pytest.mark.slow
@pytest.mark.parametrize("session", SESSIONS, ids=lambda file: file.stem)
def test_what_a_session_prints(session: Path, tmp_path: Path, monkeypatch: Any, capsys: Any):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        output, "console", lambda: Console(width=400)
    )  # a cell on a line, whatever its numbers
    shutil.copy(DATA / "demo.mcap", "rec.mcap")
    shutil.copy(DATA / "demo_calibration.toml", "cal.toml")
    content = Path("rec.mcap").read_bytes()
    Path("damaged.mcap").write_bytes(content[: int(0.85 * len(content))])
    written = session.read_text(encoding="utf-8")
    answers = []
    for line in (line for line in written.splitlines() if line.startswith("$ ")):
        words = shlex.split(line)[2:]
        code = run([*words, *(["--json", "figures.json"] if "--json" not in words else [])])
        said, errors = (text.replace(str(tmp_path), "HERE") for text in capsys.readouterr())
        parts = [f"{line}\n[{code}]", without_numbers(said), without_numbers(errors)]
        if Path("figures.json").exists():
            parts.append("json: " + " ".join(keys(json.loads(Path("figures.json").read_text()))))
            Path("figures.json").unlink()
        answers.append("\n".join(filter(None, parts)) + "\n")
    if os.environ.get("UNOCCLUDE_WRITE_MESSAGES"):
        session.write_text("\n".join(answers), encoding="utf-8")
        return
    assert "\n".join(answers) == written
