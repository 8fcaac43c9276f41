"""`smoother.smooth` and `smoother.measure`: they take a file as well as what was read of one."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Unpack

from .errors import UnoccludeError

if TYPE_CHECKING:
    from .calibration import ArmCalibration
    from .config import Config
    from .io.recording.selection import Selection
    from .measurements.clock import Clock
    from .measures import Measures, MeasureSettings
    from .recording import Recording
    from .result import Recovery
    from .runtime.pool import Progress
    from .runtime.store import Store


def smooth(
    recording: Recording | str | os.PathLike[str],
    calibration: ArmCalibration | str | os.PathLike[str] | None = None,
    config: Config | None = None,
    progress: Progress | None = None,
    store: Store | None = None,
    processes: int | None = None,
    clock: Clock | None = None,
    draws: int = 64,
    seed: int = 0,
    **selection: Unpack[Selection],
) -> Recovery:
    """Recover the arm's motion over a whole recording, or over a recording's file.

    Parameters
    ----------
    recording : Recording or path-like
        One arm and its forearm IMU, or the MCAP file that contains them.
    calibration : ArmCalibration or path-like, optional
        Lever arms and upper-arm length, with sigmas; the rest is estimated. A calibration file belongs to
        the recording's file: it also corrects the sensors.
    config : Config, optional
        Settings.
    progress : callable, optional
        Called with a fraction (0..1) and a word for the step.
    store : Store, optional
        Where what grows with the recording's length lives; in memory where None.
    processes : int, optional
        Worker processes, 0 for one per core; None uses the configuration's value.
    clock : Clock, optional
        The camera's against the IMU's as it was measured, with its sigma.
    draws : int
        This many whole motions drawn from the posterior, in `Recovery.draws`: measures have their intervals
        from them. The answer is the same with and without; 0 = none, and a twentieth less time.
    seed : int
        Of the draws' random numbers: the same one gives the same motions.
    imu, skeleton, side : str, optional
        Of a file with several: the IMU's and the skeleton's topic, "left" or "right".
    body : int, optional
        Of a file with several people: whose arm.

    Returns
    -------
    Recovery
        At the IMU's times, in the camera's frame {K}, with covariance.

    Raises
    ------
    UnoccludeError
        A file cannot be used, or nothing of the recording can be solved; in one sentence.

    Examples
    --------
    >>> recovery = smoother.smooth("session.mcap", "arm.toml", side="left")  # doctest: +SKIP
    """
    from .calibration import ArmCalibration
    from .recording import Recording
    from .smoothing import smooth as smooth_recording

    given, file = (calibration, None) if isinstance(calibration, ArmCalibration) else (None, calibration)
    if not isinstance(recording, Recording):
        from .io.recording.read import read_arm

        recording, of_file = read_arm(recording, file, store=store, truth=False, **selection)
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
    return smooth_recording(recording, given, config, progress, store, processes, clock, draws, seed)


def measure(
    result: Recovery | str | os.PathLike[str],
    settings: MeasureSettings | None = None,
    processes: int = 1,
    progress: Progress | None = None,
    *,
    side: str | None = None,
    body: int | None = None,
) -> Measures:
    """Measure a recovered motion, or that of a result's file: joints, hand, smoothness, movements.

    Parameters
    ----------
    result : Recovery or path-like
        What `smooth` returned, or the MCAP file that it was written to. With draws there are intervals.
    settings : MeasureSettings, optional
        Thresholds and sizes.
    processes : int
        Worker processes for the drawn motions, 0 = one per core; the measures are the same with any number.
    progress : callable, optional
        Called with the share done (0 to 1) and its label.
    side : str, optional
        Of a file with several arms: "left" or "right".
    body : int, optional
        Of a file with several people: whose arm.

    Returns
    -------
    Measures
        Of the session, each movement and each repetition.

    Raises
    ------
    UnoccludeError
        A file cannot be used, or several arms fit; in one sentence.

    Examples
    --------
    >>> rows = smoother.measure("out.mcap", side="left").by_key  # doctest: +SKIP
    >>> rows["elbow_flexion_range_deg"].value  # doctest: +SKIP
    """
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
