"""`unocclude export`: a result in other formats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import UnoccludeError
from .options import Force, Json, Output, Side, one_side
from .output import check_outputs, say, write_json

if TYPE_CHECKING:
    from ..result import Recovery

FORMATS = ("csv",)


def export(
    result: Annotated[
        Path, typer.Argument(metavar="OUT.mcap", help="What `smooth` wrote.", show_default=False)
    ],
    output: Output,
    format_name: Annotated[
        str, typer.Option("--format", metavar="|".join(FORMATS), help="Format to write.", show_default=False)
    ],
    side: Side = None,
    json_file: Json = None,
    force: Force = False,
) -> None:
    """Write a result as a table: one row a sample of the forearm IMU."""
    from ..io import export_csv, read_recovery

    if format_name not in FORMATS:
        raise typer.BadParameter(
            f"the format '{format_name}' is not available; formats: {', '.join(FORMATS)}"
        )
    side = one_side(side)
    found = [recovery for recovery in read_recovery(result) if side in (None, recovery.side)]
    if not found:
        raise UnoccludeError(
            f"{result}: there is no recovered arm{f' {side!r}' if side else ''} in this file"
        )
    files = output_names(output, found)
    check_outputs(force, [*files, json_file], [result])
    for recovery, path in zip(found, files, strict=True):
        export_csv(recovery, path, force=force)
        say(f"written: {path} ({len(recovery)} rows)")
    figures = [
        {"file": str(path), "rows": len(recovery), "side": recovery.side}
        for recovery, path in zip(found, files, strict=True)
    ]
    write_json(json_file, {"files": figures}, force)


def output_names(output: Path, recoveries: list[Recovery]) -> list[Path]:
    """One file an arm: the name as given, or with the side (and a number) before its ending."""
    if len(recoveries) == 1:
        return [output]
    sides = [recovery.side or "arm" for recovery in recoveries]
    names = []
    for place, side in enumerate(sides):
        again = sides[:place].count(side)
        mark = f"{side}{again + 1}" if again else side
        names.append(output.with_name(f"{output.stem}_{mark}{output.suffix}"))
    return names
