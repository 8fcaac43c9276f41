"""A recovery back from the MCAP file that `write_recovery` made."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordingError
from ...measurements.rejection import Reason
from ...recording import JOINTS, FloatArray, IntArray, JointTracks
from ...result import Estimates, FrameResiduals, Recovery
from ...trunk_motion import TrunkMotion
from ...upper_motion import UpperMotion
from ..mcap.container import Container
from ..mcap.losses import plain_name
from ..mcap.messages import Topic, TopicMessages
from ..mcap.stamps import seconds
from ..recording.decode import proto_grouper
from ..recording.read import RESULT_PREFIX
from ..recording.skeletons import SkeletonDecoder, joint_code
from ..wire import protobuf_decode as proto
from ..wire.layout import Block, Grouper, MessageLayout, axes
from .metadata import calibration_of, gaps_of
from .write import RESULT

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
        One for each arm, also where the file holds one arm only: ``[recovery] = read_recovery(path)``.
        Each is as it was written: times to the nanosecond, velocity and its covariance to rounding;
        covariances that were nan are nan again. A sample without a position has no pose and no velocity.
        Arrays in `estimates.further` come back as lists.

    Raises
    ------
    RecordingError
        The file is missing, damaged, or holds no result.
    """
    container = Container(path)

    def wanted(topic: Topic) -> bool:
        return topic.name.startswith(RESULT_PREFIX) and _kind(topic) in _TABLES

    tables: dict[str, _Table] = {}
    try:
        for batch in container.by_topic(wanted):
            for position, messages in batch.items():
                topic = container.topics[position]
                if topic.name not in tables:
                    tables[topic.name] = _TABLES[_kind(topic)](topic)
                tables[topic.name].feed(messages)
    except BROKEN_RESULT as error:
        raise RecordingError(
            f"{path}: messages of its result are damaged ({shown(error)}); run `unocclude smooth` again."
        ) from error
    names = [name for name in container.metadata if name.partition("/")[0] == RESULT]
    if not names:
        raise RecordingError(
            f"{path} holds no result; make one with `unocclude smooth REC.mcap -o OUT.mcap`."
        )
    return [_recovery(Path(path), container, tables, name) for name in names]


def _recovery(path: Path, container: Container, tables: dict[str, _Table], name: str) -> Recovery:
    suffix = name.removeprefix(RESULT)
    try:
        values: dict[str, Any] = {key: json.loads(text) for key, text in container.metadata[name].items()}
        origin = int(values["origin_ns"])
        skeleton = _get(tables, "skeleton", suffix).done()
        stamp, occluded = skeleton["stamp"], skeleton["occluded"].astype(bool)
        row, motion = _rows(stamp, tables.get(f"{RESULT_PREFIX}forearm{suffix}"))
        arrays = _motion(len(stamp), row, motion)
        joints = {joint: skeleton[joint] for joint in values["joints"] if joint in skeleton}
        spread = {joint: skeleton[f"{joint}_covariance"].reshape(-1, 3, 3) for joint in joints}
        return Recovery(
            method=values["method"],
            t_s=seconds(stamp, origin),
            occluded=occluded,
            **arrays,
            joints=joints,
            joint_covariance=spread,
            gaps=gaps_of(values["gaps"]),
            calibration=calibration_of(values["calibration"]),
            gravity_direction=np.array(values["gravity_direction"], float),
            clock_offset_s=values["clock_offset_s"],
            clock_offset_sigma_s=values["clock_offset_sigma_s"],
            arm=_arm(tables.get(f"{RESULT_PREFIX}camera{suffix}"), values["camera"], origin),
            residuals=_residuals(tables.get(f"{RESULT_PREFIX}residuals{suffix}"), origin)
            if values["has_residuals"]
            else None,
            origin_ns=origin,
            side=values["side"],
            name=values["name"],
            notes=tuple([*values["notes"], *container.notes]),
            config=values["config"],
            estimates=Estimates.from_plain(values["figures"]),
            upper=_upper(stamp, tables.get(f"{RESULT_PREFIX}upper_arm{suffix}"), values.get("upper_arm")),
            body=values.get("body"),
            trunk=_trunk(stamp, tables.get(f"{RESULT_PREFIX}trunk{suffix}"), values.get("trunk")),
        )
    except BROKEN_RESULT as error:
        damage = f" The file is damaged: {' '.join(container.notes[:4])}" if container.notes else ""
        raise RecordingError(
            f"{path}: its result{plain_name(suffix)} is damaged or of another version ({shown(error)}); "
            f"run `unocclude smooth` again.{damage}"
        ) from error


