"""The tool that kills commands, in its fast form: four seeded moments of one `smooth` with two workers."""

from __future__ import annotations

import json
import random
import subprocess
from pathlib import Path

import pytest

from tools.faults.kills import COMMAND, QUICK, Case, broken, hidden, table, try_case

pytestmark = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="reads /proc")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("killed") / "rec.mcap"
    simulate = ["simulate", "arm", "--protocol", "random", "--duration-s", "12", "-o", str(path)]
    subprocess.run([*COMMAND, *simulate], check=True, stdout=subprocess.DEVNULL, timeout=120)
    return path


@pytest.mark.parametrize("number", range(4))
def test_a_kill_leaves_nothing(recording: Path, tmp_path: Path, number: int):
    chance = random.Random(number)
    case = Case(("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT")[number], chance.uniform(0.5, 4.0))
    arguments = ["smooth", str(recording), "-o", f"{tmp_path}/r.mcap", "--processes", "2", "--force"]
    # what comes behind it in the same folder tidies up; it need not compute anything
    again = ["config", "--json", f"{tmp_path}/c.json", "--force"]
    assert try_case(case, arguments, tmp_path, again, QUICK) == []


def test_what_is_left_is_seen(tmp_path: Path):
    (tmp_path / ".r.mcap.0123.unocclude.tmp").touch()
    assert hidden(tmp_path)


def test_an_output_that_is_not_whole_is_seen(tmp_path: Path):
    magic = b"\x89MCAP0\r\n"
    (tmp_path / "a.mcap").write_bytes(magic + b"..." + magic)
    (tmp_path / "b.mcap").write_bytes(magic + b"...")
    (tmp_path / "a.json").write_text('{"a": 1}\n')
    (tmp_path / "b.json").write_text('{"a": ')
    (tmp_path / "a.html").write_text("<html></html>\n")
    (tmp_path / "b.html").write_text("<html><p>")
    assert broken(tmp_path) == ["b.html", "b.json", "b.mcap"]


def test_the_table_counts_all_logs(tmp_path: Path):
    rows = [("smooth", "SIGINT", []), ("smooth", "SIGKILL", ["left"]), ("batch", "SIGINT", [])]
    for number, (command, what, wrong) in enumerate(rows):
        row = {"command": command, "what": what, "after_s": 1.0, "wrong": wrong}
        (tmp_path / f"{number}.jsonl").write_text(json.dumps(row) + "\n")
    lines = table(sorted(tmp_path.glob("*.jsonl"))).splitlines()
    assert lines[0] == "| command | SIGKILL | SIGINT | something lost or left |"
    assert lines[2:] == ["| `smooth` | 1 | 1 | 1 |", "| `batch` | 0 | 1 | 0 |"]
