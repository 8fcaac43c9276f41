"""Recordings and results as files. Functions are imported when they are first used."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .atomic import check_output as check_output
    from .atomic import writing as writing
    from .datasets import import_broad as import_broad
    from .datasets import import_utd_mhad as import_utd_mhad
    from .export import export_csv as export_csv
    from .exports import prepare_export as prepare_export
    from .imu import read_imu as read_imu
    from .info import RecordingInfo as RecordingInfo
    from .info import describe as describe
    from .plain import import_csv as import_csv
    from .plain import open_csv as open_csv
    from .reading import open_recording as open_recording
    from .reading import read_recording as read_recording
    from .reading import select_recording as select_recording
    from .recording_writing import write_recording as write_recording
    from .result import write_recovery as write_recovery
    from .result_reading import read_recovery as read_recovery
    from .streams import RecordingFile as RecordingFile

_HOMES = {
    "RecordingFile": "streams",
    "RecordingInfo": "info",
    "check_output": "atomic",
    "describe": "info",
    "export_csv": "export",
    "import_broad": "datasets",
    "import_csv": "plain",
    "import_utd_mhad": "datasets",
    "open_csv": "plain",
    "open_recording": "reading",
    "prepare_export": "exports",
    "read_imu": "imu",
    "read_recording": "reading",
    "read_recovery": "result_reading",
    "select_recording": "reading",
    "write_recording": "recording_writing",
    "write_recovery": "result",
    "writing": "atomic",
}
__all__ = list(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_HOMES[name]}", __name__), name)
