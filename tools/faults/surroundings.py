"""Faults of what surrounds a command: disks, folders, limits, other programs, studies that were damaged.

Each case runs the command in a process of its own. Disks that are full or read-only are mounted in a mount
namespace of that process alone (`unshare`); where the system does not let us, these cases are left out.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

Rng = np.random.Generator
#: From a result and the sound one: how the motion departs, empty where it does not.
Motion = Callable[[Path, Path], str]
#: What a case ended in, and its sentence.
End = tuple[str, str]
#: Damages a study in a folder.
Damage = Callable[[Path, Rng], None]
#: How the installed script begins, and how it does with worker processes for short recordings.
COMMAND = (sys.executable, "-c", "from smoother.cli import main; main()")
QUICK = (
    sys.executable,
    "-c",
    "import smoother.runtime.pool as pool; pool.WORTH_FRAMES = 10; from smoother.cli import main; main()",
)
#: A command may take this long, s; one that waits for something that never comes takes longer.
LONGEST_S = 600
#: Mounts what it is given, runs the command, lists OUT and copies what is there for all to see.
SHELL = 'eval "$MOUNTS"; "$@"; code=$?; ls -AR "$OUT" > "$LISTING"; cp -r "$OUT" "$COPY"; exit $code'


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Attributes
    ----------
    code : int
        Its exit code.
    out, err : str
        What it printed.
    files : list of str
        What it left in the folder of its outputs, at any depth.
    """

    code: int
    out: str
    err: str
    files: list[str]

    @property
    def hidden(self) -> list[str]:
        """Temporary files among them."""
        return [name for name in self.files if name.startswith(".") and ".tmp" in name]


@cache
def can_mount() -> bool:
    """Whether this system lets us mount disks for a process alone."""
    if shutil.which("unshare") is None:
        return False
    words = ["unshare", "-rm", "sh", "-c", "mount -t tmpfs -o size=64k tmpfs /mnt"]
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


