"""What viewers show of a recovery: topics at the camera's rate, and the arm drawn for Foxglove and Rerun."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...angles import ForearmMounting, forearm_mounting, joint_angles
from ...angles.definitions import torso_axes
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
from ..wire.protobuf import alike
from ..wire.schemas import message_class

Color = tuple[float, float, float, float]
VISIBLE: Color = (0.10, 0.45, 0.75, 1.0)
RECOVERED: Color = (0.90, 0.45, 0.05, 1.0)
UNTRUSTED: Color = (0.72, 0.0, 0.16, 1.0)
#: Colours of the answer: where the camera saw the arm, where it was recovered, where it is not to be trusted.
ANSWER = (VISIBLE, RECOVERED, UNTRUSTED)
#: Place of the last.
DISTRUST = 2
CAMERA: Color = (0.45, 0.45, 0.45, 1.0)
GUESSED: Color = (0.75, 0.75, 0.75, 0.6)

#: Joints that bones link, by number.
CHAIN = [JOINTS.index(joint) for joint in ("shoulder", "elbow", "wrist", "hand")]
_RADIUS_M = {"shoulder": 0.05, "elbow": 0.04, "wrist": 0.035, "hand": 0.035, "strap": 0.025}
_THICKNESS_M = 0.012
_IDENTITY = {"position": {}, "orientation": {"w": 1.0}}

#: Rows that are written alike: which, the constants of their message, and its columns by some of them.
AlikeRows = tuple[IntArray, dict[str, Any], Callable[[IntArray], dict[str, NDArray]]]


def drawings(
    position: FloatArray,
    shade: IntArray,
    colors: tuple[Color, ...],
    frame_id: str,
    entity: str,
    stamp: IntArray,  # (F,) ns
) -> Iterator[AlikeRows]:
    """Rows that are drawn alike, and the foxglove.SceneUpdate that draws them."""
    has = np.isfinite(position).all(axis=2)
    for pattern, rows in alike(np.where(has, shade, -1)):
        shown = {i: colors[shade] for i, shade in enumerate(pattern) if shade >= 0}
        chain = [i for i in CHAIN if i in shown] if len(shown.keys() & set(CHAIN)) > 1 else []

        def columns(
            chosen: IntArray, shown: Collection[int] = shown, chain: Sequence[int] = chain
        ) -> dict[str, NDArray]:
            where = "entities.0" if shown else "deletions.0"
            points = [(f"spheres.{k}.pose.position", i) for k, i in enumerate(shown)]
            points += [(f"lines.0.points.{k}", i) for k, i in enumerate(chain)]
            places: dict[str, NDArray] = {f"{where}.{path}": position[chosen, i] for path, i in points}
            return {f"{where}.timestamp": stamp[chosen]} | places

        yield rows, _scene(shown, chain, frame_id, entity), columns


def _scene(
    shown: Mapping[int, Color], chain: Sequence[int], frame_id: str, entity: str
) -> dict[str, list[dict[str, Any]]]:
    """A sphere a joint and a line along the bones; nothing to draw deletes what was drawn before."""
    if not shown:
        return {"deletions": [{"id": entity}]}
    spheres = [
        {
            "pose": _IDENTITY,
            "size": dict.fromkeys("xyz", _RADIUS_M[JOINTS[i]]),
            "color": dict(zip("rgba", color, strict=True)),
        }
        for i, color in shown.items()
    ]
    line = {
        "pose": _IDENTITY,
        "thickness": _THICKNESS_M,
        "points": [{} for _ in chain],
        "colors": [dict(zip("rgba", shown[i], strict=True)) for i in chain],
    }
    drawn = {"frame_id": frame_id, "id": entity, "spheres": spheres, "lines": [line] if chain else []}
    return {"entities": [drawn]}


#: Beads between two joints: 5 cm apart on an adult's arm.
BETWEEN = 5
#: Its fields: offset, and foxglove.PackedElementField.NumericType (FLOAT32, UINT8).
_FIELDS = {
    "x": (0, 7),
    "y": (4, 7),
    "z": (8, 7),
    "red": (12, 1),
    "green": (13, 1),
    "blue": (14, 1),
    "alpha": (15, 1),
}
#: Bytes of a bead: three single precision coordinates and a colour.
_STRIDE = 16


def arm_point_clouds(
    position: FloatArray,  # (F, 5, 3) m
    kind: IntArray,  # int (F,)
    frame_id: str,
    stamp: IntArray,  # (F,) ns
) -> Iterator[AlikeRows]:
    """Rows that have the same joints, and the foxglove.PointCloud that draws them."""
    fields = [{"name": name, "offset": at, "type": kind} for name, (at, kind) in _FIELDS.items()]
    constants = {"frame_id": frame_id, "pose": _IDENTITY, "point_stride": _STRIDE, "fields": fields}
    for pattern, rows in alike(np.asarray(np.isfinite(position).all(axis=2))):
        weights = _weights(tuple(np.flatnonzero(pattern).tolist()))

        def columns(chosen: IntArray, weights: FloatArray = weights) -> dict[str, NDArray]:
            beads = np.empty((len(chosen), len(weights), _STRIDE), np.uint8)
            places = weights @ np.nan_to_num(position[chosen])
            beads[:, :, :12] = np.ascontiguousarray(places, "<f4").view(np.uint8)
            beads[:, :, 12:] = np.round(255 * np.array(ANSWER)).astype(np.uint8)[kind[chosen]][:, None]
            data = {"data": beads.reshape(len(chosen), -1)} if len(weights) else {}
            return {"timestamp": stamp[chosen]} | data

        yield rows, constants, columns


@lru_cache(32)
def _weights(present: tuple[int, ...]) -> FloatArray:
    """Beads (B, 5) as sums of joints: one on every joint, and some between joints that a bone links."""
    joints = np.eye(len(JOINTS))
    chain = [i for i in CHAIN if i in present]
    beads = [joints[i] for i in present]
    for one, other in pairwise(chain):
        shares = np.arange(1, BETWEEN + 1)[:, None] / (BETWEEN + 1)
        beads += list((1 - shares) * joints[one] + shares * joints[other])
    return np.array(beads).reshape(-1, len(JOINTS))


#: Name of the level frame: x towards the camera, z up, the origin in the camera.
WORLD = "world"


def common_down(
    recoveries: Iterable[Recovery],
    level_down: FloatArray | None = None,  # (3,)
) -> FloatArray | None:  # (3,)
    """Down in the camera's axes: the first arm's gravity; else of a level camera; else None."""
    for recovery in recoveries:
        if np.isfinite(recovery.gravity_direction).all():
            return recovery.gravity_direction
    return level_down


def world_axes(down: FloatArray) -> FloatArray:  # down (3,) -> (3, 3)
    """`R_W_K` (3, 3): maps a vector from the camera's axes to the level frame's."""
    ahead, up, right = torso_axes(down).T
    return np.stack([ahead, -right, up])


def world_transform(down: FloatArray | None, frame_id: str) -> dict[str, Any] | None:  # down (3,)
    """The transform from `world` to the camera; None without gravity."""
    if down is None or frame_id == WORLD:
        return None
    turn = Rotation.from_matrix(world_axes(down)).as_quat(canonical=True)
    rotation = dict(zip("xyzw", turn.tolist(), strict=True))
    return {"parent_frame_id": WORLD, "child_frame_id": frame_id, "translation": {}, "rotation": rotation}


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
    some = recovery.rows(slice(None, None, step))
    stamp = nanoseconds(some.t_s, recovery.origin_ns)
    body, name = f"forearm_imu{suffix.replace('/', '_')}", f"arm{suffix.replace('/', '_')}"

    def streams(topic: str, schema: str, kinds: Iterator[AlikeRows], stamp: IntArray) -> list[OutputStream]:
        topic = f"{RESULT_PREFIX}{topic}{suffix}"
        return [
            output.stream(
                topic,
                schema,
                stamp[rows] + shift,
                constants,
                lambda part, rows=rows, columns=columns: columns(rows[part]),  # type: ignore[misc]
            )
            for rows, constants, columns in kinds
        ]

    outgoing = streams("skeleton", "unocclude.Skeleton", _skeleton(some, frame_id, stamp), stamp)
    for topic, poses in _poses(some).items():
        of_body = (
            body.replace("forearm_imu", "thorax") if topic == "trunk" else body.replace("forearm", topic)
        )
        outgoing += streams(topic, "foxglove.Odometry", _odometry(*poses, frame_id, of_body, stamp), stamp)
    position, kind = _shown(some)
    shade = np.repeat(kind[:, None], len(JOINTS), axis=1)
    drawn = drawings(position, shade, ANSWER, frame_id, name, stamp)
    outgoing += streams("arm", "foxglove.SceneUpdate", drawn, stamp)
    clouds = arm_point_clouds(position, kind, frame_id, stamp)  # of viewers that draw no scenes
    outgoing += streams("beads", "foxglove.PointCloud", clouds, stamp)
    world = world_transform(down, frame_id)
    outgoing += streams(
        "tf", "foxglove.FrameTransforms", _transforms(some, frame_id, body, world, stamp), stamp
    )
    mounting = forearm_mounting(recovery)
    outgoing += streams("joints", "foxglove.JointStates", _joint_states(some, mounting, stamp), stamp)
    # the camera's joints on the IMU's clock, as messages and drawn
    seen, of_camera = recovery.arm, nanoseconds(recovery.arm.t_s, recovery.origin_ns)
    topic = f"{RESULT_PREFIX}camera{suffix}"
    arm = ArmFrames(topic, frame_id, 0, recovery.side, of_camera, seen.position, seen.state)
    present = joints_there(seen.state) if camera_joints is None else list(camera_joints)
    messages = arm_messages(output, arm, present)
    outgoing.append(OutputStream(messages.channel, of_camera + shift, messages.encode))
    guessed = (seen.state == JointState.INFERRED).astype(np.int64)
    shades = (seen.position, guessed, (CAMERA, GUESSED), frame_id, f"{name}_camera", of_camera)
    outgoing += streams("arm_camera", "foxglove.SceneUpdate", drawings(*shades), of_camera)
    return outgoing + _gaps(output, recovery, suffix, shift)


#: Positions (n, 3) m, quaternions (n, 4), covariances (n, 6, 6), velocities (n, 3) m/s, their (n, 3, 3).
_Motion = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]


def _poses(r: Recovery) -> dict[str, _Motion]:
    """By topic: of the forearm's IMU, and where there are, of those on further segments and the trunk."""
    nothing, unknown = np.full((len(r), 3), np.nan), np.full((len(r), 3, 3), np.nan)
    poses = {"forearm": (r.position, r.quaternion, r.pose_covariance, r.velocity, r.velocity_covariance)}
    for name, motion in r.segments.items():
        poses[name] = motion.position, motion.quaternion, motion.pose_covariance, nothing, unknown
    if (trunk := r.trunk) is not None:  # the thorax, drawn at the arm's shoulder
        covariance = np.zeros((len(r), 6, 6))
        covariance[:, 3:, 3:] = trunk.covariance
        place = np.nan_to_num(r.joints.get("shoulder", nothing))
        place[~np.isfinite(trunk.quaternion).all(axis=1)] = np.nan
        poses["trunk"] = place, trunk.quaternion, covariance, nothing, unknown
    return poses


