"""Kill a command at seeded moments, and look at what it leaves: `python -m tools.kills`.

Every case runs the command on a simulated recording of some minutes, sends a signal to it (or kills one of
its workers) at a random moment, and checks: no process of it is alive after 2 s, a tidy end leaves no
temporary file and says one line, the same command then works and leaves nothing hidden either.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

#: Runs the command as the installed script does.
COMMAND = (sys.executable, "-c", "from smoother.cli import main; main()")
#: The same with worker processes for short recordings too.
QUICK = (
    sys.executable,
    "-c",
    "import smoother.runtime.pool as pool; pool.WORTH_FRAMES = 10; from smoother.cli import main; main()",
)
#: Processes of a killed command are gone after this, s.
GONE_S = 2.0
TIDY = ("SIGTERM", "SIGHUP", "SIGINT")


@dataclass(frozen=True)
class Case:
    """What happens to a command, and when.

    Attributes
    ----------
    what : str
        SIGKILL, SIGTERM, SIGHUP, SIGINT, or "worker": one of its processes is killed.
    after_s : float, s
        Since its start.
    """

    what: str
    after_s: float


def cases(moments: int, longest_s: float, seed: int, kinds: Sequence[str]) -> Iterator[Case]:
    """So many moments of every kind."""
    chance = random.Random(seed)
    for _ in range(moments):
        for kind in kinds:
            yield Case(kind, chance.uniform(0.05, longest_s))


def children(process: int) -> list[int]:
    """All processes below one, by /proc."""
    below: list[int] = []
    for task in Path(f"/proc/{process}/task").glob("*/children"):
        try:
            mine = [int(word) for word in task.read_text().split()]
        except OSError:
            continue
        below += [each for child in mine for each in (child, *children(child))]
    return below


def is_alive(process: int) -> bool:
    """Whether a process runs; one that has ended and that nobody has asked about does not."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return stat.rsplit(")", 1)[1].split()[0] not in "ZX"


def hidden(folder: Path) -> list[str]:
    """Temporary files in a folder, at any depth."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*.tmp*"))


def try_case(
    case: Case,
    arguments: Sequence[str],
    folder: Path,
    again: Sequence[str] | None = None,
    command: Sequence[str] = COMMAND,
) -> list[str]:
    """What went wrong in a case.

    Parameters
    ----------
    case : Case
    arguments : sequence of str
        Of the command; its outputs lie in `folder`.
    folder : Path
        Empty at the start.
    again : sequence of str, optional
        Arguments of the run behind it; None = the same.
    command : sequence of str
        How to run the command.

    Returns
    -------
    wrong : list of str
        Sentences; none where all is well.
    """
    program = subprocess.Popen(
        [*command, *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    with suppress(subprocess.TimeoutExpired):
        program.wait(case.after_s)
    ended_before = program.poll() is not None
    below = children(program.pid)
    wrong: list[str] = []
    if case.what == "worker":
        workers = [each for each in below if b"spawn_main" in _command_line(each)]
        if workers:
            os.kill(workers[-1], signal.SIGKILL)
        _, said = program.communicate(timeout=600)
        if program.returncode != 0 or "unexpected" in said or "Traceback" in said:
            wrong.append(f"a killed worker: exit {program.returncode}, {said[-300:]!r}")
    else:
        number = getattr(signal, case.what)
        if not ended_before:
            # a terminal sends Ctrl-C and its own end to the whole group
            (os.killpg if case.what in ("SIGINT", "SIGHUP") else os.kill)(program.pid, number)
        _, said = program.communicate(timeout=60)
        time.sleep(GONE_S)
        alive = [each for each in below if is_alive(each)]
        if alive:
            wrong.append(f"{len(alive)} processes live on")
            for each in alive:
                os.kill(each, signal.SIGKILL)
        if not ended_before and case.what in TIDY:
            if said.count("\n") > 1 or "Traceback" in said:
                wrong.append(f"said more than a line: {said[-300:]!r}")
            if left := hidden(folder):
                wrong.append(f"left {left}")
    if not ended_before or case.what == "worker":
        after = subprocess.run(
            [*command, *(again or arguments)], capture_output=True, text=True, timeout=900, check=False
        )
        if after.returncode != 0:
            wrong.append(f"the command behind it fails: {after.stderr[-300:]!r}")
    if left := hidden(folder):
        wrong.append(f"after the next run there is still {left}")
    return wrong


def _command_line(process: int) -> bytes:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


def main() -> None:
    """Try all cases and print what went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=3.0, help="length of the recording")
    parser.add_argument("--quick", action="store_true", help="20 s of recording, with processes all the same")
    parser.add_argument("--kinds", default="SIGKILL,SIGTERM,SIGHUP,SIGINT,worker")
    parser.add_argument("--command", choices=("smooth", "gaps", "batch"), default="smooth")
    options = parser.parse_args()
    command = QUICK if options.quick else COMMAND
    minutes = 1 / 3 if options.quick else options.minutes
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        (work / "in").mkdir()
        recording = work / "in" / "rec.mcap"
        simulate = ["simulate", "arm", "--duration-s", f"{60 * minutes:g}", "--protocol", "random"]
        subprocess.run([*COMMAND, *simulate, "-o", recording], check=True, stdout=subprocess.DEVNULL)
        arguments = {
            "smooth": ["smooth", str(recording), "-o", "OUT/r.mcap", "--report", "OUT/r.html", "--force"],
            "gaps": ["gaps", str(recording), "--lengths", "1", "--gaps-per-run", "2", "--json", "OUT/g.json"],
            "batch": ["batch", str(work / "in"), "-o", "OUT/study"],
        }[options.command]
        arguments += ["--processes", "2"] + (["--force"] if options.command == "gaps" else [])

        def into(folder: Path) -> list[str]:
            return [argument.replace("OUT", str(folder)) for argument in arguments]

        (work / "whole").mkdir()
        began = time.monotonic()
        subprocess.run([*command, *into(work / "whole")], check=True, stdout=subprocess.DEVNULL)
        longest_s = time.monotonic() - began
        print(f"{options.command}: {longest_s:.1f} s without a kill")
        failed = count = 0
        for case in cases(options.moments, longest_s, options.seed, options.kinds.split(",")):
            count += 1
            with tempfile.TemporaryDirectory(dir=work) as place:
                wrong = try_case(case, into(Path(place)), Path(place), command=command)
            failed += bool(wrong)
            print(f"{case.what:8} at {case.after_s:6.2f} s: {'; '.join(wrong) or 'ok'}", flush=True)
        print(f"{count} cases, {failed} wrong")
        sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
