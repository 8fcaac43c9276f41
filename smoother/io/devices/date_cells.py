"""Dates and times of day written as text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta, timezone

import numpy as np

from ...array_types import FloatArray

_DATE = re.compile(
    r"(?:(\d{4})[-/.](\d\d?)[-/.](\d\d?)|(\d\d?)([-/.])(\d\d?)[-/.](\d{4}))[ T_]+"
    r"(\d\d?)[:.](\d\d)[:.](\d\d)(?:[.,:_](\d+))?\s*([AaPp][Mm])?\s*"
    r"(?:Z|UTC|GMT)?\s*(?:([+-])(\d\d?):?(\d\d)?)?"
)
#: To the way of writing that Arrow reads: from 2026/01/31, 10:11:12,5, and a blank before +0100.
_PLAINER = (
    (r"^(\d{4})[/.](\d\d)[/.](\d\d)", r"\1-\2-\3"),
    (r"(:\d\d),(\d{1,9})", r"\1.\2"),
    (r"\s+([+-]\d\d:?\d\d|Z)$", r"\1"),
)
_TIME_OF_DAY = re.compile(r"(\d\d?):(\d\d):(\d\d)(?:[.,:_](\d+))?")
_DAY_S = 86_400.0


def seconds_of_dates(cells: Sequence[str]) -> FloatArray:
    """Times of dates (`2026-01-31T10:11:12.5Z`, with or without a zone) or of times of day (`10:11:12.5`).

    Parameters
    ----------
    cells : sequence of str
        Dates without a zone count as UTC. `31.1.2026` is a day first, `1/31/2026` a month first.

    Returns
    -------
    ndarray, shape (n,), s
        Since 1970, or since midnight (going on past the next one); nan for a cell that is neither.
    """
    fast = _by_arrow(cells)
    if fast is not None:
        return fast
    seconds = np.array([_seconds(cell.strip()) for cell in cells], dtype=float)
    if np.nanmax(seconds, initial=0.0) < 2 * _DAY_S:  # times of day: midnight passes
        steps = np.diff(seconds, prepend=seconds[:1])
        seconds = seconds + _DAY_S * np.cumsum(np.nan_to_num(steps) < -_DAY_S / 2)
    return seconds


def _by_arrow(cells: Sequence[str]) -> FloatArray | None:
    import pyarrow as pa
    import pyarrow.compute as pc

    text = pa.array(cells, pa.string())
    for pattern, plain in _PLAINER:
        text = pc.replace_substring_regex(text, pattern, plain)
    for zone in (None, "UTC"):
        try:
            stamps = pc.cast(pc.cast(text, pa.timestamp("ns", zone)), pa.int64())
        except pa.ArrowException:
            continue
        whole = stamps.to_numpy(zero_copy_only=False)
        return whole // 1_000_000_000 + (whole % 1_000_000_000) * 1e-9
    return None


def _seconds(cell: str) -> float:
    written = _DATE.fullmatch(cell)
    if written is None:
        of_day = _TIME_OF_DAY.fullmatch(cell)
        if of_day is None:
            return float("nan")
        hours, minutes, seconds, fraction = of_day.groups()
        return int(hours) * 3600 + int(minutes) * 60 + int(seconds) + float(f"0.{fraction or 0}")
    y, m, d, one, mark, two, year, hours, minutes, seconds, fraction, noon, sign, zone_h, zone_m = (
        written.groups()
    )
    if y is None:
        y, m, d = (year, one, two) if mark == "/" else (year, two, one)
    hour = int(hours) % 12 + 12 * (noon.lower() == "pm") if noon else int(hours)
    offset = timedelta(hours=int(zone_h), minutes=int(zone_m or 0)) if sign else timedelta()
    try:
        zone = timezone(-offset if sign == "-" else offset) if sign else UTC
        whole = datetime(int(y), int(m), int(d), hour, int(minutes), int(seconds), tzinfo=zone)
    except ValueError:
        return float("nan")
    return whole.timestamp() + float(f"0.{fraction or 0}")
