"""The streams of messages that a recovery is written as."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from ..recording import JOINTS, BoolArray, FloatArray, IntArray, JointState
from ..result import FrameResiduals, Recovery
from . import scene, wire
from .merge import Outgoing, Output
from .reading import RESULT_PREFIX, nanoseconds
from .recording_writing import arm_messages
from .schemas import message_class
from .streams import ArmFrames

Columns = Callable[[IntArray], dict[str, NDArray]]


class RecoveryStreams:
    """The messages of one recovery, encoded when they are written.

    Parameters
    ----------
    output : the file.
    recovery : what to write.
    suffix : behind every topic (an arm among several).
    frame_id : of the camera.
    shift : log time less stamp, ns.
    """

    def __init__(self, output: Output, recovery: Recovery, suffix: str, frame_id: str, shift: int):
        self.output = output
        self.recovery = recovery
        self.suffix = suffix
        self.frame_id = frame_id
        self.shift = shift
        self.body = "forearm_imu" + suffix.replace("/", "_")
        self.stamp = nanoseconds(recovery.t_s, recovery.origin_ns)
        self.frame_stamp = nanoseconds(recovery.arm.t_s, recovery.origin_ns)
        self.has_position: BoolArray = np.asarray(np.isfinite(recovery.position).all(axis=1))
        self.has_turn: BoolArray = np.asarray(np.isfinite(recovery.quaternion).all(axis=1))

    def all(self) -> list[Outgoing]:
        """Every stream."""
        return [
            self._skeleton(),
            *self._odometry(),
            *self._camera(),
            *self._residuals(),
            *self._drawn(),
            *self._transforms(),
            *self._joint_states(),
            *self._gaps(),
        ]

    def _stream(
        self,
        topic: str,
        schema: str,
        template: wire.Template,
        stamp: IntArray,
        rows: IntArray,
        columns: Columns,
    ) -> Outgoing:
        def encode(part: slice) -> list[bytes]:
            chosen = rows[part]
            return template.encode(len(chosen), columns(chosen) | wire.stamps("stamp", stamp[chosen]))

        channel = self.output.channel(f"{RESULT_PREFIX}{topic}{self.suffix}", schema)
        return Outgoing(channel, stamp[rows] + self.shift, encode)

    def _odometry(self) -> Iterator[Outgoing]:
        from scipy.spatial.transform import Rotation

        r = self.recovery
        has_velocity = np.isfinite(r.velocity).all(axis=1)
        head = [wire.timestamp(1, "stamp"), wire.text(2, self.frame_id)]
        for turned in (True, False):
            for moving in (True, False):
                mine = self.has_position & (self.has_turn == turned) & (has_velocity == moving)
                if not mine.any():
                    continue
                turn = wire.vector(2, "quaternion", (1, 2, 3, 0))
                if not turned:
                    turn = wire.message(2, wire.constants(0, 0, 0, 1))
                parts = [
                    *head,
                    wire.text(3, self.body if turned else self.frame_id),
                    wire.message(4, wire.vector(1, "position"), turn),
                ]
                if moving:
                    parts.append(wire.vector(5, "velocity"))
                parts += [wire.packed(7, "covariance", 36), wire.packed(8, "velocity_covariance", 36)]

                def columns(rows: IntArray, turned: bool = turned) -> dict[str, NDArray]:
                    velocity, spread = r.velocity[rows], r.velocity_covariance[rows]
                    if turned:
                        quaternion = r.quaternion[rows]
                        back = Rotation.from_quat(quaternion, scalar_first=True).inv().as_matrix()
                        velocity = np.einsum("nij,nj->ni", back, velocity)
                        spread = back @ spread @ back.transpose(0, 2, 1)
                    whole = np.zeros((len(rows), 6, 6))
                    whole[:, :3, :3] = spread
                    return {
                        "position": r.position[rows],
                        "quaternion": r.quaternion[rows],
                        "velocity": velocity,
                        "covariance": np.nan_to_num(r.pose_covariance[rows], nan=0.0),
                        "velocity_covariance": np.nan_to_num(whole, nan=0.0),
                    }

                rows = np.flatnonzero(mine)
                template = wire.join(*parts)
                yield self._stream("forearm", "foxglove.Odometry", template, self.stamp, rows, columns)

    def _skeleton(self) -> Outgoing:
        """Every sample, so that times and occlusion are whole even where there is no answer."""
        r = self.recovery
        names = [joint for joint in JOINTS if joint in r.joints]
        parts = [wire.timestamp(1, "stamp"), wire.text(2, self.frame_id)]
        side = f"_{r.side}" if r.side else ""
        for joint in names:
            parts.append(
                wire.message(
                    4,
                    wire.text(1, joint + side),
                    wire.vector(2, joint),
                    wire.flag(3, f"{joint}_state"),
                    wire.packed(5, f"{joint}_covariance", 9),
                )
            )
        parts.append(wire.flag(5, "occluded"))

        def columns(rows: IntArray) -> dict[str, NDArray]:
            occluded = r.occluded[rows]
            found: dict[str, NDArray] = {"occluded": occluded.astype(np.int64)}
            for joint in names:
                position = r.joints[joint][rows]
                state = np.where(occluded, JointState.INFERRED, JointState.TRACKED)
                state[~np.isfinite(position).all(axis=1)] = JointState.NOT_TRACKED
                found |= {joint: position, f"{joint}_state": state}
                found[f"{joint}_covariance"] = r.joint_covariance[joint][rows]
            return found

        rows = np.arange(len(self.stamp))
        return self._stream("skeleton", "unocclude.Skeleton", wire.join(*parts), self.stamp, rows, columns)

    def _camera(self) -> Iterator[Outgoing]:
        r = self.recovery
        topic = f"{RESULT_PREFIX}camera{self.suffix}"
        arm = ArmFrames(topic, self.frame_id, 0, r.side, self.frame_stamp, r.arm.position, r.arm.state)
        stream = arm_messages(self.output, arm)
        yield Outgoing(stream.channel, stream.time_ns + self.shift, stream.encode)

    def _residuals(self) -> Iterator[Outgoing]:
        residuals = self.recovery.residuals
        if residuals is None or not len(residuals.t_s):
            return
        stamp = nanoseconds(residuals.t_s, self.recovery.origin_ns)
        patterns, which = np.unique(residuals.reason, axis=0, return_inverse=True)
        for number, pattern in enumerate(patterns):
            parts = [wire.timestamp(1, "stamp"), wire.text(2, self.frame_id)]
            for i in _present(residuals):
                value = wire.vector(2, "residual", (3 * i, 3 * i + 1, 3 * i + 2))
                used = wire.flag(3, "used", i)
                parts.append(
                    wire.message(
                        3, wire.text(1, JOINTS[i]), value, used, wire.text(4, residuals.reasons[pattern[i]])
                    )
                )

            def columns(rows: IntArray) -> dict[str, NDArray]:
                flat = residuals.residual[rows].reshape(len(rows), -1)
                return {"residual": flat, "used": residuals.used[rows].astype(np.int64)}

            rows = np.flatnonzero(which.reshape(-1) == number)
            yield self._stream("residuals", "unocclude.Residuals", wire.join(*parts), stamp, rows, columns)

    def _drawn(self) -> Iterator[Outgoing]:
        r = self.recovery
        row, inside = self._at_frames()
        after = np.full((len(row), len(JOINTS), 3), np.nan)
        for joint, position in {"strap": r.position, **r.joints}.items():
            after[:, JOINTS.index(joint)] = position[row]
        shade = np.repeat(r.occluded[row].astype(np.int64)[:, None], len(JOINTS), axis=1)
        stamp = self.frame_stamp[inside]
        colors = {0: scene.VISIBLE, 1: scene.RECOVERED}
        name = f"arm{self.suffix.replace('/', '_')}"
        for rows, template, columns in scene.drawings(after, shade, colors, self.frame_id, name):
            yield self._stream("arm", "foxglove.SceneUpdate", template, stamp, rows, columns)
        guessed = (r.arm.state == JointState.INFERRED).astype(np.int64)
        colors = {0: scene.CAMERA, 1: scene.GUESSED}
        name += "_camera"
        for rows, template, columns in scene.drawings(r.arm.position, guessed, colors, self.frame_id, name):
            yield self._stream(
                "arm_camera", "foxglove.SceneUpdate", template, self.frame_stamp, rows, columns
            )

    def _transforms(self) -> Iterator[Outgoing]:
        r = self.recovery
        row, inside = self._at_frames()
        good = self.has_position[row] & self.has_turn[row]
        if not good.any():
            return
        stamp, row = self.frame_stamp[inside][good], row[good]
        template = wire.message(
            1,
            wire.timestamp(1, "stamp"),
            wire.text(2, self.frame_id),
            wire.text(3, self.body),
            wire.vector(4, "position"),
            wire.vector(5, "quaternion", (1, 2, 3, 0)),
        )

        def columns(rows: IntArray) -> dict[str, NDArray]:
            return {"position": r.position[row[rows]], "quaternion": r.quaternion[row[rows]]}

        rows = np.arange(len(row))
        yield self._stream("tf", "foxglove.FrameTransforms", template, stamp, rows, columns)

    def _joint_states(self) -> Iterator[Outgoing]:
        flexion = elbow_flexion(self.recovery.joints)
        if flexion is None or not np.isfinite(flexion).any():
            return
        name = "elbow_flexion" + (f"_{self.recovery.side}" if self.recovery.side else "")
        template = wire.join(
            wire.timestamp(1, "stamp"), wire.message(2, wire.text(1, name), wire.double(2, "angle"))
        )
        rows = np.flatnonzero(np.isfinite(flexion))
        yield self._stream(
            "joints",
            "foxglove.JointStates",
            template,
            self.stamp,
            rows,
            lambda chosen: {"angle": flexion[chosen]},
        )

    def _gaps(self) -> Iterator[Outgoing]:
        gaps = self.recovery.gaps
        if not gaps:
            return
        data = []
        start = nanoseconds(np.array([gap.start_s for gap in gaps]), self.recovery.origin_ns)
        end = nanoseconds(np.array([gap.end_s for gap in gaps]), self.recovery.origin_ns)
        for gap, start_ns, end_ns in zip(gaps, start.tolist(), end.tolist(), strict=True):
            event = message_class("foxglove.Event")()
            event.start_time.FromNanoseconds(start_ns)
            event.end_time.FromNanoseconds(end_ns)
            said = {"kind": "occluded", "length_s": f"{gap.length_s:.3f}"}
            said |= {"side": self.recovery.side} if self.recovery.side else {}
            said |= {"open": "start"} if gap.open_start else {}
            said |= {"open": "end"} if gap.open_end else {}
            for key, value in said.items():
                event.metadata.add(key=key, value=value)
            data.append(event.SerializeToString(deterministic=True))
        channel = self.output.channel(f"{RESULT_PREFIX}gaps{self.suffix}", "foxglove.Event")
        yield Outgoing(channel, start + self.shift, lambda part: data[part])

    def _at_frames(self) -> tuple[IntArray, BoolArray]:
        """The IMU sample nearest to each camera frame that the IMU covers, and which frames those are."""
        if not len(self.stamp):
            return np.empty(0, np.int64), np.zeros(len(self.frame_stamp), bool)
        inside = (self.frame_stamp >= self.stamp[0]) & (self.frame_stamp <= self.stamp[-1])
        at = self.frame_stamp[inside]
        after = np.clip(np.searchsorted(self.stamp, at), 1, max(len(self.stamp) - 1, 1))
        before_is_nearer = (
            at - self.stamp[after - 1] < self.stamp[np.minimum(after, len(self.stamp) - 1)] - at
        )
        return np.minimum(after - before_is_nearer, len(self.stamp) - 1), inside


def elbow_flexion(joints: dict[str, FloatArray]) -> FloatArray | None:
    """Angle (N,) between upper arm and forearm, rad, 0 = straight; None without the joints."""
    if not {"shoulder", "elbow", "wrist"} <= joints.keys():
        return None
    upper = joints["elbow"] - joints["shoulder"]
    forearm = joints["wrist"] - joints["elbow"]
    across = np.linalg.norm(np.cross(upper, forearm), axis=1)
    return np.arctan2(across, np.einsum("ni,ni->n", upper, forearm))


def _present(residuals: FrameResiduals) -> list[int]:
    """Joints of which there is anything to say."""
    said = np.isfinite(residuals.residual).any(axis=(0, 2)) | residuals.used.any(axis=0)
    said |= (residuals.reason != 0).any(axis=0)
    return np.flatnonzero(said).tolist()
