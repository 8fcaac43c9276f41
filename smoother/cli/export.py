"""`unocclude export`: a result in other formats. `unocclude methods`: as the methods section of a paper."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import typer

from ..errors import UnoccludeError
from . import options as o
from .arm_output import warn
from .load import camera_frame_of, damage, load_recoveries
from .output import check_outputs, print_notes, say, say_written, write_json, write_text

if TYPE_CHECKING:
    from ..array_types import FloatArray
    from ..io.export.rows import Export
    from ..result import Recovery


Format = Literal["csv", "trc", "mot", "c3d", "parquet", "sto", "rrd", "bids"]
FORMATS = get_args(Format)
#: Endings of files that are none of these.
NO_FORMATS = ("osim", "mcap", "html", "json", "toml", "mat", "xlsx")


def export(
    result: o.Result,
    output: o.Output,
    format_name: Annotated[Format, o.option("Format to write.", "--format")],
    side: o.Side = None,
    body: o.Body = None,
    frame: Annotated[
        Literal["camera", "opensim"] | None,
        o.option(
            "Axes of trc (default opensim) and c3d (default camera); opensim: y up against gravity, x"
            " level towards the camera, origin in the camera."
        ),
    ] = None,
    rate: Annotated[o.Number, o.value("HZ", "Rate of trc, mot and c3d.  [default: the IMU's]")] = None,
    origin: Annotated[Literal["camera", "shoulder"] | None, o.option("Of trc and c3d.")] = None,
    json_file: o.Json = None,
    force: o.Force = False,
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
    from .. import __version__
    from ..io.export.prepare import DEFAULT_FRAME, prepare_export
    from ..result.untrusted import untrusted_sentences

    only: dict[str, object] = {"--frame": frame, "--origin": origin, "--rate": rate}
    only |= {"--subject": subject, "--session": session, "--task": task, "--recording": recording}
    _check(format_name, output, rate, [option for option, value in only.items() if value is not None])
    recoveries = load_recoveries(result, side, body)
    if format_name == "bids":
        _bids(result, recoveries, output, (subject, session, task), recording, json_file, force)
        return
    together = format_name == "rrd"
    files = [output] if together else output_names(output, recoveries)
    check_outputs(force, [*files, json_file], [result])
    # All arms are ready before the first is written.
    if together:
        exports = [prepared_rrd(result, recoveries)]
    else:
        wants_up = (frame or DEFAULT_FRAME.get(format_name)) == "opensim"
        level_down = _level_down(result, recoveries) if wants_up else None
        chosen = (format_name, frame, rate, level_down, __version__, origin or "camera")
        exports = [prepare_export(recovery, *chosen) for recovery in recoveries]
    for path, ready in zip(files, exports, strict=True):
        ready.write(path, force)
    figures = []
    shown = recoveries[:1] if together else recoveries  # of one file for all what is the same in all
    for recovery, path, ready in zip(shown, files, exports, strict=True):
        say(f"written: {path} ({ready.rows} row{'s' if ready.rows != 1 else ''})")
        figures.append(
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
        )
    warn(recoveries)
    print_notes(note for recovery in recoveries for note in damage(recovery.notes))
    print_notes(note for ready in exports for note in ready.notes)
    write_json(json_file, {"files": figures}, force)


def _bids(
    result: Path,
    recoveries: list[Recovery],
    output: Path,
    labels: tuple[str | None, str | None, str | None],
    source: Path | None,
    json_file: Path | None,
    force: bool,
) -> None:
    """A session of a data set: the recording, where it is named, and the answer."""
    from .. import __version__
    from ..io import read_recordings
    from ..io.export.bids import BidsNames, label_of, write_bids

    subject, session, task = labels
    names = BidsNames(subject or label_of(recoveries[0].name), session or "", task or "arm")
    check_outputs(force, [json_file], [result, source])
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
    count = write_bids(output, names, recordings, recoveries, __version__, force)
    say(f"written: {output} ({count} motion files of sub-{names.subject})")
    warn(recoveries)
    print_notes([*(note for recovery in recoveries for note in damage(recovery.notes)), *notes])
    figures = {"folder": str(output), "subject": names.subject, "session": names.session, "task": names.task}
    write_json(json_file, figures | {"motion_files": count, "notes": notes}, force)


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


def _check(format_name: str, output: Path, rate: float | None, given: Iterable[str]) -> None:
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
    output: Annotated[
        Path | None,
        o.value("FILE", "Write Markdown instead of printing.", "-o", "--output"),
    ] = None,
    side: o.Side = None,
    body: o.Body = None,
    json_file: o.Json = None,
    force: o.Force = False,
) -> None:
    """Write a paper's methods section: text, table, references.

    It states only what the file contains: sensors and rates, method and version, calibration,
    clocks, gaps, uncertainty, self-check, settings that are not the defaults. What the ISB's recommendations
    on reporting IMUs require beyond that is listed for you to fill in.

    Example: unocclude methods recovered.mcap -o methods.md
    """
    from ..io.result.read import read_origin
    from ..report.methods import methods_section

    check_outputs(force, [output, json_file], [result])
    recoveries = load_recoveries(result, side, body)
    version, title = read_origin(result)
    is_simulated = title.lower().startswith("simulated")  # the title of `unocclude simulate`
    text, figures = methods_section(recoveries, version, title if is_simulated else "")
    if output is None:
        print(text, end="")
    write_text(output, text, force)
    write_json(json_file, figures, force)
    warn(recoveries)
    if output is not None:
        say_written(output, json_file)
