"""The recovered motion: what `smooth` and every peer return."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .calibration import ArmCalibration
from .errors import UnoccludeError
from .measurements.rejection import Reason
from .measurements.visibility import Gap
from .recording import JOINTS, BoolArray, FloatArray, IntArray, JointTracks
from .trunk_motion import TrunkMotion
from .upper_motion import UpperMotion

if TYPE_CHECKING:
    import pandas

#: Samples or frames that are looked at together; what is computed of them passes through the memory.
BATCH_ROWS = 8192


@dataclass(frozen=True)
class FrameResiduals:
    """Camera minus recovered joint position, a row a camera frame.

    Attributes
    ----------
    t_s : ndarray, shape (F,), s
        Frame times on the IMU's clock.
    residual : ndarray, shape (F, 5, 3), m
        In {K}, joints in the order of `JOINTS`; nan where there is no answer.
    used : ndarray of bool, shape (F, 5)
        The sample took part in the solution.
    reason : ndarray of uint8, shape (F, 5)
        Why a tracked sample was rejected: index into `reasons`, 0 where it was not.
    reasons : tuple of Reason
        The first one empty.
    """

    t_s: FloatArray
    residual: FloatArray
    used: BoolArray
    reason: NDArray[np.uint8]
    reasons: tuple[Reason, ...] = (Reason(""),)

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

    def batches(self) -> Iterator[FrameResiduals]:
        """All frames, some thousand at a time."""
        for start in range(0, len(self), BATCH_ROWS):
            yield self.rows(slice(start, start + BATCH_ROWS))


@dataclass(frozen=True)
class Estimates:
    """What a method found besides the motion; None where it states nothing.

    Attributes
    ----------
    camera_sigma_m, camera_effective_sigma_m : dict of str to float, m an axis, optional
        Noise of a joint's sample; of a white noise with the same long-run variance.
    joint_bias_m : dict of str to tuple of float, m, optional
        Constant errors of the camera's joints (x, y, z in {K}), free of their common part.
    joint_bias_sigma_m : float, m an axis, optional
        How large such an error is in this recording.
    accelerometer_bias, gyroscope_bias : tuple of float, m/s^2 and rad/s, optional
        Mean over the recording, in {A}.
    magnetometer_blocks, magnetometer_blocks_used : int, optional
        Means of the magnetic field over some seconds, and how many took part.
    magnetometer_sigma_deg : float, degrees, optional
        How well the field's direction is believed to be known.
    magnetic_field_direction : tuple of float, optional
        Unit vector in {K}.
    given : tuple of str
        What of the arm was given beforehand: lever arms by joint, `upper_arm`, `R_F_A`.
    max_sigma_m : float, m, optional
        Samples less certain than this on an axis are marked as not to be used.
    sigma_factors : tuple of float, optional
        By gap what its sigma of positions was multiplied by, as a calibration asks for.
    trusted : bool, optional
        Nothing says that the set-up was wrong or the answer impossible.
    reasons : tuple of str
        Why it is not trusted.
    cautions : tuple of str
        What to take care of where it is trusted.
    cause : str, optional
        The likeliest cause where it is not trusted, and what to do; the first of the reasons.
    remedies : tuple of str
        Options that undo the cause ("--mirror x"); of several either one may be meant.
    further : dict
        What else a file or a baseline states, by name.
    """

    camera_sigma_m: dict[str, float] | None = None
    camera_effective_sigma_m: dict[str, float] | None = None
    joint_bias_m: dict[str, tuple[float, ...]] | None = None
    joint_bias_sigma_m: float | None = None
    accelerometer_bias: tuple[float, ...] | None = None
    gyroscope_bias: tuple[float, ...] | None = None
    magnetometer_blocks: int | None = None
    magnetometer_blocks_used: int | None = None
    magnetometer_sigma_deg: float | None = None
    magnetic_field_direction: tuple[float, ...] | None = None
    given: tuple[str, ...] = ()
    max_sigma_m: float | None = None
    sigma_factors: tuple[float, ...] = ()
    trusted: bool | None = None
    reasons: tuple[str, ...] = ()
    cautions: tuple[str, ...] = ()
    cause: str | None = None
    remedies: tuple[str, ...] = ()
    further: Mapping[str, object] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """One sentence to act on; "" where nobody judged."""
        if self.trusted is None:
            return ""
        if not self.trusted and self.cause:
            return f"Not to be trusted: {self.cause}."
        if not self.trusted:
            return f"Not to be trusted: {'; '.join(self.reasons)}."
        return f"Usable with care: {'; '.join(self.cautions)}." if self.cautions else "Usable."

    def plain(self) -> dict[str, object]:
        """Plain values by name, as files and `--json` state them; what is not stated is left out."""

        def listed(value: Any) -> Any:
            if isinstance(value, dict):
                return {name: listed(item) for name, item in value.items()}
            return list(value) if isinstance(value, tuple) else value

        stated = {each.name: getattr(self, each.name) for each in fields(self) if each.name != "further"}
        plain = {name: listed(value) for name, value in stated.items() if value is not None and value != ()}
        return plain | dict(self.further)

    @classmethod
    def from_plain(cls, values: Mapping[str, Any]) -> Estimates:
        """From plain values; unknown names, or values of another kind, stay in `further`."""
        stated: dict[str, Any] = {}
        further: dict[str, object] = {}
        for name, value in values.items():
            kind = _KINDS.get(name)
            if kind is None or (checked := kind(value)) is None:
                further[name] = value
            else:
                stated[name] = checked
        return cls(**stated, further=further)


def _number(value: object) -> float | None:
    return value if isinstance(value, int | float) and not isinstance(value, bool) else None


def _vector(value: object) -> tuple[float, ...] | None:
    is_vector = isinstance(value, list | tuple) and [_number(item) is None for item in value] == [False] * 3
    return tuple(value) if is_vector else None  # type: ignore[arg-type]


def _numbers(value: object) -> tuple[float, ...] | None:
    is_numbers = isinstance(value, list | tuple) and all(_number(item) is not None for item in value)
    return tuple(value) if is_numbers else None  # type: ignore[arg-type]


def _names(value: object) -> tuple[str, ...] | None:
    is_names = isinstance(value, list | tuple) and all(isinstance(item, str) for item in value)
    return tuple(value) if is_names else None  # type: ignore[arg-type]


def _by_joint(kind: Callable[[object], Any]) -> Callable[[object], dict[str, Any] | None]:
    def checked(value: object) -> dict[str, Any] | None:
        if not isinstance(value, Mapping):
            return None
        by_joint = {name: kind(item) for name, item in value.items() if name in JOINTS}
        return None if len(by_joint) < len(value) or None in by_joint.values() else by_joint

    return checked


#: How a plain value becomes an estimate: None where it is of another kind.
_KINDS: dict[str, Callable[[object], Any]] = {
    "camera_sigma_m": _by_joint(_number),
    "camera_effective_sigma_m": _by_joint(_number),
    "joint_bias_m": _by_joint(_vector),
    "joint_bias_sigma_m": _number,
    "accelerometer_bias": _vector,
    "gyroscope_bias": _vector,
    "magnetometer_blocks": _number,
    "magnetometer_blocks_used": _number,
    "magnetometer_sigma_deg": _number,
    "magnetic_field_direction": _vector,
    "given": _names,
    "max_sigma_m": _number,
    "sigma_factors": _numbers,
    "trusted": lambda value: value if isinstance(value, bool) else None,
    "reasons": _names,
    "cautions": _names,
    "cause": lambda value: value if isinstance(value, str) else None,
    "remedies": _names,
}


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

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        closed = [gap.length_s for gap in self.gaps]
        longest = f", the longest {max(closed):.1f} s" if closed else ""
        return (
            f"Recovery({self.name!r} by {self.method}: {len(self)} samples, {len(closed)} gaps{longest};"
            f" joints {', '.join(self.joints) or 'none'})"
        )

    def _repr_html_(self) -> str:
        """A short table of the gaps, as notebooks show it."""
        rows = "".join(
            f"<tr><td>{gap.start_s:.2f}</td><td>{gap.length_s:.2f}</td><td>{self._sigma_in(gap)}</td></tr>"
            for gap in self.gaps[:20]
        )
        more = f"<p>.. and {len(self.gaps) - 20} more</p>" if len(self.gaps) > 20 else ""
        return (
            f"<p>{escape(repr(self))}</p><table><tr><th>gap from, s</th><th>length, s</th>"
            f"<th>largest sigma, cm</th></tr>{rows}</table>{more}"
        )

    def _sigma_in(self, gap: Gap) -> str:
        inside = slice(*np.searchsorted(self.t_s, [gap.start_s, gap.end_s]).tolist())
        sigma = self.rows(inside).worst_sigma_m
        return f"{100 * np.nanmax(sigma):.1f}" if np.isfinite(sigma).any() else "no answer"

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
        return np.degrees(np.sqrt(np.trace(self.pose_covariance[:, 3:, 3:], axis1=1, axis2=2)))

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

    def to_dataframe(self) -> pandas.DataFrame:
        """The columns of the CSV export, and the velocity, as a pandas table.

        Raises
        ------
        UnoccludeError
            pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise UnoccludeError("to_dataframe() needs pandas; install it by `pip install pandas`") from error
        columns: dict[str, NDArray] = {}
        for name, values in self.to_arrays().items():
            if values.ndim == 1:
                columns[name] = values
                continue
            axes = ("qw", "qx", "qy", "qz") if values.shape[1] == 4 else ("x", "y", "z")
            stem = name.removesuffix("_quaternion")
            columns |= {f"{stem}_{axis}": values[:, k] for k, axis in enumerate(axes)}
        return pandas.DataFrame(columns)
