"""Recordings and results as files. Functions are imported when they are first used."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .datasets import import_broad as import_broad
    from .datasets import import_utd_mhad as import_utd_mhad
    from .info import describe as describe
    from .recording.read import open_recording as open_recording
    from .recording.read import read_recording as read_recording
    from .recording.read import read_recordings as read_recordings
    from .recording.write import write_recording as write_recording
    from .result.read import read_recovery as read_recovery
    from .result.write import write_recovery as write_recovery
    from .tables.recording_toml import open_csv as open_csv

_HOMES = {
    "describe": ".info",
    "import_broad": ".datasets",
    "import_utd_mhad": ".datasets",
    "open_csv": ".tables.recording_toml",
    "open_recording": ".recording.read",
    "read_recording": ".recording.read",
    "read_recovery": ".result.read",
    "read_recordings": ".recording.read",
    "write_recording": ".recording.write",
    "write_recovery": ".result.write",
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name], __name__), name)
