"""Recovery methods by name, as the commands offer them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from ..calibration import ArmCalibration
    from ..config import Config
    from ..recording import Recording
    from ..result import Recovery

    Method = Callable[[Recording], Recovery]
    Maker = Callable[[ArmCalibration | None, Config, Callable[[float, str], None] | None], Method]


def _graph(
    calibration: ArmCalibration | None, config: Config, progress: Callable[[float, str], None] | None
) -> Method:
    from .. import smooth

    return lambda recording: smooth(recording, calibration, config, progress)


#: By name: from a calibration, a configuration and a progress function to a method.
MAKERS: dict[str, Maker] = {"graph": _graph}


def choose(names: str) -> list[str]:
    """The methods of a comma-separated list; "all" is every one.

    Raises
    ------
    typer.BadParameter
        A name is unknown; the text lists those that are there.
    """
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    if wanted == ["all"]:
        return list(MAKERS)
    for name in wanted:
        if name not in MAKERS:
            raise typer.BadParameter(f"there is no method '{name}'; methods: {', '.join(MAKERS)}")
    if not wanted:
        raise typer.BadParameter(f"name a method; methods: {', '.join(MAKERS)}")
    return list(dict.fromkeys(wanted))
