"""What changes from run to run, taken out of texts: folders, the version, durations, dates of the clock."""

from __future__ import annotations

import re
from pathlib import Path

from smoother import __version__

PROJECT = Path(__file__).parents[2]
_VERSION = re.escape(__version__)
#: Patterns and their replacements, in this order; each names its source.
MASKS: tuple[tuple[str, str], ...] = (
    # `unocclude 0.1.0`, and the metadata of results and of JSON
    (rf"\bunocclude {_VERSION}", "unocclude VERSION"),
    (rf'("(?:version|unocclude)":\s*"){_VERSION}"', r'\1VERSION"'),
    # `live`: a line of the state whenever a second of the wall has passed
    (r"(?m)^ *\d+\.\d s  .*; step \d+\.\d ms; load \d+ %.*\n", ""),
    # figures of `live`, in JSON: how busy the computer was
    (r'("(?:load|step_ms|busy)":\s*)[-\d.e+]+', r"\1LOAD"),
    # how long something took, in JSON and in tables of `batch`
    (
        r'("(?:seconds|elapsed_s|took_s|cpu_s|finished|started|peak_memory_mb)":\s*)("[^"]*"|[-\d.e+]+)',
        r"\1TIME",
    ),
    # `batch`: how long it took, and where and when its inputs and the study itself came to be
    (r"\b(now in )[\d.]+ \w+, [\d.]+ times real time", r"\1TIME"),
    (r'("(?:input_place|input_state)":\s*)"[0-9a-f]{32}"', r'\1"PLACE"'),
    (r'("output_mtime_ns":\s*)\d+', r"\1MOMENT"),
    (r"\A[0-9a-f]{32}\s*\Z", "STUDY"),
    # files of a study's rows are called by the moment
    (r"\brows-\d+-[0-9a-f]+\.parquet", "rows-MOMENT.parquet"),
    # a date with a time, as ISO 8601 has it, of this century's twenties on the wall
    (r"\b20[2-9]\d-[01]\d-[0-3]\d[T ][0-2]\d:[0-5]\d(:[0-5]\d(\.\d+)?)?(Z|\+00:00)?", "MOMENT"),
)


def masked(text: str, folder: Path | None = None) -> str:
    """The text without what changes from run to run.

    Parameters
    ----------
    text : str
    folder : Path, optional
        Where the command ran: stands as FOLDER.
    """
    if folder is not None:
        for name in sorted({str(folder), str(folder.resolve())}, key=len, reverse=True):
            text = text.replace(name, "FOLDER")
    text = text.replace(str(PROJECT), "PROJECT")
    for pattern, instead in MASKS:
        text = re.sub(pattern, instead, text)
    return text
