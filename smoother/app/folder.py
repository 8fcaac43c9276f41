"""The app's folder on disk, and the desk that does its jobs one after the other.

    FOLDER/ID/app.json          name, person, date, choices
    FOLDER/ID/files/            files as they were dropped
    FOLDER/ID/recording.mcap .. what the commands wrote, under the commands' own names
    FOLDER/ID/jobs/0001/        a command that ran: its words, what it printed, how it ended
    FOLDER/comparisons/ID/      the sessions of a person: a study of `batch`, the page of `progress`
    FOLDER/.unocclude/          the address and its token, templates, models, what was removed

Everything is a file that is written whole, so that a program that is killed loses nothing. A job is a list
of commands. Each command is a process that ends with this one, however that ends; a job that was not ended
by then was stopped, and can be repeated.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
import shutil
import signal
import subprocess
import sys
import threading
import time
import unicodedata
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import UnoccludeError
from ..runtime.outputs import writing

#: Names of recordings and comparisons on disk.
_ID = re.compile(r"[a-z0-9][a-z0-9-]{0,63}")
#: Folders of the app's own.
HIDDEN, COMPARISONS = ".unocclude", "comparisons"
#: Names that some systems take for devices.
_DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{k}" for port in ("com", "lpt") for k in range(1, 10))}
#: Bytes of a file's name.
_LONGEST_NAME = 180
#: Marks that the command line reads as something else than a name.
_MARKS = str.maketrans(dict.fromkeys(",=#", "_"))


class AppError(UnoccludeError):
    """A request that cannot be met."""

    def __init__(self, sentence: str, status: int = 400) -> None:
        super().__init__(sentence)
        self.status = status


#: Where an IMU may be worn; "": the motion shows it, "-": it takes no part.
Place = Literal["", "-", "forearm_right", "forearm_left", "upper_arm_right", "upper_arm_left",
                "hand_right", "hand_left", "base"]  # fmt: skip
_REMEDY = r"(--(mirror [xyz]|swap [a-z]+,[a-z]+|negate [a-z]+(,[a-z]+)?|camera-frame [a-z]+) ?)*"


class Choices(BaseModel):
    """What the user chose for a recording."""

    model_config = ConfigDict(strict=True)

    places: dict[str, Place] = {}  # Where an IMU is worn
    left_out: list[str] = []  # Files that take no part
    # When the first IMU sample was taken, after the camera's first frame
    imu_starts_at_s: Annotated[float, Field(gt=-1e7, lt=1e7)] | None = None
    side: Literal["", "left", "right"] = ""  # "": all arms that have an IMU
    body: Annotated[int, Field(ge=0, lt=10**9)] | None = None  # The person
    # Options that undo a wrong set-up, as `check` proposes them ("--mirror x")
    remedy: Annotated[str, Field(pattern=f"^{_REMEDY}$")] = ""
    video_mirrored: bool = False  # The video used as the camera is a mirror image
    video_turn: Literal[0, 90, 180, 270] = 0  # Its pictures are turned clockwise by this many degrees


class KeptRecording(BaseModel):
    """What is kept of a recording besides its files."""

    name: str = ""  # As the user wrote them; the date as YYYY-MM-DD, or "" where the recording states it
    person: str = ""
    date: str = ""
    task: str = ""
    created_s: float = 0.0  # Since 1970
    revision: int = 0  # Rises with every change, so that two pages do not overwrite each other's
    choices: Choices = Choices()


_DATE = re.compile(r"\d{4}-\d\d-\d\d")


class AppFolder:
    """A folder of recordings."""

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.hidden = self.path / HIDDEN  # What is not for the user's eyes
        self.templates = self.hidden / "templates"  # Of tables, a file each
        self.models = self.hidden / "models"  # Of MediaPipe's pose landmarker that were dropped, for all
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            for each in (self.hidden, self.templates, self.models):
                each.mkdir(mode=0o700, exist_ok=True)
        except OSError as error:
            raise UnoccludeError(f"{path}: {error.strerror or error}; name another folder") from error

    def template_files(self) -> list[Path]:
        """All templates, by name."""
        return sorted(self.templates.glob("*.toml"))

    def recordings(self) -> list[str]:
        """Names on disk of all recordings."""
        return self._names("*/app.json")

    def comparisons(self) -> list[str]:
        """Names on disk of all comparisons."""
        return self._names(f"{COMPARISONS}/*/comparison.json")

    def _names(self, pattern: str) -> list[str]:
        found = (path.parent.name for path in self.path.glob(pattern))
        return sorted(name for name in found if _ID.fullmatch(name))

    def of(self, name: str) -> Path:
        """The folder of a recording."""
        return self._with(name, self.path / name / "app.json", "recording")

    def comparison(self, name: str) -> Path:
        """The folder of a comparison."""
        return self._with(name, self.path / COMPARISONS / name / "comparison.json", "comparison")

    def _with(self, name: str, file: Path, what: str) -> Path:
        if not _ID.fullmatch(name) or not file.is_file():
            raise AppError(f"There is no such {what} in this folder; it may have been removed.", 404)
        return file.parent

    def add(self, kept: KeptRecording) -> str:
        """Make the folder of a new recording; its name on disk."""
        name = f"{slug(kept.name) or 'recording'}-{secrets.token_hex(3)}"
        (self.path / name / "files").mkdir(parents=True)
        write_kept(self.path / name, kept.model_copy(update={"created_s": time.time()}))
        return name

    def add_comparison(self, person: str) -> tuple[str, Path]:
        """The folder in which a person's sessions are compared, the same at each time."""
        mark = hashlib.sha256(person.encode("utf-8", "replace")).hexdigest()[:8]
        name = f"{slug(person) or 'person'}-{mark}"
        folder = self.path / COMPARISONS / name
        folder.mkdir(parents=True, exist_ok=True)
        return name, folder

    def remove(self, name: str) -> Path:
        """Move a recording out of the way; where to."""
        folder, removed = self.of(name), self.hidden / "removed"
        removed.mkdir(exist_ok=True)
        stamp = f"{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(2)}"
        return folder.rename(removed / f"{name}-{stamp}")


