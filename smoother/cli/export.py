"""`unocclude export`: a result in other formats. `unocclude methods`: as the methods section of a paper."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import UnoccludeError
from .arm_output import warn
from .load import camera_frame_of, damage, load_recoveries
from .options import Body, Force, Json, Output, Result, Side, one_side
from .output import check_outputs, print_notes, say, say_written, write_json

if TYPE_CHECKING:
    from ..array_types import FloatArray
    from ..io.export.prepare import Export
    from ..result import Recovery


FORMATS = ("csv", "trc", "mot", "c3d", "parquet", "sto", "rrd", "bids")
ORIGINS = ("camera", "shoulder")
FRAMES = ("camera", "opensim")
#: Endings of files that are none of these.
NO_FORMATS = ("osim", "mcap", "html", "json", "toml", "mat", "xlsx")


def export(
    result: Result,
    output: Output,
    format_name: Annotated[
        str, typer.Option("--format", metavar="|".join(FORMATS), help="Format to write.", show_default=False)
    ],
    side: Side = None,
    body: Body = None,
    frame: Annotated[
        str | None,
        typer.Option(
            "--frame",
            metavar="|".join(FRAMES),
            help="Axes of trc (default opensim) and c3d (default camera); opensim: y up against gravity, x"
            " level towards the camera, origin in the camera.",
            show_default=False,
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate",
            metavar="HZ",
            help="Rows per second of trc, mot and c3d.  [default: the IMU's]",
            show_default=False,
        ),
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(
            "--origin",
            metavar="|".join(ORIGINS),
            help="Origin of trc and c3d: the camera, or the shoulder's median position.  [default: camera]",
            show_default=False,
        ),
    ] = None,
    draws: Annotated[
        bool,
        typer.Option("--draws", help="For parquet: write the drawn motions instead of the result."),
    ] = False,
    subject: Annotated[
        str | None,
        typer.Option(
            "--subject",
            metavar="LABEL",
            help="For bids: participant.  [default: the result's name]",
            show_default=False,
        ),
    ] = None,
    session: Annotated[
        str | None,
        typer.Option("--session", metavar="LABEL", help="For bids: session.", show_default=False),
    ] = None,
    task: Annotated[
        str | None,
        typer.Option("--task", metavar="LABEL", help="For bids: task.  [default: arm]", show_default=False),
    ] = None,
    recording: Annotated[
        Path | None,
        typer.Option(
            "--recording",
            metavar="REC.mcap",
            help="For bids: what the result was made from; its joints and IMUs are the raw data.",
            show_default=False,
        ),
    ] = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Write a result for OpenSim, MATLAB, R and others.

    Several arms give one file each; rrd and bids contain all of them.

    csv and parquet: one row per sample of the forearm IMU with poses, joints and sigmas, in metres and the
    camera's axes; parquet with units, configuration and figures as metadata. trc and c3d: markers after and
    before (camera_*), in mm, blank or residual -1 where missing; c3d with the gaps as events. mot: joint
    angles in degrees with a constant step and a number in every cell; column `answered` is 0 where a
    straight line bridges a stretch without an answer. sto: orientations of all IMUs for OpenSim's
    OpenSense, rows without one left out. bids: a session of a Motion-BIDS data set, the folder OUTPUT,
    which is begun or added to: camera and IMUs as they were recorded, the recovered arm as a derivative.
    rrd: a recording of Rerun with its views, all arms in one file; `unocclude view` opens it (needs
    `pip install '.[view]'`).

    Stretches that are not to be trusted are printed to stderr and marked in the file: column or channel
    `trusted`, dark red in rrd.
    """
    from ..result.untrusted import untrusted_sentences

    _check(format_name, frame, rate, origin)
    if draws and format_name != "parquet":
        raise typer.BadParameter(f"--draws is for parquet, not for {format_name}")
    if format_name != "bids" and (subject or session or task or recording):
        raise typer.BadParameter(
            f"--subject, --session, --task and --recording are for bids, not for {format_name}"
        )
    _check_ending(output, format_name)
    recoveries = load_recoveries(result, one_side(side), body)
    if format_name == "bids":
        _bids(result, recoveries, output, (subject, session, task), recording, json_file, force)
        return
    together = format_name == "rrd"
    files = [output] if together else output_names(output, recoveries)
    check_outputs(force, [*files, json_file], [result])
    # All arms are ready before the first is written.
    exports = (
        [prepared_rrd(result, recoveries)]
        if together
        else _prepared(result, recoveries, format_name, frame, rate, origin or "camera", draws)
    )
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
    sides = [
        (f"body_{recovery.body}_" if recovery.body is not None else "") + (recovery.side or "arm")
        for recovery in recoveries
    ]
    names = []
    for place, side in enumerate(sides):
        again = sides[:place].count(side)
        mark = f"{side}{again + 1}" if again else side
        names.append(output.with_name(f"{output.stem}_{mark}{output.suffix}"))
    return names


