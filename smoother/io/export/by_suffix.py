"""A recovery to a file whose ending gives the format, by the code of `unocclude export`."""

from __future__ import annotations

import os
from pathlib import Path

from ...errors import UnoccludeError
from ...result import Recovery
from .prepare import FORMATS, prepare_export


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

    ready = prepare_export(recovery, ending, frame, rate_hz, None, __version__, origin)
    ready.write(path, force)