def link_file(file: Path, target: Path) -> None:
    """A file under a second name, without a copy where the disk allows; whole or not at all."""
    beside = target.with_name(f".{secrets.token_hex(8)}.part")
    try:
        try:
            os.link(file.resolve(), beside)
        except OSError:
            shutil.copyfile(file, beside)
        os.replace(beside, target)
    finally:
        with suppress(OSError):
            beside.unlink()


def slug(text: str) -> str:
    """A text as small letters, digits and dashes; "" where it has none of them."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()
    return re.sub(r"[^a-z0-9]+", "-", plain).strip("-")[:40].strip("-")


def file_name(name: str) -> str:
    """The name under which a dropped file is kept."""
    plain = unicodedata.normalize("NFC", name)
    hostile = (
        not plain.strip(" .")
        or any(mark in plain for mark in '/\\:*?"<>|')
        or plain.startswith((".", "-", "~"))
        or plain.endswith((" ", "."))
        or not plain.isprintable()
        or len(plain.encode("utf-8", "surrogatepass")) > _LONGEST_NAME
        or any("\ud800" <= character <= "\udfff" for character in plain)
        or plain.split(".")[0].strip().lower() in _DEVICES
    )
    if hostile:
        raise AppError("A file of this name cannot be kept; give it a plain name and drop it again.")
    return plain.translate(_MARKS)


def read_kept(folder: Path) -> KeptRecording:
    """What is kept of a recording; what a newer version wrote besides is passed over."""
    return KeptRecording.model_validate(read_json(folder / "app.json"))


def write_kept(folder: Path, kept: KeptRecording) -> None:
    """Keep it, whole or not at all."""
    write_json(folder / "app.json", kept.model_dump())


def changed(kept: KeptRecording, wish: dict[str, Any]) -> KeptRecording:
    """What is kept, with a page's changes."""
    if wish.get("revision") != kept.revision:
        raise AppError("Another page changed this recording meanwhile; its choices are shown now.", 409)
    texts = {key: one_line(wish[key]) for key in ("name", "person", "date", "task") if key in wish}
    if (date := texts.get("date")) and not _is_date(date):
        raise AppError("The date is written as YYYY-MM-DD.")
    choices = wish.get("choices", {})
    if not isinstance(choices, dict) or choices.keys() - Choices.model_fields.keys():
        raise AppError("The choices are not those of a recording.")
    try:
        chosen = Choices.model_validate(kept.choices.model_dump() | choices)
    except ValidationError as error:
        raise AppError("A choice has a value that cannot be.") from error
    return kept.model_copy(update=texts | {"choices": chosen, "revision": kept.revision + 1})


def _is_date(text: str) -> bool:
    with suppress(ValueError):
        time.strptime(text, "%Y-%m-%d")
        return _DATE.fullmatch(text) is not None
    return False