def _check_ending(output: Path, format_name: str) -> None:
    """Refuse a name whose ending says another format."""
    ending = output.suffix.lower().removeprefix(".")
    if ending != format_name and ending in (*FORMATS, *NO_FORMATS):
        other = f", or --format {ending}" if ending in FORMATS else ""
        name = output.with_suffix(f".{format_name}")
        raise typer.BadParameter(f"{output}: the output is {format_name}; name it {name}{other}")


def _check(format_name: str, frame: str | None, rate: float | None, origin: str | None) -> None:
    """Refuse what cannot be meant, before any work is done for it."""
    from ..io.export.prepare import WITH_FRAME, WITH_RATE

    if format_name not in FORMATS:
        raise typer.BadParameter(
            f"the format '{format_name}' is not available; formats: {', '.join(FORMATS)}"
        )
    for option, value, values, formats in (
        ("--frame", frame, FRAMES, WITH_FRAME),
        ("--origin", origin, ORIGINS, WITH_FRAME),
        ("--rate", rate, (rate,), WITH_RATE),
    ):
        if value is not None and value not in values:
            raise typer.BadParameter(f"{option} is {' or '.join(map(str, values))}, not '{value}'")
        if value is not None and format_name not in formats:
            raise typer.BadParameter(f"{option} is for {', '.join(formats)}, not for {format_name}")
    if rate is not None and not 1 <= rate <= 10_000:
        raise typer.BadParameter(f"--rate is between 1 and 10000 Hz, not {rate:g}")


def _prepared(
    result: Path,
    recoveries: list[Recovery],
    format_name: str,
    frame: str | None,
    rate: float | None,
    origin: str,
    draws: bool,
) -> list[Export]:
    from .. import __version__
    from ..io.export.prepare import DEFAULT_FRAME, prepare_export

    wants_up = (frame or DEFAULT_FRAME.get(format_name)) == "opensim"
    level_down = _level_down(result, recoveries) if wants_up else None
    return [
        prepare_export(recovery, format_name, frame, rate, level_down, __version__, origin, draws)
        for recovery in recoveries
    ]


def _level_down(result: Path, recoveries: list[Recovery]) -> FloatArray | None:
    """Down in the camera's axes if the camera is level, where a method did not find gravity."""
    import numpy as np

    if all(np.isfinite(recovery.gravity_direction).all() for recovery in recoveries):
        return None
    axes = camera_frame_of(result)
    return None if axes is None else axes.down


def prepared_rrd(result: Path, recoveries: list[Recovery]) -> Export:
    """All arms for Rerun."""
    from ..io.export.prepare import prepare_rrd

    return prepare_rrd(recoveries, _level_down(result, recoveries))


def methods(
    result: Result,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE", help="What to write (Markdown), instead of printing it."
        ),
    ] = None,
    side: Side = None,
    body: Body = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Write a paper's methods section: text, table, references.

    It states only what the file contains: sensors and rates, method and version, calibration,
    clocks, gaps, uncertainty, self-check, settings that are not the defaults. What the ISB's recommendations
    on reporting IMUs require beyond that is listed for you to fill in.
    """
    from ..io.result.read import read_origin
    from ..report.methods import methods_section
    from ..runtime.outputs import writing

    check_outputs(force, [output, json_file], [result])
    recoveries = load_recoveries(result, one_side(side), body)
    origin = read_origin(result)
    text, figures = methods_section(recoveries, origin.version, origin.title if origin.is_simulated else "")
    if output is None:
        print(text, end="")
    else:
        with writing(output, force) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    write_json(json_file, figures, force)
    warn(recoveries)
    if output is not None:
        say_written(output, json_file)
