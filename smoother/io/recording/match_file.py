"""All IMUs of a file matched to its bodies and limbs; what `unocclude match` says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...errors import RecordingError
from ...matching import ImuMatch
from ...runtime.store import Store
from .bodies import people
from .match_streams import REACH_S, match_streams
from .selection import is_named, named_side, role_among
from .streams import ImuSamples, RecordingFile


def match_file(
    file: RecordingFile,
    method: str = "motion",
    reach_s: float = REACH_S,
    store: Store | None = None,
    skeleton: str | None = None,
) -> tuple[list[ImuMatch], list[str]]:
    """Settle which IMU of a file is on which body and limb, by motion alone; names are not asked.

    Parameters
    ----------
    file : RecordingFile
        All streams.
    method : str
        A name in `matching.METHODS`.
    reach_s : float, s
        Clocks may be this far apart.
    store : Store, optional
        Where joined and cleaned columns are to lie; None = in memory.
    skeleton : str, optional
        Topic (or a part of it, or its frame_id) of the arms; None for all.

    Returns
    -------
    matches : list of ImuMatch
        One for each IMU, by its topic.
    notes : list of str
        What was joined, dropped or left open.

    Raises
    ------
    RecordingError
        The file has no IMU, no arm that is tracked, or too little to compare.
    """
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
    arms, notes = people(replace(file, arms=arms), store)
    matches, more = match_streams(file, file.imus, arms, method=method, reach_s=reach_s, store=store)
    return matches, notes + more + _contradicted(file.imus, matches)


def _contradicted(imus: Sequence[ImuSamples], matches: Sequence[ImuMatch]) -> list[str]:
    """Sensors whose names say something else than their motion, where the motion is sure."""
    notes = []
    for imu, match in zip(imus, matches, strict=True):
        named, side = role_among(imu, imus), named_side(imu.topic, imu.frame_id)
        if match.limb is None or not match.is_sure:
            continue
        segment = "forearm" if match.limb.segment == "wrist" else match.limb.segment
        if named == "hand" and segment == "forearm":
            continue  # no limb of its own to be matched to: the forearm's is the nearest
        if (named and named != segment) or (side and match.limb.side and side != match.limb.side):
            notes.append(
                f"{imu.topic} moves as {match.limb.label}, which its name contradicts; if it was mixed up, "
                f"name it in the recording or give --imu {imu.topic} with --side and --body."
            )
    return notes