def one_line(value: object) -> str:
    """A short text on one line."""
    if not isinstance(value, str) or len(value) > 200:
        raise AppError("A name is a text of at most 200 characters.")
    return " ".join("".join(c for c in value if c.isprintable()).split())


def read_json(path: Path) -> dict[str, Any]:
    """A file's object; {} where it is not there or is being written."""
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return values if isinstance(values, dict) else {}


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write an object, whole or not at all."""
    with writing(path, True) as temporary:
        temporary.write_text(json.dumps(values, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


#: States in which a job is not over.
OPEN = ("waiting", "running")
#: Bytes of what a command printed that the page shows.
_SHOWN_BYTES = 20_000
#: So often it looks whether a command is to stop, s.
_LOOK_S = 0.1
#: Time in which a command that has to stop can remove its outputs, s.
_GRACE_S = 10.0
#: How a process runs one command of the program.
_PROGRAM = (
    *(sys.executable, "-P", "-c"),
    "from smoother.app.folder import watch_parent; watch_parent(); from smoother.cli import main; main()",
)


def latest(folder: Path) -> Path | None:
    """The folder of a recording's latest job; None without any."""
    jobs = folder / "jobs"
    whole = [p for p in jobs.iterdir() if (p / "job.json").is_file()] if jobs.is_dir() else []
    return max((p for p in whole if p.name.isdecimal()), key=lambda p: int(p.name), default=None)


def state_of(job: Path, printed: bool = False) -> dict[str, Any]:
    """How far a job is, by its files on disk; with `printed`, what its commands printed once it has ended.

    Its state is "waiting", "running", "done", "failed", "held" (by the check: the result could not be
    trusted), "cancelled" by the user, or "stopped" with the program or the computer.
    """
    words, progress = read_json(job / "job.json"), read_json(job / "progress.json")
    steps, state = words.get("steps", []), str(words.get("state", "waiting"))
    step = min(int(words.get("step", 0)), max(len(steps) - 1, 0))
    return {
        "number": int(job.name),  # Of the recording's jobs, from 1
        "kind": str(words.get("kind", "")),  # What it is for ("describe", "recover", ..)
        "state": state,
        "step": step,  # The command that runs or was the last, from 0, and how many there are
        "steps": len(steps),
        "step_name": steps[step]["name"] if steps else "",
        "share": float(progress.get("share", -1.0)),  # Part done of it, 0 to 1; -1 where it does not say
        "text": str(progress.get("text", "")),  # What it is doing
        "sentence": str(words.get("sentence", "")),  # Why it failed, in the command's words
        "printed": _printed(job) if printed and state not in OPEN else "",
        "stamp": str(words.get("stamp", "")),  # Of what went in
    }


def refuse_busy(place: Path) -> None:
    """Refuse to change a recording whose job is not over."""
    job = latest(place)
    if job is not None and state_of(job)["state"] in OPEN:
        raise AppError("This recording is being worked on; wait for it, or cancel it.", 409)


def _printed(job: Path) -> str:
    parts = []
    for name in ("out.txt", "err.txt"):
        with suppress(OSError):
            parts.append((job / name).read_bytes()[-_SHOWN_BYTES:].decode("utf-8", "replace"))
    return "".join(parts).strip()


