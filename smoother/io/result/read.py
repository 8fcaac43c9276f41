"""A recovery back from the MCAP file that `write_recovery` made."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...body import FURTHER
from ...errors import RecordingError
from ...measurements.visibility import Reason
from ...recording import JOINTS, JointTracks
from ...result import Draws, Estimates, FrameResiduals, Recovery
from ...result.segment_motion import SegmentMotion, TrunkMotion
from ...rotation import Rotation
from ..mcap.container import Container
from ..mcap.messages import Topic, plain_name, seconds, told_behind
from ..recording.read import METADATA, RESULT_PREFIX
from .messages import TABLES, CameraTable, DrawsTable, ResidualTable, TopicTable, kind_of
from .write import RESULT, calibration_of, gaps_of

Kind = TypeVar("Kind")
#: What gathers each kind of a result's topics.
_TABLES: dict[str, type[TopicTable]] = TABLES | {"draws": DrawsTable}
#: What values of a result that somebody else wrote, or that are damaged, end in.
BROKEN_RESULT = (
    KeyError,
    ValueError,
    TypeError,
    AttributeError,
    IndexError,
    ArithmeticError,
    AssertionError,
    RecursionError,
    ImportError,
)


def read_recovery(path: str | os.PathLike[str]) -> list[Recovery]:
    """Read the recovered motion from a result file: a list with one `Recovery` for each arm in it.

    Parameters
    ----------
    path : path-like
        A file of `write_recovery`.

    Returns
    -------
    list of Recovery
        One for each arm, also where the file contains one arm only: ``[recovery] = read_recovery(path)``.
        Each is as it was written: times to the nanosecond, velocity and its covariance to rounding;
        covariances that were nan are nan again. A sample without a position has no pose and no velocity.
        Arrays in `estimates.further` come back as lists.

    Raises
    ------
    RecordingError
        The file is missing, damaged, or has no result.
    """
    container = Container(path)

    def wanted(topic: Topic) -> bool:
        return topic.name.startswith(RESULT_PREFIX) and kind_of(topic) in _TABLES

    tables: dict[str, TopicTable] = {}
    try:
        for batch in container.by_topic(wanted):
            for position, messages in batch.items():
                topic = container.topics[position]
                if topic.name not in tables:
                    tables[topic.name] = _TABLES[kind_of(topic)](topic)
                tables[topic.name].feed(messages)
    except BROKEN_RESULT as error:
        raise RecordingError(
            f"{path}: messages of its result are damaged ({shown(error)}); run `unocclude smooth` again."
        ) from error
    names = [name for name in container.metadata if name.partition("/")[0] == RESULT]
    if not names:
        raise RecordingError(f"{path} has no result; make one with `unocclude smooth REC.mcap -o OUT.mcap`.")
    return [_recovery(Path(path), container, tables, name) for name in names]


def stated_estimates(metadata: Mapping[str, Mapping[str, str]]) -> dict[str, Estimates]:
    """What each arm of a result states besides its motion."""
    found = {}
    for name, values in metadata.items():
        if name.partition("/")[0] == RESULT:
            with suppress(*BROKEN_RESULT):
                found[name.removeprefix(RESULT).lstrip("/")] = Estimates.from_plain(
                    json.loads(values["figures"])
                )
    return found


@dataclass(frozen=True)
class ResultOrigin:
    """What a result's file states of its making."""

    version: str = ""  # Of the program that wrote it; "" where it does not say
    title: str = ""  # What the recording inside calls itself; "" where it does not say

    @property
    def is_simulated(self) -> bool:
        """Whether the recording calls itself a simulation, as those of `unocclude simulate` do."""
        return self.title.lower().startswith("simulated")


