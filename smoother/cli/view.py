"""`unocclude view`: a result in Rerun, in a window or in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..errors import UnoccludeError
from .arm_output import warn
from .options import Result, Side, one_side
from .output import say

#: Where the web viewer waits, and where the data comes from.
WEB_PORT, DATA_PORT = 9090, 9876


def view(
    result: Result,
    side: Side = None,
    web: Annotated[
        bool,
        typer.Option("--web", help="Serve a viewer for the browser of this machine instead of a window."),
    ] = False,
    web_port: Annotated[
        int,
        typer.Option("--web-port", metavar="N", min=1, max=65535, help="Port of the page, with --web."),
    ] = WEB_PORT,
    port: Annotated[
        int,
        typer.Option("--port", metavar="N", min=1, max=65535, help="Port of the data, with --web."),
    ] = DATA_PORT,
) -> None:
    """Show a result in Rerun: the arm in space, curves, gaps.

    Needs rerun-sdk (`pip install '.[view]'`). It listens on 127.0.0.1 only and contacts no other
    computer: no usage statistics, no update checks. Ctrl-C ends --web.
    """
    import tempfile

    from ..io import read_recovery
    from ..io.export.rrd import rerun_module
    from .export import prepared_rrd
    from .viewer import LOOPBACK, WebPage, check_ports, data_address, free_port, show, web_server, window

    side = one_side(side)
    recoveries = [recovery for recovery in read_recovery(result) if side in (None, recovery.side)]
    if not recoveries:
        raise UnoccludeError(f"{result}: there is no recovered arm {side!r} in this file")
    rerun_module()
    warn(recoveries)
    if web:
        check_ports(web_port, port)
    ready = prepared_rrd(result, recoveries)
    with tempfile.TemporaryDirectory(prefix="unocclude-") as folder:
        file = Path(folder) / f"{result.stem}.rrd"
        ready.write(file, False)
        if not web:
            say("the window of Rerun opens; close it to end")
            show(window(file))
            return
        inner_port = free_port()
        with WebPage(web_port, inner_port, port):
            say(f"open http://{LOOPBACK}:{web_port}/?url={data_address(port)}  (Ctrl-C ends it)")
            show(web_server(file, inner_port, port))