def _odometry(
    position: FloatArray,
    quaternion: FloatArray,
    covariance: FloatArray,
    velocity: FloatArray,
    spread: FloatArray,
    frame_id: str,
    body: str,
    stamp: IntArray,
) -> Iterator[AlikeRows]:
    """The samples with a position, those with orientation and velocity apart."""
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

        frames = {"frame_id": frame_id, "body_frame_id": body if turned else frame_id}
        yield mine, frames | {"pose": {"orientation": {"w": 1.0}}}, columns


def _skeleton(r: Recovery, frame_id: str, stamp: IntArray) -> Iterator[AlikeRows]:
    """Every moment, so that times and occlusion are whole even where there is no answer."""
    names = [joint for joint in JOINTS if joint in r.joints]
    side = f"_{r.side}" if r.side else ""

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

    constants = {"frame_id": frame_id, "joints": [{"name": joint + side} for joint in names]}
    yield np.arange(len(r)), constants, columns


def _shown(r: Recovery) -> tuple[FloatArray, IntArray]:
    """The arm's joints (n, 5, 3) m, and how each moment is drawn (n,): seen, recovered or not trusted."""
    position = np.full((len(r), len(JOINTS), 3), np.nan)
    for joint, places in {"strap": r.position, **r.joints}.items():
        position[:, JOINTS.index(joint)] = places
    return position, np.where(r.trusted, r.occluded.astype(np.int64), DISTRUST)


