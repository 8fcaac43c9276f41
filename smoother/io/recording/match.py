"""Which IMU is on which limb of a file's arms, by one assignment of all, and what a person reads of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...errors import RecordingError
from ...matching import ImuMatch, Limb, limbs_of, match_imus
from ...recording import ImuStream, JointTracks
from ..mcap.messages import seconds
from .bodies import people
from .clean import clean_arm, clean_imu
from .names import is_named, named_side, role_among
from .streams import ArmFrames, ImuSamples, RecordingFile, rows_of

#: Clocks may be this far apart, s; and where an assignment within that leaves open what is meant.
REACH_S, FAR_S = 5.0, 600.0


def match_streams(
    file: RecordingFile,
    imus: Sequence[ImuSamples],
    arms: Sequence[ArmFrames],
    *,
    method: str = "motion",
    reach_s: float = REACH_S,
    may_be: Callable[[int, Limb], bool] | None = None,
) -> tuple[list[ImuMatch], list[str]]:
    """Match some IMUs of a file to some of its arms, by motion alone."""
    source = str(file.path)
    notes: list[str] = []
    stamps = [*(imu.stamp_ns for imu in imus), *(arm.stamp_ns for arm in arms)]
    origin = min((int(each[0]) for each in stamps if len(each)), default=0)
    limbs: list[Limb] = []
    for arm in (arm for arm in arms if arm.tracked):
        try:
            frames, dropped = clean_arm(arm, source)
        except RecordingError as error:
            notes.append(f"{arm.label} cannot be matched: {error}")
            continue
        notes += dropped
        t_s = seconds(frames.stamp_ns, origin)
        tracks = JointTracks(arm.topic, t_s, frames.position, frames.state)
        limbs += limbs_of(tracks, arm.body, arm.side, arm.topic)
    streams: list[ImuStream] = []
    for imu in imus:
        try:
            samples, dropped = clean_imu(imu, source)
        except RecordingError as error:
            # one broken sensor of a box does not keep the others from being matched
            samples, dropped = rows_of(imu, slice(0, 0)), [f"{imu.topic} cannot be matched: {error}"]
        notes += dropped
        streams.append(samples.on_axis(origin))
    allowed = None
    if may_be is not None:
        allowed = np.array([[may_be(i, limb) for limb in limbs] for i in range(len(streams))], bool)
    level_down = replace(file, arms=list(arms)).level_down
    try:
        matches = match_imus(streams, limbs, level_down, method, reach_s, allowed)
    except RecordingError as error:
        raise RecordingError(f"{source}: {error}.") from None
    start = min((float(limb.tracks.t_s[0]) for limb in limbs), default=0.0) - reach_s
    end = max((float(limb.tracks.t_s[-1]) for limb in limbs), default=0.0) + reach_s
    for stream, match in zip(streams, matches, strict=True):
        if len(stream) and (stream.t_s[0] > end or stream.t_s[-1] < start):
            notes.append(
                f"{stream.name} and the camera have no time in common, so it cannot be matched; set the"
                f" clocks to within {reach_s:g} s of each other."
            )
        elif len(stream) and not match.is_known:
            best = " or ".join(f"{where} ({p:.0%})" for where, p in match.others[:2])
            notes.append(
                f"{stream.name} may be on {best}: the motion does not settle it; record some seconds in which"
                " this limb moves and the others do something else."
            )
    return matches, notes


def match_file(
    file: RecordingFile,
    method: str = "motion",
    reach_s: float | None = None,
    skeleton: str | None = None,
) -> tuple[list[ImuMatch], list[str]]:
    """Settle which IMU of a file is on which body and limb, by motion alone; names are not asked."""
    if not file.imus:
        raise RecordingError(f"{file.path} has no IMU to match; record the IMUs as well.")
    arms = [arm for arm in file.arms if skeleton is None or is_named(skeleton, arm.topic, arm.frame_id)]
    if file.arms and not arms:
        topics = ", ".join(dict.fromkeys(arm.topic for arm in file.arms))
        raise RecordingError(f"{file.path}: no skeleton fits --skeleton {skeleton}; it has {topics}.")
    if not any(arm.tracked for arm in arms):
        raise RecordingError(
            f"{file.path} shows no arm to match IMUs to (no forearm joint is tracked); "
            "record again with the arms in view of the camera for some seconds."
        )
    arms, notes = people(replace(file, arms=arms))
    reach_s = REACH_S if reach_s is None else reach_s
    matches, more = match_streams(file, file.imus, arms, method=method, reach_s=reach_s)
    notes += more
    for imu, match in zip(file.imus, matches, strict=True):
        if match.limb is None or not match.is_sure:
            continue
        named, side = role_among(imu, file.imus), named_side(imu.topic, imu.frame_id)
        segment = "forearm" if match.limb.segment == "wrist" else match.limb.segment
        # a hand has no limb of its own to be matched to: the forearm's is the nearest
        other_limb = named not in ("", segment) and (named, segment) != ("hand", "forearm")
        if other_limb or (side and match.limb.side and side != match.limb.side):
            notes.append(
                f"{imu.topic} moves as {match.limb.label}, which its name contradicts; if it was mixed up, "
                f"name it in the recording or give --imu {imu.topic} with --side and --body."
            )
    return matches, notes