def shown(error: BaseException) -> str:
    """An error of a library, short enough for a sentence."""
    return f"{type(error).__name__} {plain_name(str(error))}"


def _upper(stamp: IntArray, table: _Table | None, values: dict[str, Any] | None) -> UpperMotion | None:
    """An upper-arm IMU's poses at the samples (n,)."""
    if values is None:
        return None
    arrays = _motion(len(stamp), *_rows(stamp, table))
    return UpperMotion(
        **{name: arrays[name] for name in ("position", "quaternion", "pose_covariance")},
        mount_sigma_rad=np.array(values["mount_sigma_rad"], float),
        clock_offset_s=values["clock_offset_s"],
        name=values["name"],
    )


def _trunk(stamp: IntArray, table: _Table | None, values: dict[str, Any] | None) -> TrunkMotion | None:
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
    )


def _rows(stamp: IntArray, table: _Table | None) -> tuple[IntArray, dict[str, NDArray]]:
    """Rows of the samples that have a pose, and the poses."""
    if table is None:
        return np.empty(0, np.int64), {}
    motion = table.done()
    return np.searchsorted(stamp, motion["stamp"]), motion


def _motion(count: int, row: IntArray, motion: dict[str, NDArray]) -> dict[str, Any]:
    from scipy.spatial.transform import Rotation

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


def _arm(table: _Table | None, name: str, origin: int) -> JointTracks:
    nothing = np.full((0, len(JOINTS), 3), np.nan)
    if table is None:
        return JointTracks(name, np.empty(0), nothing, np.zeros((0, len(JOINTS)), np.int8))
    assert isinstance(table, _CameraTable)
    return table.tracks(name, origin)


def _residuals(table: _Table | None, origin: int) -> FrameResiduals:
    if table is None:
        shape = (0, len(JOINTS))
        return FrameResiduals(
            np.empty(0), np.empty((*shape, 3)), np.zeros(shape, bool), np.zeros(shape, np.uint8)
        )
    assert isinstance(table, _ResidualTable)
    values = table.done()
    return FrameResiduals(
        seconds(values["stamp"], origin),
        values["residual"].reshape(-1, len(JOINTS), 3),
        values["used"].astype(bool),
        values["reason"],
        tuple(Reason.of_sentence(sentence) for sentence in table.reasons),
    )


def _get(tables: dict[str, _Table], kind: str, suffix: str) -> _Table:
    return tables[f"{RESULT_PREFIX}{kind}{suffix}"]


class _Table:
    """Columns of one topic, gathered batch by batch in the file's order."""

    def __init__(self, topic: Topic):
        self.grouper: Grouper = proto_grouper(topic.schema)
        self.parts: list[tuple[IntArray, dict[str, NDArray]]] = []
        self.fed = 0

    def feed(self, messages: TopicMessages) -> None:
        for index, block, layout in self.grouper.groups_in(messages.chunk, messages.start, messages.stop):
            stamp = proto.stamps(block, layout, np.zeros(len(index), np.int64))
            self.parts.append((index + self.fed, {"stamp": stamp, **self.columns(block, layout)}))
        self.fed += len(messages.start)

    def columns(self, block: Block, layout: MessageLayout) -> dict[str, NDArray]:
        raise NotImplementedError

    def done(self) -> dict[str, NDArray]:
        names = {name for _, columns in self.parts for name in columns}
        # Times within a topic increase; messages of different layouts come one layout after the other.
        order = np.argsort(np.concatenate([columns["stamp"] for _, columns in self.parts]), kind="stable")
        return {name: np.concatenate([columns[name] for _, columns in self.parts])[order] for name in names}


