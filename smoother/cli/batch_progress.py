"""The table of a study that runs, on a terminal only."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from ..runtime.printable import printable

if TYPE_CHECKING:
    from ..study.columns import Row
    from ..study.run import Tally

#: Recordings that are shown, the latest ones.
SHOWN = 12


@contextmanager
def study_progress() -> Iterator[Callable[[Tally, Row | None], None]]:
    """Yield a function (tally, row of the recording that has just ended or None) that renews the table."""
    if not sys.stderr.isatty():
        yield lambda tally, row: None
        return
    from rich.console import Console
    from rich.live import Live

    latest: deque[Row] = deque(maxlen=SHOWN)
    with Live(console=Console(stderr=True), refresh_per_second=4, transient=True) as live:

        def show(tally: Tally, row: Row | None) -> None:
            if row is not None:
                latest.append(row)
            live.update(progress_table(tally, latest))

        yield show


def progress_table(tally: Tally, latest: deque[Row]) -> Any:
    """How far a study is, and its latest recordings."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=headline(tally), title_justify="left", title_style="bold")
    table.add_column("recording", overflow="fold")
    for column in ("length, s", "gaps", "largest sigma, cm", "times real time"):
        table.add_column(column, justify="right")
    table.add_column("")
    for row in latest:
        distrusted = row.get("trusted") is False
        length, sigma, spent = (row.get(name) for name in ("duration_s", "sigma_max_m", "seconds"))
        cells = (
            row["recording"],
            "" if length is None else f"{length:.0f}",
            "" if row.get("gaps") is None else str(row["gaps"]),
            "" if sigma is None else f"{100 * sigma:.1f}",
            "" if length is None or not spent else f"{length / spent:.0f}",
            row.get("error") or ("not to be trusted" if distrusted else row["status"]),
        )
        bad = distrusted or row["status"] == "failed"
        table.add_row(*[Text(printable(cell)) for cell in cells], style="red" if bad else None)
    return table


def headline(tally: Tally) -> str:
    """How far a study is, in a line."""
    sentence = f"{tally.ended} of {tally.total}"
    if tally.failed:
        sentence += f", {tally.failed} failed"
    worked = tally.computed + tally.failed
    if worked and tally.seconds > 0:
        left_s = (tally.total - tally.ended) * tally.seconds / worked
        sentence += f"; {tally.recorded_s / tally.seconds:.0f} times real time, {_clock(left_s)} left"
    return sentence


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}"
