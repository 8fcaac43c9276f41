"""What a file holds, before it is decided what to use: streams with the stamps as recorded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...array_types import BoolArray, FloatArray, IntArray
from ...errors import RecordingError
from ...measurements.visibility import enough_joints
from ...recording import CameraFrame, JointState


@dataclass
class ImuSamples:
    """One inertial sensor.

    Attributes
    ----------
    topic, frame_id : str
        Where it came from.
    stamp_ns : ndarray of int, shape (N,), ns
        As recorded.
    acc, gyro : ndarray, shape (N, 3), m/s^2 and rad/s
    mag : ndarray, shape (N, 3), optional
        In the sensor's unit, or None.
    log_shift_ns : int, ns
        Median of log time minus stamp.
    """

    topic: str
    frame_id: str
    stamp_ns: IntArray
    acc: FloatArray
    gyro: FloatArray
    mag: FloatArray | None = None
    log_shift_ns: int = 0


@dataclass
class FieldSamples:
    """A magnetometer that publishes by itself.

    Attributes
    ----------
    topic, frame_id : str
        Where it came from.
    stamp_ns : ndarray of int, shape (N,), ns
        As recorded.
    mag : ndarray, shape (N, 3)
        In its own unit.
    """

    topic: str
    frame_id: str
    stamp_ns: IntArray
    mag: FloatArray


@dataclass
class ArmFrames:
    """One arm of one body as a camera saw it.

    Attributes
    ----------
    topic, frame_id, side : str
    body : int
        What it is; side is "left", "right" or "".
    stamp_ns : ndarray of int, shape (F,), ns
        As recorded.
    position : ndarray, shape (F, 5, 3), m
        Joints in the order of `JOINTS`; nan where there is none.
    state : ndarray of int8, shape (F, 5)
        `JointState` values.
    camera_frame : CameraFrame, optional
        Convention of the axes where the message type settles it.
    """

    topic: str
    frame_id: str
    body: int
    side: str
    stamp_ns: IntArray
    position: FloatArray
    state: NDArray[np.int8]
    camera_frame: CameraFrame | None = None

    @property
    def label(self) -> str:
        """For messages: topic, body and side."""
        return f"{self.topic} (body {self.body}{', ' + self.side if self.side else ''})"

    @property
    def tracked(self) -> int:
        """Number of frames with a tracked forearm joint."""
        return int(enough_joints(self.state == JointState.TRACKED, 1).sum())


@dataclass
class PoseSamples:
    """Poses of something in a frame: the truth, or a candidate for it.

    Attributes
    ----------
    topic, frame_id : str
        Where it came from.
    stamp_ns : ndarray of int, shape (M,), ns
    position : ndarray, shape (M, 3), m
    quaternion : ndarray, shape (M, 4)
        qw, qx, qy, qz.
    score : ndarray of bool, shape (M,), optional
        Samples to score on, or None for all.
    joints : dict of str to ndarray, shape (M, 3), m
        Further reference positions by joint.
    """

    topic: str
    frame_id: str
    stamp_ns: IntArray
    position: FloatArray
    quaternion: FloatArray
    score: BoolArray | None = None
    joints: dict[str, FloatArray] = field(default_factory=dict)


@dataclass(frozen=True)
class TopicInfo:
    """A topic as `info` lists it; times are log times, ns."""

    name: str
    schema: str
    encoding: str
    count: int
    first_ns: int
    last_ns: int

    @property
    def duration_s(self) -> float:
        """First to last message, s."""
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def rate_hz(self) -> float:
        """Mean rate; nan for fewer than two messages."""
        return (self.count - 1) / self.duration_s if self.duration_s > 0 else float("nan")


@dataclass
class RecordingFile:
    """All that a file (or a folder of plain files) holds, by kind.

    Attributes
    ----------
    path : Path
        The file or folder.
    topics : list of TopicInfo
        Every topic, those that are not used included.
    imus : list of ImuSamples
    arms : list of ArmFrames
    poses : list of PoseSamples
        Streams found, samples as recorded (not cleaned).
    camera_frame : CameraFrame, optional
        Convention of the camera's axes where the file states it.
    gravity_hint : ndarray, shape (3,), optional
        Unit vector of down in {K}, or None.
    notes : list of str
        What was wrong with the file, and what it says of itself.
    metadata : dict of str to dict of str to str
        Its metadata records, by name.
    damage : list of str
        Of the notes those on a damaged container.
    frames_without_body : int
        Skeleton messages were there, and none had a joint of an arm.
    clocks_unrelated : bool
        The IMUs' clock and the camera's have nothing in common.
    """

    path: Path
    topics: list[TopicInfo] = field(default_factory=list)
    imus: list[ImuSamples] = field(default_factory=list)
    arms: list[ArmFrames] = field(default_factory=list)
    poses: list[PoseSamples] = field(default_factory=list)
    camera_frame: CameraFrame | None = None
    gravity_hint: FloatArray | None = None
    notes: list[str] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    frames_without_body: int = 0
    damage: list[str] = field(default_factory=list)
    clocks_unrelated: bool = False

    @contextmanager
    def damage_told(self) -> Iterator[None]:
        """Within this, an error's sentence is followed by what is damaged in the file.

        Raises
        ------
        RecordingError
            Where one is raised inside.
        """
        try:
            yield
        except RecordingError as error:
            if not self.damage or self.damage[0] in str(error):
                raise
            raise RecordingError(f"{error} The file is damaged: {' '.join(self.damage[:4])}") from error

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    @property
    def level_down(self) -> FloatArray | None:
        """(3,) down in {K} as the file says, else of a camera that stands level; None if neither is known."""
        if self.gravity_hint is not None:
            return self.gravity_hint
        frames = (self.camera_frame, *(arm.camera_frame for arm in self.arms))
        return next((frame.down for frame in frames if frame is not None), None)