def _transforms(
    r: Recovery, frame_id: str, body: str, world: dict[str, Any] | None, stamp: IntArray
) -> Iterator[AlikeRows]:
    """The camera to the forearm's IMU, and the level frame, in every message: viewers begin anywhere."""
    has_pose = np.isfinite(r.position).all(axis=1) & np.isfinite(r.quaternion).all(axis=1)
    forearm = {"parent_frame_id": frame_id, "child_frame_id": body}
    for posed in (True, False):
        transforms = [*([forearm] if posed else []), *([world] if world else [])]

        def columns(rows: IntArray, posed: bool = posed, count: int = len(transforms)) -> dict[str, NDArray]:
            pose: dict[str, NDArray] = {f"transforms.{k}.timestamp": stamp[rows] for k in range(count)}
            if posed:
                pose["transforms.0.translation"] = r.position[rows]
                pose["transforms.0.rotation"] = r.quaternion[rows][:, [1, 2, 3, 0]]
            return pose

        rows = np.flatnonzero(has_pose == posed)
        if transforms and len(rows):
            yield rows, {"transforms": transforms}, columns


def _joint_states(r: Recovery, mounting: ForearmMounting, stamp: IntArray) -> Iterator[AlikeRows]:
    """The joint angles that are known at a sample, and behind them their sigmas, rad."""
    angles = joint_angles(r, mounting)
    side = f"_{r.side}" if r.side else ""
    names = [*(f"{name}{side}" for name in angles.values), *(f"{name}_sigma{side}" for name in angles.sigmas)]
    table = np.radians(np.column_stack([*angles.values.values(), *angles.sigmas.values()]))
    for pattern, rows in alike(np.isfinite(table)):  # samples with the same ones are written alike
        places = np.flatnonzero(pattern).tolist()

        def columns(chosen: IntArray, places: list[int] = places) -> dict[str, NDArray]:
            known = {f"joints.{k}.position": table[chosen, place] for k, place in enumerate(places)}
            return {"timestamp": stamp[chosen]} | known

        if places:
            yield rows, {"joints": [{"name": names[place]} for place in places]}, columns


def _gaps(output: Output, r: Recovery, suffix: str, shift: int) -> list[OutputStream]:
    """Each gap as an event, and as a line of a log, which more programs show."""
    if not r.gaps:
        return []
    times = nanoseconds(np.array([[gap.start_s, gap.end_s] for gap in r.gaps]), r.origin_ns)
    verdicts = r.gap_verdicts if r.has_verdict else (None,) * len(r.gaps)
    each = [
        gap_messages(gap, start, end, r.side, verdict)
        for gap, (start, end), verdict in zip(r.gaps, times.tolist(), verdicts, strict=True)
    ]
    outgoing = []
    for topic, schema, data in zip(
        ("gaps", "log"), ("foxglove.Event", "foxglove.Log"), map(list, zip(*each, strict=True)), strict=True
    ):
        channel = output.channel(f"{RESULT_PREFIX}{topic}{suffix}", schema)
        outgoing.append(OutputStream(channel, times[:, 0] + shift, data.__getitem__))
    return outgoing


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
