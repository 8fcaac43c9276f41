"""What a file contains, before it is decided what to use: streams with the stamps as recorded.

Streams whose stamps are put right: rows out of order, lone stamps far away. What their names say: the segment
that an IMU is on, its side, a body's number.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from calib.intrinsics import Intrinsics

from ...array_types import BoolArray, FloatArray, IntArray
from ...errors import RecordingError
from ...measurements.timestamps import largest_group
from ...measurements.visibility import enough_joints
from ...recording import CameraFrame, CameraPose, ImuStream, JointState
from ...runtime.store import by_rows
from ..mcap.messages import Topic, nanoseconds, seconds, told_behind

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


States = NDArray[np.int8]  # `JointState` values


@dataclass
class SkeletonTable:
    """One body's joints as a file has them, in metres, times not yet repaired."""

    body: int  # The file's number of the body
    t_s: FloatArray | None  # (F,) s: frame times as written, on the camera's clock
    # dict of (F, 3) m: By joint and side (`wrist_left`, `shoulder_right`, ..); nan where there is none
    position: dict[str, FloatArray]
    state: dict[str, States]  # int (F,): `JointState` values of the same joints
    frame: CameraFrame | None = None  # Where the format settles the axes
    gravity_hint: FloatArray | None = None  # (3,)
    rate_hz: float | None = None  # Rate that the file or its format states
    relative: bool = False  # Positions are relative to the body (about the hips)
    units: str = ""  # As written in the file ("mm")
    notes: list[str] = field(default_factory=list)  # What was decided or dropped in reading, a sentence each

    def __len__(self) -> int:
        return next(map(len, self.position.values()), 0)


@dataclass
class ImuSamples:
    """One inertial sensor as a file has it, in SI units."""

    topic: str  # Where it came from, or what the file calls the sensor ("" where it does not say)
    frame_id: str = ""  # Where it came from
    stamp_ns: IntArray = field(default_factory=lambda: np.empty(0, np.int64))  # (N,): as a recording has them
    acc: FloatArray | None = None  # (N, 3) m/s^2; None where there is only another sensor
    gyro: FloatArray | None = None  # (N, 3) rad/s; as `acc`
    mag: FloatArray | None = None  # (N, 3): in the sensor's own unit
    log_shift_ns: int = 0  # Median of log time minus stamp
    t_s: FloatArray | None = None  # (N,) s: stamps as a table has them, on the device's clock
    rate_hz: float | None = None  # Rate that the file states, or that its counter counts
    counter: IntArray | None = None  # (N,): packet counter, where there is one
    counter_wraps: int = 0  # 0 = it does not wrap
    units: str = ""  # As the file has them, for the line that is said of it ("m/s^2, deg/s")
    notes: list[str] = field(default_factory=list)  # What was decided or dropped in reading, a sentence each
    made_of: tuple[str, ...] = ()  # Streams of the file that contain a half each; () where one has the whole
    assumed: bool = False  # A gyroscope only because a vector without a name shows no gravity

    def __len__(self) -> int:
        columns = (self.acc, self.gyro, self.t_s, self.stamp_ns)
        return next((len(each) for each in columns if each is not None), 0)

    @property
    def vectors(self) -> tuple[FloatArray, FloatArray]:
        """Specific force and angular velocity of a sensor that has both."""
        assert self.acc is not None and self.gyro is not None
        return self.acc, self.gyro

    @property
    def role(self) -> str:
        """The segment by its names: "forearm", "upper_arm", "hand", "trunk", "base" or ""."""
        return named_segment(self.topic) or named_segment(self.frame_id)

    @property
    def side(self) -> str:
        """The side by its names: "left", "right" or ""."""
        return named_side(self.topic, self.frame_id)

    @classmethod
    def of(cls, topic: str, imu: ImuStream, origin_ns: int) -> ImuSamples:
        """A recording's stream under a topic, with stamps."""
        stamp_ns = nanoseconds(imu.t_s, origin_ns)
        return cls(topic, topic.rpartition("/")[2], stamp_ns, imu.acc, imu.gyro, imu.mag)

    def on_axis(self, origin_ns: int) -> ImuStream:
        """The same with times in seconds after an origin."""
        return ImuStream(self.topic, seconds(self.stamp_ns, origin_ns), *self.vectors, self.mag)


