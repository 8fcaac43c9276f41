"""What was measured as text: one function a table, each gives lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from .whole import PATIENCE_S

#: What the project aims at; printed beside.
AIM_TIMES_REAL = 100.0
AIM_PEAK_MB = 250.0
AIM_HELP_S = 0.3
AIM_REST_SHARE = 0.5
AIM_PLAIN = {6.0: 8.0, 30.0: 20.0}
#: Parts that take less than this, s a minute of recording, have no growth to speak of.
LEAST_S = 0.002
#: Functions of the rest that are listed.
FUNCTIONS = 15


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A title, column heads and rows; the first column to the left, numbers to the right."""
    widths = [max(len(row[i]) for row in (columns, *rows)) for i in range(len(columns))]

    def line(row: Sequence[str]) -> str:
        cells = [
            text.ljust(w) if i == 0 else text.rjust(w)
            for i, (text, w) in enumerate(zip(row, widths, strict=True))
        ]
        return "  " + "  ".join(cells).rstrip()

    return ["", title, line(columns), *(line(row) for row in rows)]


def number(value: float | None, digits: int = 1) -> str:
    """Digits after the point; "-" where the value is missing."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def whole(runs: list[dict[str, Any]]) -> list[str]:
    """End to end, memory and exactness by length."""
    rows = [
        (
            f"{run['minutes']:g} min",
            number(run["file_mb"]),
            number(run["length_s"] / run["seconds"], 0),
            number(run["seconds"]),
            number(60.0 * run["cpu_s"] / run["length_s"], 2),
            number(run["main_mb"] or None, 0),
            number(run["worker_mb"] or None, 0),
            str(run["workers"]),
            str(run["exact"]["gaps"]),
            number(run["exact"]["rms_cm"], 2),
            number(run["exact"]["max_cm"], 2),
            number(run["exact"]["rms_deg"], 2),
            number(100.0 * run["exact"]["inside_95"], 1),
        )
        for run in runs
    ]
    columns = (
        "`unocclude smooth`",
        "file MB",
        "x real time",
        "s",
        "CPU s a min",
        "peak MB",
        "worker MB",
        "workers",
        "gaps",
        "rms cm",
        "max cm",
        "rms deg",
        "95 % holds",
    )
    title = (
        f"End to end, file to file, program start included (aim: {AIM_TIMES_REAL:.0f} x at 60 min,"
        f" {AIM_PEAK_MB:.0f} MB per process at any length); errors in gaps against the simulated motion.\n"
        "Peak: private memory (RssAnon, looked at every 20 ms) of the main process and of the largest worker;"
        " mapped files and libraries are left out."
    )
    return table(title, columns, rows)


def against(ratios: dict[float, dict[str, float]], python: str) -> list[str]:
    """Another installation beside ours by length."""
    rows = [
        (f"{minutes:g} min", *(number(value, 2) for value in each.values()))
        for minutes, each in ratios.items()
    ]
    title = f"`unocclude smooth` of {python} over ours, ratio of medians (above 1: ours needs less)"
    return table(title, ("length", "time", "CPU time", "peak", "worker's peak"), rows)


def waiting(commands: list[dict[str, Any]], minutes: float) -> list[str]:
    """What a person waits for, each beside `smooth`, and what lets them wait too long without a word."""
    (smooth_s,) = (each["seconds"] for each in commands if each["name"] == "smooth")
    rows = [
        (
            each["name"],
            number(each["seconds"]),
            number(each["seconds"] / smooth_s, 2),
            "yes" if each["shows_progress"] else "no",
        )
        for each in commands
    ]
    mute = [each["name"] for each in commands if each["seconds"] > PATIENCE_S and not each["shows_progress"]]
    said = f"Longer than {PATIENCE_S:g} s without a word of how far they are: {', '.join(mute) or 'none'}."
    title = f"What a person waits for, {minutes:g} minutes"
    return [*table(title, ("unocclude", "s", "of smooth", "progress"), rows), said]


def beside(minutes: float, found: dict[str, Any], command_s: float | None, length_s: float) -> list[str]:
    """Other methods on one recording."""
    ours = found["smooth"]["own_s"]
    rows = []
    for name, each in found.items():
        if isinstance(each, str):
            rows.append((name, each, *[""] * 10))
            continue
        own, exact = each["own_s"], each["exact"]
        sign = "> " if each.get("stopped") else ""
        rows.append(
            (
                name,
                sign + number(own, 2),
                sign + number(each["all_s"], 2),
                number(each["cpu_s"], 2),
                number(length_s / own, 0) if not sign else f"< {number(length_s / own, 0)}",
                "" if name == "smooth" else sign + number(own / ours, 2),
                "" if name == "smooth" or command_s is None else sign + number(own / command_s, 2),
                number(each["peak_mb"], 0),
                number(exact["rms_cm"], 2) if exact else "-",
                number(exact["max_cm"], 2) if exact else "-",
                number(100.0 * exact["inside_95"], 1) if exact else "-",
                "" if name == "smooth" or not exact else number(each["from_smooth_cm"], 2),
            )
        )
    columns = (
        f"{minutes:g} min",
        "own s",
        "with needs s",
        "CPU s",
        "x real time",
        "smooth is faster x",
        "command is faster x",
        "peak MB",
        "rms cm",
        "max cm",
        "95 % holds",
        "from smooth cm",
    )
    aim = AIM_PLAIN.get(minutes)
    title = (
        "Beside other ways, from a recording in memory to an answer in memory; all but `smooth` are given"
        " what it found"
        + (f" (aim: {aim:g} x faster than a plain graph)" if aim else "")
        + ".\n`smooth` runs on all processes, self-calibration included; the command also starts, reads and"
        " writes."
    )
    lines = table(title, columns, rows)
    for name, each in found.items():
        if isinstance(each, dict) and each.get("steps"):
            steps = {k: v for k, v in each["steps"].items() if k not in ("iterations", "nodes")}
            lines.append(
                f"  {name}: {each['steps']['nodes']} nodes, {each['steps']['iterations']} iterations; "
                + ", ".join(f"{step} {number(s, 2)} s" for step, s in steps.items())
            )
    return lines
