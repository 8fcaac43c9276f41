"""`unocclude export`, `methods`, `view`: a result in other formats, as a methods section, in Rerun."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from socket import socket
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from ..errors import UnoccludeError
from . import options as o
from .load import ResultInput, camera_frame_of
from .output import Out, print_notes, say, warn, write_text

if TYPE_CHECKING:
    from ..array_types import FloatArray
    from ..io.export.prepare import Export
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
    session: Annotated[o.Text, o.rare_value("LABEL", "For bids: session.")] = None,
    task: Annotated[o.Text, o.rare_value("LABEL", "For bids: task.  [default: arm]")] = None,
    recording: Annotated[o.File, o.rare_value("REC.mcap", "For bids: what the result was made from.")] = None,
) -> None:
    """Write a result for OpenSim, MATLAB, R and others.

    Several arms give one file each; rrd and bids contain all of them. docs/exports.md describes each format.
    Stretches that are not to be trusted are printed to stderr and marked in the file.

    Example: unocclude export recovered.mcap --format trc -o recovered.trc
    """
    from ..io.mcap.messages import damage

    given = {"--frame": frame, "--origin": origin, "--rate": rate}
    of_bids = {"--subject": subject, "--session": session, "--task": task, "--recording": recording}
    _check(
        format_name, output, rate, [name for name, value in (given | of_bids).items() if value is not None]
    )
    recoveries = arms.load(result)
    if format_name == "bids":
        figures = _bids(recoveries, output, (subject, session, task), recording, out)
    else:
        figures = _files(result, recoveries, output, (format_name, frame, rate, origin), out)
    out.json(figures)
    warn(recoveries)
    of_files = (note for file in figures.get("files", [figures]) for note in file["notes"])
    print_notes([*(note for recovery in recoveries for note in damage(recovery.notes)), *of_files])


def _files(
    result: Path,
    recoveries: list[Recovery],
    output: Path,
    chosen: tuple[str, str | None, float | None, str | None],
    out: Out,
) -> dict[str, Any]:
    """A file for each arm, or one for all; all arms are ready before the first is written."""
    from .. import __version__
    from ..io.export import DEFAULT_FRAME, prepare_export
    from ..io.mcap.messages import damage
    from ..result.untrusted import untrusted_sentences

    format_name, frame, rate, origin = chosen
    together = format_name == "rrd"
    paths = [output] if together else output_names(output, recoveries)
    out.check(paths, [result])
    if together:
        exports = [prepared_rrd(result, recoveries)]
    else:
        wants_up = (frame or DEFAULT_FRAME.get(format_name)) == "opensim"
        level_down = _level_down(result, recoveries) if wants_up else None
        how = (format_name, frame, rate, level_down, __version__, origin or "camera")
        exports = [prepare_export(recovery, *how) for recovery in recoveries]
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
    return {"files": figures}


def _bids(
    recoveries: list[Recovery],
    output: Path,
    labels: tuple[str | None, str | None, str | None],
    source: Path | None,
    out: Out,
) -> dict[str, Any]:
    """A session of a data set: the recording, where it is named, and the answer."""
    from .. import __version__
    from ..io import read_recordings
    from ..io.export.bids import BidsNames, label_of, write_bids

    subject, session, task = labels
    names = BidsNames(subject or label_of(recoveries[0].name), session or "", task or "arm")
    wanted = {(recovery.side, recovery.body) for recovery in recoveries}
    read = [] if source is None else read_recordings(source)
    recordings = [each for each in read if (each.side, each.body) in wanted]
    if source is not None and not recordings:
        raise UnoccludeError(f"{source} has none of the result's arms; name the recording it was made from")
    alone = "the data set has the answer alone; --recording REC.mcap adds what it was made from"
    count = write_bids(output, names, recordings, recoveries, __version__, out.force)
    say(f"written: {output} ({count} motion files of sub-{names.subject})")
    figures = {"folder": str(output), "subject": names.subject, "session": names.session, "task": names.task}
    return figures | {"motion_files": count, "notes": [alone] if source is None else []}


def output_names(output: Path, recoveries: list[Recovery]) -> list[Path]:
    """One file per arm: the name as given, or with body, side (and a number) before its ending."""
    names: list[Path] = [output] if len(recoveries) == 1 else []
    for recovery in recoveries[len(names) :]:
        mark = ("" if recovery.body is None else f"body_{recovery.body}_") + (recovery.side or "arm")
        marks = (mark, *(f"{mark}{number}" for number in range(2, len(recoveries) + 1)))
        each = (output.with_name(f"{output.stem}_{mark}{output.suffix}") for mark in marks)
        names.append(next(name for name in each if name not in names))
    return names


def _check(format_name: str, output: Path, rate: float | None, given: list[str]) -> None:
    """Refuse what cannot be meant, before any work is done for it."""
    from ..io.export import WITH_FRAME, WITH_RATE

    of_format = {"--frame": WITH_FRAME, "--origin": WITH_FRAME, "--rate": WITH_RATE}
    fitting = {option: of_format.get(option, ("bids",)) for option in given}
    wrong: dict[str, object] = {
        f"{option} is for {', '.join(formats)}, not for {format_name}": format_name not in formats
        for option, formats in fitting.items()
    }
    if rate is not None:
        wrong[f"--rate is between 1 and 10000 Hz, not {rate:g}"] = not 1 <= rate <= 10_000
    ending = output.suffix.lower().removeprefix(".")
    other = f", or --format {ending}" if ending in FORMATS else ""
    name = output.with_suffix(f".{format_name}")
    wrong[f"{output}: the output is {format_name}; name it {name}{other}"] = (
        ending != format_name and ending in (*FORMATS, *NO_FORMATS)
    )
    o.refuse(wrong)


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
        show_window(window("--port", "auto", str(file)))


def window(*options: str) -> list[str]:
    """Command line of the viewer itself: its wrapper in Python hides how it ended, and outlives it."""
    spec = find_spec("rerun_cli")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    names = ("Rerun.app/Contents/MacOS/Rerun", "rerun", "rerun.exe")
    programs = [path for folder in folders for name in names if (path := Path(folder) / name).is_file()]
    if not programs:
        raise UnoccludeError(f"rerun-sdk is installed without its viewer; {INSTEAD}")
    return [str(programs[0]), "--bind", LOOPBACK, "--hide-welcome-screen", *options]


#: A viewer that cannot open its window has ended by then, s.
_OPENS_S = 1.0


@contextmanager
def live_window() -> Iterator[str]:
    """The address at which a viewer listens meanwhile."""
    with socket() as free:
        free.bind((LOOPBACK, 0))
        port = free.getsockname()[1]
    silent = subprocess.DEVNULL
    viewer = subprocess.Popen(window("--port", str(port)), env=environment(), stdout=silent, stderr=silent)
    try:
        with suppress(subprocess.TimeoutExpired):
            viewer.wait(_OPENS_S)
            raise UnoccludeError("Rerun's window does not open (is there a screen?); leave out --view")
        yield f"rerun+http://{LOOPBACK}:{port}/proxy"
    finally:
        viewer.terminate()
        viewer.wait()


def environment() -> dict[str, str]:
    """The viewer's environment, in which it communicates with this machine only.

    Rerun reports its use to tel.rerun.io unless `CI` is set, and asks GitHub for newer versions whatever is
    set: its way out leads to a proxy that is not there.
    """
    proxies = dict.fromkeys(("http_proxy", "https_proxy", "all_proxy"), NOWHERE)
    proxies["no_proxy"] = f"{LOOPBACK},localhost"
    dropped = {"force_rerun_analytics", *proxies}
    variables = {name: value for name, value in os.environ.items() if name.lower() not in dropped}
    return variables | proxies | {name.upper(): value for name, value in proxies.items()} | {"CI": "true"}


def show_window(arguments: list[str]) -> None:
    """Run the viewer until it is closed; it ends with this command."""
    with suppress(KeyboardInterrupt):
        words = subprocess.PIPE, subprocess.STDOUT
        viewer = subprocess.run(arguments, env=environment(), stdout=words[0], stderr=words[1], check=False)
        if viewer.returncode:
            said = viewer.stdout.decode("utf-8", "replace").split("\n")
            last = next((line.strip()[:300] for line in reversed(said) if line.strip()), "it said nothing")
            raise UnoccludeError(f"Rerun's viewer ended with an error ({last}); {INSTEAD}")
