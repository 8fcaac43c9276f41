"""The tool that kills commands, in its fast form: four seeded moments of one `smooth` with two workers."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from tools.kills import COMMAND, QUICK, Case, hidden, try_case

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
