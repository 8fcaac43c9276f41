"""Rerun's viewer as a process that speaks to nobody but this machine."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path

from ..errors import UnoccludeError
from .web_page import LOOPBACK

#: The port `discard`, where nobody answers.
NOWHERE = f"http://{LOOPBACK}:9"


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
