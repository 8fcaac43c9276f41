"""A progress bar on stderr, on a terminal only."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ..runtime.printable import printable

Progress = Callable[[float, str], None]


@contextmanager
def progress_bar(text: str) -> Iterator[Progress]:
    """Yield a function (part done 0 to 1, what is being done) that moves the bar."""
    if not sys.stderr.isatty():
        yield lambda fraction, text: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    bar = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
        auto_refresh=False,  # it would take a thread, and worker processes start fastest without
    )
    with bar:
        task = bar.add_task(text, total=1.0)
        yield lambda fraction, text: bar.update(
            task, completed=fraction, description=printable(text), refresh=True
        )
