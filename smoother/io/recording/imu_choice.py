"""Which IMUs of a file may be meant."""

from __future__ import annotations

from ...errors import RecordingError
from .stream_names import is_named, named_side, role, topics_of
from .streams import ImuSamples, RecordingFile


def choose_imu(file: RecordingFile, name: str | None = None) -> ImuSamples:
    """The IMU of that name, of whatever limb, or the only one that there is.

    Parameters
    ----------
    file : RecordingFile
        All streams.
    name : str, optional
        Topic (or a part of it, or its frame_id).

    Returns
    -------
    ImuSamples
        As recorded.

    Raises
    ------
    RecordingError
        There is none, none of that name, or no name where there are several; the message lists them.
    """
    if name is None and len(file.imus) > 1:
        listed = ", ".join(stream.topic for stream in file.imus)
        raise RecordingError(f"{file.path} has several IMUs ({listed}); choose one with --imu.")
    if name is None and len(file.imus) == 1:
        return file.imus[0]
    return forearm_imus(file, name)[0]


def forearm_imus(file: RecordingFile, name: str | None) -> list[ImuSamples]:
    """The IMU of that name, or all that may be on a forearm by their names.

    Raises
    ------
    RecordingError
        There is none; the message lists what the file has.
    """
    if not file.imus:
        raise RecordingError(
            f"{file.path} has no IMU (sensor_msgs/Imu or unocclude.Imu); it has {topics_of(file)}; "
            "record the wrist's IMU as well."
        )
    listed = ", ".join(stream.topic for stream in file.imus)
    if name is not None:
        exact = [stream for stream in file.imus if stream.topic.strip("/") == name.strip("/")]
        matches = exact or [s for s in file.imus if is_named(name, s.topic, s.frame_id)]
        if len(matches) != 1:
            what = "more than one IMU fits" if matches else "no IMU fits"
            raise RecordingError(
                f"{file.path}: {what} --imu {name}; it has {listed}{_what_fits(name, matches, file.imus)}."
            )
        return matches
    candidates = [stream for stream in file.imus if role(stream) not in ("base", "upper_arm", "trunk")]
    if not candidates:
        raise RecordingError(
            f"{file.path}: no IMU is named as one of a forearm; it has {listed}; choose with --imu."
        )
    named = [s for s in candidates if role(s) == "forearm" or named_side(s.topic, s.frame_id)]
    return named or candidates


def _what_fits(name: str, matches: list[ImuSamples], imus: list[ImuSamples]) -> str:
    """What to give instead of a name that fits none or several IMUs, for the end of a sentence."""
    forearms = [stream for stream in matches if role(stream) not in ("base", "upper_arm", "trunk")]
    if len(forearms) == 1:
        return f"; for the one on the forearm give --imu {forearms[0].topic}"
    side = named_side(name)
    may_be = any(named_side(stream.topic, stream.frame_id) in (side, "") for stream in imus)
    return f"; for the {side} arm give --side {side}" if side and may_be else ""
