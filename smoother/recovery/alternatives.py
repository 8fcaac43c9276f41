"""Other ways in which a recording may have been set up: what would be wrong, and what undoes it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..array_types import FloatArray
from ..measurements.remedy import AXES, Remedy
from ..recording import JOINTS, CameraFrame, JointState, Recording

#: Of frames, at most so many say on which side of the camera the arm is.
MOST_FRAMES = 20_000
#: Degrees in a radian.
DEGREES = float(np.degrees(1.0))


@dataclass(frozen=True)
class Alternative:
    """A recording as it would have been, had one mistake not been made.

    Attributes
    ----------
    mistake : str
        What was wrong then, as "the skeleton seems mirrored (x)".
    corrected : function
        From the recording to the one without the mistake.
    advice : str
        What to do about it.
    remedy : Remedy, optional
        The options that undo it.
    kind : str
        Of alternatives of one kind the first that fits is meant.
    """

    mistake: str
    corrected: Callable[[Recording], Recording]
    advice: str
    remedy: Remedy | None = None
    kind: str = ""


def alternatives(recording: Recording) -> Iterator[Alternative]:
    """All that is tried, the likelier first."""
    for axis in AXES:
        remedy = Remedy(mirror=axis)
        if _in_front(recording, remedy):
            yield by_remedy(remedy, f"the skeleton seems mirrored ({axis})", "mirror")
    yield by_remedy(Remedy(negate=("accelerometer",)), "the accelerometer's sign seems turned")
    yield by_remedy(Remedy(negate=("gyroscope",)), "the gyroscope's sign seems turned")
    yield by_remedy(Remedy(negate=("accelerometer", "gyroscope")), "the sensor's axes seem left-handed")
    yield Alternative(
        "the gyroscope's rates seem 57 times too small (rad/s converted as if they were deg/s)",
        lambda given: _turning(given, DEGREES),
        'import them again as they are (gyroscope_unit = "rad/s")',
    )
    yield Alternative(
        "the gyroscope's rates seem 57 times too large (deg/s called rad/s)",
        lambda given: _turning(given, 1.0 / DEGREES),
        'import them again in their unit (gyroscope_unit = "deg/s")',
    )
    for factor, words in ((1000.0, "1000 times too small"), (100.0, "100 times too small")):
        yield Alternative(
            f"the camera's positions seem {words}",
            lambda given, by=factor: _sized(given, by),  # type: ignore[misc]
            "import them again in their unit (position_unit)",
        )
    yield Alternative(
        "the IMU seems to sit on the upper arm",
        _upper_arm_as_forearm,
        "strap it to the forearm, near the wrist",
    )


def by_remedy(remedy: Remedy, mistake: str, kind: str = "") -> Alternative:
    """The alternative that some options undo."""
    return Alternative(mistake, remedy.applied, f"run again with {remedy.options}", remedy, kind or mistake)


def _in_front(recording: Recording, remedy: Remedy) -> bool:
    """Whether a camera that looks along z could see the arm then; any other sees it anywhere."""
    if recording.camera_frame not in (CameraFrame.KINECT, CameraFrame.OPTICAL):
        return True
    depth = _tracked(recording)[:, 2]
    depth_m = float(np.median(depth)) if len(depth) else 1.0
    return (depth_m > 0.0) != (remedy.mirror == "z")


def _tracked(recording: Recording) -> FloatArray:
    """Positions (n, 3) of some of the tracked samples."""
    arm = recording.arm.select(slice(None, None, max(len(recording.arm) // MOST_FRAMES, 1)))
    position = arm.position[arm.state == JointState.TRACKED]
    return np.asarray(position[np.isfinite(position).all(axis=1)])


def frames_with_down(down: FloatArray, recording: Recording, within_deg: float) -> list[CameraFrame]:
    """Other conventions of the camera's axes in which down is near a direction (3,) of {K}."""
    cosine = np.cos(np.radians(within_deg))
    return [
        frame
        for frame in CameraFrame
        if frame is not recording.camera_frame and float(frame.down @ down) > cosine
    ]


def _turning(recording: Recording, factor: float) -> Recording:
    return replace(recording, imu=replace(recording.imu, gyro=recording.imu.gyro * factor))


def _sized(recording: Recording, factor: float) -> Recording:
    return replace(recording, arm=replace(recording.arm, position=recording.arm.position * factor))


def _upper_arm_as_forearm(recording: Recording) -> Recording:
    """Shoulder and elbow called elbow and wrist; nothing else is there."""
    arm = recording.arm
    position, state = np.full_like(arm.position, np.nan), np.zeros_like(arm.state)
    for joint, name in (("shoulder", "elbow"), ("elbow", "wrist")):
        position[:, JOINTS.index(name)] = arm.joint(joint)
        state[:, JOINTS.index(name)] = arm.state[:, JOINTS.index(joint)]
    return replace(recording, arm=replace(arm, position=position, state=state))
