"""The app's folder on disk, and the desk that does its jobs one after the other.

    FOLDER/ID/app.json          name, person, date, choices
    FOLDER/ID/files/            files as they were dropped
    FOLDER/ID/recording.mcap .. what the commands wrote, under the commands' own names
    FOLDER/ID/job/              its last job: the commands' words, what they printed, how it ended
    FOLDER/.unocclude/          the address and its token, templates, models, what was removed

Everything is a file that is written whole, so that a program that is killed loses nothing. A job is a list
of commands. Each command is a process that ends with this one, however that ends; a job that was not ended
by then was stopped, and can be repeated.
"""

from __future__ import annotations

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

#: Names of recordings on disk.
_ID = re.compile(r"[a-z0-9][a-z0-9-]{0,63}")
#: The app's own folder.
HIDDEN = ".unocclude"
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
        found = (path.parent.name for path in self.path.glob("*/app.json"))
        return sorted(name for name in found if _ID.fullmatch(name))

    def of(self, name: str) -> Path:
        """The folder of a recording."""
        if not _ID.fullmatch(name) or not (self.path / name / "app.json").is_file():
            raise AppError("There is no such recording in this folder; it may have been removed.", 404)
        return self.path / name

    def add(self, kept: KeptRecording) -> str:
        """Make the folder of a new recording; its name on disk."""
        name = f"{slug(kept.name) or 'recording'}-{secrets.token_hex(3)}"
        (self.path / name / "files").mkdir(parents=True)
        write_kept(self.path / name, kept.model_copy(update={"created_s": time.time()}))
        return name

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
    texts = {key: one_line(wish[key]) for key in ("name", "person", "date") if key in wish}
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


class KeptJob(BaseModel):
    """The commands of a recording's last job, and how far they are; one that cannot be read was stopped."""

    number: int = 1  # Of the recording's jobs
    kind: str = ""  # What it is for ("describe", "recover", ..)
    # "waiting", "running", "done", "failed", "held" (by the check: the result could not be trusted),
    # "cancelled" by the user, or "stopped" with the program or the computer
    state: str = "stopped"
    step: int = 0  # The command that runs or was the last
    steps: list[dict[str, Any]] = []
    sentence: str = ""  # Why it failed, in the command's words
    stamp: str = ""  # Of what went in


def job_folder(place: Path) -> Path:
    """Where a recording's last job is kept."""
    return place / "job"


