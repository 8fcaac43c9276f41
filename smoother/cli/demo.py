"""`unocclude demo` and `app`: the main job on a small recording, or on a page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from ..runtime.packages import extra_module
from . import options as o
from .load import PersonConfigInput, ResultInput, TrialInput
from .output import Out, check_outputs, say, say_command, write_json

#: Used where `data/` has no recording.
SEED = 1


def demo(
    folder: Annotated[Path, o.value("FOLDER", "Replaces an earlier one.", "-o", "--output")] = Path(
        "out/demo"
    ),
    processes: o.Processes = None,
    json_file: o.Json = None,
) -> None:
    """Recover a small recording, validate it, write a report.

    Example: unocclude demo
    """
    from ..error_radius import in_cm, within_words
    from .evaluation import validate
    from .smooth import smooth

    folder.mkdir(parents=True, exist_ok=True)
    check_outputs(True, [json_file])
    source, result = _recording(folder), folder / "demo_recovered.mcap"
    report, smooth_json, validate_json = (
        folder / f"demo_{name}" for name in ("report.html", "smooth.json", "validate.json")
    )
    say(f"recording: {source}")
    smooth(source, result, TrialInput(), PersonConfigInput(processes=processes), Out(smooth_json, True))
    out = Out(validate_json, True)
    validate(result, ResultInput(), out, source, report=report, processes=processes)
    recovery, validation = (
        json.loads(path.read_text(encoding="utf-8")) for path in (smooth_json, validate_json)
    )
    write_json(json_file, {"recovery": recovery, "validation": validation, "report": report.name}, True)
    hidden = validation["occluded"]
    within, most = within_words(hidden["position_p95_m"]), in_cm(hidden["position_max_m"])
    say(f"In the gaps the answer is {within} of the truth, {most} at most.")
    say("Without any calibration, as a first recording of your own. The same by hand:")
    say_command("smooth", source, "-o", result, "--force")
    say_command("validate", result, "--truth", source)
    say(f"report: {report.resolve()}")


def _recording(folder: Path) -> Path:
    """The recording beside the source tree, or one simulated on the spot."""
    kept = Path(__file__).parents[2] / "data" / "demo.mcap"
    if kept.is_file():
        return kept
    from ..io import write_recording
    from ..simulation import ArmSimulation, simulate_arm

    path = folder / "demo.mcap"
    write_recording(simulate_arm(ArmSimulation.preset("realistic"), SEED).recording, path, force=True)
    return path


#: Where recordings are stored unless the user says otherwise.
FOLDER = Path("unocclude")


def app(
    port: Annotated[
        int | None, o.rare_value("N", "Of the page.  [default: a free one]", min=0, max=65535)
    ] = None,
    folder: Annotated[o.File, o.value("DIR", "Of recordings.  [default: ~/unocclude]")] = None,
    no_browser: Annotated[bool, o.option("Print the address only.", "--no-browser")] = False,
) -> None:
    """Open the local page: from files to report in the browser.

    The printed address contains a token, which is required. Other computers cannot open the page.
    Ctrl-C ends it: what is running then is stopped and can be repeated, all else is kept in the folder.

    Example: unocclude app --folder recordings
    """
    for name, package in (("uvicorn", "uvicorn"), ("starlette", "starlette")):
        extra_module(name, package, "app")
    from ..app.folder import AppFolder
    from ..app.server import redirect_file, serve

    place = AppFolder(Path.home() / FOLDER if folder is None else folder)

    def ready(address: str) -> None:
        print(address, flush=True)
        if not no_browser:
            import webbrowser

            webbrowser.open(redirect_file(place, address).as_uri())

    serve(place, port, ready)
