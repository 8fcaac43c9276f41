"""What joint angles are computed from: a recovery, or anything else with the same columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol, Self

from ..array_types import FloatArray
from ..calibration import ArmCalibration
from .estimates import Estimates
from .segment_motion import SegmentMotion, TrunkMotion


class MovingArm(Protocol):
    """The columns of a `Recovery` that angles need; see there for shapes, units and frames."""

    @property
    def method(self) -> str:
        """Name of the method."""
        ...

    @property
    def side(self) -> str:
        """Of the arm: "left", "right" or ""."""
        ...

    @property
    def t_s(self) -> FloatArray:
        """(N,) s."""
        ...

    @property
    def position(self) -> FloatArray:
        """(N, 3) m, of the IMU in {K}."""
        ...

    @property
    def quaternion(self) -> FloatArray:
        """(N, 4) qw, qx, qy, qz of `R_K_A`."""
        ...

    @property
    def pose_covariance(self) -> FloatArray:
        """(N, 6, 6) of position and rotation vector in {K}."""
        ...

    @property
    def joints(self) -> Mapping[str, FloatArray]:
        """(N, 3) m in {K}, by joint."""
        ...

    @property
    def joint_covariance(self) -> Mapping[str, FloatArray]:
        """(N, 3, 3) m^2, by joint."""
        ...

    @property
    def calibration(self) -> ArmCalibration | None:
        """Of the arm."""
        ...

    @property
    def gravity_direction(self) -> FloatArray:
        """(3,) unit vector of down in {K}."""
        ...

    @property
    def estimates(self) -> Estimates:
        """What was found besides the motion."""
        ...

    @property
    def segments(self) -> Mapping[str, SegmentMotion]:
        """Of IMUs on further segments, by the segment's name."""
        ...

    @property
    def upper(self) -> SegmentMotion | None:
        """Of an IMU on the upper arm."""
        ...

    @property
    def trunk(self) -> TrunkMotion | None:
        """Of the thorax."""
        ...

    def __len__(self) -> int: ...

    def batches(self, overlap: int = 0) -> Iterator[Self]:
        """All samples, some thousand at a time."""
        ...
