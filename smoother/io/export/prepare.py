"""What is ready to be written in a format: all that can fail for the data's sake is behind us."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...result import Recovery

#: The formats, and for which of them axes and rate may be chosen.
FORMATS = ("csv", "trc", "mot", "c3d", "parquet", "sto", "rrd")
WITH_FRAME = ("trc", "c3d")
WITH_RATE = ("trc", "mot", "c3d")
#: Axes if none are asked for: OpenSim is what reads TRC; a C3D goes with its recording.
DEFAULT_FRAME = {"trc": "opensim", "c3d": "camera", "sto": "opensim"}


@dataclass(frozen=True)
class Export:
    """An arm in a format."""

    rows: int  # In the file
    write: Callable[[Path, bool], None]  # Writes it to a path; the second argument is `force`
    rate_hz: float | None = None  # Rows per second where the step is constant
    frame: str | None = None  # Axes of the positions
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each


def prepare_export(
    recovery: Recovery,
    format_name: str,
    frame: str | None = None,
    rate_hz: float | None = None,
    level_down: FloatArray | None = None,  # (3,)
    version: str = "unknown",
    origin: str = "camera",
    draws: bool = False,
) -> Export:
    """Bring one arm into a format, without writing yet."""
    if format_name not in FORMATS:
        raise UnoccludeError(f"the format '{format_name}' is not available; formats: {', '.join(FORMATS)}")
    if format_name == "mot":
        return _mot(recovery, rate_hz)
    if format_name in WITH_FRAME:
        chosen = frame or DEFAULT_FRAME[format_name]
        return _markers(recovery, format_name, chosen, rate_hz, level_down, version, origin)
    if format_name == "sto":
        return _sto(recovery, level_down)
    if format_name == "rrd":
        return prepare_rrd([recovery], level_down=level_down)
    rows, write = len(recovery), partial(_write_rows, recovery, format_name, version, draws)
    if draws:
        from .parquet import drawn_rows

        rows = drawn_rows(recovery)
    return Export(rows, write, frame="camera")


def _write_rows(
    recovery: Recovery, format_name: str, version: str, draws: bool, path: Path, force: bool
) -> None:
    from .csv import export_csv
    from .parquet import export_draws, export_parquet

    if format_name == "csv":
        export_csv(recovery, path, force)
    else:
        (export_draws if draws else export_parquet)(recovery, path, version, force)


def prepare_rrd(
    recoveries: Sequence[Recovery],
    level_down: FloatArray | None = None,  # (3,)
) -> Export:
    """All arms of a result as one recording of Rerun, without writing yet; see `rrd.write_rrd`."""
    from .rrd import check_rrd, write_rrd

    check_rrd(recoveries)
    return Export(
        sum(len(recovery) for recovery in recoveries),
        lambda path, force: write_rrd(recoveries, path, level_down=level_down, force=force),
        frame="camera",
    )


def _mot(recovery: Recovery, rate_hz: float | None) -> Export:
    from .storage import mot_table, write_mot

    table = mot_table(recovery, rate_hz)
    return Export(
        len(table.t_s),
        lambda path, force: write_mot(table, path, recovery, force),
        table.rate_hz,
        notes=table.notes,
    )


def _sto(recovery: Recovery, level_down: FloatArray | None) -> Export:
    from .storage import orientation_table, write_sto

    table = orientation_table(recovery, level_down)
    notes = (*table.notes, *level_note(recovery))
    return Export(
        len(table.t_s), lambda path, force: write_sto(table, path, force), frame="opensim", notes=notes
    )


def level_note(recovery: Recovery) -> tuple[str, ...]:
    """A note where OpenSim's axes are those of a camera that is taken to stand level."""
    if np.isfinite(recovery.gravity_direction).all():
        return ()
    return (f"the method '{recovery.method}' found no gravity: the camera is assumed level.",)


def _markers(
    recovery: Recovery,
    format_name: str,
    frame: str,
    rate_hz: float | None,
    level_down: FloatArray | None,
    version: str,
    origin: str,
) -> Export:
    from .markers import c3d_content, check_frames, marker_table, write_c3d, write_trc

    table = marker_table(recovery, frame, rate_hz, level_down, origin)
    rate, rows = table.grid.rate_hz, len(table.grid.t_s)
    notes = level_note(recovery) if frame == "opensim" else ()
    if format_name == "trc":
        return Export(
            rows,
            lambda path, force: write_trc(path, table.names, table.grid.t_s, table.position, rate, force),
            rate,
            frame,
            notes,
        )
    check_frames(recovery.name, rows, rate)
    content = c3d_content(recovery, table, frame, version)
    return Export(rows, lambda path, force: write_c3d(path, content, force), rate, frame, notes)


def export_recovery(
    recovery: Recovery,
    path: str | os.PathLike[str],
    *,
    force: bool = False,
    frame: str | None = None,
    rate_hz: float | None = None,
    origin: str = "camera",
) -> None:
    """Write a recovery in the format of the file's ending."""
    path = Path(path)
    ending = path.suffix.lower().removeprefix(".")
    if ending == "mcap":
        from ..result.write import write_recovery

        write_recovery(recovery, path, force=force)
        return
    if ending not in FORMATS:
        endings = ", ".join(f".{name}" for name in ("mcap", *FORMATS))
        raise UnoccludeError(f"{path}: its ending names no format; endings: {endings}")
    from ... import __version__

    prepare_export(recovery, ending, frame, rate_hz, None, __version__, origin).write(path, force)
