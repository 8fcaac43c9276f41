"""What corrects a recording whose set-up was wrong in a way that can be undone: axes, names, signs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import RecordingError
from ..recording import JOINTS, CameraFrame, JointTracks, Recording
from ..runtime.store import by_rows

AXES = ("x", "y", "z")
SENSORS = ("accelerometer", "gyroscope")
#: Joints whose names may be swapped; the strap is not a joint of a skeleton.
SWAPPED = ("shoulder", "elbow", "wrist", "hand")


@dataclass(frozen=True)
class Remedy:
    """What to undo in a recording before anything is made of it."""

    mirror: str = ""  # The camera's axis along which the skeleton is mirrored
    swap: tuple[str, ...] = ()  # Two joints whose names are exchanged; or none
    negate: tuple[str, ...] = ()  # Sensors ("accelerometer", "gyroscope") whose sign is turned
    camera_frame: CameraFrame | None = None  # What the camera's axes are in truth
    sides: bool = False  # The person's left arm is called the right one, and the other way round

    def __post_init__(self) -> None:
        if self.mirror not in ("", *AXES):
            raise RecordingError(f"a skeleton is mirrored along x, y or z, not '{self.mirror}'")
        if self.swap and (len(set(self.swap)) != 2 or len(self.swap) != 2 or set(self.swap) - set(SWAPPED)):
            raise RecordingError(
                f"two joints of {', '.join(SWAPPED)} can be swapped, not '{','.join(self.swap)}'"
            )
        if set(self.negate) - set(SENSORS):
            raise RecordingError(f"{' and '.join(SENSORS)} can be negated, not '{','.join(self.negate)}'")

    @property
    def options(self) -> str:
        """As on the command line; "" where there is nothing to undo."""
        return " ".join(self.each_option)

    @property
    def each_option(self) -> tuple[str, ...]:
        """The same, each option with its value."""
        options = [
            ("mirror", self.mirror),
            ("swap", ",".join(self.swap)),
            ("swap", "left,right" if self.sides else ""),
            ("negate", ",".join(self.negate)),
            ("camera-frame", str(self.camera_frame or "")),
        ]
        return tuple(f"--{name} {value}" for name, value in options if value)

    def applied(self, recording: Recording) -> Recording:
        """The recording with these mistakes undone, and a note of each."""
        if not self.options:
            return recording
        imu, arm, trunk, opposite = recording.imu, recording.arm, recording.trunk, recording.opposite
        if self.sides:
            if opposite is None:
                raise RecordingError(f"{recording.name}: the camera saw one arm, so sides cannot be swapped")
            arm, opposite = opposite, arm
        if "accelerometer" in self.negate:
            imu = replace(imu, acc=by_rows(np.negative, imu.acc))
        if "gyroscope" in self.negate:
            imu = replace(imu, gyro=by_rows(np.negative, imu.gyro))
        if self.mirror:
            sign = np.where(np.array(AXES) == self.mirror, -1.0, 1.0)

            def mirrored(tracks: JointTracks) -> JointTracks:
                return replace(tracks, position=by_rows(lambda part: part * sign, tracks.position))

            arm, opposite = mirrored(arm), None if opposite is None else mirrored(opposite)
            if trunk is not None and trunk.other_arm is not None:
                trunk = replace(trunk, other_arm=mirrored(trunk.other_arm))
        if self.swap:
            first, second = self.swap
            other = {first: second, second: first}
            columns = [JOINTS.index(other.get(joint, joint)) for joint in JOINTS]
            position = by_rows(lambda part: part[:, columns], arm.position)
            arm = replace(arm, position=position, state=np.asarray(arm.state)[:, columns])
        return replace(
            recording,
            imu=imu,
            arm=arm,
            trunk=trunk,
            opposite=opposite,
            camera_frame=self.camera_frame or recording.camera_frame,
            notes=(*recording.notes, *self._notes()),
            applied_fixes=(*recording.applied_fixes, *self.each_option),
        )

    def _notes(self) -> list[str]:
        notes = [f"the {sensor}'s sign was turned (--negate {sensor})" for sensor in self.negate]
        if self.mirror:
            notes.append(f"the skeleton was mirrored along {self.mirror} (--mirror {self.mirror})")
        if self.swap:
            first, second = self.swap
            notes.append(f"{first} and {second} were swapped (--swap {first},{second})")
        if self.sides:
            notes.append("left and right of the skeleton were swapped (--swap left,right)")
        if self.camera_frame is not None:
            notes.append(f"the camera's axes were taken as {self.camera_frame} (--camera-frame)")
        return notes
