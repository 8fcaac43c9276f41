"""Kill a command at seeded moments, and look at what it leaves: `python -m tools.faults.kills`.

Every case runs the command on a simulated recording of some minutes, sends a signal to it (or kills one of
its workers) at a random moment, and checks: no process of it is alive after 2 s, the recording is as it was,
every output that is there is whole (in half of the cases there were earlier ones), a tidy end leaves no
temporary file and says one line, the next command works and leaves nothing hidden either. The next command
is the same in one case of `--again-every`, else (not for a study) one that only writes a file beside the
outputs. `--log FILE` notes what came of it, and `--write PAGE` puts what several logs contain into a page.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from tools.faults import write_table

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
#: A signal ends it within this, s.
ENDS_S = 60.0
KINDS = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT", "worker")
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
    """A number of moments of every kind."""
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
    """Whether a process runs; one that has ended but was not waited for does not."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False
    return stat.rsplit(")", 1)[1].split()[0] not in "ZX"


def of_session(leader: int) -> list[int]:
    """Processes that run in the session of a command, whoever started them."""
    members = []
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, ValueError, IndexError):
            fields = (place / "stat").read_text().rsplit(")", 1)[1].split()
            if fields[0] not in "ZX" and int(fields[3]) == leader:
                members.append(int(place.name))
    return members


def hidden(folder: Path) -> list[str]:
    """Temporary files in a folder, at any depth."""
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*.tmp*"))


def broken(folder: Path) -> list[str]:
    """Outputs of a folder that are there under their names and not whole."""
    wrong = []
    for path in sorted(folder.rglob("*.*")):
        if not path.is_file() or "tmp" in path.suffix or ".unocclude" in path.relative_to(folder).parts:
            continue
        data = path.read_bytes()
        is_whole = {
            ".mcap": data[:8] == data[-8:] == b"\x89MCAP0\r\n",
            ".parquet": len(data) > 8 and data[:4] == data[-4:] == b"PAR1",
            ".html": data.rstrip().endswith(b"</html>"),
            ".json": data.rstrip().endswith(b"}"),
        }.get(path.suffix, True)
        wrong += [] if is_whole else [str(path.relative_to(folder))]
    return wrong


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
        Of the command; its outputs are in `folder`.
    folder : Path
        Empty at the start.
    again : sequence of str, optional
        Arguments of a short command behind it, run in this process; None = the same command anew.
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
        with suppress(subprocess.TimeoutExpired):
            program.wait(ENDS_S)
        until = time.monotonic() + GONE_S
        while time.monotonic() < until and of_session(program.pid):
            time.sleep(0.05)
        if alive := of_session(program.pid):
            names = [_command_line(each)[-80:].replace(b"\0", b" ") for each in alive]
            wrong.append(f"{len(alive)} processes live on: {names}")
            for each in alive:
                with suppress(ProcessLookupError):
                    os.kill(each, signal.SIGKILL)
        _, said = program.communicate(timeout=60)
        if not ended_before and case.what in TIDY:
            if said.count("\n") > 1 or "Traceback" in said:
                wrong.append(f"said more than a line: {said[-300:]!r}")
            if left := hidden(folder):
                wrong.append(f"left {left}")
    if torn := broken(folder):
        wrong.append(f"not whole: {torn}")
    if not ended_before or case.what == "worker":
        code, said = _again(again, [*command, *arguments])
        if code != 0:
            wrong.append(f"the command behind it fails: {said[-300:]!r}")
    if left := hidden(folder):
        wrong.append(f"after the next run there is still {left}")
    if torn := broken(folder):
        wrong.append(f"after the next run not whole: {torn}")
    return wrong


def _again(short: Sequence[str] | None, whole: Sequence[str]) -> tuple[int, str]:
    """Exit code of the command that comes next, and what it said."""
    if short is None:
        after = subprocess.run(whole, capture_output=True, text=True, timeout=900, check=False)
        return after.returncode, after.stderr
    from smoother.cli.run import run

    with redirect_stdout(StringIO()), redirect_stderr(StringIO()) as said:
        code = run(list(short))
    return code, said.getvalue()


def _command_line(process: int) -> bytes:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


