"""`unocclude app`: the whole way on one page in this computer's browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ..runtime.packages import extra_module

#: Where recordings are stored unless the user says otherwise.
FOLDER = Path("unocclude")


def app(
    port: Annotated[
        int | None,
        typer.Option(
            "--port", metavar="N", min=0, max=65535, help="Port of the page.  [default: a free one]"
        ),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            "--folder",
            metavar="DIR",
            help="Folder for recordings and results; created if missing.  [default: unocclude, in your home"
            " folder]",
            show_default=False,
        ),
    ] = None,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Print the address only, without opening a browser.")
    ] = False,
) -> None:
    """Open the local page: from files to report in the browser.

    The printed address contains a token, which is required. Other computers cannot open the page.
    Ctrl-C ends it: what is running then is stopped and can be repeated, all else is kept in the folder.
    """
    for name, package in (("uvicorn", "uvicorn"), ("starlette", "starlette")):
        extra_module(name, package, "app")
    from ..app.folder import AppFolder
    from ..app.serving import serve

    def ready(address: str) -> None:
        print(address, flush=True)
        if not no_browser:
            import webbrowser

            webbrowser.open(address)

    serve(AppFolder(Path.home() / FOLDER if folder is None else folder), port, ready)
