"""The arm's motion over a recording, sample by sample, with that of further IMUs; several arms."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from textwrap import shorten
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from ..array_types import BoolArray, FloatArray, IntArray
from ..calibration import ArmCalibration
from ..error_radius import error_radius, within_words
from ..errors import UnoccludeError
from ..linalg import median_rate_hz, rotation_sigma_deg, rows_of
from ..measurements.visibility import Gap, Reason
from ..recording import JointTracks, Recording, arm_words
from ..runtime.packages import pandas_module
from ..runtime.store import by_rows
from .columns import SAMPLES, Column, columns_of, flat_columns
from .draws import Draws, turned_by
from .estimates import Estimates
from .verdict import GapVerdict, gap_verdicts, trusted_at

if TYPE_CHECKING:
    import pandas
    import pyarrow
    from matplotlib.figure import Figure

    from ..angles import AngleTable

_VERDICT_LENGTH = 200
#: Samples or frames that are looked at together; what is computed of them passes through the memory.
BATCH_ROWS = 8192


@dataclass(frozen=True)
class FrameResiduals:
    """Camera minus recovered joint position, one row per camera frame."""

    t_s: FloatArray  # (F,), s: Frame times on the IMU's clock
    # (F, 5, 3), m: In {K}, joints in the order of `JOINTS`; nan where there is no answer
    residual: FloatArray
    used: BoolArray  # (F, 5): The sample was used in the solution
    # (F, 5): Why a tracked sample was rejected: index into `reasons`, 0 where it was not
    reason: NDArray[np.uint8]
    reasons: tuple[Reason, ...] = (Reason(""),)  # The first one empty

    def __len__(self) -> int:
        return len(self.t_s)

    def rows(self, rows: slice) -> FrameResiduals:
        """Some of the frames."""
        return rows_of(self, rows, "t_s", "residual", "used", "reason")

    def batches(self) -> Iterator[FrameResiduals]:
        """All frames, some thousand at a time."""
        for start in range(0, len(self), BATCH_ROWS):
            yield self.rows(slice(start, start + BATCH_ROWS))


def _axis_sigma(pose_covariance: FloatArray) -> FloatArray:
    """Standard deviations of positions, (n, 3), of covariances of poses (n, 6, 6)."""
    return np.sqrt(np.einsum("nii->ni", pose_covariance[:, :3, :3]))


@dataclass(frozen=True)
class SegmentMotion:
    """The IMU on a segment beyond the forearm at the forearm IMU's times; nan where it has no samples."""

    position: FloatArray  # (N, 3), m: In {K}
    quaternion: FloatArray  # (N, 4): qw, qx, qy, qz: from the IMU's axes to {K}
    pose_covariance: FloatArray  # (N, 6, 6), m and rad: Of (position in {K}, rotation vector in {K})
    # (3,), rad: How far the bone's axes may be from where `SegmentMounting.R_bone` has them, soft tissue
    # included, about each of them
    mount_sigma_rad: FloatArray
    clock_offset_s: float = float("nan")  # s: t_own = t_camera + offset, mean
    name: str = ""  # Of the IMU

    def rows(self, rows: slice | IntArray) -> SegmentMotion:
        """Some of the samples."""
        return rows_of(self, rows, "position", "quaternion", "pose_covariance")

    @property
    def sigma_m(self) -> FloatArray:
        """(N, 3) standard deviation of the IMU's position, m per axis of {K}."""
        return _axis_sigma(self.pose_covariance)

    @property
    def sigma_deg(self) -> FloatArray:
        """(N,) square root of the trace of the orientation covariance, degrees."""
        return rotation_sigma_deg(self.pose_covariance[:, 3:, 3:])


