"""Recordings and results as files. Functions are imported when they are first used."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .datasets import import_broad as import_broad
    from .datasets import import_utd_mhad as import_utd_mhad
    from .export.csv import export_csv as export_csv
    from .export.prepare import prepare_export as prepare_export
    from .files import ImuFiles as ImuFiles
    from .files import import_files as import_files
    from .info import describe as describe
    from .recording.read import open_recording as open_recording
    from .recording.read import read_imu as read_imu
    from .recording.read import read_recording as read_recording
    from .recording.read import read_recordings as read_recordings
    from .recording.select import select_recording as select_recording
    from .recording.select import select_recordings as select_recordings
    from .recording.streams import RecordingFile as RecordingFile
    from .recording.write import write_recording as write_recording
    from .result.read import read_recovery as read_recovery
    from .result.write import write_recovery as write_recovery
    from .tables.recording_toml import import_csv as import_csv
    from .tables.recording_toml import open_csv as open_csv

_HOMES = {
    "ImuFiles": ".files",
    "RecordingFile": ".recording.streams",
    "describe": ".info",
    "export_csv": ".export.csv",
    "import_broad": ".datasets",
    "import_csv": ".tables.recording_toml",
    "import_files": ".files",
    "import_utd_mhad": ".datasets",
    "open_csv": ".tables.recording_toml",
    "open_recording": ".recording.read",
    "prepare_export": ".export.prepare",
    "read_imu": ".recording.read",
    "read_recording": ".recording.read",
    "read_recovery": ".result.read",
    "read_recordings": ".recording.read",
    "select_recording": ".recording.select",
    "select_recordings": ".recording.select",
    "write_recording": ".recording.write",
    "write_recovery": ".result.write",
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name], __name__), name)