class _OdometryTable(_Table):
    def columns(self, block: Block, layout: MessageLayout) -> dict[str, NDArray]:
        rows = len(block)
        turned = layout.texts.get("frame_id") != layout.texts.get("body_frame_id")
        velocity = np.full((rows, 3), np.nan)
        if "linear_velocity.x" in layout.fields:
            velocity = layout.vector(block, axes("linear_velocity"))
        return {
            "position": layout.vector(block, axes("pose.position")),
            "quaternion": layout.vector(block, axes("pose.orientation", "wxyz")),
            "velocity": velocity,
            "covariance": layout.get(block, "pose_covariance"),
            "velocity_covariance": layout.get(block, "velocity_covariance"),
            "turned": np.full(rows, turned),
        }


class _SkeletonTable(_Table):
    def columns(self, block: Block, layout: MessageLayout) -> dict[str, NDArray]:
        columns: dict[str, NDArray] = {"occluded": layout.integer(block, "occluded")}
        for i in range(layout.counts.get("joints", 0)):
            code = joint_code(layout.texts[f"joints.{i}.name"])
            if code is None:
                continue
            joint = JOINTS[code[1]]
            columns[joint] = layout.vector(block, axes(f"joints.{i}.position"))
            columns[f"{joint}_covariance"] = layout.get(block, f"joints.{i}.position_covariance")
        return columns


class _ResidualTable(_Table):
    def __init__(self, topic: Topic):
        super().__init__(topic)
        self.reasons = [""]

    def columns(self, block: Block, layout: MessageLayout) -> dict[str, NDArray]:
        rows = len(block)
        residual = np.full((rows, len(JOINTS), 3), np.nan)
        used = np.zeros((rows, len(JOINTS)), np.int64)
        reason = np.zeros(len(JOINTS), np.uint8)
        for i in range(layout.counts.get("joints", 0)):
            joint = JOINTS.index(layout.texts[f"joints.{i}.name"])
            residual[:, joint] = layout.vector(block, axes(f"joints.{i}.residual"))
            used[:, joint] = layout.integer(block, f"joints.{i}.used")
            reason[joint] = self._code(layout.texts.get(f"joints.{i}.reason", ""))
        return {"residual": residual, "used": used, "reason": np.tile(reason, (rows, 1))}

    def _code(self, sentence: str) -> int:
        """Number of a sentence, in the order in which they are met."""
        if sentence not in self.reasons:
            self.reasons.append(sentence)
        return self.reasons.index(sentence)


class _CameraTable(_Table):
    def __init__(self, topic: Topic):
        super().__init__(topic)
        self.decoder = SkeletonDecoder(topic, proto_grouper(topic.schema))

    def feed(self, messages: TopicMessages) -> None:
        self.decoder.feed(messages)

    def tracks(self, name: str, origin: int) -> JointTracks:
        stamp, arms = self.decoder.found()
        if not arms:
            nothing = np.full((len(stamp), len(JOINTS), 3), np.nan)
            return JointTracks(
                name, seconds(stamp, origin), nothing, np.zeros((len(stamp), len(JOINTS)), np.int8)
            )
        return JointTracks(name, seconds(arms[0].stamp_ns, origin), arms[0].position, arms[0].state)


_TABLES: dict[str, type[_Table]] = {
    "forearm": _OdometryTable,
    "upper_arm": _OdometryTable,
    "trunk": _OdometryTable,
    "skeleton": _SkeletonTable,
    "residuals": _ResidualTable,
    "camera": _CameraTable,
}


def _kind(topic: Topic) -> str:
    """What follows the prefix of a result's topics, without the arm."""
    return topic.name.removeprefix(RESULT_PREFIX).partition("/")[0]
