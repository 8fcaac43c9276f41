"""What the channels of a stream are: its labels, types and units."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordingError
from ..io.tables.imu import Sensors, channel_labels, find_sensors, kind_of, stem_of
from ..io.tables.joints import find_joint_columns, program_of, words_of
from ..io.tables.skeletons import kinect_states, share_states, without_origin
from ..io.tables.units import ACCELERATION, ANGULAR_VELOCITY, METRES, plain_unit
from ..recording import JOINTS, CameraFrame, JointState
from ..runtime.printable import printable

#: Labels of programs that follow several people: `body1_wrist_right_x`, `Person 2: WristRight_X`.
_BODY = re.compile(
    r"(?:body|person|user|skeleton|actor|subject|player)[ _.:-]?"
    r"(?P<body>\d+|[a-z](?=[ _.:-]))[ _.:/-]+(?P<label>.+)",
    re.IGNORECASE,
)
#: The channel format of strings (`pylsl.cf_string`).
_STRINGS = 3
Axes = tuple[int, int, int]
#: Words of a label beside a joint's whose numbers are a Kinect's states, not shares of one.
_STATES = {"state", "trackingstate", "status", "level"}
#: The camera's axes where names of joints show which program sent them.
_FRAMES = {"azure": CameraFrame.OPTICAL, "kinect": CameraFrame.KINECT}
#: Of an IMU's sensors: what they are called, their units, and examples of these.
_SENSORS = {
    "acc": ("accelerometer", ACCELERATION, "m/s^2 or g"),
    "gyro": ("gyroscope", ANGULAR_VELOCITY, "rad/s or deg/s"),
}


@dataclass(frozen=True)
class StreamLabels:
    """A stream's description of itself."""

    name: str  # Its name and type
    kind: str
    labels: list[str]  # Of its channels; "" where there is none
    types: list[str]
    units: list[str]
    is_text: bool = False  # It sends strings instead of numbers

    @classmethod
    def of(cls, info: Any) -> StreamLabels:
        """From a full `pylsl.StreamInfo`."""
        channels, channel = [], info.desc().child("channels").child("channel")
        for _ in range(info.channel_count()):
            channels.append(channel)
            channel = channel.next_sibling("channel")
        labels, types, units = channel_labels(channel.child_value for channel in channels)
        return cls(info.name(), info.type(), labels, types, units, info.channel_format() == _STRINGS)

    @property
    def sensors(self) -> Sensors:
        """The IMUs' sensors among its channels."""
        return find_sensors(self.labels, self.types, f"{self.name} {self.kind}")

    def refused(self, why: str) -> RecordingError:
        """The error of a stream that cannot be used."""
        return RecordingError(f"The stream {printable(self.name)} {why}")

    def check_numbers(self) -> None:
        """Refuse a stream of text."""
        if self.is_text:
            raise self.refused(
                "sends text, not numbers; name the one with the samples (markers and notes of a session"
                " usually are of this kind)."
            )

    @property
    def shown(self) -> str:
        """Its labels, for a sentence."""
        labels = [label for label in self.labels if label]
        if not labels:
            return "its channels have no labels"
        more = f", and {len(labels) - 8} more" if len(labels) > 8 else ""
        return f"its channels are {printable(', '.join(labels[:8])[:150])}{more}"

    def factor(self, columns: Axes, known: dict[str, float], what: str, such_as: str) -> float:
        """What a unit of these channels is in SI."""
        units = {self.units[column].strip() for column in columns}
        factors = {known.get(plain_unit(unit)) for unit in units}
        if len(factors) == 1 and (factor := factors.pop()) is not None:
            return factor
        stated = printable(", ".join(sorted(units))[:60])
        problem = f"is stated as {stated!r}, which is not known" if any(units) else "is missing"
        raise self.refused(
            f"cannot be used: the unit of its {what} {problem}; send {such_as} as the channels' unit."
        )