def read_job(place: Path) -> KeptJob | None:
    """A recording's last job; None without any."""
    try:
        return KeptJob.model_validate_json((job_folder(place) / "job.json").read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return KeptJob()


def write_job(place: Path, job: KeptJob) -> None:
    """Keep it, whole or not at all."""
    write_json(job_folder(place) / "job.json", job.model_dump())


def printed(place: Path) -> str:
    """What the commands of a recording's last job printed."""
    parts = []
    for name in ("out.txt", "err.txt"):
        with suppress(OSError):
            parts.append((job_folder(place) / name).read_bytes()[-_SHOWN_BYTES:].decode("utf-8", "replace"))
    return "".join(parts).strip()


def refuse_busy(place: Path) -> None:
    """Refuse to change a recording whose job is not over."""
    job = read_job(place)
    if job is not None and job.state in OPEN:
        raise AppError("This recording is being worked on; wait for it, or cancel it.", 409)


class JobDesk:
    """Does jobs in the order in which they came, and stops them."""

    def __init__(self, folder: AppFolder) -> None:
        self._worker = ThreadPoolExecutor(1, "jobs")
        self._cancelled: set[tuple[Path, int]] = set()
        self._closing = threading.Event()
        for place in map(folder.of, folder.recordings()):
            job = read_job(place)
            if job is not None and job.state in OPEN:  # an earlier server left it
                with suppress(OSError, UnoccludeError):
                    write_job(place, job.model_copy(update={"state": "stopped"}))

    def add(self, place: Path, kind: str, steps: list[dict[str, Any]], stamp: str = "") -> None:
        """Put a job at the end of the queue."""
        refuse_busy(place)
        before = read_job(place)
        number = 1 if before is None else before.number + 1
        job = KeptJob(number=number, kind=kind, state="waiting", steps=steps, stamp=stamp)
        job_folder(place).mkdir(exist_ok=True)
        write_job(place, job)
        for name in ("out.txt", "err.txt", "progress.json"):
            (job_folder(place) / name).unlink(missing_ok=True)
        self._worker.submit(self._do, place, job)

    def cancel(self, place: Path) -> None:
        """Stop a recording's job, or take it from the queue."""
        job = read_job(place)
        if job is not None and job.state in OPEN:
            self._cancelled.add((place, job.number))
            if job.state == "waiting":
                write_job(place, job.model_copy(update={"state": "cancelled"}))

    def close(self) -> None:
        """Stop what runs, and what waits."""
        self._closing.set()
        self._worker.shutdown(cancel_futures=True)

    def _note(self, place: Path, job: KeptJob, **changes: Any) -> None:
        """Change a job and what is kept of it; while the disk is full, it is tried again."""
        for name, value in changes.items():
            setattr(job, name, value)
        while True:
            with suppress(OSError, UnoccludeError):
                write_job(place, job)
                return
            if self._closing.wait(_LOOK_S):
                return

    def _do(self, place: Path, job: KeptJob) -> None:
        if self._asked_to_stop(place, job):
            return
        self._note(place, job, state="running")
        try:
            state, sentence = self._run(place, job)
        except OSError as error:
            state, sentence = "failed", f"{error.strerror or error}; make room and run again."
        if state == "done":  # what went into the last one of this kind
            with suppress(OSError, UnoccludeError):
                write_json(job_folder(place) / f"{job.kind}.json", {"stamp": job.stamp})
        self._note(place, job, state=state, sentence=sentence)

    def _run(self, place: Path, job: KeptJob) -> tuple[str, str]:
        """Do a job; its end, and why it failed."""
        for at, step in enumerate(job.steps):
            self._note(place, job, step=at)
            (job_folder(place) / "progress.json").unlink(missing_ok=True)
            if "link" in step:
                source, target = (place / name for name in step["link"])
                link_file(source, target)
                continue
            code = self._command(place, job, step["argv"])
            if why := self._asked_to_stop(place, job):
                return why, ""
            if code in step.get("held", []):
                return "held", ""
            if code not in step.get("ok", [0]):
                return "failed", _last_words(
                    job_folder(place) / "err.txt"
                ) or f"The command ended with {code}."
        return "done", ""

    def _asked_to_stop(self, place: Path, job: KeptJob) -> str:
        """Why a job is to stop: "cancelled" by the user, "stopped" with the server, or ""."""
        is_cancelled = (place, job.number) in self._cancelled
        return "cancelled" if is_cancelled else "stopped" if self._closing.is_set() else ""

    def _command(self, place: Path, job: KeptJob, words: list[str]) -> int:
        """Run a command in the recording's folder; its exit code."""
        root, kept = str(Path(__file__).parents[2]), job_folder(place)
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH")))),
            "UNOCCLUDE_PROGRESS": str(kept / "progress.json"),
            "PYTHONIOENCODING": "utf-8",
        }
        with open(kept / "out.txt", "ab") as out, open(kept / "err.txt", "ab") as err:
            process = subprocess.Popen(
                [*_PROGRAM, *words],
                cwd=place,
                env=environment,
                stdin=subprocess.PIPE,  # closed with this process, however it ends; see watch_parent
                stdout=out,
                stderr=err,
                start_new_session=True,  # a signal for it reaches its workers, and none for us does
            )
            with process:
                while process.poll() is None:
                    if self._asked_to_stop(place, job):
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
