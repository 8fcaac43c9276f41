"""`smoother.smooth` and `smoother.measure`: they take a file as well as what was read of one."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Unpack

from .errors import UnoccludeError

if TYPE_CHECKING:
    from .calibration import ArmCalibration
    from .config import Config
    from .io.recording.choose import Selection
    from .measurements.clock import Clock
    from .measures import Measures, MeasureSettings
    from .recording import Recording
    from .result import Recovery
    from .runtime.pool import Progress


def smooth(
    recording: Recording | str | os.PathLike[str],
    calibration: ArmCalibration | str | os.PathLike[str] | None = None,
    config: Config | None = None,
    progress: Progress | None = None,
    processes: int | None = None,
    clock: Clock | None = None,
    draws: int = 64,
    seed: int = 0,
    **selection: Unpack[Selection],
) -> Recovery:
    """Recover the arm's motion over a whole recording, or over a recording's file."""
    from .calibration import ArmCalibration
    from .recording import Recording
    from .smoothing import smooth as smooth_recording

    given, file = (calibration, None) if isinstance(calibration, ArmCalibration) else (None, calibration)
    if not isinstance(recording, Recording):
        from .io.recording.read import read_arms

        [(recording, of_file)] = read_arms(recording, file, truth=False, alone=True, **selection)
        given = given or of_file
    elif selection:
        raise UnoccludeError(
            f"{', '.join(selection)}: smooth() chooses among a file's streams; this recording is read already"
        )
    elif file is not None:
        raise UnoccludeError(
            f"{os.fspath(file)}: a calibration file belongs to the recording's file, as it also corrects the"
            " sensors; give smooth() both as paths, or an arm of it: read_calibration(FILE).arm(SIDE)"
        )
    return smooth_recording(recording, given, config, progress, processes, clock, draws, seed)


def measure(
    result: Recovery | str | os.PathLike[str],
    settings: MeasureSettings | None = None,
    processes: int = 1,
    progress: Progress | None = None,
    *,
    side: str | None = None,
    body: int | None = None,
) -> Measures:
    """Measure a recovered motion, or that of a result's file: joints, hand, smoothness, movements."""
    from .measures.measuring import measure as measure_recovery
    from .result import Recovery

    if not isinstance(result, Recovery):
        from .io import read_recovery

        arms = read_recovery(result)
        fitting = [one for one in arms if side in (None, one.side) and body in (None, one.body)]
        if len(fitting) != 1:
            labels = ", ".join(one.arm_label for one in arms) or "none"
            what = "several arms fit" if fitting else "no arm fits"
            raise UnoccludeError(
                f"{os.fspath(result)}: {what}; name one by side and body; the file has: {labels}"
            )
        result = fitting[0]
    return measure_recovery(result, settings, processes, progress)
