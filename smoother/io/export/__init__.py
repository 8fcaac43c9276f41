"""A recovery in the formats of other programs."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

from ...array_types import FloatArray
from ...errors import UnoccludeError
from ...result import Recovery
from .prepare import Export, export_csv, export_parquet

#: The formats, and for which of them axes and rate may be chosen.
FORMATS = ("csv", "trc", "mot", "c3d", "parquet", "sto", "rrd")
WITH_FRAME = ("trc", "c3d")
WITH_RATE = ("trc", "mot", "c3d")
#: Axes if none are asked for: OpenSim is what reads TRC; a C3D goes with its recording.
DEFAULT_FRAME = {"trc": "opensim", "c3d": "camera", "sto": "opensim"}


def prepare_export(
    recovery: Recovery,
    format_name: str,
    frame: str | None = None,
    rate_hz: float | None = None,
    level_down: FloatArray | None = None,  # (3,)
    version: str = "unknown",
    origin: str = "camera",
) -> Export:
    """Bring one arm into a format, without writing yet."""
    if format_name in ("csv", "parquet"):
        parquet = partial(export_parquet, recovery, version=version)
        write = partial(export_csv, recovery) if format_name == "csv" else parquet
        return Export(len(recovery), write, frame="camera")
    if format_name in ("mot", "sto"):
        from .storage import prepare_mot, prepare_sto

        return prepare_mot(recovery, rate_hz) if format_name == "mot" else prepare_sto(recovery, level_down)
    if format_name == "rrd":
        from .rrd import prepare_rrd

        return prepare_rrd([recovery], level_down)
    if format_name in WITH_FRAME:
        from .markers import prepare_markers

        chosen = frame or DEFAULT_FRAME[format_name]
        return prepare_markers(recovery, format_name, chosen, rate_hz, level_down, version, origin)
    raise UnoccludeError(f"the format '{format_name}' is not available; formats: {', '.join(FORMATS)}")


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
