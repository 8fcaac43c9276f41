"""What came in from sensor and camera since the last look, with the times at which it came."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..array_types import FloatArray, IntArray
from ..recording import JOINTS, CameraFrame


@dataclass(frozen=True)
class ImuRows:
    """Samples of the IMU in the order in which they came.

    Attributes
    ----------
    t_s : ndarray, shape (n,), s
        Stamps.
    acc : ndarray, shape (n, 3), m/s^2
        Specific force in {A}.
    gyro : ndarray, shape (n, 3), rad/s
        Angular velocity in {A}.
    arrival_s : ndarray, shape (n,), s
        When they came, on the session's clock.
    mag : ndarray, shape (n, 3), optional
        Magnetic field in the sensor's unit: recorded, not used while live.
    """

    t_s: FloatArray
    acc: FloatArray
    gyro: FloatArray
    arrival_s: FloatArray
    mag: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.t_s)

    def select(self, rows: IntArray | slice) -> ImuRows:
        """Some of the samples."""
        mag = None if self.mag is None else self.mag[rows]
        return ImuRows(self.t_s[rows], self.acc[rows], self.gyro[rows], self.arrival_s[rows], mag)

    def stamped(self, t_s: FloatArray) -> ImuRows:
        """The same samples with other stamps (n,), s."""
        return replace(self, t_s=t_s)

    @classmethod
    def joined(cls, rows: Sequence[ImuRows]) -> ImuRows:
        """One after the other."""
        mags = [one.mag for one in rows if one.mag is not None]
        mag = np.concatenate(mags) if len(mags) == len(rows) else None
        return cls(
            np.concatenate([one.t_s for one in rows]),
            np.concatenate([one.acc for one in rows]),
            np.concatenate([one.gyro for one in rows]),
            np.concatenate([one.arrival_s for one in rows]),
            mag,
        )

    @classmethod
    def none(cls) -> ImuRows:
        """No sample."""
        return cls(np.empty(0), np.empty((0, 3)), np.empty((0, 3)), np.empty(0))


@dataclass(frozen=True)
class FrameRows:
    """Frames of the camera in the order in which they came.

    Attributes
    ----------
    t_s : ndarray, shape (n,), s
        Stamps.
    position : ndarray, shape (n, 5, 3), m
        Joints in the order of `JOINTS`, in {K}; nan where there is none.
    state : ndarray of int8, shape (n, 5)
        `JointState` values.
    arrival_s : ndarray, shape (n,), s
        When they came, on the session's clock.
    """

    t_s: FloatArray
    position: FloatArray
    state: NDArray[np.int8]
    arrival_s: FloatArray

    def __len__(self) -> int:
        return len(self.t_s)

    def select(self, rows: IntArray | slice) -> FrameRows:
        """Some of the frames."""
        return FrameRows(self.t_s[rows], self.position[rows], self.state[rows], self.arrival_s[rows])

    def stamped(self, t_s: FloatArray) -> FrameRows:
        """The same frames with other stamps (n,), s."""
        return replace(self, t_s=t_s)

    @classmethod
    def joined(cls, rows: Sequence[FrameRows]) -> FrameRows:
        """One after the other."""
        return cls(
            np.concatenate([one.t_s for one in rows]),
            np.concatenate([one.position for one in rows]),
            np.concatenate([one.state for one in rows]),
            np.concatenate([one.arrival_s for one in rows]),
        )

    @classmethod
    def none(cls) -> FrameRows:
        """No frame."""
        shape = (0, len(JOINTS))
        return cls(np.empty(0), np.empty((*shape, 3)), np.empty(shape, np.int8), np.empty(0))


@dataclass(frozen=True)
class Arrivals:
    """What came since the last look.

    Attributes
    ----------
    imu : ImuRows
    frames : FrameRows
    events : tuple of str
        What was done to their stamps, a sentence each.
    """

    imu: ImuRows = field(default_factory=ImuRows.none)
    frames: FrameRows = field(default_factory=FrameRows.none)
    events: tuple[str, ...] = ()


@dataclass(frozen=True)
class SourceInfo:
    """What a session is made of.

    Attributes
    ----------
    imu, skeleton : str
        Names of the streams.
    side : str
        "left", "right" or "".
    joints : tuple of str
        Joints that the skeleton has.
    origin_ns : int, ns
        What the session's times count from.
    camera_frame : CameraFrame, optional
        Convention of the camera's axes where it is known.
    gravity_hint : ndarray, shape (3,), optional
        Direction of down in {K} where it is known.
    name : str
        Of the session.
    lsl_start_s : float, s, optional
        The same on this computer's LSL clock, where that is the session's.
    notes : tuple of str
        How it was decided, and what is assumed, one sentence each.
    """

    imu: str
    skeleton: str
    side: str
    joints: tuple[str, ...]
    origin_ns: int
    camera_frame: CameraFrame | None = None
    gravity_hint: FloatArray | None = None
    name: str = "session"
    lsl_start_s: float | None = None
    notes: tuple[str, ...] = ()


class Source(Protocol):
    """Where a session's samples and frames come from: streams of the network, or a recording."""

    @property
    def info(self) -> SourceInfo:
        """What the session is made of."""

    @property
    def speed(self) -> float:
        """How fast its time goes, 1 being as usual; 0 waits for nobody."""

    @property
    def ended(self) -> bool:
        """Nothing will come any more."""

    def now_s(self) -> float:
        """The session's time, s."""

    def wait(self, seconds: float) -> None:
        """Until something comes, at most so long."""

    def arrivals(self) -> Arrivals:
        """What came since the last call."""

    def close(self) -> None:
        """Let the streams go."""
