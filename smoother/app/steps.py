"""The commands of each job, as a user would type them in the recording's folder; what the page is sent."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Sequence
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..result.draws import USUAL_DRAWS
from .folder import (
    OPEN,
    AppError,
    AppFolder,
    Choices,
    KeptRecording,
    job_folder,
    printed,
    read_job,
    read_json,
    read_kept,
)

Step = dict[str, Any]

#: What commands write in a recording's folder.
RESULT, REPORT = "recovered.mcap", "report.html"
STREAMS, CHECK, FIGURES, MATCHES = "streams.json", "check.json", "smooth.json", "matches.json"
IMPORTED, SESSION = "import.json", "session.txt"
#: Files that are used without being a stream.
_NO_STREAM = ("video", "model", "calibration", "description")
NO_MODEL = (
    "A video is the only camera here, and the model with which MediaPipe finds the arm in it is missing: drop"
    " the file pose_landmarker_full.task (or _lite, _heavy) beside the video."
)
#: Exports by format: the file that is written.
EXPORTS = {
    "csv": "recovered.csv",
    "trc": "recovered.trc",
    "mot": "recovered.mot",
    "c3d": "recovered.c3d",
    "sto": "recovered.sto",
    "parquet": "recovered.parquet",
    "measures": "measures.csv",
}


def recording_of(place: Path) -> str:
    """Name of the recording's file: what it was called when it was dropped, for the titles of reports."""
    name = place.name.rpartition("-")[0]
    return f"{name}.mcap" if name and f"{name}.mcap" != RESULT else "recording.mcap"


def files_of(place: Path) -> list[Path]:
    """The dropped files of a recording, whole ones, by name."""
    folder = place / "files"
    listed = folder.iterdir() if folder.is_dir() else ()
    return sorted(each for each in listed if each.is_file() and not each.name.startswith("."))


def described(place: Path) -> list[dict[str, Any]]:
    """What `import describe` found in the files that are there."""
    there = {each.name for each in files_of(place)}
    try:
        about = (place / STREAMS).stat()
    except OSError:
        return []
    found = _found(place / STREAMS, about.st_mtime_ns, about.st_size)
    return [dict(each) for each in found if Path(each["file"]).name in there]


@lru_cache(maxsize=256)
def _found(path: Path, mtime_ns: int, size: int) -> list[dict[str, Any]]:
    """The files of `streams.json`, read once: a page requests it several times per second."""
    found: list[dict[str, Any]] = read_json(path).get("files", [])
    return found


def describe_steps(folder: AppFolder, place: Path) -> list[Step]:
    """Look at all files."""
    if not files_of(place):
        raise AppError("There are no files yet; drop those of the camera and of the IMU.")
    words = ["import", "describe", "files", *_templates(folder), "--json", STREAMS, "--force"]
    return [{"name": "describe", "argv": words}]


def import_steps(folder: AppFolder, place: Path) -> list[Step]:
    """Make the recording of the files; several IMUs are matched with the limbs by their motion."""
    kept, target = read_kept(place), recording_of(place)
    files = [each for each in described(place) if Path(each["file"]).name not in kept.choices.left_out]
    streams = [each for each in files if each["kind"] not in _NO_STREAM]
    is_described = any(each["kind"] == "description" for each in files)
    film = None if is_described else camera_video(files)
    if not streams and not film and not is_described:
        raise AppError("There is no camera or IMU file yet; drop them here.")
    is_whole = not film and [each["format"] for each in streams] == ["mcap"]
    words = ["import"]
    end = ["--one-session", "--json", IMPORTED, "-o", target, "--force"]
    if kept.choices.imu_starts_at_s is not None:
        end = ["--imu-starts-at", repr(float(kept.choices.imu_starts_at_s)), *end]
    if is_described:
        words += ["csv", "files", "-o", target, "--force"]
    elif film:
        model = model_of(folder, files)
        if not model:
            raise AppError(NO_MODEL)
        words += ["video", _local(film), "--model", model]
        words += ["--mirrored"] if kept.choices.video_mirrored else []
        words += ["--turn", str(kept.choices.video_turn)] if kept.choices.video_turn else []
        words += [*_imu_words(files, kept.choices, every=True), *_templates(folder), *end]
    elif not is_whole:  # an unrecognised file is named too, so that the reason is shown
        skeletons = [each for each in streams if any(s["kind"] == "skeleton" for s in each["streams"])]
        words += ["files", *(_local(each) for each in streams if not each["streams"])]
        words += [word for each in skeletons for word in ("--skeleton", _local(each))]
        words += [*_imu_words(streams, kept.choices), *_templates(folder), *end]
    steps: list[Step] = [{"name": "import", "argv": words}]
    if is_whole and not is_described:
        steps = [{"name": "import", "link": [_local(streams[0]), target]}]
    if _is_open(streams, kept.choices):
        words = ["match", target, "--json", MATCHES, "--force"]
        steps.append({"name": "match", "argv": words, "ok": [0, 1]})  # a proposal, no condition
    return steps


