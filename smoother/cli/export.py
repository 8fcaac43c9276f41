"""`unocclude export`, `methods`, `view`: a result in other formats, as a methods section, in Rerun."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import typer

from ..errors import UnoccludeError
from . import options as o
from .load import ResultInput, camera_frame_of, damage
from .output import Out, print_notes, say, warn, write_text

if TYPE_CHECKING:
    from ..array_types import FloatArray
    from ..io.export.grid import Export
    from ..result import Recovery


Format = Literal["csv", "trc", "mot", "c3d", "parquet", "sto", "rrd", "bids"]
FORMATS = get_args(Format)
#: Endings of files that are none of these.
NO_FORMATS = ("osim", "mcap", "html", "json", "toml", "mat", "xlsx")


def export(
    result: o.Result,
    output: Annotated[Path, o.value("FILE", "Output file.", "-o", "--output"), o.UNCHECKED],
    arms: ResultInput,
    out: Out,
    format_name: Annotated[Format, o.option("Format to write.", "--format")],
    frame: Annotated[
        Literal["camera", "opensim"] | None,
        o.option(
            "Axes of trc (default opensim) and c3d (default camera); opensim: y up against gravity, x"
            " level towards the camera, origin in the camera."
        ),
    ] = None,
    rate: Annotated[o.Number, o.value("HZ", "Rate of trc, mot and c3d.  [default: the IMU's]")] = None,
    origin: Annotated[Literal["camera", "shoulder"] | None, o.option("Of trc and c3d.")] = None,
    subject: Annotated[o.Text, o.rare_value("LABEL", "For bids.  [default: the result's name]")] = None,
    session: Annotated[str | None, o.rare_value("LABEL", "For bids: session.")] = None,
    task: Annotated[str | None, o.rare_value("LABEL", "For bids: task.  [default: arm]")] = None,
    recording: Annotated[o.File, o.rare_value("REC.mcap", "For bids: what the result was made from.")] = None,
) -> None:
    """Write a result for OpenSim, MATLAB, R and others.

    Several arms give one file each; rrd and bids contain all of them. docs/exports.md describes each format.
    Stretches that are not to be trusted are printed to stderr and marked in the file.

    Example: unocclude export recovered.mcap --format trc -o recovered.trc
    """
    of_files = {"--frame": frame, "--origin": origin, "--rate": rate}
    of_bids = {"--subject": subject, "--session": session, "--task": task, "--recording": recording}
    _check(
        format_name, output, rate, [name for name, value in (of_files | of_bids).items() if value is not None]
    )
    recoveries = arms.load(result)
    if format_name == "bids":
        figures, notes = _bids(recoveries, output, (subject, session, task), recording, out)
    else:
        figures, notes = _files(result, recoveries, output, format_name, frame, rate, origin, out)
    out.json(figures)
    warn(recoveries)
    print_notes([*(note for recovery in recoveries for note in damage(recovery.notes)), *notes])


def _files(
    result: Path,
    recoveries: list[Recovery],
    output: Path,
    format_name: str,
    frame: str | None,
    rate: float | None,
    origin: str | None,
    out: Out,
) -> tuple[dict[str, Any], list[str]]:
    """A file for each arm, or one for all; all arms are ready before the first is written."""
    from .. import __version__
    from ..io.export.prepare import DEFAULT_FRAME, prepare_export
    from ..result.untrusted import untrusted_sentences

    together = format_name == "rrd"
    paths = [output] if together else output_names(output, recoveries)
    out.check(paths, [result])
    if together:
        exports = [prepared_rrd(result, recoveries)]
    else:
        wants_up = (frame or DEFAULT_FRAME.get(format_name)) == "opensim"
        level_down = _level_down(result, recoveries) if wants_up else None
        chosen = (format_name, frame, rate, level_down, __version__, origin or "camera")
        exports = [prepare_export(recovery, *chosen) for recovery in recoveries]
    for path, ready in zip(paths, exports, strict=True):
        ready.write(path, out.force)
        say(f"written: {path} ({ready.rows} row{'s' if ready.rows != 1 else ''})")
    figures = [
        {
            "file": str(path),
            "rows": ready.rows,
            "side": "" if together and len(recoveries) > 1 else recovery.side,
            **({} if recovery.body is None else {"body": recovery.body}),
            "rate_hz": ready.rate_hz,
            "frame": ready.frame,
            "origin_ns": recovery.origin_ns,
            "trusted": recovery.estimates.trusted,
            "verdict": recovery.estimates.verdict,
            "untrusted": list(untrusted_sentences(recovery)),
            "notes": [*damage(recovery.notes), *ready.notes],
        }
        for recovery, path, ready in zip(recoveries, paths, exports, strict=False)
    ]
    return {"files": figures}, [note for ready in exports for note in ready.notes]


def _bids(
    recoveries: list[Recovery],
    output: Path,
    labels: tuple[str | None, str | None, str | None],
    source: Path | None,
    out: Out,
) -> tuple[dict[str, Any], list[str]]:
    """A session of a data set: the recording, where it is named, and the answer."""
    from .. import __version__
    from ..io import read_recordings
    from ..io.export.bids import BidsNames, label_of, write_bids

    subject, session, task = labels
    names = BidsNames(subject or label_of(recoveries[0].name), session or "", task or "arm")
    wanted = {(recovery.side, recovery.body) for recovery in recoveries}
    recordings, notes = [], []
    if source is None:
        notes.append("the data set has the answer alone; --recording REC.mcap adds what it was made from")
    else:
        recordings = [each for each in read_recordings(source) if (each.side, each.body) in wanted]
        if not recordings:
            raise UnoccludeError(
                f"{source} has none of the result's arms; name the recording it was made from"
            )
    count = write_bids(output, names, recordings, recoveries, __version__, out.force)
    say(f"written: {output} ({count} motion files of sub-{names.subject})")
    figures = {"folder": str(output), "subject": names.subject, "session": names.session, "task": names.task}
    return figures | {"motion_files": count, "notes": notes}, notes


def output_names(output: Path, recoveries: list[Recovery]) -> list[Path]:
    """One file per arm: the name as given, or with body, side (and a number) before its ending."""
    if len(recoveries) == 1:
        return [output]
    names: list[Path] = []
    for recovery in recoveries:
        mark = ("" if recovery.body is None else f"body_{recovery.body}_") + (recovery.side or "arm")
        marks = (mark, *(f"{mark}{number}" for number in range(2, len(recoveries) + 1)))
        each = (output.with_name(f"{output.stem}_{mark}{output.suffix}") for mark in marks)
        names.append(next(name for name in each if name not in names))
    return names


def _check(format_name: str, output: Path, rate: float | None, given: list[str]) -> None:
    """Refuse what cannot be meant, before any work is done for it."""
    from ..io.export.prepare import WITH_FRAME, WITH_RATE

    of_format = {"--frame": WITH_FRAME, "--origin": WITH_FRAME, "--rate": WITH_RATE}
    for option in given:
        if format_name not in (formats := of_format.get(option, ("bids",))):
            raise typer.BadParameter(f"{option} is for {', '.join(formats)}, not for {format_name}")
    if rate is not None and not 1 <= rate <= 10_000:
        raise typer.BadParameter(f"--rate is between 1 and 10000 Hz, not {rate:g}")
    ending = output.suffix.lower().removeprefix(".")
    if ending != format_name and ending in (*FORMATS, *NO_FORMATS):
        other = f", or --format {ending}" if ending in FORMATS else ""
        name = output.with_suffix(f".{format_name}")
        raise typer.BadParameter(f"{output}: the output is {format_name}; name it {name}{other}")


def _level_down(result: Path, recoveries: list[Recovery]) -> FloatArray | None:
    """Down in the camera's axes if the camera is level, where a method did not find gravity."""
    import numpy as np

    if all(np.isfinite(recovery.gravity_direction).all() for recovery in recoveries):
        return None
    axes = camera_frame_of(result)
    return None if axes is None else axes.down


