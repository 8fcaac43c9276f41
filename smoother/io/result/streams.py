"""What viewers show of a recovery: topics at the camera's rate, encoded when they are written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...angles import ForearmMounting, forearm_mounting, joint_angles
from ...array_types import FloatArray, IntArray
from ...linalg import median_rate_hz
from ...measurements.visibility import Gap
from ...recording import JOINTS, JointState
from ...result import GapVerdict, Recovery
from ...rotation import Rotation
from ..mcap.merge import Output, OutputStream
from ..mcap.messages import nanoseconds
from ..recording.read import RESULT_PREFIX
from ..recording.streams import ArmFrames
from ..recording.write import arm_messages, joints_there
from ..wire.protobuf_encode import alike
from ..wire.schemas import message_class
from . import drawing as scene
from .drawing import AlikeRows, arm_point_clouds, world_transform

#: Pictures a second where the camera's rate is not known.
PICTURES_HZ = 30.0


def recovery_streams(
    output: Output,
    recovery: Recovery,
    suffix: str,
    frame_id: str,
    shift: int,
    down: FloatArray | None = None,  # (3,)
    camera_joints: Sequence[int] | None = None,
) -> list[OutputStream]:
    """The messages of one recovery; the joints of the camera are those that it ever has, unless stated."""
    rates = [median_rate_hz(t) if len(t) > 1 else PICTURES_HZ for t in (recovery.t_s, recovery.arm.t_s)]
    step = max(round(rates[0] / rates[1]), 1) if np.isfinite(rates).all() and rates[1] > 0.0 else 1
    each = _Streams(output, suffix, frame_id, shift, forearm_mounting(recovery), recovery.origin_ns)
    some = recovery.rows(slice(None, None, step))
    present = joints_there(recovery.arm.state) if camera_joints is None else list(camera_joints)
    return [
        *each.skeleton(some),
        *each.poses(some),
        *each.drawn(some),
        *each.transforms(some, world_transform(down, frame_id)),
        *each.joint_states(some),
        *each.camera(recovery, present),
        *each.gaps(recovery),
    ]


class _Streams:
    """The streams of one recovery; what each of them needs."""

    def __init__(
        self,
        output: Output,
        suffix: str,
        frame_id: str,
        shift: int,
        mounting: ForearmMounting,
        origin_ns: int,
    ):
        self.output, self.suffix, self.frame_id, self.shift = output, suffix, frame_id, shift
        self.mounting, self.origin_ns = mounting, origin_ns
        self.body = "forearm_imu" + suffix.replace("/", "_")
        self.name = f"arm{suffix.replace('/', '_')}"

    def _stamps(self, t_s: FloatArray) -> IntArray:
        return nanoseconds(t_s, self.origin_ns)

    def _stream(self, topic: str, schema: str, stamp: IntArray, alike_rows: AlikeRows) -> OutputStream:
        """Some rows of stamps (n,) on a topic."""
        rows, constants, columns = alike_rows
        name, time_ns = f"{RESULT_PREFIX}{topic}{self.suffix}", stamp[rows] + self.shift
        return self.output.stream(name, schema, time_ns, constants, lambda part: columns(rows[part]))

    def poses(self, r: Recovery) -> Iterator[OutputStream]:
        """Of the forearm's IMU, and where there are, of those on further segments and the trunk."""
        stamp, nothing = self._stamps(r.t_s), np.full((len(r), 3), np.nan)
        poses = {"forearm": ((r.position, r.quaternion, r.pose_covariance), self.body)}
        for name, motion in r.segments.items():
            pose = (motion.position, motion.quaternion, motion.pose_covariance)
            poses[name] = pose, self.body.replace("forearm", name)
        if (trunk := r.trunk) is not None:  # the thorax, drawn at the arm's shoulder
            covariance = np.zeros((len(r), 6, 6))
            covariance[:, 3:, 3:] = trunk.covariance
            place = np.nan_to_num(r.joints.get("shoulder", nothing))
            place[~np.isfinite(trunk.quaternion).all(axis=1)] = np.nan
            poses["trunk"] = (place, trunk.quaternion, covariance), self.body.replace("forearm_imu", "thorax")
        unknown = np.full((len(r), 3, 3), np.nan)
        for topic, (pose, body) in poses.items():
            moved = (r.velocity, r.velocity_covariance) if topic == "forearm" else (nothing, unknown)
            for rows in self._odometry(pose, moved, body, stamp):
                yield self._stream(topic, "foxglove.Odometry", stamp, rows)

    def _odometry(
        self,
        poses: tuple[FloatArray, FloatArray, FloatArray],  # (n, 3) m; (n, 4); (n, 6, 6)
        moved: tuple[FloatArray, FloatArray],  # (n, 3) m/s: velocity; (n, 3, 3): its covariance
        body: str,
        stamp: IntArray,
    ) -> Iterator[AlikeRows]:
        """The samples with a position, those with orientation and velocity apart."""
        (position, quaternion, covariance), (velocity, spread) = poses, moved
        has = [np.isfinite(each).all(axis=1) for each in (position, quaternion, velocity)]
        for (placed, turned, moving), mine in alike(np.stack(has, axis=1)):
            if not placed:
                continue

            def columns(rows: IntArray, turned: int = turned, moving: int = moving) -> dict[str, NDArray]:
                speed, whole = velocity[rows], np.zeros((len(rows), 6, 6))
                whole[:, :3, :3] = spread[rows]
                if turned:
                    back = Rotation.from_quat(quaternion[rows], scalar_first=True).inv().as_matrix()
                    speed = np.einsum("nij,nj->ni", back, speed)
                    whole[:, :3, :3] = back @ whole[:, :3, :3] @ back.transpose(0, 2, 1)
                each = {"timestamp": stamp[rows], "pose.position": position[rows]}
                each |= {"pose.orientation": quaternion[rows][:, [1, 2, 3, 0]]} if turned else {}
                each |= {"linear_velocity": speed} if moving else {}
                return each | {
                    "pose_covariance": np.nan_to_num(covariance[rows], nan=0.0).reshape(-1, 36),
                    "velocity_covariance": np.nan_to_num(whole, nan=0.0).reshape(-1, 36),
                }

            frames = {"frame_id": self.frame_id, "body_frame_id": body if turned else self.frame_id}
            yield mine, frames | {"pose": {"orientation": {"w": 1.0}}}, columns

    def skeleton(self, r: Recovery) -> Iterator[OutputStream]:
        """Every moment, so that times and occlusion are whole even where there is no answer."""
        names = [joint for joint in JOINTS if joint in r.joints]
        side = f"_{r.side}" if r.side else ""
        stamp = self._stamps(r.t_s)

        def columns(rows: IntArray) -> dict[str, NDArray]:
            occluded = r.occluded[rows]
            arrays: dict[str, NDArray] = {"timestamp": stamp[rows], "occluded": occluded.astype(np.int64)}
            for k, joint in enumerate(names):
                position = r.joints[joint][rows]
                state = np.where(occluded, JointState.INFERRED, JointState.TRACKED)
                state[~np.isfinite(position).all(axis=1)] = JointState.NOT_TRACKED
                arrays |= {f"joints.{k}.position": position, f"joints.{k}.state": state}
                arrays[f"joints.{k}.position_covariance"] = r.joint_covariance[joint][rows].reshape(-1, 9)
            return arrays

        constants = {"frame_id": self.frame_id, "joints": [{"name": joint + side} for joint in names]}
        yield self._stream("skeleton", "unocclude.Skeleton", stamp, (np.arange(len(r)), constants, columns))

    def camera(self, r: Recovery, present: list[int]) -> Iterator[OutputStream]:
        """The camera's joints on the IMU's clock, as messages and drawn."""
        topic, stamp = f"{RESULT_PREFIX}camera{self.suffix}", self._stamps(r.arm.t_s)
        arm = ArmFrames(topic, self.frame_id, 0, r.side, stamp, r.arm.position, r.arm.state)
        stream = arm_messages(self.output, arm, present)
        yield OutputStream(stream.channel, stream.time_ns + self.shift, stream.encode)
        guessed = (r.arm.state == JointState.INFERRED).astype(np.int64)
        colors, name = (scene.CAMERA, scene.GUESSED), f"{self.name}_camera"
        for rows in scene.drawings(r.arm.position, guessed, colors, self.frame_id, name, stamp):
            yield self._stream("arm_camera", "foxglove.SceneUpdate", stamp, rows)

    def drawn(self, r: Recovery) -> Iterator[OutputStream]:
        """The arm, as a scene and as beads."""
        stamp, position = self._stamps(r.t_s), np.full((len(r), len(JOINTS), 3), np.nan)
        for joint, places in {"strap": r.position, **r.joints}.items():
            position[:, JOINTS.index(joint)] = places
        kind = np.where(r.trusted, r.occluded.astype(np.int64), scene.DISTRUST)
        shade = np.repeat(kind[:, None], len(JOINTS), axis=1)
        for rows in scene.drawings(position, shade, scene.ANSWER, self.frame_id, self.name, stamp):
            yield self._stream("arm", "foxglove.SceneUpdate", stamp, rows)
        for rows in arm_point_clouds(position, kind, self.frame_id, stamp):
            yield self._stream("beads", "foxglove.PointCloud", stamp, rows)

    def transforms(self, r: Recovery, world: dict[str, Any] | None) -> Iterator[OutputStream]:
        """The camera to the forearm's IMU, and the level frame, in every message: viewers begin anywhere."""
        has_pose = np.isfinite(r.position).all(axis=1) & np.isfinite(r.quaternion).all(axis=1)
        stamp = self._stamps(r.t_s)
        forearm = {"parent_frame_id": self.frame_id, "child_frame_id": self.body}
        for posed in (True, False):
            transforms = [*([forearm] if posed else []), *([world] if world else [])]

            def columns(
                rows: IntArray, posed: bool = posed, count: int = len(transforms)
            ) -> dict[str, NDArray]:
                pose: dict[str, NDArray] = {f"transforms.{k}.timestamp": stamp[rows] for k in range(count)}
                if posed:
                    pose["transforms.0.translation"] = r.position[rows]
                    pose["transforms.0.rotation"] = r.quaternion[rows][:, [1, 2, 3, 0]]
                return pose

            rows = np.flatnonzero(has_pose == posed)
            if transforms and len(rows):
                yield self._stream(
                    "tf", "foxglove.FrameTransforms", stamp, (rows, {"transforms": transforms}, columns)
                )

    def joint_states(self, r: Recovery) -> Iterator[OutputStream]:
        """The joint angles that are known at a sample, and behind them their sigmas, rad."""
        angles = joint_angles(r, self.mounting)
        names = [*angles.values, *(f"{name}_sigma" for name in angles.sigmas)]
        table = np.radians(np.column_stack([*angles.values.values(), *angles.sigmas.values()]))
        side = f"_{r.side}" if r.side else ""
        stamp = self._stamps(r.t_s)
        for pattern, rows in alike(np.isfinite(table)):  # samples with the same ones are written alike
            places = np.flatnonzero(pattern).tolist()

            def of_rows(chosen: IntArray, places: list[int] = places) -> dict[str, NDArray]:
                angles = {f"joints.{k}.position": table[chosen, place] for k, place in enumerate(places)}
                return {"timestamp": stamp[chosen]} | angles

            if places:
                constants = {"joints": [{"name": names[k] + side} for k in places]}
                yield self._stream("joints", "foxglove.JointStates", stamp, (rows, constants, of_rows))

    def gaps(self, r: Recovery) -> Iterator[OutputStream]:
        """Each gap as an event, and as a line of a log, which more programs show."""
        if not r.gaps:
            return
        times = self._stamps(np.array([[gap.start_s, gap.end_s] for gap in r.gaps]))
        verdicts = r.gap_verdicts if r.has_verdict else (None,) * len(r.gaps)
        each = [
            gap_messages(gap, start, end, r.side, verdict)
            for gap, (start, end), verdict in zip(r.gaps, times.tolist(), verdicts, strict=True)
        ]
        events, lines = ([messages[k] for messages in each] for k in range(2))
        for topic, schema, data in (("gaps", "foxglove.Event", events), ("log", "foxglove.Log", lines)):
            channel = self.output.channel(f"{RESULT_PREFIX}{topic}{self.suffix}", schema)
            yield OutputStream(channel, times[:, 0] + self.shift, data.__getitem__)


