"""`unocclude view`: a result in a window of Rerun."""

from __future__ import annotations

from pathlib import Path

from ..errors import UnoccludeError
from .arm_output import warn
from .options import Result, Side, one_side
from .output import say


def view(
    result: Result,
    side: Side = None,
) -> None:
    """Show a result in Rerun: the arm in space, curves, gaps.

    Needs rerun-sdk (`pip install '.[view]'`). It listens on 127.0.0.1 only and contacts no other
    computer: no usage statistics, no update checks.
    """
    import tempfile

    from ..io import read_recovery
    from ..io.export.rrd import rerun_module
    from .export import prepared_rrd
    from .viewer import show, window

    side = one_side(side)
    recoveries = [recovery for recovery in read_recovery(result) if side in (None, recovery.side)]
    if not recoveries:
        raise UnoccludeError(f"{result}: there is no recovered arm {side!r} in this file")
    rerun_module()
    warn(recoveries)
    ready = prepared_rrd(result, recoveries)
    with tempfile.TemporaryDirectory(prefix="unocclude-") as folder:
        file = Path(folder) / f"{result.stem}.rrd"
        ready.write(file, False)
        say("the window of Rerun opens; close it to end")
        show(window(file))
