"""`unocclude demo` and `app`: the main job on a small recording, or on a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from ..runtime.packages import extra_module
from . import options as o
from .output import check_outputs, progress_bar, say, say_command, write_json

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
    from .. import smooth
    from ..error_radius import in_cm, within_words
    from ..evaluation.validate import validate
    from ..io import read_recording, write_recovery
    from ..report import write_report
    from ..result.draws import USUAL_DRAWS
    from .config import read_config
    from .smooth import print_recovery, smooth_figures

    folder.mkdir(parents=True, exist_ok=True)
    check_outputs(True, [json_file])
    source = _recording(folder)
    recording = read_recording(source)
    say(f"recording: {source}")
    config = read_config(None, processes)
    with progress_bar("recovering") as progress:
        recovery = smooth(recording, None, config, progress, draws=USUAL_DRAWS)
    result, report = folder / "demo_recovered.mcap", folder / "demo_report.html"
    write_recovery([recovery], result, source=source, force=True)
    truth = recording.truth
    validation = None
    if truth is not None:
        with progress_bar("measuring") as progress:
            validation = validate(recovery, truth, processes=processes or 0, progress=progress)
    write_report(recovery, report, recording=recording, validation=validation, truth=truth, force=True)
    figures = {
        "recovery": smooth_figures(recording, recovery),
        "validation": validation and validation.to_dict(),
        "report": report.name,
    }
    write_json(json_file, figures, True)
    print_recovery(recording, recovery)
    if validation is not None and validation.occluded.position_p95_m is not None:
        within, most_m = within_words(validation.occluded.position_p95_m), validation.occluded.position_max_m
        say(f"In the gaps the answer is {within} of the truth, {in_cm(most_m or 0.0)} at most.")
    say("Joints, joint angles and the calibration are in the report.")
    by_hand = folder / "by_hand.mcap"
    say("Without any calibration, as a first recording of your own. The same by hand:")
    say_command("smooth", source, "-o", by_hand, "--force")
    if validation is not None:
        say_command("validate", by_hand, "--truth", source)
    say(f"result: {result}")
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
    from ..app.serving import redirect_file, serve

    place = AppFolder(Path.home() / FOLDER if folder is None else folder)

    def ready(address: str) -> None:
        print(address, flush=True)
        if not no_browser:
            import webbrowser

            webbrowser.open(redirect_file(place, address).as_uri())

    serve(place, port, ready)