@dataclass(frozen=True)
class TrunkMotion:
    """The thorax at the forearm IMU's times; nan where the trunk's IMU has no samples."""

    # (N, 4): qw, qx, qy, qz of `R_K_T`: from the thorax's axes {T} (ISB: x forward, y up, z to its right)
    quaternion: FloatArray
    covariance: FloatArray  # (N, 3, 3), rad^2: Of the rotation vector in {K}
    R_T_D: FloatArray  # (3, 3): Mounting: maps a vector from the IMU's axes {D} to the thorax's
    mount_sigma_rad: FloatArray  # (3,), rad: How far the mounting may be off about each of the thorax's axes
    clock_offset_s: float = float("nan")  # s: t_trunk = t_camera + offset, mean
    name: str = "trunk"  # Of the IMU
    by_imu: bool = True  # By an IMU on it; False where it is by both shoulders as the camera sees them

    def rows(self, rows: slice | IntArray) -> TrunkMotion:
        """Some of the samples."""
        return rows_of(self, rows, "quaternion", "covariance")

    @property
    def sigma_deg(self) -> FloatArray:
        """(N,) square root of the trace of the orientation covariance, degrees."""
        return rotation_sigma_deg(self.covariance)


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
        Notes on this result for the reader, one sentence each.
    config : dict
        The effective configuration, as plain values.
    estimates : Estimates
        What was found besides the motion.
    segments : dict of str to SegmentMotion
        Of IMUs on further segments, at the same samples, by the segment's name ("upper_arm").
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
    segments: dict[str, SegmentMotion] = field(default_factory=dict)
    trunk: TrunkMotion | None = None
    body: int | None = None
    draws: Draws | None = None

    @property
    def upper(self) -> SegmentMotion | None:
        """Of an IMU on the upper arm; None without one."""
        return self.segments.get("upper_arm")

    @property
    def arm_label(self) -> str:
        """Which arm, in words: "right arm of body 2"; without a side "arm"."""
        return arm_words(self.side, self.body)

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        return "\n  ".join(self._lines())

    def _lines(self) -> list[str]:
        """Whose arm, how long, how many gaps and how sure, the joints, the verdict."""
        side = f", {self.side} arm" if self.side else ""
        length_s = float(self.t_s[-1] - self.t_s[0]) if len(self) else 0.0
        lines = [
            f"Recovery of {self.name} by {self.method}{side}: {length_s:.1f} s, {len(self)} samples"
            f" at {median_rate_hz(self.t_s):.1f} Hz"
        ]
        if self.gaps:
            radii = [radius for gap in self.gaps if (radius := self._error_95_m(gap)) is not None]
            known = f"; at worst {within_words(max(radii))}" if radii else "; no answer in them"
            lengths_s = [gap.length_s for gap in self.gaps]
            lines.append(
                f"{len(self.gaps)} gap{'s' if len(self.gaps) > 1 else ''}, {sum(lengths_s):.1f} s occluded,"
                f" the longest {max(lengths_s):.1f} s{known}"
            )
        else:
            lines.append("no gaps")
        lines.append(f"joints {', '.join(self.joints) or 'none'}")
        if distrusted := sum(not verdict.trusted for verdict in self.gap_verdicts):
            lines.append(f"{distrusted} of {len(self.gaps)} gaps not to be trusted")
        if self.estimates.verdict:
            lines.append(shorten(self.estimates.verdict, _VERDICT_LENGTH, placeholder=" .."))
        return lines

    def _error_95_m(self, gap: Gap) -> float | None:
        """Where the IMU is least certain in a gap, m; None where there is no answer."""
        inside = slice(*np.searchsorted(self.t_s, [gap.start_s, gap.end_s]).tolist())
        radius = self.rows(inside).error_95_m
        return float(np.nanmax(radius)) if np.isfinite(radius).any() else None

    def rows(self, rows: slice | IntArray) -> Recovery:
        """The recovery of some samples; frames, gaps and all else stay whole. A slice copies nothing."""
        some = rows_of(self, rows, "t_s", *SAMPLES, "joints", "joint_covariance")
        segments = {name: motion.rows(rows) for name, motion in self.segments.items()}
        return replace(some, segments=segments, trunk=self.trunk and self.trunk.rows(rows))

    def drawn(self, k: int) -> Recovery:
        """A motion drawn from the posterior in place of the answer.

        Parameters
        ----------
        k : int
            Its number, from 0.

        Returns
        -------
        Recovery
            Position, orientation, velocity and joints as drawn; its covariances are zero, all else is the
            answer's.

        Raises
        ------
        UnoccludeError
            None were drawn, or there is no such number.
        """
        if self.draws is None:
            raise UnoccludeError(
                f"{self.name}: no motions were drawn; ask `unocclude smooth` for them with --draws 64"
            )
        moved = self.draws.at(k, self.t_s)
        segments = {}
        for name, motion in self.segments.items():
            turned = motion.quaternion
            if name in moved.turns:
                turned = turned_by(moved.turns[name], turned)
            zeros = _zeros(motion.pose_covariance)
            segments[name] = replace(motion, quaternion=turned, pose_covariance=zeros)
        return replace(
            self,
            position=self.position + moved.position,
            quaternion=turned_by(moved.rotation, self.quaternion),
            velocity=self.velocity + moved.velocity,
            pose_covariance=_zeros(self.pose_covariance),
            velocity_covariance=_zeros(self.velocity_covariance),
            joints={joint: at + moved.joints.get(joint, 0.0) for joint, at in self.joints.items()},
            joint_covariance={joint: _zeros(each) for joint, each in self.joint_covariance.items()},
            segments=segments,
            draws=None,
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
        return by_rows(lambda position: np.isfinite(position).all(axis=1), self.position)

    @property
    def sigma_m(self) -> FloatArray:
        """(N, 3) standard deviation of the IMU's position, m per axis of {K}."""
        return _axis_sigma(self.pose_covariance)

    @property
    def worst_sigma_m(self) -> FloatArray:
        """(N,) standard deviation of the IMU's position on its worst axis, m."""
        return by_rows(lambda pose: _axis_sigma(pose).max(axis=1), self.pose_covariance)

    @property
    def error_95_m(self) -> FloatArray:
        """(N,) the distance within which the IMU's position is in 95 of 100 cases, m."""
        return by_rows(lambda pose: error_radius(pose[:, :3, :3]), self.pose_covariance)

    @property
    def sigma_deg(self) -> FloatArray:
        """(N,) square root of the trace of the orientation covariance, degrees."""
        return rotation_sigma_deg(self.pose_covariance[:, 3:, 3:])

    @property
    def trusted(self) -> BoolArray:
        """(N,) whether a sample, and the gap it is in, is to be trusted; all if the result was not judged."""
        doubtful = (gap for gap in self.gap_verdicts if not gap.trusted)
        return trusted_at(self.t_s, self.estimates.trusted, (*self.estimates.untrusted, *doubtful))

    @property
    def gap_verdicts(self) -> tuple[GapVerdict, ...]:
        """Of every gap, in the order of `gaps`, whether it is to be trusted, and why not."""
        estimates = self.estimates
        return gap_verdicts(self.gaps, estimates.trusted, estimates.reasons, estimates.untrusted)

    @property
    def has_verdict(self) -> bool:
        """Whether it was judged; otherwise `trusted` has no meaning."""
        return self.estimates.trusted is not None or bool(self.estimates.untrusted)

    def angles(self) -> AngleTable:
        """Every joint angle with its sigma: flexion, shoulder, pronation, in the ISB's order of turns.

        Returns
        -------
        table : AngleTable
            `values` and `sigmas` (N,) in degrees by name, `reasons` where an angle is empty, and
            `to_dataframe()`.

        Examples
        --------
        >>> recovery.angles().values["elbow_flexion"]  # doctest: +SKIP
        """
        from ..angles import joint_angles

        return joint_angles(self)

    def plot(
        self,
        what: Sequence[str] | None = None,
        *,
        from_s: float | None = None,
        to_s: float | None = None,
        width_cm: float = 17.0,
    ) -> Figure:
        """A figure for a paper: curves over time with their 95 % bands, gaps shaded.

        Parameters
        ----------
        what : sequence of str, optional
            Angles ("elbow_flexion", ..), joints ("wrist", ..; "imu"), or "error_95", how far off the IMU's
            position may be; elbow flexion, shoulder elevation, wrist and that where None.
        from_s, to_s : float, s
            Part of the recording to draw; all of it where None.
        width_cm : float, cm
            17 fits a page, 8.5 a column.

        Returns
        -------
        figure : matplotlib.figure.Figure
            Text of 8 pt; `.savefig("figure.pdf")` writes it.

        Raises
        ------
        UnoccludeError
            matplotlib is not installed, or there is nothing of what was asked for.

        Examples
        --------
        >>> recovery.plot(["elbow_flexion"], from_s=10, to_s=20).savefig("elbow.pdf")  # doctest: +SKIP
        """
        draw: Callable[..., Figure] = _from_above("plot_recovery")
        chosen = {} if what is None else {"what": what}
        return draw(self, **chosen, from_s=from_s, to_s=to_s, width_cm=width_cm)

    def export(
        self,
        path: str | os.PathLike[str],
        *,
        force: bool = False,
        frame: str | None = None,
        rate_hz: float | None = None,
        origin: str = "camera",
    ) -> None:
        """Write it in the format of the file's ending, as `unocclude export` does.

        Parameters
        ----------
        path : path-like
            Ending in .csv, .parquet, .trc, .mot, .c3d, .rrd or .mcap.
        force : bool
            Overwrite a file that exists.
        frame : str, optional
            Axes of trc and c3d: "camera" or "opensim".
        rate_hz : float, optional
            Rows per second of trc, mot and c3d; the IMU's where None.
        origin : str
            Zero of trc and c3d: "camera" or "shoulder".

        Raises
        ------
        UnoccludeError
            The ending is not a format, the format needs what there is not, or the file exists.

        Examples
        --------
        >>> recovery.export("recovered.csv")  # doctest: +SKIP
        """
        write: Callable[..., None] = _from_above("export_recovery")
        write(self, path, force=force, frame=frame, rate_hz=rate_hz, origin=origin)

    def to_arrays(self) -> dict[str, FloatArray | BoolArray]:
        """Everything a notebook needs, by the column families of the CSV export.

        Returns
        -------
        dict with `t_s` (N,), `occluded` (N,), `imu` (N, 3), `imu_quaternion` (N, 4; qw, qx, qy,
        qz), `velocity` (N, 3), `sigma` (N, 3), `sigma_deg` (N,), and for each joint found its
        position `elbow` (N, 3) .. and `elbow_sigma` (N, 3) ... Metres in the camera frame. With an
        IMU on the upper arm its `upper_imu`, `upper_imu_quaternion`, `upper_sigma` and `upper_sigma_deg`;
        with one on the trunk `trunk_quaternion` and `trunk_sigma_deg`. Then the joint angles (N,) and their
        sigmas, `elbow_flexion_deg`, `elbow_flexion_sigma_deg` .. (see `angles`). The last is `trusted`
        (N,), a mask of the samples to be trusted; a result that was not judged has none.
        """
        return self._arrays(columns_of(self))

    def _arrays(self, columns: Sequence[Column]) -> dict[str, FloatArray | BoolArray]:
        arrays: dict[str, FloatArray | BoolArray] = {"t_s": self.t_s, "occluded": self.occluded}
        arrays |= {column.name: column.values for column in columns if column.is_there}
        return arrays | {"trusted": self.trusted} if self.has_verdict else arrays

    def to_table(self) -> pyarrow.Table:
        """The columns of the CSV export, and the velocity, as an Arrow table.

        Returns
        -------
        table : pyarrow.Table
            One row per sample; null where there is no answer. `trusted`, the last column, is null in every
            row of a result that was not judged. `table.schema.field(NAME).metadata` has the unit.
            `.to_pandas()` gives a pandas table where pandas is installed.
        """
        import pyarrow as pa

        columns = columns_of(self)
        units = {"t_s": "s"} | {name: each.unit for each in columns for name in each.flat}
        arrays = {
            name: pa.array(np.ascontiguousarray(values), from_pandas=True)
            for name, values in flat_columns(self._arrays(columns)).items()
        }
        arrays.setdefault("trusted", pa.nulls(len(self), pa.bool_()))
        fields = [
            pa.field(name, array.type, metadata={"unit": units.get(name, "")})
            for name, array in arrays.items()
        ]
        return pa.Table.from_arrays(list(arrays.values()), schema=pa.schema(fields))

    def to_dataframe(self) -> pandas.DataFrame:
        """The same as a pandas table; `trusted` is of pandas' type "boolean", which has missing values.

        Raises
        ------
        UnoccludeError
            pandas is not installed.
        """
        pandas = pandas_module()
        frame = pandas.DataFrame(flat_columns(self.to_arrays()))
        trusted = self.trusted if self.has_verdict else [None] * len(self)
        return frame.assign(trusted=pandas.array(trusted, dtype="boolean"))


def _from_above(name: str) -> Callable[..., Any]:
    """A function of a floor above the core, by the name under which the package has it."""
    function: Callable[..., Any] = getattr(import_module(__package__.partition(".")[0]), name)
    return function


def _zeros(values: FloatArray) -> FloatArray:
    """Zeros of that shape, which take no memory."""
    return np.broadcast_to(np.zeros(()), values.shape)


def arm_tags(recoveries: Sequence[Recovery]) -> list[str]:
    """A name for each arm among several, as topics end in: "left", or "body_2/left" with several people.

    Where side and body do not distinguish them, a number does.
    """

    def tag(recovery: Recovery) -> str:
        side = recovery.side or "arm"
        return side if recovery.body is None else f"body_{recovery.body}/{side}"

    tags = [tag(recovery) for recovery in recoveries]
    return [
        one if tags.count(one) == 1 and recovery.side else f"{one}_{number}"
        for number, (one, recovery) in enumerate(zip(tags, recoveries, strict=True), start=1)
    ]


def is_of_arm(recovery: Recovery, recording: Recording) -> bool:
    """Whether a recovery is of this arm of a recording."""
    of_arm = (recording.arm.name, recording.side, recording.body)
    return of_arm == (recovery.arm.name, recovery.side, recovery.body)


@dataclass(frozen=True)
class Recoveries(Sequence[Recovery]):
    """The arms of a recording: by number, by side, or by name where there are several people.

    `recoveries["left"]`, `recoveries["body_2/left"]`, `recoveries[0]`; iterates over the arms.

    Attributes
    ----------
    arms : tuple of Recovery
        In order of body and side.
    left_out : tuple of str
        A sentence for each arm that could not be recovered.
    """

    arms: tuple[Recovery, ...]
    left_out: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.arms)

    @overload
    def __getitem__(self, key: int | str) -> Recovery: ...
    @overload
    def __getitem__(self, key: slice) -> tuple[Recovery, ...]: ...
    def __getitem__(self, key: int | str | slice) -> Recovery | tuple[Recovery, ...]:
        if not isinstance(key, str):
            return self.arms[key]
        named = [arm for arm, tag in zip(self.arms, self.tags, strict=True) if tag == key]
        fitting = named or [arm for arm in self.arms if arm.side == key]
        if len(fitting) != 1:
            what = "several arms fit" if fitting else "there is no arm"
            raise UnoccludeError(f"{what} {key!r}; arms: {', '.join(self.tags)}")
        return fitting[0]

    @property
    def tags(self) -> list[str]:
        """The arms' names, as a result file's topics end in."""
        return arm_tags(self.arms)
