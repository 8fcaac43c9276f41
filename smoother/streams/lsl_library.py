"""The Lab Streaming Layer's library `pylsl`, an extra."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from ..errors import UnoccludeError
from ..runtime.packages import extra_module
from ..runtime.printable import printable

#: Where liblsl looks for settings of the user's own.
_SETTINGS = (
    *("lsl_api.cfg", "~/lsl_api/lsl_api.cfg", "/etc/lsl_api/lsl_api.cfg"),
)  # fmt: skip
#: The library writes lines of its log to the terminal, into the dashboard; -3 is the least.
_NO_LOG = "[log]\nlevel = -3\n"


@cache
def lsl_module() -> ModuleType:
    """The package `pylsl`, which keeps silent on the terminal unless the user has settings for it.

    Raises
    ------
    UnoccludeError
        It is not installed, or it finds no library liblsl; the sentence says what to do.
    """
    try:
        pylsl = extra_module("pylsl", "pylsl", "live")
    except (RuntimeError, OSError) as error:
        raise UnoccludeError(
            "pylsl is installed without the library liblsl; install a wheel of pylsl that brings it"
            " (`pip install -U pylsl`), or liblsl itself, and name its file in PYLSL_LIB"
        ) from error
    has_settings = os.environ.get("LSLAPICFG") or any(Path(file).expanduser().exists() for file in _SETTINGS)
    if not has_settings and hasattr(pylsl, "set_config_content"):
        pylsl.set_config_content(_NO_LOG)
    return pylsl


def streams_there(seconds: float) -> list[Any]:
    """Streams on the network, as far as they answer within some seconds."""
    return list(lsl_module().resolve_streams(seconds))


def listed(streams: Sequence[Any]) -> str:
    """Names and types of streams, for a sentence."""
    names = sorted({f"{stream.name()} (type {stream.type() or 'none'})" for stream in streams})
    shown = [printable(name[:80]) for name in names[:8]]
    more = [f"and {len(names) - 8} more"] if len(names) > 8 else []
    return ", ".join([*shown, *more]) or "none"


def is_wanted(stream: Any, wanted: str) -> bool:
    """Whether a stream is meant: by its name or source_id, or by a part of the name."""
    name = stream.name()
    return wanted in (name, stream.source_id()) or wanted.lower() in name.lower()
