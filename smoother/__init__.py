"""unocclude: the arm's motion where the depth camera could not see it.

from smoother import read_recording, smooth
recovery = smooth(read_recording("recording.mcap"))
arrays = recovery.to_arrays()
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from .calibration import ArmCalibration
    from .config import Config
    from .io import read_recording, read_recovery, write_recording, write_recovery
    from .recording import Recording
    from .result import Recovery
    from .smoothing import smooth

#: Where each public name lives; loaded at first use, so that the command line starts at once.
_HOME = {
    "ArmCalibration": "calibration",
    "Config": "config",
    "Recording": "recording",
    "Recovery": "result",
    "read_recording": "io",
    "read_recovery": "io",
    "write_recording": "io",
    "write_recovery": "io",
}

__all__ = [
    "ArmCalibration",
    "Config",
    "Recording",
    "Recovery",
    "read_recording",
    "read_recovery",
    "smooth",
    "write_recording",
    "write_recovery",
]


def __getattr__(name: str) -> object:
    if name == "smooth":
        return import_module(".smoothing", __name__).smooth
    if name in _HOME:
        return getattr(import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