@dataclass
class ArmFrames:
    """One arm of one body as a camera saw it."""

    topic: str
    frame_id: str
    body: int  # What it is; side is "left", "right" or ""
    side: str
    stamp_ns: IntArray  # int (F,) ns: as recorded
    position: FloatArray  # (F, 5, 3) m: joints in the order of `JOINTS`; nan where there is none
    state: NDArray[np.int8]  # int (F, 5): `JointState` values
    camera_frame: CameraFrame | None = None  # Convention of the axes where the message type settles it
    lens: Intrinsics | None = None  # Of a camera without depth

    @property
    def key(self) -> tuple[str, int, str]:
        """Whose arm it is: topic, body and side."""
        return self.topic, self.body, self.side

    @property
    def label(self) -> str:
        """For messages: topic, body and side."""
        return f"{self.topic} (body {self.body}{', ' + self.side if self.side else ''})"

    @property
    def tracked(self) -> int:
        """Number of frames with a tracked forearm joint."""
        return int(enough_joints(self.state == JointState.TRACKED, 1).sum())


@dataclass(frozen=True)
class KnownLens:
    """The lens of a camera without depth, and the camera's pose if that was measured."""

    lens: Intrinsics
    pose: CameraPose | None = None  # In the first camera's frame


@dataclass(frozen=True)
class CameraStream:
    """A camera beyond the first, whose skeleton is a topic of its own."""

    name: str
    camera_frame: CameraFrame | None = None  # Convention of its axes
    gravity_hint: FloatArray | None = None  # (3,): unit vector of down in its frame


@dataclass
class PoseSamples:
    """Poses of something in a frame: the truth, or a candidate for it."""

    topic: str  # Where it came from
    frame_id: str  # Where it came from
    stamp_ns: IntArray  # int (M,) ns
    position: FloatArray  # (M, 3) m
    quaternion: FloatArray  # (M, 4): qw, qx, qy, qz
    score: BoolArray | None = None  # bool (M,): samples to score on, or None for all
    # dict of (M, 3) m: Further reference positions by joint
    joints: dict[str, FloatArray] = field(default_factory=dict)


@dataclass
class RecordingFile:
    """All that a file (or a folder of plain files) holds, by kind."""

    path: Path  # The file or folder
    topics: list[Topic] = field(default_factory=list)  # Every topic, those that are not used included
    imus: list[ImuSamples] = field(default_factory=list)
    arms: list[ArmFrames] = field(default_factory=list)
    poses: list[PoseSamples] = field(default_factory=list)  # Streams found, samples as recorded (not cleaned)
    camera_frame: CameraFrame | None = None  # Convention of the camera's axes where the file states it
    gravity_hint: FloatArray | None = None  # (3,): unit vector of down in {K}, or None
    # What was wrong with the file, and what its metadata states
    notes: list[str] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # Its metadata records, by name
    frames_without_body: int = 0  # Skeleton messages were there, and none had a joint of an arm
    damage: list[str] = field(default_factory=list)  # Of the notes those on a damaged container
    clocks_unrelated: bool = False  # The IMUs' clock and the camera's have nothing in common
    applied_fixes: tuple[str, ...] = ()  # Options by which it is read otherwise than it says
    # Cameras beyond the first that the file names, by the topic of their skeleton
    cameras: dict[str, CameraStream] = field(default_factory=dict)
    # Of cameras without depth, by the topic of their keypoints
    lenses: dict[str, KnownLens] = field(default_factory=dict)
    # Accelerometers and gyroscopes alone, which belong to no IMU
    halves: list[ImuSamples] = field(default_factory=list)

    @contextmanager
    def damage_told(self) -> Iterator[None]:
        """Within this, an error's sentence is followed by what is damaged in the file."""
        try:
            yield
        except RecordingError as error:
            if not self.damage or self.damage[0] in str(error):
                raise
            raise RecordingError(f"{error}{told_behind(self.damage)}") from error

    @property
    def name(self) -> str:
        """The file's name."""
        return self.path.name

    @property
    def level_down(self) -> FloatArray | None:
        """(3,) down in {K} as the file states, else of a level camera; None if neither is known."""
        if self.gravity_hint is not None:
            return self.gravity_hint
        frames = (self.camera_frame, *(arm.camera_frame for arm in self.arms))
        return next((frame.down for frame in frames if frame is not None), None)


#: Key and value of a file's own metadata that state this. Stamps that run back in other files are a fault.
ORDER, ARRIVAL = "order", "arrival"


