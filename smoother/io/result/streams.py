"""The streams of messages that a recovery is written as."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...angles import JointAngles
from ...array_types import BoolArray, FloatArray, IntArray
from ...recording import JOINTS, JointState
from ...result import FrameResiduals, Recovery
from ..mcap.merge import Encoded, Output, OutputStream, TimeAxis
from ..mcap.messages import nanoseconds
from ..recording.read import RESULT_PREFIX
from ..recording.streams import ArmFrames
from ..recording.write import arm_messages, joints_there
from ..wire.protobuf_encode import alike, encoded
from . import drawing as scene
from .drawing import AlikeRows, arm_point_clouds, world_transform
from .messages import (
    SCHEMA,
    draw_messages,
    gap_messages,
    joints_with_residuals,
    message_rows,
    odometry,
    residual_messages,
    segment_poses,
    thorax_poses,
)

#: How many `axes` a recovery has.
AXES = 5


class RecoveryStreams:
    """The messages of one recovery, batch by batch, encoded when they are written."""

    def __init__(
        self,
        output: Output,
        recovery: Recovery,
        suffix: str,
        frame_id: str,
        shift: int,
        down: FloatArray | None = None,
    ):
        self.output = output
        self.recovery = recovery
        self.suffix = suffix
        self.frame_id = frame_id
        self.shift = shift
        self.world = world_transform(down, frame_id)
        self.body = "forearm_imu" + suffix.replace("/", "_")
        self.camera_joints = joints_there(recovery.arm.state)
        residuals = recovery.residuals
        self.residual_joints = [] if residuals is None else joints_with_residuals(residuals)
        self.gap_start_s = np.array([gap.start_s for gap in recovery.gaps])
        self.trusted = recovery.trusted
        self.angles = JointAngles(recovery)

    def axes(self) -> list[TimeAxis]:
        """Times of the samples, the frames, the residuals, the gaps and the messages of drawn motions."""
        r = self.recovery
        residual_t = np.empty(0) if r.residuals is None else r.residuals.t_s
        drawn_t = np.empty(0) if r.draws is None else r.draws.t_s[message_rows(r.draws)]
        times = (r.t_s, r.arm.t_s, residual_t, self.gap_start_s, drawn_t)
        return [TimeAxis(t_s, r.origin_ns, self.shift) for t_s in times]

    def batch(
        self, samples: slice, frames: slice, residuals: slice, gaps: slice, draws: slice
    ) -> list[OutputStream]:
        """Every stream of a batch, from its rows on the `axes`."""
        part = self.recovery.rows(samples)
        part = replace(part, arm=part.arm.select(frames), gaps=part.gaps[gaps])
        part_residuals = None if part.residuals is None else part.residuals.rows(residuals)
        nearest, inside = self._at_frames(samples, part)
        return [
            self._skeleton(part),
            *self._poses(part),
            *self._camera(part),
            *self._residuals(part_residuals),
            *self._drawn(part, nearest, inside),
            *self._transforms(part, nearest, inside),
            *self._joint_states(part),
            *self._gaps(part),
            *self._draws(draws),
        ]

    def _stamps(self, t_s: FloatArray) -> IntArray:
        return nanoseconds(t_s, self.recovery.origin_ns)

    def _stream(self, topic: str, schema: str, stamp: IntArray, alike_rows: AlikeRows) -> OutputStream:
        """Some rows of stamps (n,) on a topic."""
        rows, constants, columns = alike_rows

        def encode(part: slice) -> Encoded:
            return encoded(schema, constants, columns(rows[part]))

        channel = self.output.channel(f"{RESULT_PREFIX}{topic}{self.suffix}", schema)
        return OutputStream(channel, stamp[rows] + self.shift, encode)

    def _poses(self, r: Recovery) -> Iterator[OutputStream]:
        """Of the forearm's IMU, and where there are, of those on further segments and the trunk."""
        poses = {"forearm": (r, self.body)}
        for name, motion in r.segments.items():
            poses[name] = segment_poses(r, motion), self.body.replace("forearm", name)
        if (thorax := thorax_poses(r)) is not None:
            poses["trunk"] = thorax, self.body.replace("forearm_imu", "thorax")
        stamp = self._stamps(r.t_s)
        for topic, (moving, body) in poses.items():
            for rows in odometry(moving, self.frame_id, body, stamp):
                yield self._stream(topic, "foxglove.Odometry", stamp, rows)

    def _skeleton(self, r: Recovery) -> OutputStream:
        """Every sample, so that times and occlusion are whole even where there is no answer."""
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
        return self._stream("skeleton", "unocclude.Skeleton", stamp, (np.arange(len(r)), constants, columns))

    def _camera(self, r: Recovery) -> Iterator[OutputStream]:
        topic = f"{RESULT_PREFIX}camera{self.suffix}"
        stamp = self._stamps(r.arm.t_s)
        arm = ArmFrames(topic, self.frame_id, 0, r.side, stamp, r.arm.position, r.arm.state)
        stream = arm_messages(self.output, arm, self.camera_joints)
        yield OutputStream(stream.channel, stream.time_ns + self.shift, stream.encode)

    def _residuals(self, residuals: FrameResiduals | None) -> Iterator[OutputStream]:
        if residuals is None or not len(residuals):
            return
        stamp = self._stamps(residuals.t_s)
        for rows in residual_messages(residuals, self.residual_joints, self.frame_id, stamp):
            yield self._stream("residuals", "unocclude.Residuals", stamp, rows)

    def _drawn(self, r: Recovery, nearest: IntArray, inside: BoolArray) -> Iterator[OutputStream]:
        whole, stamp = self.recovery, self._stamps(r.arm.t_s)
        after = np.full((len(nearest), len(JOINTS), 3), np.nan)
        for joint, position in {"strap": whole.position, **whole.joints}.items():
            after[:, JOINTS.index(joint)] = position[nearest]
        kind = np.where(self.trusted[nearest], whole.occluded[nearest].astype(np.int64), scene.DISTRUST)
        shade = np.repeat(kind[:, None], len(JOINTS), axis=1)
        name, at, frame_id = f"arm{self.suffix.replace('/', '_')}", stamp[inside], self.frame_id
        for rows in scene.drawings(after, shade, scene.ANSWER, frame_id, name, at):
            yield self._stream("arm", "foxglove.SceneUpdate", at, rows)
        for rows in arm_point_clouds(after, kind, frame_id, at):
            yield self._stream("beads", "foxglove.PointCloud", at, rows)
        guessed = (r.arm.state == JointState.INFERRED).astype(np.int64)
        colors = (scene.CAMERA, scene.GUESSED)
        for rows in scene.drawings(r.arm.position, guessed, colors, frame_id, f"{name}_camera", stamp):
            yield self._stream("arm_camera", "foxglove.SceneUpdate", stamp, rows)

    def _transforms(self, r: Recovery, nearest: IntArray, inside: BoolArray) -> Iterator[OutputStream]:
        position, quaternion = self.recovery.position[nearest], self.recovery.quaternion[nearest]
        has_pose = np.isfinite(position).all(axis=1) & np.isfinite(quaternion).all(axis=1)
        stamp = self._stamps(r.arm.t_s)[inside]
        forearm = {"parent_frame_id": self.frame_id, "child_frame_id": self.body}
        # The level frame is in every message, so that a viewer has it wherever it begins.
        for posed in (True, False):
            transforms = [*([forearm] if posed else []), *([self.world] if self.world else [])]

            def columns(
                rows: IntArray, posed: bool = posed, count: int = len(transforms)
            ) -> dict[str, NDArray]:
                pose: dict[str, NDArray] = {f"transforms.{k}.timestamp": stamp[rows] for k in range(count)}
                if posed:
                    pose["transforms.0.translation"] = position[rows]
                    pose["transforms.0.rotation"] = quaternion[rows][:, [1, 2, 3, 0]]
                return pose

            rows = np.flatnonzero(has_pose == posed)
            if transforms and len(rows):
                alike_rows = (rows, {"transforms": transforms}, columns)
                yield self._stream("tf", "foxglove.FrameTransforms", stamp, alike_rows)

    def _joint_states(self, r: Recovery) -> Iterator[OutputStream]:
        """The joint angles that are known at a sample, and behind them their sigmas, rad."""
        values, sigmas = self.angles.at(r)
        columns = values | {f"{name}_sigma": sigma for name, sigma in sigmas.items()}
        names, table = list(columns), np.radians(np.column_stack(list(columns.values())))
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

    def _gaps(self, r: Recovery) -> Iterator[OutputStream]:
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

    def _draws(self, messages: slice) -> Iterator[OutputStream]:
        """Motions drawn from the posterior, where there are."""
        draws = self.recovery.draws
        if draws is None:
            return
        first = message_rows(draws)[messages]

        def encode(part: slice) -> Encoded:
            return list(draw_messages(draws, first[part], self.recovery.origin_ns, self.frame_id))

        channel = self.output.channel(f"{RESULT_PREFIX}draws{self.suffix}", SCHEMA)
        yield OutputStream(channel, self._stamps(draws.t_s[first]) + self.shift, encode)

    def _at_frames(self, samples: slice, batch: Recovery) -> tuple[IntArray, BoolArray]:
        """The IMU sample nearest to each frame that the IMU covers, and which of its frames those are."""
        first = max(samples.start - 1, 0)
        stamp, frame = self._stamps(self.recovery.t_s[first : samples.stop + 1]), self._stamps(batch.arm.t_s)
        if not len(stamp):
            return np.empty(0, np.int64), np.zeros(len(frame), bool)
        inside: BoolArray = (frame >= stamp[0]) & (frame <= stamp[-1])
        at, last = frame[inside], len(stamp) - 1
        after = np.clip(np.searchsorted(stamp, at), 1, max(last, 1))
        before_is_nearer = at - stamp[after - 1] < stamp[np.minimum(after, last)] - at
        return first + np.minimum(after - before_is_nearer, last), inside
