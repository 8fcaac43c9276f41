"""What commands make of damaged and hostile files: `python -m tools.faults --write tools/faults/matrix.md`.

Each case is a file with one fault, drawn from a seed, on which the real command runs in a process of its
own with a guard for time and memory. What it ends in is one of these: right (the answer of the sound file),
partly right with a note, one clear sentence, SILENT (less, or something else, and not a word), UNEXPECTED
(a traceback, an "unexpected error", a signal, or more time or memory than the guard allows). `--every 20`
runs one case in twenty, which is what the tests do; `--log FILE` notes each outcome, and cases that the file
already holds are not run again.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from smoother.cli.run import run
from smoother.errors import UnoccludeError
from smoother.io import read_recovery
from tools.faults import write_table
from tools.faults.cases import Case, Workshop, all_cases

ENDS = ("right", "note", "sentence", "SILENT", "UNEXPECTED")
#: A case may take this long, s of the processor and (on a busy machine) in all, and this much memory, bytes.
MOST_CPU_S, MOST_S, MOST_MEMORY = 40, 300, 3 << 30
#: An answer is another one where it is off by more than this, m, and by this many of its own sigmas.
OFF_M, OFF_SIGMAS = 0.02, 4.0


@dataclass(frozen=True)
class Outcome:
    """What a case ended in.

    Attributes
    ----------
    case : Case
        The fault.
    end : str
        One of `ENDS`.
    text : str
        The sentence, the first new note, or what was unexpected.
    seconds : float, s
        How long the command took.
    """

    case: Case
    end: str
    text: str
    seconds: float = 0.0

    def to_line(self) -> str:
        """A line of the log."""
        words = {"case": key_of(self.case), "end": self.end, "text": self.text, "seconds": self.seconds}
        return json.dumps(words) + "\n"


def key_of(case: Case) -> str:
    """The same for the same case in every run with a seed."""
    return f"{case.family} | {case.fault} | {case.name} | {case.base}"


@dataclass(frozen=True)
class Answer:
    """What a command left: its exit code, what it printed, its figures and files.

    Attributes
    ----------
    code : int
        Of the process; negative for a signal.
    out, err : str
        What it printed.
    figures : dict
        Its JSON; empty where there is none.
    folder : Path
        Where its outputs lie.
    """

    code: int
    out: str
    err: str
    figures: dict
    folder: Path

    @property
    def notes(self) -> set[str]:
        """Lines on something to look at, and the notes among the figures."""
        lines = {
            line for line in self.out.splitlines() if line.startswith(("note:", "cannot be", "not ready"))
        }
        files = [note for file in self.figures.get("files", []) for note in file["notes"]]
        return lines | {str(note) for note in [*self.figures.get("notes", []), *files]}


def run_case(case: Case, folder: Path) -> Answer:
    """Run a case's command in a child with a guard."""
    arguments = [*case.arguments(folder), "--json", str(folder / "figures.json"), "--force"]
    child = os.fork()
    if child == 0:
        code = 70
        try:
            signal.alarm(MOST_S)
            cpu_s = case.cpu_s or MOST_CPU_S
            resource.setrlimit(resource.RLIMIT_CPU, (cpu_s, cpu_s + 2))
            pages = int(Path("/proc/self/statm").read_text().split()[0])
            most = pages * resource.getpagesize() + MOST_MEMORY
            resource.setrlimit(resource.RLIMIT_AS, (most, most))
            for stream, name in ((1, "out"), (2, "err")):
                os.dup2(os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
            sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
            code = run(arguments)
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)
    status = os.waitpid(child, 0)[1]
    figures = {}
    if (folder / "figures.json").exists():
        figures = json.loads((folder / "figures.json").read_text())
    out, err = ((folder / name).read_text(errors="replace") for name in ("out", "err"))
    return Answer(os.waitstatus_to_exitcode(status), out, err, figures, folder)


def outcome_of(case: Case, answer: Answer, sound: Answer) -> Outcome:
    """What the answer of a damaged file is, beside that of the sound one."""
    err = answer.err.strip()
    if answer.code not in (0, 1, 2):
        return Outcome(case, "UNEXPECTED", f"exit {answer.code}: {err[-200:]}")
    if "Traceback" in err or "unexpected error" in err or "not enough memory" in err:
        return Outcome(case, "UNEXPECTED", err[-300:])
    if answer.code:
        is_sentence = err.count("\n") == 0 and err.startswith("unocclude: ") and len(err) < 2000
        left = [path.name for path in answer.folder.iterdir() if path.name.startswith(".")]
        is_sentence &= not left and not (answer.folder / "out.mcap").exists()
        return Outcome(case, "sentence" if is_sentence else "UNEXPECTED", err or "no word")
    new = sorted(answer.notes - sound.notes)
    wrong = differs(case, answer, sound)
    if not wrong:
        return Outcome(case, "right", new[0] if new else "")
    if new or answer.figures.get("trusted") is False:
        message = new[0] if new else str(answer.figures.get("verdict"))
        return Outcome(case, "note", message)
    return Outcome(case, "SILENT", wrong)


def differs(case: Case, answer: Answer, sound: Answer) -> str:
    """What the answer lacks or has otherwise than the sound file's; empty where it is right."""
    if case.kind == "info":
        count = {topic["name"]: topic["count"] for topic in answer.figures["topics"]}
        for topic in sound.figures["topics"]:
            if count.get(topic["name"]) != topic["count"]:
                return f"{topic['name']}: {count.get(topic['name'])} of {topic['count']} messages"
        missing = answer.figures["missing"].get("smooth")
        return "" if missing == sound.figures["missing"].get("smooth") else str(missing)
    if case.kind == "smooth":
        return other_motion(answer.folder / "out.mcap", sound.folder / "out.mcap")
    for key in case.compares:
        a, b = answer.figures.get(key), sound.figures.get(key)
        if json.dumps(a) != json.dumps(b):
            return f"{key}: {str(a)[:80]} instead of {str(b)[:80]}"
    return ""