def read_origin(path: str | os.PathLike[str]) -> ResultOrigin:
    """What a result's file states of its making; empty where it states nothing."""
    container = Container(path)
    for _ in container.by_topic(lambda topic: False):
        pass  # metadata is met on the way
    version = ""
    for name, values in container.metadata.items():
        if name.partition("/")[0] == RESULT:
            with suppress(*BROKEN_RESULT):
                version = _of_type(json.loads(values["version"]), str)
    title = container.metadata.get(METADATA, {}).get("name", "")
    return ResultOrigin("" if version == "unknown" else version, title)


def _recovery(path: Path, container: Container, tables: dict[str, TopicTable], name: str) -> Recovery:
    suffix = name.removeprefix(RESULT)
    try:
        values: dict[str, Any] = {key: json.loads(text) for key, text in container.metadata[name].items()}
        origin = int(values["origin_ns"])
        skeleton = tables[f"{RESULT_PREFIX}skeleton{suffix}"].done()
        stamp, occluded = skeleton["stamp"], skeleton["occluded"].astype(bool)
        row, motion = _rows(stamp, tables.get(f"{RESULT_PREFIX}forearm{suffix}"))
        arrays = _motion(len(stamp), row, motion)
        joints = {joint: skeleton[joint] for joint in values["joints"] if joint in skeleton}
        spread = {joint: skeleton[f"{joint}_covariance"].reshape(-1, 3, 3) for joint in joints}
        return Recovery(
            method=_of_type(values["method"], str),
            t_s=seconds(stamp, origin),
            occluded=occluded,
            **arrays,
            joints=joints,
            joint_covariance=spread,
            gaps=gaps_of(values["gaps"]),
            calibration=calibration_of(values["calibration"]),
            gravity_direction=np.array(values["gravity_direction"], float),
            clock_offset_s=float(values["clock_offset_s"]),
            clock_offset_sigma_s=float(values["clock_offset_sigma_s"]),
            arm=_arm(tables.get(f"{RESULT_PREFIX}camera{suffix}"), values["camera"], origin),
            residuals=_residuals(tables.get(f"{RESULT_PREFIX}residuals{suffix}"), origin)
            if values["has_residuals"]
            else None,
            origin_ns=origin,
            side=_of_type(values["side"], str),
            name=_of_type(values["name"], str),
            notes=tuple([*(_of_type(note, str) for note in values["notes"]), *container.notes]),
            config=_of_type(values["config"], dict),
            estimates=Estimates.from_plain(values["figures"]),
            segments={
                body.name: _segment(stamp, tables.get(f"{RESULT_PREFIX}{body.name}{suffix}"), own)
                for body in FURTHER
                if (own := values.get(body.name)) is not None
            },
            body=None if values.get("body") is None else _of_type(values["body"], int),
            trunk=_trunk(stamp, tables.get(f"{RESULT_PREFIX}trunk{suffix}"), values.get("trunk")),
            draws=_draws(tables.get(f"{RESULT_PREFIX}draws{suffix}"), values.get("draws"), origin),
        )
    except BROKEN_RESULT as error:
        raise RecordingError(
            f"{path}: its result{plain_name(suffix)} is damaged or of another version ({shown(error)}); "
            f"run `unocclude smooth` again.{told_behind(container.notes)}"
        ) from error


def shown(error: BaseException) -> str:
    """An error of a library, short enough for a sentence."""
    return f"{type(error).__name__} {plain_name(str(error))}"


def _segment(stamp: IntArray, table: TopicTable | None, values: dict[str, Any]) -> SegmentMotion:
    """A further IMU's poses at the samples (n,)."""
    arrays = _motion(len(stamp), *_rows(stamp, table))
    return SegmentMotion(
        **{name: arrays[name] for name in ("position", "quaternion", "pose_covariance")},
        mount_sigma_rad=np.array(values["mount_sigma_rad"], float),
        clock_offset_s=values["clock_offset_s"],
        name=values["name"],
    )