class JobDesk:
    """Does jobs in the order in which they came, and stops them."""

    def __init__(self, folder: AppFolder) -> None:
        self._lock = threading.Lock()
        self._worker = ThreadPoolExecutor(1, "jobs")
        self._running: Path | None = None
        self._cancelled: set[Path] = set()
        self._closing = threading.Event()
        places = [folder.of(name) for name in folder.recordings()]
        places += [folder.comparison(name) for name in folder.comparisons()]
        for job in filter(None, map(latest, places)):  # what an earlier server left
            if state_of(job)["state"] in OPEN:
                with suppress(OSError, UnoccludeError):
                    write_json(job / "job.json", read_json(job / "job.json") | {"state": "stopped"})

    def add(self, place: Path, kind: str, steps: list[dict[str, Any]], stamp: str = "") -> int:
        """Put a job at the end of the queue; its number."""
        with self._lock:
            refuse_busy(place)
            jobs = place / "jobs"
            jobs.mkdir(exist_ok=True)
            number = 1 + max((int(p.name) for p in jobs.iterdir() if p.name.isdecimal()), default=0)
            job = jobs / f"{number:04d}"  # one without job.json was left by a full disk: its number is passed
            job.mkdir()
            try:
                write_json(job / "job.json", {"kind": kind, "steps": steps, "stamp": stamp})
            except BaseException:
                shutil.rmtree(job, ignore_errors=True)
                raise
            self._worker.submit(self._do, job)
        return number

    def cancel(self, place: Path) -> None:
        """Stop a recording's job, or take it from the queue."""
        job = latest(place)
        with self._lock:
            if job is not None and job == self._running:
                self._cancelled.add(job)
            elif job is not None and state_of(job)["state"] == "waiting":
                write_json(job / "job.json", read_json(job / "job.json") | {"state": "cancelled"})

    def close(self) -> None:
        """Stop what runs, and what waits."""
        self._closing.set()
        self._worker.shutdown(cancel_futures=True)

    def _note(self, job: Path, **changes: Any) -> None:
        """Change what is kept of a job; while the disk is full, it is tried again."""
        while True:
            with suppress(OSError, UnoccludeError):
                write_json(job / "job.json", read_json(job / "job.json") | changes)
                return
            if self._closing.wait(_LOOK_S):
                return

    def _do(self, job: Path) -> None:
        with self._lock:
            if state_of(job)["state"] != "waiting":
                return
            self._running = job
        self._note(job, state="running")
        try:
            state, sentence = self._run(job)
        except OSError as error:
            state, sentence = "failed", f"{error.strerror or error}; make room and run again."
        self._note(job, state=state, sentence=sentence)
        self._running = None

    def _run(self, job: Path) -> tuple[str, str]:
        """Do a job; its end, and why it failed."""
        for at, step in enumerate(read_json(job / "job.json")["steps"]):
            self._note(job, step=at)
            with suppress(OSError):
                (job / "progress.json").unlink()
            if "link" in step:
                source, target = (job.parents[1] / name for name in step["link"])
                link_file(source, target)
                continue
            code = self._command(job, step["argv"])
            if why := self._asked_to_stop(job):
                return why, ""
            if code in step.get("held", []):
                return "held", ""
            if code not in step.get("ok", [0]):
                return "failed", _last_words(job / "err.txt") or f"The command ended with {code}."
        return "done", ""

    def _asked_to_stop(self, job: Path) -> str:
        """Why a job is to stop: "cancelled" by the user, "stopped" with the server, or ""."""
        return "cancelled" if job in self._cancelled else "stopped" if self._closing.is_set() else ""

    def _command(self, job: Path, words: list[str]) -> int:
        """Run a command in the recording's folder; its exit code."""
        root = str(Path(__file__).parents[2])
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH")))),
            "UNOCCLUDE_PROGRESS": str(job / "progress.json"),
            "PYTHONIOENCODING": "utf-8",
        }
        with open(job / "out.txt", "ab") as out, open(job / "err.txt", "ab") as err:
            process = subprocess.Popen(
                [*_PROGRAM, *words],
                cwd=job.parents[1],
                env=environment,
                stdin=subprocess.PIPE,  # closed with this process, however it ends; see watch_parent
                stdout=out,
                stderr=err,
                start_new_session=True,  # a signal for it reaches its workers, and none for us does
            )
            with process:
                while process.poll() is None:
                    if self._asked_to_stop(job):
                        _end(process)
                    with suppress(subprocess.TimeoutExpired):
                        process.wait(_LOOK_S)
        return process.returncode


def _last_words(path: Path) -> str:
    """The sentence that a command ended with."""
    with suppress(OSError):
        lines = path.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        mine = [line for line in lines if line.startswith("unocclude: ")]
        return (mine or lines or [""])[-1].removeprefix("unocclude: ")
    return ""


def watch_parent() -> None:
    """In a command: end it and its workers when the process that started it is gone, even by kill -9."""
    pipe = os.dup(0)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)

    def watch() -> None:
        while os.read(pipe, 1):
            pass
        for number in (signal.SIGTERM, getattr(signal, "SIGKILL", signal.SIGTERM)):
            os.killpg(0, number) if hasattr(os, "killpg") else os.kill(os.getpid(), number)
            time.sleep(_GRACE_S)

    threading.Thread(target=watch, daemon=True).start()


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a command and its workers: asked to first, then at once."""
    for number in (signal.SIGTERM, getattr(signal, "SIGKILL", signal.SIGTERM)):
        with suppress(OSError):
            os.killpg(process.pid, number) if hasattr(os, "killpg") else process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(_GRACE_S)
            return
