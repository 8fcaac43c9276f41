"""What rows of a study say of the machine: nothing, unless asked for."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from .fingerprint import text_hash

if TYPE_CHECKING:
    from .job import Job


def place_of(word: str, source: str) -> str:
    """A recording's place as a hash with the study's word as its key: known again, but not read."""
    return text_hash("place", word, source)[:32]


def without_places(text: str, job: Job) -> str:
    """A sentence without the folders and the name of this machine.

    Parameters
    ----------
    text : str
        May hold paths.
    job : Job
        Its recording is called by its name in the study, its folder by ".", other files by their last name.
    """
    import socket

    calibration = Path(job.calibration)
    places = {job.source: job.name, job.folder: "."}
    if job.calibration:
        places |= {job.calibration: calibration.name, str(calibration.parent): ""}
    places[str(Path(job.source).parent)] = ""
    for folder in (tempfile.gettempdir(), os.getcwd(), os.path.expanduser("~")):
        places.setdefault(folder, f"[{'temporary' if folder == tempfile.gettempdir() else 'own'} folder]")
    for path in sorted(places, key=len, reverse=True):  # the longest first: folders lie in folders
        if path and path.strip("/\\"):
            text = text.replace(path, places[path])
    host = socket.gethostname()
    return text.replace(host, "a machine") if len(host) > 3 else text