#: Columns that a stream may have, a row a sample; of several joints in a mapping.
_COLUMNS = (
    *("stamp_ns", "t_s", "counter", "acc", "gyro", "mag"),
    *("position", "state", "quaternion", "score", "joints"),
)
AnyStream = TypeVar("AnyStream", bound="DataclassInstance")
Stream = TypeVar("Stream", ImuSamples, ArmFrames, PoseSamples)


def rows_of(stream: AnyStream, rows: NDArray | slice) -> AnyStream:
    """Rows of a stream, by their numbers, by a mask or a slice."""
    columns: dict[str, Any] = {}
    for name in _COLUMNS:
        values = getattr(stream, name, None)
        if isinstance(values, dict):
            columns[name] = {key: kept(each, rows) for key, each in values.items()}
        elif values is not None and len(values):
            columns[name] = kept(values, rows)
    return replace(stream, **columns)


def kept(values: NDArray, rows: NDArray | slice) -> NDArray:
    """Rows of a column (N, ...), by numbers, a mask or a slice; the same array where that is all."""
    if isinstance(rows, slice):
        return values[rows]
    if rows.dtype == bool:
        if rows.all():
            return values
        rows = np.flatnonzero(rows)
    return by_rows(lambda part: values[part], rows)


def in_order(stream: Stream) -> Stream:
    """The stream in the order of its stamps; itself where it is."""
    stamp = stream.stamp_ns
    is_sorted = bool((stamp[1:] >= stamp[:-1]).all())
    return stream if is_sorted else rows_of(stream, np.argsort(stamp, kind="stable"))


def without_outlying(stream: Stream, notes: list[str]) -> Stream:
    """The stream without samples whose stamps lie far from all others; itself where there are none."""
    mask = largest_group(stream.stamp_ns)
    if mask is None:
        return stream
    dropped = ~mask
    near = int(np.median(stream.stamp_ns[mask]))
    days = abs(int(stream.stamp_ns[dropped][0]) - near) / 86_400e9
    notes.append(
        f"{stream.topic}: {int(dropped.sum())} of {len(mask)} stamps lie far from all others, the first by"
        f" {days:.1f} days; these samples were dropped."
    )
    return rows_of(stream, mask)


# ------------------------------------------------------------------------- what names of streams say

OTHER_SIDE = {"left": "right", "right": "left"}
#: Words of names and the segment that they speak of; the first row that fits counts.
_SEGMENTS = (
    ("trunk", ("trunk", "sternum", "chest", "torso", "thorax")),
    ("upper_arm", ("upper",)),
    ("forearm", ("forearm", "wrist", "lower_arm", "watch")),
    ("hand", ("hand", "palm", "metacarp")),
    ("forearm", ("arm",)),
    ("base", ("base", "camera", "kinect", "k4a", "azure", "depth", "realsense")),
)


def named_segment(name: str) -> str:
    """The segment that a name speaks of, or ""."""
    spoken = words(name)
    return next((segment for segment, named in _SEGMENTS if any(word in spoken for word in named)), "")


def role_among(stream: ImuSamples, imus: Sequence[ImuSamples]) -> str:
    """Its role in a file: an IMU named after a hand is used as the forearm's where that arm has no other."""
    if stream.role != "hand":
        return stream.role
    others = [imu.side for imu in imus if imu.role in ("", "forearm")]
    is_beside = others if not stream.side else {"", stream.side} & set(others)
    return "hand" if is_beside else "forearm"


def named_side(*names: str) -> str:
    """The side that names speak of: "left", "right" or ""."""
    for name in names:
        left, right = "left" in words(name), "right" in words(name)
        if left != right:
            return "left" if left else "right"
    return ""


def is_named(wanted: str, topic: str, frame_id: str) -> bool:
    """Whether a stream is what was asked for: by a part of its topic, or by its frame_id."""
    return wanted.strip("/").lower() in topic.lower() or wanted == frame_id


def words(name: str) -> str:
    """Lower case with the parts of CamelCase apart."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def is_of_other_arm(name: str, side: str, body: int | None = None) -> bool:
    """Whether a name speaks of another side than this one, or of another body."""
    other_side = bool(side) and named_side(name) not in ("", side)
    named = re.search(r"body_?(\d+)", words(name))
    return other_side or (body is not None and named is not None and int(named[1]) != body)


def free_name(name: str, taken: set[str]) -> str:
    """The name, or with a number where it is taken; it is taken from then on."""
    number, free = 2, name
    while free in taken:
        free, number = f"{name}_{number}", number + 1
    taken.add(free)
    return free
