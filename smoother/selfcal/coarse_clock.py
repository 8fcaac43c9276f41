"""A clock offset of any size, roughly: before the smoother looks for it within its own reach.

The offset is the one that the motion proves (`pairing`), and the camera's stamps are moved by it.
"""

from __future__ import annotations

from dataclasses import replace

from ..errors import CalibrationError
from ..measurements.clock import Clock
from ..measurements.timeline import Timeline
from ..recording import ImuStream, JointTracks, Recording
from ..result.verdict import Pairing
from .agreement import agreement, agreement_of
from .pairing import LIKELY, chosen, find_pairing, is_ambiguous


def pair(
    recording: Recording, timeline: Timeline | None = None, given: Clock | None = None
) -> tuple[Recording, Clock | None, Pairing | None]:
    """Whether camera and IMU belong together; their clocks brought to where the fine search reaches.

    Parameters
    ----------
    recording : Recording
        Its clocks may be any time apart.
    timeline : Timeline, optional
        Of the recording, where it is there already.
    given : Clock, optional
        What the user stated, or was measured otherwise; then no other is looked for.

    Returns
    -------
    recording : Recording
        With the camera's stamps moved.
    clock : Clock or None
        How they were moved; None where they were near enough.
    pairing : Pairing or None
        Whether the motion proves it; None where there is no forearm direction to compare.
    """
    if given is not None:
        recording = _moved(recording, given)
        pairing, _ = find_pairing(recording, None, given)
        return recording, given, pairing
    pairing, clock = find_pairing(recording, timeline)
    return (recording if clock is None else _moved(recording, clock)), clock, pairing


def synchronise_coarsely(
    recording: Recording, timeline: Timeline | None = None, measured: Clock | None = None
) -> tuple[Recording, Clock | None]:
    """Bring the camera's stamps to where the fine search finds the rest; `pair` without its answer.

    With `measured` nothing is looked for.
    """
    clock = measured or coarse_clock(recording, timeline)
    return (recording if clock is None else _moved(recording, clock)), clock


def coarse_clock(recording: Recording, timeline: Timeline | None = None) -> Clock | None:
    """The camera's clock to some tens of milliseconds; None where the fine search reaches it by itself."""
    return find_pairing(recording, timeline)[1]


def coarse_offset(recording: Recording, reach_s: float) -> float:
    """t_imu - t_camera to some tens of milliseconds; 0 where the fine search reaches it by itself.

    Parameters
    ----------
    recording : Recording
        One arm with elbow and wrist, and its IMU; with `strap` alone nothing is looked for.
    reach_s : float, s
        The fine search finds offsets up to this.

    Raises
    ------
    CalibrationError
        The clocks are farther apart than the fine search reaches, and the motion does not tell how far.
    """
    found = agreement(recording)
    if found is None:
        return 0.0
    line = chosen(found, recording.clocks_unrelated)
    if is_ambiguous(found, line):
        raise CalibrationError(
            f"{recording.name}: the camera's clock and the IMU's seem {abs(line.offset_s):.1f} s apart, but"
            " repeated motion fits other offsets as well; record 20 s of irregular motion in view"
        )
    is_believed = recording.clocks_unrelated or line.chance < LIKELY
    return line.offset_s if is_believed and abs(line.offset_s) > reach_s else 0.0


def shifted_agreement(imu: ImuStream, arm: JointTracks, reach_s: float) -> tuple[float, float, bool]:
    """How well an IMU turns as an arm does, at whatever shift of their clocks.

    Parameters
    ----------
    imu : ImuStream
        Its times may count from anywhere.
    arm : JointTracks
        With elbow and wrist.
    reach_s : float, s
        A shift up to this needs no proof: clocks that far apart count as near.

    Returns
    -------
    correlation : float
        Of the forearm's turning with what the IMU explains of it, at the best shift; 0 where there is too
        little to compare.
    shift_s : float, s
        t_imu - t_camera there.
    far : bool
        The best shift is out of reach and evident.
    """
    found = agreement_of(imu, arm)
    if found is None:
        return 0.0, 0.0, False
    best = found.best
    return best.explained**0.5, best.offset_s, abs(best.offset_s) > reach_s and best.chance < LIKELY


def _moved(recording: Recording, clock: Clock) -> Recording:
    return replace(recording, arm=replace(recording.arm, t_s=clock.to_imu(recording.arm.t_s)))
