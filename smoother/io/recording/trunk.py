"""Which IMU of a file is on the trunk, and the other arm, whose shoulder shows the trunk's heading."""

from __future__ import annotations

from ...errors import RecordingError
from ...recording import ImuStream, JointTracks, TrunkSensors
from ...runtime.store import Store
from ..mcap.stamps import seconds
from .bodies import join_bodies
from .clean import clean_arm, clean_imu
from .selection import StreamChoice
from .stream_names import role
from .streams import RecordingFile


def trunk_of(
    file: RecordingFile, choice: StreamChoice, origin_ns: int, store: Store
) -> tuple[TrunkSensors | None, list[str]]:
    """The trunk's IMU by its name, and sentences on it.

    Parameters
    ----------
    file : RecordingFile
        All streams.
    choice : StreamChoice
        The arm that was taken.
    origin_ns : int, ns
        What times count from.
    store : Store
        Where samples and frames lie.

    Returns
    -------
    trunk : TrunkSensors or None
        None where no name says so, or several do.
    notes : list of str
        How it was decided, and what was dropped.
    """
    named = [imu for imu in file.imus if imu is not choice.imu and role(imu) == "trunk"]
    if not named:
        return None, []
    if len(named) > 1:
        names = ", ".join(imu.topic for imu in named)
        return None, [f"Of the trunk IMUs {names} none was taken: their names do not tell which is meant."]
    samples, notes = clean_imu(named[0], str(file.path), store)
    t_s = seconds(samples.stamp_ns, origin_ns, store)
    imu = ImuStream(samples.topic, t_s, samples.acc, samples.gyro)
    notes = [f"IMU {samples.topic} is on the trunk by its name.", *notes]
    return TrunkSensors(imu, opposite_arm(file, choice, origin_ns, store)), notes


def opposite_arm(
    file: RecordingFile, choice: StreamChoice, origin_ns: int, store: Store
) -> JointTracks | None:
    """The camera's joints of the same person's other arm; None where there is none. Parameters as above."""
    mine = choice.arm
    if not any({arm.side, mine.side} == {"left", "right"} for arm in file.arms):
        return None
    others = [
        arm
        for arm in join_bodies(file.arms, store)[0]
        if (arm.topic, arm.body) == (mine.topic, mine.body) and {arm.side, mine.side} == {"left", "right"}
    ]
    if not others:
        return None
    try:
        other, _ = clean_arm(others[0], str(file.path), store)
    except RecordingError:  # that arm cannot be used, and nobody asked for it
        return None
    return JointTracks(other.topic, seconds(other.stamp_ns, origin_ns, store), other.position, other.state)
