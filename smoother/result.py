"""The recovered motion: what `smooth` and every peer return."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .calibration import ArmCalibration
from .measurements.visibility import Gap
from .recording import JOINTS, BoolArray, FloatArray, IntArray, JointTracks

#: Samples or frames that are looked at together; what is computed of them passes through the memory.
BLOCK = 8192


@dataclass(frozen=True)
class FrameResiduals:
    """Camera minus recovered joint position, a row a camera frame.

    Attributes
    ----------
    t_s : (F,) frame times on the IMU's clock, s.
    residual : (F, 5, 3) m in {K}, joints in the order of `JOINTS`; nan where there is no answer.
    used : (F, 5) the sample took part in the solution.
    reason : (F, 5) why a tracked sample was set aside: index into `reasons`, 0 where it was not.
    reasons : the sentences, the first one empty.
    """

    t_s: FloatArray
    residual: FloatArray
    used: BoolArray
    reason: NDArray[np.uint8]
    reasons: tuple[str, ...] = ("",)

    def __len__(self) -> int:
        return len(self.t_s)

    def rows(self, rows: slice) -> FrameResiduals:
        """Some of the frames."""
        return replace(
            self,
            t_s=self.t_s[rows],
            residual=self.residual[rows],
            used=self.used[rows],
            reason=self.reason[rows],
        )

    def blocks(self) -> Iterator[FrameResiduals]:
        """All frames, some thousand at a time."""
        for start in range(0, len(self), BLOCK):
            yield self.rows(slice(start, start + BLOCK))


@dataclass(frozen=True)
class Recovery:
    """The arm's motion on the IMU's times and clock, with covariance.

    Covariances are one-sigma, in {K}; nan where the method has no answer or states none.

    Attributes
    ----------
    method : name of the method ("graph" or a peer).
    t_s : (N,) the IMU's stamps, s after `origin_ns`.
    occluded : (N,) the camera did not see the forearm at that time.
    position : (N, 3) of the IMU, m in {K}; nan where there is no answer.
    quaternion : (N, 4) qw, qx, qy, qz of `R_K_A`.
    velocity : (N, 3) m/s in {K}.
    pose_covariance : (N, 6, 6) of (position in {K} m, rotation vector in {K} rad).
    velocity_covariance : (N, 3, 3) (m/s)^2 in {K}.
    joints : positions (N, 3) by joint name, m in {K}.
    joint_covariance : (N, 3, 3) by joint name, m^2 in {K}.
    gaps : the occluded stretches.
    calibration : what was used or found for this arm; None for methods that need none.
    gravity_direction : (3,) unit vector of down in {K}; nan where the method does not solve it.
    clock_offset_s, clock_offset_sigma_s : t_imu = t_camera + offset.
    arm : the camera's joints, stamps moved to the IMU's clock.
    residuals : camera against answer; None for methods that keep none.
    notes : what a reader must know of this result, one sentence each.
    config : the effective configuration, as plain values.
    figures : further numbers worth keeping (biases, noise found, timings), by name.
    """

    method: str
    t_s: FloatArray
    occluded: BoolArray
    position: FloatArray
    quaternion: FloatArray
    velocity: FloatArray
    pose_covariance: FloatArray
    velocity_covariance: FloatArray
    joints: dict[str, FloatArray]
    joint_covariance: dict[str, FloatArray]
    gaps: tuple[Gap, ...]
    calibration: ArmCalibration | None
    gravity_direction: FloatArray
    clock_offset_s: float
    clock_offset_sigma_s: float
    arm: JointTracks
    residuals: FrameResiduals | None = None
    origin_ns: int = 0
    side: str = ""
    name: str = "recording"
    notes: tuple[str, ...] = ()
    config: dict[str, object] = field(default_factory=dict)
    figures: dict[str, object] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.t_s)

    def rows(self, rows: slice | IntArray) -> Recovery:
        """The recovery of some samples; frames, gaps and all else stay whole. A slice copies nothing."""

        def part(column: NDArray) -> NDArray:
            return column[rows]

        return replace(
            self,
            t_s=part(self.t_s),
            occluded=part(self.occluded),
            position=part(self.position),
            quaternion=part(self.quaternion),
            velocity=part(self.velocity),
            pose_covariance=part(self.pose_covariance),
            velocity_covariance=part(self.velocity_covariance),
            joints={joint: part(values) for joint, values in self.joints.items()},
            joint_covariance={joint: part(values) for joint, values in self.joint_covariance.items()},
        )

    def blocks(self, overlap: int = 0) -> Iterator[Recovery]:
        """All samples, some thousand at a time (`rows`).

        With an overlap each block begins with the last samples of the one before.
        """
        for start in range(0, len(self), BLOCK):
            yield self.rows(slice(max(start - overlap, 0), start + BLOCK))

    def frames(self) -> Iterator[JointTracks]:
        """All camera frames, some thousand at a time, like `blocks`."""
        for start in range(0, len(self.arm), BLOCK):
            yield self.arm.select(slice(start, start + BLOCK))

    @property
    def answered(self) -> BoolArray:
        """(N,) whether there is a position."""
        return self._of_each(lambda block: np.asarray(np.isfinite(block.position).all(axis=1)), bool)

    @property
    def sigma_m(self) -> FloatArray:
        """(N, 3) standard deviation of the IMU's position, m an axis of {K}."""
        return np.sqrt(np.einsum("nii->ni", self.pose_covariance[:, :3, :3]))

    @property
    def worst_sigma_m(self) -> FloatArray:
        """(N,) standard deviation of the IMU's position on its worst axis, m."""
        return self._of_each(lambda block: block.sigma_m.max(axis=1), float)

    @property
    def sigma_deg(self) -> FloatArray:
        """(N,) square root of the trace of the orientation covariance, degrees."""
        return np.degrees(np.sqrt(np.trace(self.pose_covariance[:, 3:, 3:], axis1=1, axis2=2)))

    def _of_each(self, value: Callable[[Recovery], NDArray], kind: type) -> NDArray:
        """(N,) a value of each sample, with little more than itself in memory."""
        values: NDArray = np.empty(len(self), kind)
        start = 0
        for block in self.blocks():
            values[start : start + len(block)] = value(block)
            start += len(block)
        return values

    def to_arrays(self) -> dict[str, FloatArray | BoolArray]:
        """Everything a notebook needs, by the column families of the CSV export.

        Returns
        -------
        dict with `t_s` (N,), `occluded` (N,), `imu` (N, 3), `imu_quaternion` (N, 4; qw, qx, qy,
        qz), `velocity` (N, 3), `sigma` (N, 3), `sigma_deg` (N,), and for each joint found its
        position `elbow` (N, 3) .. and `elbow_sigma` (N, 3) ... Metres in the camera frame.
        """
        arrays: dict[str, FloatArray | BoolArray] = {
            "t_s": self.t_s,
            "occluded": self.occluded,
            "imu": self.position,
            "imu_quaternion": self.quaternion,
            "velocity": self.velocity,
            "sigma": self.sigma_m,
            "sigma_deg": self.sigma_deg,
        }
        for joint in (name for name in JOINTS if name in self.joints):
            arrays[joint] = self.joints[joint]
            arrays[f"{joint}_sigma"] = np.sqrt(np.einsum("nii->ni", self.joint_covariance[joint]))
        return arrays