def run_words(
    words: Sequence[str],
    folder: Path,
    mounts: str = "",
    environment: dict[str, str] | None = None,
    command: Sequence[str] = COMMAND,
) -> Ended:
    """Run a command whose outputs go to `folder`/out; `mounts` are shell commands before it."""
    out = folder / "out"
    out.mkdir(exist_ok=True)
    listing, copy = folder / "listing", folder / "copy"
    space = ["unshare", "-rm"] if mounts else []
    program = subprocess.Popen(
        [*space, "sh", "-c", SHELL, "sh", *command, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
        env={
            **os.environ,
            "OMP_NUM_THREADS": "1",
            "MOUNTS": mounts,
            "OUT": str(out),
            "LISTING": str(listing),
            "COPY": str(copy),
            **(environment or {}),
        },
    )
    printed, said = ended_in_time(program)
    listed = listing.read_text().splitlines() if listing.exists() else []
    files = [line for line in listed if line and not line.endswith(":")]
    return Ended(program.returncode, printed, said, files)


def ended_in_time(program: subprocess.Popen[str]) -> tuple[str, str]:
    """What a program in a session of its own printed; it and all it started are killed after `LONGEST_S`."""
    try:
        return program.communicate(timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        os.killpg(program.pid, signal.SIGKILL)
        printed, said = program.communicate()
        return printed, f"{said}\nkilled: it did not end within {LONGEST_S} s"


def end_of(ended: Ended, wrong: str, allowed: Sequence[str] = ()) -> End:
    """What a case ended in, and its sentence: as in `tools.faults`.

    `wrong`: what the answer lacks, empty where it is right; `allowed`: codes beside 0 and 1.
    """
    said = ended.err.strip()
    if ended.code not in (0, 1) or "Traceback" in ended.err + ended.out or "unexpected error" in said:
        return "UNEXPECTED", f"exit {ended.code}: {said[-300:]}"
    if ended.hidden:
        return "UNEXPECTED", f"left {ended.hidden}"
    if ended.code == 0:
        notes = [line for line in ended.out.splitlines() if line.startswith("note:")]
        if not wrong:
            return "right", ""
        return ("note", notes[0]) if notes else ("SILENT", wrong)
    if said.count("\n") == 0 and said.startswith("unocclude: "):
        return "sentence", said
    if not said and "Failed" in ended.out:  # a study prints a table of what failed
        return "sentence", " ".join(ended.out.partition("Failed")[2].split())[:200]
    return "UNEXPECTED", said[-300:] or "no word"


def words_of(shop: Path) -> dict[str, list[str]]:
    """Commands that write files, on what the workshop holds; OUT is the folder of their outputs."""
    first, plain = shop / "ours", ["--processes", "1"]
    smooth = ["smooth", f"{first}/rec.mcap", "--calibration", f"{first}/cal.toml", "-o", "OUT/out.mcap"]
    return {
        "smooth": [*smooth, *plain],
        "smooth with report": [*smooth, *plain, "--report", "OUT/out.html", "--json", "OUT/out.json"],
        "import": ["import", "csv", f"{shop}/csv", "-o", "OUT/new.mcap"],
        "repair": ["repair", f"{first}/rec.mcap", "-o", "OUT/new.mcap"],
        "export": ["export", f"{shop}/result/out.mcap", "--format", "csv", "-o", "OUT/out.csv"],
        "simulate": ["simulate", "arm", "--duration-s", "5", "-o", "OUT/new.mcap"],
        "batch": ["batch", f"{shop}/studied", "-o", "OUT/study", *plain],
    }


def full_output(size: str, words: Sequence[str], shop: Path, folder: Path, motion: Motion) -> End:
    """The disk of the outputs has limited space."""
    mounts = f"mount -t tmpfs -o size={size} tmpfs {folder}/out"
    ended = run_words([word.replace("OUT", f"{folder}/out") for word in words], folder, mounts)
    return end_of(ended, _compared(shop, folder, motion))


def _compared(shop: Path, folder: Path, motion: Motion) -> str:
    """How the motion departs from the sound one, where there is any among the outputs."""
    results = sorted((folder / "copy").rglob("out.mcap"))
    for path in results:
        if wrong := motion(path, shop / "result" / "out.mcap"):
            return wrong
    return ""


def full_temporary(size: str, shop: Path, folder: Path, motion: Motion) -> End:
    """The disk for temporary files has limited space; the recording is long enough to need it."""
    (folder / "tmp").mkdir()
    mounts = f"mount -t tmpfs -o size={size} tmpfs {folder}/tmp"
    words = ["smooth", f"{shop}/long.mcap", "-o", f"{folder}/out/out.mcap", "--processes", "1"]
    ended = run_words(words, folder, mounts, {"TMPDIR": f"{folder}/tmp"})
    is_there = (folder / "copy" / "out.mcap").exists()
    return end_of(ended, "" if is_there else "there is no result")


def read_only(what: str, words: Sequence[str], shop: Path, folder: Path, motion: Motion) -> End:
    """A folder cannot be written to: that of the outputs, of the input, or of temporary files."""
    place = {"output": f"{folder}/out", "temporary": f"{folder}/tmp", "input": f"{shop}/ours"}[what]
    (folder / "tmp").mkdir()
    (folder / "out").mkdir()
    mounts = f"mount --bind {place} {place} && mount -o remount,ro,bind {place}"
    environment = {"TMPDIR": f"{folder}/tmp"} if what == "temporary" else {}
    ended = run_words([word.replace("OUT", f"{folder}/out") for word in words], folder, mounts, environment)
    return end_of(ended, _compared(shop, folder, motion))


def limited_memory(megabytes: int, words: Sequence[str], shop: Path, folder: Path, motion: Motion) -> End:
    """So much memory, the program itself included."""
    program = f"import resource; resource.setrlimit(resource.RLIMIT_DATA, ({megabytes << 20},) * 2); "
    command = (sys.executable, "-c", program + "from smoother.cli import main; main()")
    ended = run_words([word.replace("OUT", f"{folder}/out") for word in words], folder, command=command)
    return end_of(ended, _compared(shop, folder, motion))


def two_at_once(what: str, words: Sequence[str], shop: Path, folder: Path, motion: Motion) -> End:
    """The same command twice at the same time (`what`: "twice"): both right, or one that states why not."""
    (folder / "out").mkdir()
    arguments = [*COMMAND, *(word.replace("OUT", f"{folder}/out") for word in words)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    programs = [subprocess.Popen(arguments, **pipes) for _ in range(2)]  # type: ignore[call-overload]
    printed = [ended_in_time(program) for program in programs]
    shutil.copytree(folder / "out", folder / "copy")
    files = [path.name for path in (folder / "out").rglob("*")]
    outputs = [path for path in (folder / "copy").rglob("*.*") if not path.name.startswith(".")]
    wrong = _compared(shop, folder, motion) or ("" if outputs else "no output")
    both = [
        end_of(Ended(program.returncode, out, err, files), wrong)
        for program, (out, err) in zip(programs, printed, strict=True)
    ]
    order = ["right", "note", "sentence", "SILENT", "UNEXPECTED"]
    if [end for end, _ in both] == ["sentence", "sentence"]:
        return "UNEXPECTED", f"neither of the two did the work: {both[0][1]}"
    return max(both, key=lambda one: order.index(one[0]))


def killed_worker(after_s: float, words: Sequence[str], shop: Path, folder: Path, motion: Motion) -> End:
    """One of the worker processes is killed."""
    from tools.faults.kills import Case, try_case

    out = folder / "out"
    out.mkdir()
    wrong = try_case(
        Case("worker", after_s),
        [word.replace("OUT", str(out)) for word in words],
        out,
        ["config", "--json", f"{out}/after.json", "--force"],
        QUICK,
    )
    shutil.copytree(out, folder / "copy")
    wrong += [text for text in [_compared(shop, folder, motion)] if text]
    return ("UNEXPECTED", "; ".join(wrong)) if wrong else ("right", "")


def damaged_study(damage: Damage, rng: Rng, shop: Path, folder: Path, motion: Motion) -> End:
    """A study is done, its ledger is damaged, and the same command comes again."""
    study = folder / "out" / "study"
    shutil.copytree(shop / "study", study)
    outputs = {path: path.read_bytes() for path in study.glob("*.mcap")}
    damage(study, rng)
    words = [
        "batch",
        f"{shop}/studied",
        "-o",
        str(study),
        "--json",
        f"{folder}/figures.json",
        "--processes",
        "1",
    ]
    ended = run_words(words, folder)
    figures = folder / "figures.json"
    done = json.loads(figures.read_text())["done"] if figures.exists() else 0
    wrong = "" if done == len(outputs) else f"{done} of {len(outputs)} recordings are done"
    if any(not path.exists() or path.read_bytes() != content for path, content in outputs.items()):
        wrong = wrong or "a result is another one"
    end, text = end_of(ended, wrong)
    if end == "right":
        text = next((line for line in ended.out.splitlines() if line.startswith("note:")), "")
    return end, text


def _each(pattern: str, change: Callable[[bytes, Rng], bytes]) -> Damage:
    """A change of the bytes of all files of a pattern."""

    def damage(study: Path, rng: Rng) -> None:
        paths = sorted(study.glob(pattern))
        assert paths, f"there is no {pattern}"
        for path in paths:
            path.write_bytes(change(path.read_bytes(), rng))

    return damage


def _flipped(data: bytes, rng: Rng) -> bytes:
    at = int(rng.integers(len(data)))
    return data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]


def _strange_rows(study: Path, rng: Rng) -> None:
    """Files among the rows of workers that are not rows."""
    rows = study / ".unocclude" / "rows"
    rows.mkdir(parents=True, exist_ok=True)
    texts = [
        b"",
        b"{",
        b"[]",
        b'{"id": 1}',
        b"\0" * 500,
        rng.bytes(200),
        b"[" * 50_000,
        b'{"id": "' + b"x" * 9,
    ]
    for number, text in enumerate(texts):
        (rows / f"{number}.json").write_bytes(text)


LEDGER: dict[str, Damage] = {
    "cut off": _each("results/*.parquet", lambda data, rng: data[: int(rng.integers(len(data)))]),
    "empty": _each("results/*.parquet", lambda data, rng: b""),
    "zeros": _each("results/*.parquet", lambda data, rng: bytes(len(data))),
    "a bit": _each("results/*.parquet", _flipped),
    "random bytes": _each("results/*.parquet", lambda data, rng: rng.bytes(len(data))),
    "gone": lambda study, rng: shutil.rmtree(study / "results"),
    "rows that are none": _strange_rows,
    "mark cut off": _each(".unocclude/study", lambda data, rng: data[:3]),
    "mark of random bytes": _each(".unocclude/study", lambda data, rng: rng.bytes(40)),
    "mark gone": lambda study, rng: (study / ".unocclude" / "study").unlink(),
}
