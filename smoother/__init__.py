"""unocclude: the arm's motion where the depth camera could not see it.

import smoother

recovery = smoother.smooth("recording.mcap")
table = recovery.to_table()
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

__version__ = "1.0.0rc1"

if TYPE_CHECKING:
    from calib.file import read_calibration

    from .api import measure, smooth
    from .calibration import ArmCalibration
    from .config import Config
    from .errors import UnoccludeError
    from .evaluation.validate import validate
    from .io import read_recording, read_recordings, read_recovery, write_recording, write_recovery
    from .measures import Measures, MeasureSettings, measure_both
    from .recording import ImuStream, JointState, JointTracks, Recording, Truth
    from .result import Draws, Recoveries, Recovery
    from .several_arms import smooth_arms

#: Where each public name lives; loaded at first use, so that the command line starts at once.
_HOME = {
    "ArmCalibration": "smoother.calibration",
    "Config": "smoother.config",
    "Draws": "smoother.result",
    "ImuStream": "smoother.recording",
    "JointState": "smoother.recording",
    "JointTracks": "smoother.recording",
    "MeasureSettings": "smoother.measures",
    "Measures": "smoother.measures",
    "Recording": "smoother.recording",
    "Recoveries": "smoother.result",
    "Recovery": "smoother.result",
    "Truth": "smoother.recording",
    "UnoccludeError": "smoother.errors",
    "measure": "smoother.api",
    "measure_both": "smoother.measures",
    "read_calibration": "calib.file",
    "read_recording": "smoother.io",
    "read_recordings": "smoother.io",
    "read_recovery": "smoother.io",
    "smooth": "smoother.api",
    "smooth_arms": "smoother.several_arms",
    "validate": "smoother.evaluation.validate",
    "write_recording": "smoother.io",
    "write_recovery": "smoother.io",
}

__all__ = [
    "ArmCalibration",
    "Config",
    "Draws",
    "ImuStream",
    "JointState",
    "JointTracks",
    "MeasureSettings",
    "Measures",
    "Recording",
    "Recoveries",
    "Recovery",
    "Truth",
    "UnoccludeError",
    "measure",
    "measure_both",
    "read_calibration",
    "read_recording",
    "read_recordings",
    "read_recovery",
    "smooth",
    "smooth_arms",
    "validate",
    "write_recording",
    "write_recovery",
]


#: What values offer as methods and floors above them do: `Recovery.export`, `Recovery.plot`.
_METHODS = {
    "export_recovery": "smoother.io.export",
    "plot_recovery": "smoother.report.publication",
}


def __getattr__(name: str) -> object:
    home = _HOME.get(name) or _METHODS.get(name)
    if home is not None:
        return getattr(import_module(home), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