def _is_open(files: Sequence[dict[str, Any]], choices: Choices) -> bool:
    """Whether it is left to the motion where an IMU is worn, and there is more than one answer."""
    worn = [choices.places.get(key, "") for key in sensor_keys(files)]
    joints = [
        name for each in files for s in each["streams"] if s["kind"] == "skeleton" for name in s["holds"]
    ]
    sides = {name.rpartition("_")[2] for name in joints}
    return "" in worn and (len([place for place in worn if place != "-"]) > 1 or {"left", "right"} <= sides)


def sensor_keys(files: Sequence[dict[str, Any]]) -> list[str]:
    """The IMUs of files, by what a choice names them."""
    keys = []
    for each in files:
        sensors = [stream for stream in each["streams"] if stream["kind"] == "imu"]
        keys += [sensor_key(each["file"], sensor, len(sensors)) for sensor in sensors]
    return keys


def camera_video(files: Sequence[dict[str, Any]]) -> dict[str, Any] | None:
    """The video used as the camera, where no file contains a skeleton."""
    if any(stream["kind"] == "skeleton" for each in files for stream in each["streams"]):
        return None
    return next((each for each in files if each["kind"] == "video"), None)


def model_of(folder: AppFolder, files: Sequence[dict[str, Any]]) -> str:
    """The model of the pose landmarker, as a command in the recording's folder names it; "" without one."""
    mine = [_local(each) for each in files if each["kind"] == "model"]
    kept = sorted(folder.models.glob("*.task"), key=lambda each: (-each.stat().st_mtime_ns, each.name))
    return next(iter([*mine, *map(str, kept)]), "")


def _local(about: dict[str, Any]) -> str:
    return f"files/{Path(about['file']).name}"


def _imu_words(files: Sequence[dict[str, Any]], choices: Choices, every: bool = False) -> list[str]:
    """`--imu` of all sensors; with `every` also of unrecognised files, so that the reason is shown."""
    words: list[str] = []
    halves: dict[str, list[tuple[str, str]]] = {}
    for each in files:
        sensors = [stream for stream in each["streams"] if stream["kind"] == "imu"]
        for sensor in sensors:
            file = _local(each)
            key = sensor_key(file, sensor, len(sensors))
            worn: str = choices.places.get(key, "")
            if worn == "-":
                continue
            source = f"{file}#{sensor['name']}" if len(sensors) > 1 and sensor["name"] else file
            if {"accelerometer", "gyroscope"} <= set(sensor["holds"]):
                words += ["--imu", f"{worn}={source}" if worn else source]
            else:
                halves.setdefault(worn, []).append((sensor["holds"][0], file))
        if every and not each["streams"] and each["kind"] not in _NO_STREAM:
            words += ["--imu", _local(each)]
    for worn, parts in _whole(halves).items():
        sources = ",".join(file for _, file in sorted(parts))  # the accelerometer's first
        words += ["--imu", f"{worn}={sources}" if worn else sources]
    return words


def _whole(halves: dict[str, list[tuple[str, str]]]) -> dict[str, list[tuple[str, str]]]:
    """Accelerometers and gyroscopes in files of their own, by where they are worn, put together."""
    parts = {worn: list(files) for worn, files in halves.items()}
    for holds, file in halves.get("", []):
        lacking = [w for w, own in parts.items() if w and holds not in [each for each, _ in own]]
        if len(lacking) == 1:
            parts[lacking[0]].append((holds, file))
            parts[""].remove((holds, file))
    for own in parts.values():
        names = [holds for holds, _ in own]
        if len(set(names)) < len(names):
            listed = ", ".join(Path(file).name for _, file in own)
            raise AppError(
                f"Accelerometer and gyroscope are in files of their own, and there are several: {listed}."
                " Choose where each of them is worn, the same for the two of one IMU."
            )
    return {worn: own for worn, own in parts.items() if own}