def other_motion(path: Path, sound: Path) -> str:
    """How a recovered motion departs from the sound one; empty where it does not."""
    try:
        (new,), (old,) = read_recovery(path), read_recovery(sound)
    except UnoccludeError as error:
        return str(error)
    shift_ns = new.origin_ns - old.origin_ns
    there = np.rint((new.t_s) * 1e9).astype(np.int64) + shift_ns
    wanted = np.rint(old.t_s * 1e9).astype(np.int64)
    rows = np.searchsorted(there, wanted).clip(0, max(len(there) - 1, 0))
    met = abs(there[rows] - wanted) < 1_000_000
    if (~met).sum() > 0:
        return f"{int((~met).sum())} of {len(wanted)} samples have no answer"
    off = np.linalg.norm(new.position[rows] - old.position, axis=1)
    sigma = np.sqrt(np.einsum("nii->n", new.pose_covariance[rows][:, 3:, 3:]).clip(0))
    bad = ~(off < np.maximum(OFF_M, OFF_SIGMAS * np.nan_to_num(sigma)))
    return f"off by up to {np.nanmax(off):.3f} m" if bad.any() else ""


def run_all(cases: list[Case], shop: Workshop, shown: bool = True, log: Path | None = None) -> list[Outcome]:
    """Run all cases one after the other, but those whose outcome the log contains."""
    sound: dict[str, Answer] = {}
    before = logged(log)
    outcomes = []
    for number, case in enumerate(cases):
        if old := before.get(key_of(case)):
            outcomes.append(Outcome(case, old["end"], old["text"], old["seconds"]))
            continue
        if case.runs is None and case.base not in sound:
            folder = Path(tempfile.mkdtemp(prefix="sound_", dir=shop.folder))
            answer = run_case(case.sound(shop), folder)
            if answer.code:
                sys.exit(f"the sound file of {case.family} is refused: {answer.err}")
            sound[case.base] = answer
        with tempfile.TemporaryDirectory(dir=shop.folder) as name:
            folder = Path(name)
            began = time.monotonic()
            if case.runs is not None:
                outcome = Outcome(case, *case.runs(folder, other_motion))
            else:
                case.make(shop, folder)
                outcome = outcome_of(case, run_case(case, folder), sound[case.base])
            outcome = replace(outcome, seconds=round(time.monotonic() - began, 2))
        outcomes.append(outcome)
        if log is not None:
            with log.open("a", encoding="utf-8") as file:
                file.write(outcome.to_line())
        if shown and outcome.end in ENDS[3:]:
            print(f"{outcome.end}: {case.family}, {case.name}: {outcome.text}", file=sys.stderr, flush=True)
        if shown and number % 100 == 99:
            print(f"{number + 1} of {len(cases)}, {time.process_time():.0f} s", file=sys.stderr, flush=True)
    return outcomes


def logged(log: Path | None) -> dict[str, dict[str, Any]]:
    """Outcomes of an earlier run by case; what was silent or unexpected is run again."""
    if log is None or not log.exists():
        return {}
    rows = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    return {row["case"]: row for row in rows if row["end"] in ENDS[:3]}


def table(outcomes: list[Outcome]) -> str:
    """Counts by family and fault as Markdown."""
    families: dict[tuple[str, str], Counter[str]] = {}
    for outcome in outcomes:
        key = (outcome.case.family, outcome.case.fault)
        families.setdefault(key, Counter())[outcome.end] += 1
    lines = [
        "| file | fault | cases | right | partly right, with a note | one sentence | silent | unexpected |",
        "|---|---|---|---|---|---|---|---|",
    ]
    total: Counter[str] = Counter()
    for (family, fault), counts in families.items():
        total.update(counts)
        cells = " | ".join(str(counts[end]) for end in ENDS)
        lines.append(f"| {family} | {fault} | {sum(counts.values())} | {cells} |")
    cells = " | ".join(f"**{total[end]}**" for end in ENDS)
    lines.append(f"| all | | **{sum(total.values())}** | {cells} |")
    return "\n".join(lines)


def main() -> int:
    """Run the selected cases; 1 where one was silent or unexpected."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--every", type=int, default=1, help="run one case in this many")
    parser.add_argument("--first", type=int, default=0, help="leave out this many before them")
    parser.add_argument("--quick", action="store_true", help="leave out those that may take long")
    parser.add_argument("--family", help="only families whose name contains this")
    parser.add_argument("--log", type=Path, help="note outcomes here, and run only cases that it lacks")
    parser.add_argument("--write", type=Path, help="put the table into this page")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        shop = Workshop(Path(name), options.seed)
        cases = [case for case in all_cases(shop) if not options.family or options.family in case.family]
        cases = [case for case in cases[options.first :: options.every] if not (options.quick and case.cpu_s)]
        outcomes = run_all(cases, shop, log=options.log)
    text = table(outcomes)
    print(text)
    if options.write:
        worst = [o for o in outcomes if o.end in ENDS[3:]]
        listed = "".join(f"- {o.end}: {o.case.family}, {o.case.name}: {o.text}\n" for o in worst[:40])
        where = f"\n\nNot as it should be:\n\n{listed}" if worst else ""
        made = f"`python -m tools.faults --seed {options.seed} --every {options.every}` gave\n\n{text}{where}"
        write_table(options.write, made, "tools.faults")
    return int(any(outcome.end in ENDS[3:] for outcome in outcomes))


if __name__ == "__main__":
    sys.exit(main())