def gap_messages(
    gap: Gap, start_ns: int, end_ns: int, side: str, verdict: GapVerdict | None = None
) -> tuple[bytes, bytes]:
    """A gap as `foxglove.Event` and as a line, `foxglove.Log`, encoded."""
    values = {"kind": "occluded", "length_s": f"{gap.length_s:.3f}"}
    values |= {"side": side} if side else {}
    values |= {"open": "start"} if gap.open_start else {}
    values |= {"open": "end"} if gap.open_end else {}
    line = message_class("foxglove.Log")(name="unocclude")
    line.level, line.message = line.WARNING, f"{side} forearm occluded for {gap.length_s:.2f} s".lstrip()
    if verdict is not None:
        values["trusted"] = str(verdict.trusted).lower()
        if not verdict.trusted:
            values["reasons"], line.level = "; ".join(verdict.reasons), line.ERROR
            line.message += f"; the answer is not to be trusted: {values['reasons']}"
    metadata = [{"key": key, "value": value} for key, value in values.items()]
    event = message_class("foxglove.Event")(metadata=metadata)
    event.start_time.FromNanoseconds(start_ns)
    event.end_time.FromNanoseconds(end_ns)
    line.timestamp.FromNanoseconds(start_ns)
    return event.SerializeToString(deterministic=True), line.SerializeToString(deterministic=True)