def sensor_key(file: str, sensor: dict[str, Any], count: int) -> str:
    """By what a choice names an IMU: its file, and the sensor in it where there are several."""
    name = Path(file).name
    return f"{name}#{sensor['name']}" if count > 1 else name


def _templates(folder: AppFolder) -> list[str]:
    return [word for path in folder.template_files() for word in ("--template", str(path))]


def _arm_words(folder: AppFolder, place: Path, kept: KeptRecording) -> list[str]:
    """Options of `check` and `smooth` by what was chosen."""
    words = kept.choices.remedy.replace("--", " --").split()  # options, each with its value
    if kept.choices.side:
        words += ["--side", kept.choices.side]
    if kept.choices.body is not None:
        words += ["--body", str(kept.choices.body)]
    left_out = kept.choices.left_out
    given = [each for each in described(place) if each["kind"] == "calibration"]
    given = [each for each in given if Path(each["file"]).name not in left_out]
    return words + (["--calibration", _local(given[0])] if given else _session_words(folder, place))


def _session_words(folder: AppFolder, place: Path) -> list[str]:
    """`--session`, where the person was recorded several times that day: short trials prove themselves so."""
    mine = read_kept(place)
    day = recorded_date(place, mine)
    if not (mine.person and day):
        return []
    others = [(folder.of(name), read_kept(folder.of(name))) for name in folder.recordings()]
    same = [at for at, kept in others if kept.person == mine.person and recorded_date(at, kept) == day]
    trials = [path for path in (at / recording_of(at) for at in same if at != place) if path.is_file()]
    if not trials:
        return []
    lines = "".join(f"{os.path.relpath(path, place)}\n" for path in trials)
    (place / SESSION).write_text(lines, encoding="utf-8")
    return ["--session", SESSION]


def check_steps(folder: AppFolder, place: Path, strict: bool = False) -> list[Step]:
    """Import and check; with `strict`, a set-up that seems wrong stops the job there."""
    arm = _arm_words(folder, place, read_kept(place))
    words = ["check", recording_of(place), *arm, "--json", CHECK, "--force"]
    verdict: Step = {"ok": [0], "held": [3]} if strict else {"ok": [0, 3]}
    return [*import_steps(folder, place), {"name": "check", "argv": words, **verdict}]


def recover_steps(folder: AppFolder, place: Path, anyway: bool = False) -> list[Step]:
    """Import, check, recover, and write the report."""
    kept = read_kept(place)
    words = ["smooth", recording_of(place), "-o", RESULT, "--report", REPORT, "--json", FIGURES, "--force"]
    words += ["--draws", str(USUAL_DRAWS), *_arm_words(folder, place, kept)]
    return [*check_steps(folder, place, strict=not anyway), {"name": "recover", "argv": words}]


def export_steps(place: Path, formats: Sequence[str]) -> list[Step]:
    """The result in other formats, into `exports/`."""
    if not (place / RESULT).is_file():
        raise AppError("There is no result yet; recover the recording first.")
    wrong = [each for each in formats if each not in EXPORTS]
    if wrong or not formats:
        raise AppError(f"Formats are {', '.join(EXPORTS)}.")
    (place / "exports").mkdir(exist_ok=True)
    steps = []
    for each in formats:
        target = f"exports/{EXPORTS[each]}"
        words = ["export", RESULT, "--format", each, "-o", target, "--force"]
        if each == "measures":
            words = ["measures", RESULT, "--csv", target, "--force"]
        steps.append({"name": f"export {each}", "argv": words})
    return steps


def recorded_date(place: Path, kept: KeptRecording) -> str:
    """The day of a recording: as written, else by the stamps of its files; "" where they count from zero."""
    from datetime import UTC, datetime

    if kept.date:
        return kept.date
    starts = [stream["start_s"] for each in described(place) for stream in each["streams"]]
    dated = [start for start in starts if 631_152_000 < start < 4_102_444_800]  # 1990 to 2100
    return f"{datetime.fromtimestamp(min(dated), UTC):%Y-%m-%d}" if dated else ""


