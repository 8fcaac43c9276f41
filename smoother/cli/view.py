"""`unocclude view`: a result in a window of Rerun."""

from __future__ import annotations

from pathlib import Path

from . import options as o
from .arm_output import warn
from .load import load_recoveries
from .output import say


def view(result: o.Result, side: o.Side = None) -> None:
    """Show a result in Rerun: the arm in space, curves, gaps.

    Needs rerun-sdk (`pip install '.[view]'`). It listens on 127.0.0.1 only and contacts no other
    computer: no usage statistics, no update checks.

    Example: unocclude view recovered.mcap
    """
    import tempfile

    from ..io.export.rrd import rerun_module
    from .export import prepared_rrd
    from .viewer import show, window

    recoveries = load_recoveries(result, side)
    rerun_module()
    warn(recoveries)
    ready = prepared_rrd(result, recoveries)
    with tempfile.TemporaryDirectory(prefix="unocclude-") as folder:
        file = Path(folder) / f"{result.stem}.rrd"
        ready.write(file, False)
        say("the window of Rerun opens; close it to end")
        show(window(file))
