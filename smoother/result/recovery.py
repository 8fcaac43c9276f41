"""The arm's motion over a recording, sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..calibration import ArmCalibration
from ..errors import UnoccludeError
from ..linalg import rotation_sigma_deg
from ..measurements.visibility import Gap
from ..recording import JOINTS, BoolArray, FloatArray, IntArray, JointTracks, arm_words
from ..trunk_motion import TrunkMotion
from ..upper_motion import UpperMotion
from .draws import Draws
from .estimates import Estimates
from .frame_residuals import BATCH_ROWS, FrameResiduals

if TYPE_CHECKING:
    import pandas
    import pyarrow


@dataclass(frozen=True, repr=False)
class Recovery:
    """The arm's motion on the IMU's times and clock, with covariance.

    Covariances are one-sigma, in {K}; nan where the method has no answer or states none.

    Attributes
    ----------
    method : str
        Name of the method ("graph" or a baseline).
    t_s : ndarray, shape (N,), s
        The IMU's stamps, after `origin_ns`.
    occluded : ndarray of bool, shape (N,)
        The camera did not see the forearm at that time.
    position : ndarray, shape (N, 3), m
        Of the IMU, in {K}; nan where there is no answer.
    quaternion : ndarray, shape (N, 4)
        qw, qx, qy, qz of `R_K_A`.
    velocity : ndarray, shape (N, 3), m/s
        In {K}.
    pose_covariance : ndarray, shape (N, 6, 6), m and rad
        Of (position in {K}, rotation vector in {K}).
    velocity_covariance : ndarray, shape (N, 3, 3), (m/s)^2
        In {K}.
    joints : dict of str to ndarray, shape (N, 3), m
        Positions by joint name, in {K}.
    joint_covariance : dict of str to ndarray, shape (N, 3, 3), m^2
        By joint name.
    gaps : tuple of Gap
        In the order of time.
    calibration : ArmCalibration, optional
        What was used or found for this arm; None for methods that need none.
    gravity_direction : ndarray, shape (3,)
        Unit vector of down in {K}; nan where the method does not solve it.
    clock_offset_s, clock_offset_sigma_s : float, s
        t_imu = t_camera + offset.
    arm : JointTracks
        The camera's joints, stamps moved to the IMU's clock.
    residuals : FrameResiduals, optional
        Camera against answer; None for methods that keep none.
    origin_ns : int, ns
        What the times count from.
    side, name : str
        Of the recording.
    notes : tuple of str
        What a reader must know of this result, one sentence each.
    config : dict
        The effective configuration, as plain values.
    estimates : Estimates
        What was found besides the motion.
    upper : UpperMotion, optional
        Of an IMU on the upper arm, at the same samples.
    trunk : TrunkMotion, optional
        Of an IMU on the trunk, at the same samples.
    body : int, optional
        The camera's number of the person, where several are told apart.
    draws : Draws, optional
        Whole motions drawn from the posterior, where they were asked for.
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
    estimates: Estimates = field(default_factory=Estimates)
    upper: UpperMotion | None = None
    trunk: TrunkMotion | None = None
    body: int | None = None
    draws: Draws | None = None

    @property
    def arm_label(self) -> str:
        """Which arm, in words: "right arm of body 2"; without a side "arm"."""
        return arm_words(self.side, self.body)

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        from ..result_view import recovery_text

        return recovery_text(self)

    def _repr_html_(self) -> str:
        """The gaps as a table, and a small picture, as notebooks show it."""
        from ..result_view import recovery_html

        return recovery_html(self)

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
            upper=None if self.upper is None else self.upper.rows(rows),
            trunk=None if self.trunk is None else self.trunk.rows(rows),
        )

    def drawn(self, k: int) -> Recovery:
        """A motion drawn from the posterior in place of the answer (`Draws.recovery`).

        Parameters
        ----------
        k : int
            Its number, from 0.

        Returns
        -------
        Recovery
            At the same samples; covariances are zero.

        Raises
        ------
        UnoccludeError
            None were drawn, or there is no such number.
        """
        if self.draws is None:
            raise UnoccludeError(
                f"{self.name}: no motions were drawn; ask `unocclude smooth` for them with --draws 64"
            )
        return self.draws.recovery(self, k)

    def batches(self, overlap: int = 0) -> Iterator[Recovery]:
        """All samples, some thousand at a time (`rows`).

        With an overlap each batch begins with the last samples of the one before.
        """
        for start in range(0, len(self), BATCH_ROWS):
            yield self.rows(slice(max(start - overlap, 0), start + BATCH_ROWS))

    def frame_batches(self) -> Iterator[JointTracks]:
        """All camera frames, some thousand at a time, like `batches`."""
        for start in range(0, len(self.arm), BATCH_ROWS):
            yield self.arm.select(slice(start, start + BATCH_ROWS))

    @property
    def answered(self) -> BoolArray:
        """(N,) whether there is a position."""
        return self._of_each(lambda batch: np.asarray(np.isfinite(batch.position).all(axis=1)), bool)

    @property
    def sigma_m(self) -> FloatArray:
        """(N, 3) standard deviation of the IMU's position, m an axis of {K}."""
        return np.sqrt(np.einsum("nii->ni", self.pose_covariance[:, :3, :3]))

    @property
    def worst_sigma_m(self) -> FloatArray:
        """(N,) standard deviation of the IMU's position on its worst axis, m."""
        return self._of_each(lambda batch: batch.sigma_m.max(axis=1), float)

    @property
    def sigma_deg(self) -> FloatArray:
        """(N,) square root of the trace of the orientation covariance, degrees."""
        return rotation_sigma_deg(self.pose_covariance[:, 3:, 3:])

    def _of_each(self, value: Callable[[Recovery], NDArray], kind: type) -> NDArray:
        """(N,) a value of each sample, with little more than itself in memory."""
        values: NDArray = np.empty(len(self), kind)
        start = 0
        for batch in self.batches():
            values[start : start + len(batch)] = value(batch)
            start += len(batch)
        return values

    def to_arrays(self) -> dict[str, FloatArray | BoolArray]:
        """Everything a notebook needs, by the column families of the CSV export.

        Returns
        -------
        dict with `t_s` (N,), `occluded` (N,), `imu` (N, 3), `imu_quaternion` (N, 4; qw, qx, qy,
        qz), `velocity` (N, 3), `sigma` (N, 3), `sigma_deg` (N,), and for each joint found its
        position `elbow` (N, 3) .. and `elbow_sigma` (N, 3) ... Metres in the camera frame. With an
        IMU on the upper arm its `upper_imu`, `upper_imu_quaternion`, `upper_sigma` and `upper_sigma_deg`;
        with one on the trunk `trunk_quaternion` and `trunk_sigma_deg`.
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
        if self.upper is not None:
            arrays |= {"upper_imu": self.upper.position, "upper_imu_quaternion": self.upper.quaternion}
            arrays |= {"upper_sigma": self.upper.sigma_m, "upper_sigma_deg": self.upper.sigma_deg}
        if self.trunk is not None:
            arrays |= {"trunk_quaternion": self.trunk.quaternion, "trunk_sigma_deg": self.trunk.sigma_deg}
        return arrays

    def to_table(self) -> pyarrow.Table:
        """The columns of the CSV export, and the velocity, as an Arrow table.

        Returns
        -------
        table : pyarrow.Table
            A row a sample; null where there is no answer. `table.schema.field(NAME).metadata` has the unit.
            `.to_pandas()` gives a pandas table where pandas is installed.
        """
        from ..result_view import recovery_table

        return recovery_table(self)

    def to_dataframe(self) -> pandas.DataFrame:
        """The same as a pandas table.

        Raises
        ------
        UnoccludeError
            pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise UnoccludeError("to_dataframe() needs pandas; install it by `pip install pandas`") from error
        from ..result_view import flat_columns

        return pandas.DataFrame(flat_columns(self))