def stamp(folder: AppFolder, place: Path) -> str:
    """A hash of all inputs of a recovery: files, settings, and the templates that read one of the files."""
    parts: list[Any] = []
    used = {each["format"] for each in described(place)}
    templates = [path for path in folder.template_files() if f"template:{path.stem}" in used]
    for path in (*files_of(place), *templates):
        about = path.stat()
        parts.append((path.name, about.st_size, about.st_mtime_ns))
    parts.append(read_kept(place).choices.model_dump())
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


#: Files that may be taken away, besides the recording and exports.
DOWNLOADS = (RESULT, REPORT, CHECK, FIGURES)
#: What the page shows of a check's and a recovery's figures.
_SHOWN = ("trusted", "verdict", "reasons", "cautions", "cause", "remedies", "signs", "self_check", "pairing")


def overview(folder: AppFolder, version: str) -> dict[str, Any]:
    """The first page."""
    return {
        "folder": str(folder.path),
        "version": version,
        "free_bytes": shutil.disk_usage(folder.path).free,
        "recordings": [summary(folder, name) for name in folder.recordings()],
        "templates": [path.stem for path in folder.template_files()],
    }


def summary(folder: AppFolder, name: str, with_printed: bool = False) -> dict[str, Any]:
    """A recording in the list, perhaps with what its last job printed."""
    place = folder.of(name)
    kept = read_kept(place)
    job = _job(place, with_printed)
    figures = _verdict(place / FIGURES) or _verdict(place / CHECK)
    return {
        "id": name,
        "name": kept.name,
        "person": kept.person,
        "date": recorded_date(place, kept),
        "created_s": kept.created_s,
        "files": len(files_of(place)),
        "recovered": (place / RESULT).is_file(),
        "trusted": None if figures is None else figures["trusted"],
        "verdict": "" if figures is None else figures["verdict"],
        "job": job,
    }


def recording(folder: AppFolder, name: str) -> dict[str, Any]:
    """One recording: files, streams without their plots, choices, results, and its job."""
    place = folder.of(name)
    kept = read_kept(place)
    made_of = read_json(job_folder(place) / "recover.json").get("stamp", "")
    known = described(place)
    seen = {Path(each["file"]).name for each in known}
    files = files_of(place)
    return {
        **summary(folder, name, with_printed=True),
        "own_date": kept.date,
        "revision": kept.revision,
        "choices": kept.choices.model_dump(),
        "dropped": [{"name": path.name, "bytes": path.stat().st_size} for path in files],
        "looked_at": [each["file"] for each in known] if seen >= {path.name for path in files} else [],
        "looked_ns": (place / STREAMS).stat().st_mtime_ns if (place / STREAMS).is_file() else 0,
        "imported": (place / recording_of(place)).is_file(),
        "proposals": _proposals(place, kept.choices, known),
        "camera_video": _camera_video(folder, kept.choices, known),
        "check": _verdict(place / CHECK),
        "result": _verdict(place / FIGURES) if (place / RESULT).is_file() else None,
        "report": (place / REPORT).is_file(),
        "report_at": (place / REPORT).stat().st_mtime_ns if (place / REPORT).is_file() else 0,
        "outdated": bool((place / RESULT).is_file() and made_of not in ("", stamp(folder, place))),
        "exports": [each for each, file in EXPORTS.items() if (place / "exports" / file).is_file()],
        "unread": [Path(each["file"]).name for each in known if each["error"]]
        + [path.name for path in files if (place / STREAMS).is_file() and not path.stat().st_size],
        "downloads": [file for file in (recording_of(place), *DOWNLOADS) if (place / file).is_file()],
    }


def _camera_video(folder: AppFolder, choices: Choices, files: list[dict[str, Any]]) -> dict[str, Any] | None:
    """The video used as the camera: its file, the model's, and whether MediaPipe is there."""
    used = [each for each in files if Path(each["file"]).name not in choices.left_out]
    film = camera_video(used)
    if film is None:
        return None
    return {
        "file": Path(film["file"]).name,
        "model": Path(model_of(folder, used)).name,
        "installed": find_spec("mediapipe") is not None,
    }


