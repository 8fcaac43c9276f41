"""`unocclude view`: a result in a window of Rerun, which communicates with this machine only."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path

from ..errors import UnoccludeError
from . import options as o
from .arm_output import warn
from .load import load_recoveries
from .output import say

#: Nobody but this machine may read what is shown: these are patients.
LOOPBACK = "127.0.0.1"
#: The port `discard`, where nothing answers.
NOWHERE = f"http://{LOOPBACK}:9"
INSTEAD = "`unocclude export --format rrd` writes a file that any Rerun viewer opens"


def view(result: o.Result, side: o.Side = None) -> None:
    """Show a result in Rerun: the arm in space, curves, gaps.

    Needs rerun-sdk (`pip install '.[view]'`). It listens on 127.0.0.1 only and contacts no other
    computer: no usage statistics, no update checks.

    Example: unocclude view recovered.mcap
    """
    from ..io.export.rrd import rerun_module
    from .export import prepared_rrd

    recoveries = load_recoveries(result, side)
    rerun_module()
    warn(recoveries)
    ready = prepared_rrd(result, recoveries)
    with tempfile.TemporaryDirectory(prefix="unocclude-") as folder:
        file = Path(folder) / f"{result.stem}.rrd"
        ready.write(file, False)
        say("the window of Rerun opens; close it to end")
        show(window(file))


def window(file: Path) -> list[str]:
    """Command line of the viewer in a window."""
    return [str(program()), "--bind", LOOPBACK, "--port", "auto", "--hide-welcome-screen", str(file)]


def program() -> Path:
    """Rerun's viewer itself: its wrapper in Python hides how it ended, and lives on when it is stopped."""
    spec = find_spec("rerun_cli")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        for name in ("Rerun.app/Contents/MacOS/Rerun", "rerun", "rerun.exe"):
            if (file := Path(folder) / name).is_file():
                return file
    raise UnoccludeError(f"rerun-sdk is installed without its viewer; {INSTEAD}")


def environment() -> dict[str, str]:
    """The viewer's environment, in which it communicates with this machine only.

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
    """Run the viewer until it is closed."""
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as words:
        viewer = subprocess.Popen(arguments, env=environment(), stdout=words, stderr=subprocess.STDOUT)
        # Ending this command ends the viewer, and the file with the patient's motion is deleted.
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
        raise UnoccludeError(f"Rerun's viewer ended with an error ({last}); {INSTEAD}")
