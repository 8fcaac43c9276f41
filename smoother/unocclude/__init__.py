"""unocclude: the arm's motion where the depth camera could not see it.

    import unocclude

    recovery = unocclude.smooth("recording.mcap")
    table = recovery.to_table()

What `smoother` shows, under the name that is installed; `smooth` also takes files.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Unpack

import smoother
from smoother import __version__ as __version__

if TYPE_CHECKING:
    from smoother import ArmCalibration as ArmCalibration
    from smoother import Config as Config
    from smoother import Draws as Draws
    from smoother import ImuStream as ImuStream
    from smoother import JointState as JointState
    from smoother import JointTracks as JointTracks
    from smoother import Measures as Measures
    from smoother import MeasureSettings as MeasureSettings
    from smoother import Recording as Recording
    from smoother import Recoveries as Recoveries
    from smoother import Recovery as Recovery
    from smoother import Truth as Truth
    from smoother import UnoccludeError as UnoccludeError
    from smoother import measure as measure
    from smoother import measure_both as measure_both
    from smoother import read_calibration as read_calibration
    from smoother import read_recording as read_recording
    from smoother import read_recordings as read_recordings
    from smoother import read_recovery as read_recovery
    from smoother import smooth_arms as smooth_arms
    from smoother import validate as validate
    from smoother import write_recording as write_recording
    from smoother import write_recovery as write_recovery
    from smoother.io.recording.selection import Selection
    from smoother.measurements.clock import Clock
    from smoother.runtime.pool import Progress
    from smoother.runtime.store import Store

__all__ = sorted([*smoother.__all__, "measures", "simulation"])


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
    >>> recovery = unocclude.smooth("session.mcap", "arm.toml", side="left")  # doctest: +SKIP
    """
    from smoother.calibration import ArmCalibration
    from smoother.errors import UnoccludeError
    from smoother.recording import Recording

    given, file = (calibration, None) if isinstance(calibration, ArmCalibration) else (None, calibration)
    if not isinstance(recording, Recording):
        from smoother.io.recording.read import read_arm

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
    return smoother.smooth(recording, given, config, progress, store, processes, clock, draws, seed)


def measures(
    result: Recovery | str | os.PathLike[str],
    settings: MeasureSettings | None = None,
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
    >>> rows = unocclude.measures("out.mcap", side="left").by_key  # doctest: +SKIP
    >>> rows["elbow_flexion_range_deg"].value  # doctest: +SKIP
    """
    from smoother.errors import UnoccludeError
    from smoother.result import Recovery

    if not isinstance(result, Recovery):
        arms = smoother.read_recovery(result)
        fitting = [one for one in arms if side in (None, one.side) and body in (None, one.body)]
        if len(fitting) != 1:
            labels = ", ".join(one.arm_label for one in arms) or "none"
            what = "several arms fit" if fitting else "no arm fits"
            raise UnoccludeError(
                f"{os.fspath(result)}: {what}; name one by side and body; the file has: {labels}"
            )
        result = fitting[0]
    return smoother.measure(result, settings)


def __getattr__(name: str) -> object:
    if name == "simulation":
        return import_module("unocclude.simulation")
    if name in __all__:
        return getattr(smoother, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
