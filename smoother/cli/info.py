"""`unocclude info`: what a recording holds."""

from __future__ import annotations

from .options import Force, Json, RecordingPath
from .output import check_outputs, print_notes, print_table, say, write_json


def info(recording_file: RecordingPath, json_file: Json = None, force: Force = False) -> None:
    """Show topics, rates, durations, clocks and gaps, and what is missing for which step."""
    from ..io import describe

    check_outputs(force, [json_file], [recording_file])
    about = describe(recording_file).to_dict()
    write_json(json_file, about, force)
    print_about(str(recording_file), about)


def print_about(title: str, about: dict[str, object]) -> None:
    """Print what a recording holds."""
    from .imports import about_table

    print_table(title, *about_table(about))
    rest = [(name, value) for name, value in about.items() if name not in ("topics", "notes", "missing")]
    print_table("Arm", ("what", "value"), rest)
    print_notes(about.get("notes") or [])  # type: ignore[arg-type]
    missing = about.get("missing") or {}
    if isinstance(missing, dict):
        for step, reasons in missing.items():
            say(f"{step}: {reasons}")
