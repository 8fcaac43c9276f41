"""`unocclude view`: a result in Rerun, in a window or in the browser."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from ..errors import UnoccludeError
from .options import Result, Side, one_side
from .output import say
from .web_page import LOOPBACK, WebPage, free_port

#: The port `discard`, where nobody answers.
NOWHERE = f"http://{LOOPBACK}:9"
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
    """Show a result in Rerun: the arm in space, upright; place and flexion with 2 sigma; the gaps.

    Needs rerun-sdk (`pip install unocclude[view]`). It listens on 127.0.0.1 alone and speaks to nobody
    else: no usage statistics, no questions for newer versions. A window closes as usual; --web is ended
    by Ctrl-C.
    """
    from ..io import read_recovery
    from ..io.export.rrd import rerun_module
    from .export import prepared_rrd

    side = one_side(side)
    recoveries = [recovery for recovery in read_recovery(result) if side in (None, recovery.side)]
    if not recoveries:
        raise UnoccludeError(f"{result}: there is no recovered arm {side!r} in this file")
    rerun_module()
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


def data_address(port: int) -> str:
    """Where a web viewer finds the data, as its address bar takes it."""
    return f"rerun%2Bhttp%3A%2F%2F{LOOPBACK}%3A{port}%2Fproxy"


def window(file: Path) -> list[str]:
    """Command line of the viewer in a window."""
    return [str(program()), "--bind", LOOPBACK, "--port", "auto", "--hide-welcome-screen", str(file)]


def web_server(file: Path, page_port: int, data_port: int) -> list[str]:
    """Command line of the viewer that serves a browser: its page and the data."""
    ports = ["--port", str(data_port), "--serve-web", "--web-viewer-port", str(page_port)]
    return [str(program()), "--bind", LOOPBACK, *ports, str(file)]


def program() -> Path:
    """Rerun's viewer itself: its wrapper in Python hides how it ended, and lives on when it is stopped.

    Raises
    ------
    UnoccludeError
        rerun-sdk does not bring one for this machine.
    """
    spec = find_spec("rerun_cli")
    folders = [Path(folder) for folder in (spec.submodule_search_locations or ())] if spec else []
    names = ("Rerun.app/Contents/MacOS/Rerun", "rerun", "rerun.exe")
    for file in (folder / name for folder in folders for name in names):
        if file.is_file():
            return file
    raise UnoccludeError(
        "rerun-sdk is installed without its viewer; `unocclude export --format rrd` writes a file that"
        " any Rerun viewer opens"
    )


def check_ports(*ports: int) -> None:
    """Refuse ports that another program has.

    Raises
    ------
    UnoccludeError
        The first that is taken, and how to take another.
    """
    for port in ports:
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((LOOPBACK, port))
            except OSError as error:
                raise UnoccludeError(
                    f"port {port} of {LOOPBACK} cannot be used ({error.strerror}); give others with"
                    " --port and --web-port"
                ) from error


def environment() -> dict[str, str]:
    """The viewer's environment, in which it speaks to nobody but this machine.

    Rerun reports its use to tel.rerun.io unless `CI` is set, and asks GitHub for newer versions whatever is
    set: its way out leads to a proxy that is not there.
    """
    proxies = ("http_proxy", "https_proxy", "all_proxy", "no_proxy")
    dropped = {"force_rerun_analytics", *proxies}
    variables = {name: value for name, value in os.environ.items() if name.lower() not in dropped}
    for name in proxies:
        value = f"{LOOPBACK},localhost" if name == "no_proxy" else NOWHERE
        variables |= {name: value, name.upper(): value}
    return variables | {"CI": "true"}


def show(arguments: list[str]) -> None:
    """Run the viewer until it is closed.

    Raises
    ------
    UnoccludeError
        It ended with an error; its last words are in the sentence.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as words:
        viewer = subprocess.Popen(arguments, env=environment(), stdout=words, stderr=subprocess.STDOUT)
        # Ending this command ends the viewer, and the file with the patient's motion goes.
        before = signal.signal(signal.SIGTERM, signal.default_int_handler)
        try:
            code = viewer.wait()
        except KeyboardInterrupt:
            return
        finally:
            signal.signal(signal.SIGTERM, before)
            viewer.terminate()
            viewer.wait()
        words.seek(0)
        lines = [line.strip() for line in words if line.strip()]
    if code:
        last = lines[-1][:300] if lines else "it said nothing"
        raise UnoccludeError(
            f"Rerun's viewer ended with an error ({last}); `unocclude view --web` shows the result in a"
            " browser"
        )