def words_of(command: str, recordings: list[Path], processes: int = 2) -> list[str]:
    """Words of a command on recordings; OUT is the folder of its outputs."""
    first = str(recordings[0])
    few = ["--gaps-per-run", "2", "--lengths", "1"]
    return {
        "smooth": ["smooth", first, "-o", "OUT/r.mcap", "--report", "OUT/r.html", "--force"],
        "gaps": ["gaps", first, *few, "--json", "OUT/g.json", "--report", "OUT/g.html", "--force"],
        "compare": ["compare", first, "--json", "OUT/c.json", "--report", "OUT/c.html", "--force"],
        "batch": ["batch", str(recordings[0].parent), "-o", "OUT/study"],
    }[command] + ["--processes", str(processes)]


def table(logs: Sequence[Path]) -> str:
    """What logs contain, as Markdown: one row per command."""
    rows = [json.loads(line) for log in logs for line in log.read_text(encoding="utf-8").splitlines()]
    kinds = [kind for kind in KINDS if any(row["what"] == kind for row in rows)]
    lines = [
        f"| command | {' | '.join(kinds)} | something lost or left |",
        "|---" * (len(kinds) + 2) + "|",
    ]
    for command in dict.fromkeys(row["command"] for row in rows):
        mine = [row for row in rows if row["command"] == command]
        counts = [str(sum(row["what"] == kind for row in mine)) for kind in kinds]
        lines.append(f"| `{command}` | {' | '.join(counts)} | {sum(bool(row['wrong']) for row in mine)} |")
    return "\n".join(lines)


def main() -> None:
    """Try all cases and print what went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=3.0, help="length of the recording")
    parser.add_argument("--quick", action="store_true", help="10 s of recording, with processes all the same")
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--command", choices=("smooth", "gaps", "compare", "batch"), default="smooth")
    parser.add_argument(
        "--again-every", type=int, default=1, help="run the same command again in one of this many"
    )
    parser.add_argument("--processes", type=int, default=2, help="workers of the command")
    parser.add_argument("--until", type=float, default=1e9, help="no kill later than this, s")
    parser.add_argument("--log", type=Path, action="append", default=[], help="note each case here")
    parser.add_argument("--write", type=Path, help="only put what the logs hold into this page")
    options = parser.parse_args()
    if options.write:
        write_table(options.write, table(options.log), "tools.faults.kills")
        return
    command = QUICK if options.quick else COMMAND
    minutes = 1 / 6 if options.quick else options.minutes
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        (work / "in").mkdir()
        recordings = [work / "in" / f"{k}.mcap" for k in range(3 if options.command == "batch" else 1)]
        for seed, recording in enumerate(recordings):
            simulate = ["simulate", "arm", "--duration-s", f"{60 * minutes:g}", "--protocol", "random"]
            simulate += ["--seed", str(seed), "-o", str(recording)]
            subprocess.run([*COMMAND, *simulate], check=True, stdout=subprocess.DEVNULL)
        contents = [recording.read_bytes() for recording in recordings]
        arguments = words_of(options.command, recordings, options.processes)

        def into(folder: Path) -> list[str]:
            return [argument.replace("OUT", str(folder)) for argument in arguments]

        (work / "whole").mkdir()
        began = time.monotonic()
        subprocess.run([*command, *into(work / "whole")], check=True, stdout=subprocess.DEVNULL)
        longest_s = min(time.monotonic() - began, options.until)
        print(f"{options.command}: {longest_s:.1f} s without a kill")
        failed = count = 0
        for case in cases(options.moments, longest_s, options.seed, options.kinds.split(",")):
            with tempfile.TemporaryDirectory(dir=work) as place:
                folder = Path(place)
                if count % 2 and options.command != "batch":  # a study that is done has nothing to kill
                    shutil.copytree(work / "whole", folder, dirs_exist_ok=True)
                aside = ["config", "--json", f"{folder}/after.json", "--force"]
                turn = count // len(options.kinds.split(","))  # each kind is run again once in this many
                is_same = options.command == "batch" or (count + turn) % options.again_every == 0
                again = None if is_same else aside
                wrong = try_case(case, into(folder), folder, again, command)
                if [recording.read_bytes() for recording in recordings] != contents:
                    wrong.append("the recording is another one")
            count += 1
            failed += bool(wrong)
            print(f"{case.what:8} at {case.after_s:6.2f} s: {'; '.join(wrong) or 'ok'}", flush=True)
            row = {"command": options.command, "what": case.what, "after_s": case.after_s, "wrong": wrong}
            for log in options.log:
                with log.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(row) + "\n")
        print(f"{count} cases, {failed} wrong")
        sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
