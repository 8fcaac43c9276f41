"""IMUs and arms of a file handed to `smoother.matching`, and what a person is told of the answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...array_types import FloatArray
from ...errors import RecordingError
from ...matching import ImuMatch, Limb, limbs_of, match_imus
from ...recording import ImuStream, JointTracks
from ...runtime.store import Store
from ..mcap.stamps import seconds
from .clean import clean_arm, clean_imu
from .streams import ArmFrames, ImuSamples, RecordingFile

#: Clocks may be this far apart, s.
REACH_S = 5.0


def match_streams(
    file: RecordingFile,
    imus: Sequence[ImuSamples],
    arms: Sequence[ArmFrames],
    *,
    method: str = "motion",
    reach_s: float = REACH_S,
    store: Store | None = None,
    may_be: Callable[[int, Limb], bool] | None = None,
) -> tuple[list[ImuMatch], list[str]]:
    """Match some IMUs of a file to some of its arms, by motion alone.

    Parameters
    ----------
    file : RecordingFile
        For its name, and for what it says of gravity.
    imus : sequence of ImuSamples
        The IMUs.
    arms : sequence of ArmFrames
        The arms that they may be on.
    method : str
        A name in `matching.METHODS`.
    reach_s : float, s
        Clocks may be this far apart.
    store : Store, optional
        Where cleaned columns are to lie; None = in memory.
    may_be : callable of (int, Limb) to bool, optional
        Whether an IMU, by its row, may be on a limb at all; None = any may be on any.

    Returns
    -------
    matches : list of ImuMatch
        One for each IMU.
    notes : list of str
        What was dropped or left open.

    Raises
    ------
    RecordingError
        There is too little to compare.
    """
    store, source = store or Store(), str(file.path)
    notes: list[str] = []
    stamps = [*(imu.stamp_ns for imu in imus), *(arm.stamp_ns for arm in arms)]
    origin = min((int(stamp[0]) for stamp in stamps if len(stamp)), default=0)
    limbs: list[Limb] = []
    for arm in arms:
        if arm.tracked:
            frames, dropped = clean_arm(arm, source, store)
            notes += dropped
            t_s = seconds(frames.stamp_ns, origin, store)
            tracks = JointTracks(arm.topic, t_s, frames.position, frames.state)
            limbs += limbs_of(tracks, arm.body, arm.side, arm.topic)
    streams: list[ImuStream] = []
    for imu in imus:
        try:
            samples, dropped = clean_imu(imu, source, store)
        except RecordingError as error:
            # one broken sensor of a box does not keep the others from being matched
            notes.append(f"{imu.topic} cannot be matched: {error}")
            streams.append(ImuStream(imu.topic, np.empty(0), np.empty((0, 3)), np.empty((0, 3))))
            continue
        notes += dropped
        streams.append(
            ImuStream(imu.topic, seconds(samples.stamp_ns, origin, store), samples.acc, samples.gyro)
        )
    allowed = None
    if may_be is not None:
        allowed = np.array([[may_be(i, limb) for limb in limbs] for i in range(len(streams))], bool)
    try:
        matches = match_imus(streams, limbs, down_of(file, arms), method, reach_s, allowed)
    except RecordingError as error:
        raise RecordingError(f"{source}: {error}.") from None
    return matches, notes + _left_open(streams, limbs, matches, reach_s)


def down_of(file: RecordingFile, arms: Sequence[ArmFrames]) -> FloatArray | None:
    """Rough direction of gravity in {K} as the file states it; None where it does not."""
    if file.gravity_hint is not None:
        return file.gravity_hint
    frames = [file.camera_frame, *(arm.camera_frame for arm in arms)]
    return next((frame.down for frame in frames if frame is not None), None)


def _left_open(
    imus: Sequence[ImuStream], limbs: Sequence[Limb], matches: Sequence[ImuMatch], reach_s: float
) -> list[str]:
    notes = []
    start = min((float(limb.tracks.t_s[0]) for limb in limbs), default=0.0)
    end = max((float(limb.tracks.t_s[-1]) for limb in limbs), default=0.0)
    for imu, match in zip(imus, matches, strict=True):
        if len(imu) and (imu.t_s[0] - reach_s > end or imu.t_s[-1] + reach_s < start):
            notes.append(
                f"{imu.name} and the camera have no time in common, so it cannot be matched; set the clocks "
                f"to within {reach_s:g} s of each other."
            )
        elif len(imu) and not match.is_known:
            best = " or ".join(f"{where} ({p:.0%})" for where, p in match.others[:2])
            notes.append(
                f"{imu.name} may be on {best}: the motion does not settle it; record some seconds in which "
                "this limb moves and the others do something else."
            )
    return notes
