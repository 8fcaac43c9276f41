"""Which column of a table is the time, and in what unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from .joints import TIME_WORDS, column_named, time_unit_of, words_of
from .table import DeviceTable, shown
from .units import SECONDS, TIME, in_seconds, plain_unit, time_unit

#: This share of the steps of a column of times rises, and lies within these parts of the usual one.
_RISES, _EVEN, _EVEN_SHARE = 0.95, (0.3, 3.0), 0.8
#: Fewer rows than these rise by chance.
_FEWEST = 8


def time_column(table: DeviceTable) -> int | None:
    """The column that is the time by its name; without names the first."""
    if not table.labels:
        return 0
    exact = column_named(table.names, TIME_WORDS)
    first = 0 if table.labels[0].startswith(("time", "timestamp", "elapsed", "epoch")) else None
    return first if exact is None else exact


def stated_time_unit(table: DeviceTable, column: int) -> str:
    """The unit that a column of times states, in brackets or in its name; "" where it states none."""
    return TIME.get(plain_unit(table.unit(column)), "") or time_unit_of(
        table.names[column] if table.names else ""
    )


def seconds(table: DeviceTable, column: int | None, unit: str = "s") -> FloatArray | None:
    """Times of a column, (n,) in s, dates since 1970; None for no column or one without times."""
    if column is None or not any(table.texts(column)[:2000]):
        return None
    times, dates = table.times(column)
    if dates or not np.isfinite(times).any():
        return times if np.isfinite(times).any() else None
    stated = TIME.get(plain_unit(table.unit(column)), unit)
    fits = time_unit(stated, times) or stated
    note = f"Times are in {fits}, by the rate or the date that they give, not in {stated}."
    if fits != stated and note not in table.notes:
        table.notes.append(note)
    return in_seconds(times, fits)


def time_among(
    table: DeviceTable, free: Sequence[int], rates_hz: tuple[float, float], notes: list[str]
) -> tuple[int | None, str]:
    """The column that is the time and its unit ("iso" of dates), of those that nothing else is known of."""
    for at in free:
        name = shown(table.name(at).removeprefix("column "), 60)
        try:
            values, dates = table.times(at)
        except RecordingError:  # of words, not of times
            continue
        step = np.diff(values[np.isfinite(values)])
        moved = step[step != 0]
        rises = len(moved) and (moved > 0).mean() > _RISES
        if {"x", "y", "z", "w"} & set(words_of(name)) or len(values) < _FEWEST or not rises:
            continue
        if dates:
            return at, "iso"
        if len(moved) < 0.3 * (len(values) - 1):
            continue
        usual = float(np.median(moved))
        if usual == 1 and (values % 1 == 0)[np.isfinite(values)].all() and np.nanmax(values) < 1e11:
            notes.append(f"The column {name} counts rows or packets and is not the time.")
            continue
        unit = time_unit("", values, rates_hz)
        even = ((step > _EVEN[0] * usual) & (step < _EVEN[1] * usual)).mean() > _EVEN_SHARE
        if unit is None and not even:
            continue
        if unit is None or not even or not (step > 0).all() or not np.isfinite(values).all():
            raise RecordingError(
                f"{table.path} has no time by its name; its column {name} rises like one, in no certain unit:"
                " call it time_s, time_ms, time_us, time_ns or time_ticks, or describe it in a recording.toml"
                f" (`unocclude import describe {table.path}`)."
            )
        notes.append(
            f"The column {name} was taken for the time, in {unit}: it alone rises evenly, with"
            f" {1 / (usual * SECONDS[unit]):.4g} rows per second."
        )
        return at, unit
    return None, ""
