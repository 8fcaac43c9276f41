"""What the page is sent: recordings in a list, one recording with all that is known of it, comparisons."""

from __future__ import annotations

import re
import shutil
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from .folder import AppFolder, Choices, read_json, read_kept
from .jobs import OPEN, latest, state_of
from .steps import (
    CHECK,
    EXPORTS,
    FIGURES,
    IMPORTED,
    MATCHES,
    REPORT,
    RESULT,
    STREAMS,
    camera_video,
    described,
    files_of,
    model_of,
    recorded_date,
    recording_of,
    sensor_key,
    sensor_keys,
    stamp,
)

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
        "comparisons": [comparison(folder, name) for name in folder.comparisons()],
        "templates": [path.stem for path in folder.template_files()],
    }


def summary(folder: AppFolder, name: str, printed: bool = False) -> dict[str, Any]:
    """A recording in the list; `printed`: with what its last job printed."""
    place = folder.of(name)
    kept = read_kept(place)
    job = _job(place, printed)
    figures = _verdict(place / FIGURES) or _verdict(place / CHECK)
    return {
        "id": name,
        "name": kept.name,
        "person": kept.person,
        "date": recorded_date(place, kept),
        "task": kept.task,
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
    mine = stamp(folder, place)
    known = described(place)
    seen = {Path(each["file"]).name for each in known}
    files = files_of(place)
    return {
        **summary(folder, name, printed=True),
        "own_date": kept.date,
        "revision": kept.revision,
        "choices": kept.choices.model_dump(),
        "stamp": mine,
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
        "outdated": bool((place / RESULT).is_file() and _result_stamp(place) not in ("", mine)),
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


def comparison(folder: AppFolder, name: str) -> dict[str, Any]:
    """A person's sessions compared."""
    place = folder.comparison(name)
    about = read_json(place / "comparison.json")
    return {
        "id": name,
        "person": about.get("person", ""),
        "ready": (place / "progress.html").is_file(),
        "job": _job(place),
    }


def _job(place: Path, printed: bool = True) -> dict[str, Any] | None:
    job = latest(place)
    if job is None:
        return None
    state = state_of(job, printed)
    state["sentence"] = in_page_words(state["sentence"])
    return {**state, "open": state["state"] in OPEN}


def _result_stamp(place: Path) -> str:
    """The stamp of the job that made the result."""
    jobs = place / "jobs"
    for job in sorted(jobs.iterdir(), reverse=True) if jobs.is_dir() else ():
        state = state_of(job)
        if (state["kind"], state["state"]) == ("recover", "done"):
            stamped: str = state["stamp"]
            return stamped
    return ""


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