def _trunk(stamp: IntArray, table: TopicTable | None, values: dict[str, Any] | None) -> TrunkMotion | None:
    """The thorax's orientation at the samples (n,)."""
    if values is None:
        return None
    arrays = _motion(len(stamp), *_rows(stamp, table))
    return TrunkMotion(
        arrays["quaternion"],
        arrays["pose_covariance"][:, 3:, 3:],
        R_T_D=np.array(values["R_T_D"], float),
        mount_sigma_rad=np.array(values["mount_sigma_rad"], float),
        clock_offset_s=values["clock_offset_s"],
        name=values["name"],
        by_imu=_of_type(values.get("by_imu", True), bool),
    )


def _of_type(value: Any, kind: type[Kind]) -> Kind:
    """The value, which a file of somebody else may have of another type."""
    if not isinstance(value, kind):
        raise TypeError(f"{kind.__name__} expected, not {type(value).__name__}")
    return value


def _draws(table: TopicTable | None, values: dict[str, Any] | None, origin: int) -> Draws | None:
    """Motions drawn from the posterior."""
    if values is None:
        return None
    if table is None:
        raise ValueError("its drawn motions are missing")
    assert isinstance(table, DrawsTable)
    return table.draws(int(values["seed"]), origin)


def _rows(stamp: IntArray, table: TopicTable | None) -> tuple[IntArray, dict[str, NDArray]]:
    """Rows of the samples that have a pose, and the poses."""
    if table is None:
        return np.empty(0, np.int64), {}
    motion = table.done()
    return np.searchsorted(stamp, motion["stamp"]), motion


def _motion(count: int, row: IntArray, motion: dict[str, NDArray]) -> dict[str, Any]:
    arrays: dict[str, Any] = {
        "position": np.full((count, 3), np.nan),
        "quaternion": np.full((count, 4), np.nan),
        "velocity": np.full((count, 3), np.nan),
        "pose_covariance": np.full((count, 6, 6), np.nan),
        "velocity_covariance": np.full((count, 3, 3), np.nan),
    }
    if not len(row):
        return arrays
    turned = motion["turned"].astype(bool)
    velocity = motion["velocity"]
    spread = motion["velocity_covariance"].reshape(-1, 6, 6)[:, :3, :3].copy()
    if turned.any():
        turn = Rotation.from_quat(motion["quaternion"][turned], scalar_first=True).as_matrix()
        velocity[turned] = np.einsum("nij,nj->ni", turn, velocity[turned])
        spread[turned] = turn @ spread[turned] @ turn.transpose(0, 2, 1)
    arrays["position"][row] = motion["position"]
    arrays["quaternion"][row[turned]] = motion["quaternion"][turned]
    arrays["velocity"][row] = velocity
    arrays["pose_covariance"][row] = _unknown(motion["covariance"].reshape(-1, 6, 6))
    arrays["velocity_covariance"][row] = _unknown(spread)
    return arrays


def _unknown(covariance: FloatArray) -> FloatArray:
    """A variance of zero means that it is not known: its row and column become nan."""
    covariance = covariance.copy()
    unknown = np.einsum("nii->ni", covariance) == 0
    covariance[unknown[:, :, None] | unknown[:, None, :]] = np.nan
    return covariance


def _arm(table: TopicTable | None, name: str, origin: int) -> JointTracks:
    nothing = np.full((0, len(JOINTS), 3), np.nan)
    if table is None:
        return JointTracks(name, np.empty(0), nothing, np.zeros((0, len(JOINTS)), np.int8))
    assert isinstance(table, CameraTable)
    return table.tracks(name, origin)


def _residuals(table: TopicTable | None, origin: int) -> FrameResiduals:
    if table is None:
        shape = (0, len(JOINTS))
        return FrameResiduals(
            np.empty(0), np.empty((*shape, 3)), np.zeros(shape, bool), np.zeros(shape, np.uint8)
        )
    assert isinstance(table, ResidualTable)
    values = table.done()
    return FrameResiduals(
        seconds(values["stamp"], origin),
        values["residual"].reshape(-1, len(JOINTS), 3),
        values["used"].astype(bool),
        values["reason"],
        tuple(Reason.of_sentence(sentence) for sentence in table.reasons),
    )