@dataclass(frozen=True)
class ImuChannels:
    """Channels of an IMU, or of its accelerometer or gyroscope alone."""

    axes: dict[str, Axes]  # Columns of x, y, z of `acc`, `gyro` and `mag`, as far as they are sent
    units: dict[str, float]  # m/s^2 and rad/s in one of theirs

    @classmethod
    def of(cls, stream: StreamLabels, half: str = "") -> ImuChannels:
        """What an IMU's stream contains; of one half, `acc` or `gyro`, where that is asked for."""
        stream.check_numbers()
        wanted, sensors = [half] if half else list(_SENSORS), stream.sensors
        _check_one_of_each(stream, sensors)
        whole = {name: axes for name, axes in sensors.items() if set(wanted) <= axes.keys()}
        if not whole:
            there = {kind for axes in sensors.values() for kind in axes}
            lacks = [f"{kind}_x, {kind}_y, {kind}_z" for kind in wanted if kind not in there]
            raise stream.refused(
                f"cannot be used as {_SENSORS[half][0] if half else 'IMU'}: {stream.shown};"
                f" {' and '.join(lacks)} are missing: send accelerometer and gyroscope with these labels and"
                " their units, in one stream or in two (--gyro names the second)."
            )
        if len(whole) > 1:
            names = printable(", ".join(whole))
            raise stream.refused(
                f"contains several IMUs ({names}); send that of the forearm in a stream of its own."
            )
        axes = {kind: at for kind, at in next(iter(whole.values())).items() if kind in (*wanted, "mag")}
        units = {}
        for kind in wanted:
            what, known, such_as = _SENSORS[kind]
            units[kind] = stream.factor(axes[kind], known, what, such_as)
        return cls(axes, units)

    def with_gyroscope(self, gyro: ImuChannels, behind: int) -> ImuChannels:
        """An accelerometer's with a gyroscope's, whose channels come after `behind` others."""
        axes = {kind: (x + behind, y + behind, z + behind) for kind, (x, y, z) in gyro.axes.items()}
        return ImuChannels({**self.axes, **axes}, {**self.units, **gyro.units})

    def values(self, samples: NDArray) -> dict[str, NDArray]:
        """Specific force, angular velocity in SI, magnetic field as sent (n, 3) of samples (n, channels)."""
        samples = samples.astype(float)
        return {kind: samples[:, at] * self.units.get(kind, 1.0) for kind, at in self.axes.items()}


def is_accelerometer(stream: StreamLabels) -> bool:
    """Whether it has an IMU's accelerometer and no gyroscope."""
    kinds = {kind for axes in stream.sensors.values() for kind in axes}
    return not stream.is_text and kinds & _SENSORS.keys() == {"acc"}


def belongs(name: str, kind: str, to_name: str) -> bool:
    """Whether a stream, by its name and type, may be the gyroscope of an accelerometer's stream."""
    return kind_of(words_of(f"{name} {kind}")) == "gyro" and stem_of(name) == stem_of(to_name)


def _check_one_of_each(stream: StreamLabels, sensors: Sensors) -> None:
    """Refuse a stream with two sensors of a kind of which it does not show which belong together."""
    for kind, (what, *_) in _SENSORS.items():
        used = [at for axes in sensors.values() for at in axes.get(kind, ())]
        spare = [
            label
            for at, label in enumerate(stream.labels)
            if at not in used and used and kind_of(words_of(label)) == kind and label[-1:].lower() in "xyz"
        ]
        if spare:
            shown = printable(", ".join(dict.fromkeys([*(stream.labels[at] for at in used), *spare])))
            raise stream.refused(f"has several {what}s ({shown}); send the one with the larger range.")


