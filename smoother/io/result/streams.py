"""What viewers show of a recovery: topics at the camera's rate, encoded when they are written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...angles import JointAngles
from ...array_types import FloatArray, IntArray
from ...linalg import median_rate_hz
from ...recording import JOINTS, JointState
from ...result import Recovery
from ..mcap.merge import Encoded, Output, OutputStream
from ..mcap.messages import nanoseconds
from ..recording.read import RESULT_PREFIX
from ..recording.streams import ArmFrames
from ..recording.write import arm_messages, joints_there
from ..wire.protobuf_encode import alike, encoded
from . import drawing as scene
from .drawing import AlikeRows, arm_point_clouds, world_transform
from .messages import gap_messages, odometry

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
    each = _Streams(output, suffix, frame_id, shift, JointAngles(recovery), recovery.origin_ns)
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
        self, output: Output, suffix: str, frame_id: str, shift: int, angles: JointAngles, origin_ns: int
    ):
        self.output, self.suffix, self.frame_id, self.shift = output, suffix, frame_id, shift
        self.angles, self.origin_ns = angles, origin_ns
        self.body = "forearm_imu" + suffix.replace("/", "_")
        self.name = f"arm{suffix.replace('/', '_')}"

    def _stamps(self, t_s: FloatArray) -> IntArray:
        return nanoseconds(t_s, self.origin_ns)

    def _stream(self, topic: str, schema: str, stamp: IntArray, alike_rows: AlikeRows) -> OutputStream:
        """Some rows of stamps (n,) on a topic."""
        rows, constants, columns = alike_rows

        def encode(part: slice) -> Encoded:
            return encoded(schema, constants, columns(rows[part]))

        channel = self.output.channel(f"{RESULT_PREFIX}{topic}{self.suffix}", schema)
        return OutputStream(channel, stamp[rows] + self.shift, encode)

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
            is_forearm = topic == "forearm"
            velocity = r.velocity if is_forearm else nothing
            spread = r.velocity_covariance if is_forearm else unknown
            for rows in odometry(pose, velocity, spread, self.frame_id, body, stamp):
                yield self._stream(topic, "foxglove.Odometry", stamp, rows)

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
        parts, names = [], []
        for batch in r.batches():
            values, sigmas = self.angles.at(batch)
            names = [*values, *(f"{name}_sigma" for name in sigmas)]
            parts.append(np.column_stack([*values.values(), *sigmas.values()]))
        table = np.radians(np.concatenate(parts)) if parts else np.empty((0, 0))
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
        gaps = r.gaps
        if not gaps:
            return
        start = self._stamps(np.array([gap.start_s for gap in gaps]))
        end = self._stamps(np.array([gap.end_s for gap in gaps]))
        events, lines = gap_messages(gaps, start, end, r.side, r.gap_verdicts if r.has_verdict else None)
        for topic, schema, data in (("gaps", "foxglove.Event", events), ("log", "foxglove.Log", lines)):
            channel = self.output.channel(f"{RESULT_PREFIX}{topic}{self.suffix}", schema)
            yield OutputStream(channel, start + self.shift, data.__getitem__)