def _proposals(place: Path, choices: Choices, files: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Where each IMU is worn by `match`, by the key that a choice names it with."""
    matches = {each["imu"]: each for each in read_json(place / MATCHES).get("matches", [])}
    topics: dict[str, list[str]] = {}
    for report in read_json(place / IMPORTED).get("files", []):
        imus = [topic for topic in report["topics"] if topic.startswith("/imu/")]
        for part in report["path"].split(", "):
            topics.setdefault(Path(part).name, []).extend(imus)
    found = {}
    for each in files:
        keys = [key for key in sensor_keys([each]) if choices.places.get(key, "") != "-"]
        for key, topic in zip(keys, topics.get(Path(each["file"]).name, []), strict=False):
            if topic in matches:
                found[key] = matches[topic]
    return found


def streams(folder: AppFolder, name: str) -> dict[str, Any]:
    """What the files contain, with plots; every IMU has the `key` by which a choice names it."""
    place = folder.of(name)
    files = described(place)
    for each in files:
        count = sum(stream["kind"] == "imu" for stream in each["streams"])
        each["streams"] = [
            {**stream, "key": sensor_key(each["file"], stream, count)} for stream in each["streams"]
        ]
        each["name"] = Path(each["file"]).name
        each["error"], each["notes"] = in_page_words(each["error"]), in_page_words(each["notes"])
    return {"files": files}


def _job(place: Path, with_printed: bool) -> dict[str, Any] | None:
    """How far a recording's last job is; with what its commands printed once it has ended."""
    job = read_job(place)
    if job is None:
        return None
    progress, is_open = read_json(job_folder(place) / "progress.json"), job.state in OPEN
    names = [str(step.get("name", "")) for step in job.steps]
    return {
        **job.model_dump(include={"number", "kind", "state", "step"}),
        "steps": len(names),
        "step_name": names[job.step] if job.step < len(names) else "",
        "share": float(progress.get("share", -1.0)),  # Part done of it, 0 to 1; -1 where it does not say
        "text": str(progress.get("text", "")),  # What it is doing
        "sentence": in_page_words(job.sentence),
        "printed": printed(place) if with_printed and not is_open else "",
        "open": is_open,
    }


def _verdict(path: Path) -> dict[str, Any] | None:
    figures = read_json(path)
    if "trusted" not in figures:
        return None
    shown = {key: figures.get(key) for key in (*_SHOWN, "allows")}
    return {key: value if key == "remedies" else in_page_words(value) for key, value in shown.items()}


#: What a sentence of a command calls an option or a command, and where the page has it.
_PLACES = (
    (r"`?--(mirror|swap|negate|camera-frame)\b( [a-z]+(,[a-z]+)*)?`?", "the button that corrects it"),
    (r"`?--imu-starts-at( [A-Z]+)?`?", '"First IMU sample after the camera\'s first frame" (More options)'),
    (r"`?--side( [A-Za-z]+)?`?", '"Arm" (More options)'),
    (r"`?--body( [A-Z]+)?`?", '"Person" (More options)'),
    (r"`?--calibration( [A-Za-z.]+)?`?", "a calibration file dropped with the others"),
    (r"`?--model( [A-Za-z._]+)?`?", "the model's file dropped with the others"),
    (r"`?--mirrored`?", '"The video is mirrored"'),
    (r"`?--turn( [A-Z]+)?`?", '"Rotate the video"'),
    (r"`?--imu [A-Za-z_]+=[^ `,;]*`?", '"Worn on"'),
    (r"`?(unocclude )?import describe( [A-Za-z._/]+)?`?", '"Describe this table"'),
    (r"`?--template( [A-Za-z._]+)?`?", '"Describe this table"'),
)


def in_page_words(value: Any) -> Any:
    """A command's sentence, or several, with what the page offers in place of the command line's options."""
    if isinstance(value, list):
        return [in_page_words(each) for each in value]
    if isinstance(value, dict):
        return {key: in_page_words(each) for key, each in value.items()}
    if isinstance(value, str):
        for pattern, words in _PLACES:
            value = re.sub(pattern, words, value)
    return value