@dataclass(frozen=True)
class SkeletonChannels:
    """Channels of one arm's joints."""

    side: str  # "left", "right" or ""
    axes: dict[str, Axes]  # Columns of x, y, z by joint
    confidence: dict[str, int]  # Column of a confidence (a share of one) or a Kinect's state by joint
    states: set[str]  # Joints of which it is a state
    metres: float  # In one of their units
    camera_frame: CameraFrame | None  # Where the joints' names identify the camera

    @classmethod
    def of(
        cls, stream: StreamLabels, side: str | None, prefer_side: str | None = None, body: str | None = None
    ) -> SkeletonChannels:
        """What a skeleton's stream contains of one arm."""
        stream.check_numbers()
        stream = _of_one_body(stream, body)
        columns = find_joint_columns(stream.labels)
        by_side: dict[str, dict[str, Axes]] = {}
        for name, triple in {**columns.axes, **_straps(stream.labels)}.items():
            joint, _, of_side = name.rpartition("_")
            by_side.setdefault(of_side, {})[joint] = triple
        by_side = {of: axes for of, axes in by_side.items() if _is_usable(axes)}
        if not by_side:
            raise stream.refused(
                f"cannot be used as skeleton: {stream.shown}; shoulder, elbow and wrist of an arm are"
                " missing: send their x, y, z with labels such as wrist_right_x, and the unit."
            )
        chosen = side or (prefer_side if prefer_side in by_side else None)
        if chosen is None and len(by_side) > 1:
            raise stream.refused("shows both arms; choose the one with the IMU by --side.")
        chosen = next(iter(by_side)) if chosen is None else chosen
        axes = by_side.get(chosen, by_side.get(""))
        if axes is None:
            raise stream.refused(f"shows no {chosen} arm: {stream.shown}.")
        metres = stream.factor(next(iter(axes.values())), METRES, "positions", "m or mm")
        beside = {joint: columns.confidence.get(f"{joint}_{chosen}") for joint in axes}
        known = {joint: at for joint, at in beside.items() if at is not None}
        states = {joint for joint, at in known.items() if _STATES & set(words_of(stream.labels[at]))}
        frame = _FRAMES.get(program_of(stream.labels))
        return cls(chosen, axes, known, states, metres, frame)

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints that are there, in the order of `JOINTS`."""
        return tuple(joint for joint in JOINTS if joint in self.axes)

    def values(self, samples: NDArray) -> dict[str, NDArray]:
        """`position` (n, 5, 3) in m and `state` (n, 5) of samples (n, channels)."""
        samples = samples.astype(float)
        position = np.full((len(samples), len(JOINTS), 3), np.nan)
        state = np.full((len(samples), len(JOINTS)), JointState.NOT_TRACKED, np.int8)
        for joint, columns in self.axes.items():
            at, stated = JOINTS.index(joint), self.confidence.get(joint)
            position[:, at] = without_origin(samples[:, columns]) * self.metres
            is_there, read = np.isfinite(position[:, at]).all(axis=1), share_states
            if joint in self.states:
                read = kinect_states
            tracked = JointState.TRACKED if stated is None else read(samples[:, stated])
            state[:, at] = np.where(is_there, tracked, JointState.NOT_TRACKED)
        return {"position": position, "state": state}


def _of_one_body(stream: StreamLabels, body: str | None) -> StreamLabels:
    """The labels of one body without what says whose they are; those of other bodies are empty."""
    found = [_BODY.match(label) for label in stream.labels]
    bodies = sorted({match["body"].lower() for match in found if match})
    if not bodies:
        return stream
    there = ", ".join(bodies[:8])
    if body is None and len(bodies) > 1:
        raise stream.refused(f"shows several bodies ({there}); choose with --body.")
    wanted = bodies[0] if body is None else body.lower()
    if wanted not in bodies:
        raise stream.refused(f"shows no body {printable(wanted)}, but {there}.")
    labels = [
        label if match is None else match["label"] if match["body"].lower() == wanted else ""
        for label, match in zip(stream.labels, found, strict=True)
    ]
    return replace(stream, labels=labels)


def _straps(labels: Sequence[str]) -> dict[str, Axes]:
    """Columns of the strap's own position by its name and side."""
    columns: dict[str, dict[str, int]] = {}
    for at, label in enumerate(labels):
        words = words_of(label)
        if "strap" in words and words[-1] in ("x", "y", "z"):
            side = next((word for word in words if word in ("left", "right")), "")
            columns.setdefault(f"strap_{side}", {})[words[-1]] = at
    return {name: (c["x"], c["y"], c["z"]) for name, c in columns.items() if len(c) == 3}


def _is_usable(axes: dict[str, Axes]) -> bool:
    return "strap" in axes or ("elbow" in axes and bool({"wrist", "hand"} & axes.keys()))