def prepared_rrd(result: Path, recoveries: list[Recovery]) -> Export:
    """All arms for Rerun."""
    from ..io.export.rrd import prepare_rrd

    return prepare_rrd(recoveries, _level_down(result, recoveries))


def methods(
    result: o.Result,
    arms: ResultInput,
    out: Out,
    output: Annotated[
        o.File, o.value("FILE", "Write Markdown instead of printing.", "-o", "--output"), o.WRITTEN
    ] = None,
) -> None:
    """Write a paper's methods section: text, table, references.

    It states only what the file contains: sensors and rates, method and version, calibration,
    clocks, gaps, uncertainty, self-check, settings that are not the defaults. What the ISB's recommendations
    on reporting IMUs require beyond that is listed for you to fill in.

    Example: unocclude methods recovered.mcap -o methods.md
    """
    from ..io.result.read import read_origin
    from ..report.methods import methods_section

    recoveries = arms.load(result)
    version, title = read_origin(result)
    is_simulated = title.lower().startswith("simulated")  # the title of `unocclude simulate`
    text, figures = methods_section(recoveries, version, title if is_simulated else "")
    write_text(output, text, out.force)
    out.json(figures)
    if output is None:
        print(text, end="")
    warn(recoveries)
    if output is not None:
        out.end(output)


#: Nobody but this machine may read what is shown: these are patients.
LOOPBACK = "127.0.0.1"
#: The port `discard`, where nothing answers.
NOWHERE = f"http://{LOOPBACK}:9"
INSTEAD = "`unocclude export --format rrd` writes a file that any Rerun viewer opens"


def view(result: o.Result, arms: ResultInput) -> None:
    """Show a result in Rerun: the arm in space, curves, gaps.

    Needs rerun-sdk (`pip install '.[view]'`). It listens on 127.0.0.1 only and contacts no other
    computer: no usage statistics, no update checks.

    Example: unocclude view recovered.mcap
    """
    from ..io.export.rrd import rerun_module

    recoveries = arms.load(result)
    rerun_module()
    warn(recoveries)
    ready = prepared_rrd(result, recoveries)
    with tempfile.TemporaryDirectory(prefix="unocclude-") as folder:
        file = Path(folder) / f"{result.stem}.rrd"
        ready.write(file, False)
        say("the window of Rerun opens; close it to end")
        show_window(window(file))


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


def show_window(arguments: list[str]) -> None:
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
