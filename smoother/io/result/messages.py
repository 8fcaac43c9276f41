"""What a result has beside its trajectory as messages, and its topics as tables of numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray
from ...measurements.visibility import Gap
from ...result import GapVerdict, Recovery
from ...result.segment_motion import SegmentMotion
from ...rotation import Rotation
from ..wire.protobuf_encode import alike
from ..wire.schemas import message_class
from .drawing import AlikeRows


def gap_messages(
    gaps: Sequence[Gap],
    start_ns: IntArray,  # int (n,) ns
    end_ns: IntArray,  # int (n,) ns
    side: str,
    verdicts: Sequence[GapVerdict] | None = None,
) -> tuple[list[bytes], list[bytes]]:
    """Events (`foxglove.Event`) and lines (`foxglove.Log`), encoded."""
    events, lines = [], []
    each_verdict: Sequence[GapVerdict | None] = [None] * len(gaps) if verdicts is None else verdicts
    for gap, verdict, start, end in zip(gaps, each_verdict, start_ns.tolist(), end_ns.tolist(), strict=True):
        event = message_class("foxglove.Event")()
        event.start_time.FromNanoseconds(start)
        event.end_time.FromNanoseconds(end)
        values = {"kind": "occluded", "length_s": f"{gap.length_s:.3f}"}
        values |= {"side": side} if side else {}
        values |= {"open": "start"} if gap.open_start else {}
        values |= {"open": "end"} if gap.open_end else {}
        if verdict is not None:
            values["trusted"] = str(verdict.trusted).lower()
            values |= {} if verdict.trusted else {"reasons": "; ".join(verdict.reasons)}
        for key, value in values.items():
            event.metadata.add(key=key, value=value)
        events.append(event.SerializeToString(deterministic=True))
        line = message_class("foxglove.Log")()
        line.timestamp.FromNanoseconds(start)
        line.level = line.WARNING
        line.message = f"{side} forearm occluded for {gap.length_s:.2f} s".lstrip()
        if verdict is not None and not verdict.trusted:
            line.level = line.ERROR
            line.message += f"; the answer is not to be trusted: {'; '.join(verdict.reasons)}"
        line.name = "unocclude"
        lines.append(line.SerializeToString(deterministic=True))
    return events, lines


def segment_poses(r: Recovery, motion: SegmentMotion) -> Recovery:
    """A further IMU's poses, without velocities, in the forearm's place."""
    return replace(
        r,
        position=motion.position,
        quaternion=motion.quaternion,
        pose_covariance=motion.pose_covariance,
        velocity=np.full_like(r.velocity, np.nan),
    )


def thorax_poses(r: Recovery) -> Recovery | None:
    """The thorax's orientation, drawn at the arm's shoulder, likewise."""
    if r.trunk is None:
        return None
    known = np.asarray(np.isfinite(r.trunk.quaternion).all(axis=1))
    covariance = np.zeros((len(r), 6, 6))
    covariance[:, 3:, 3:] = r.trunk.covariance
    at = np.nan_to_num(r.joints["shoulder"]) if "shoulder" in r.joints else np.zeros((len(r), 3))
    return replace(
        r,
        position=np.where(known[:, None], at, np.nan),
        quaternion=r.trunk.quaternion,
        pose_covariance=covariance,
        velocity=np.full_like(r.velocity, np.nan),
    )


def odometry(r: Recovery, frame_id: str, body: str, stamp: IntArray) -> Iterator[AlikeRows]:
    """The samples with a position, those with orientation and velocity apart, as foxglove.Odometry."""
    has_position = np.isfinite(r.position).all(axis=1)
    has = np.isfinite(r.quaternion).all(axis=1), np.isfinite(r.velocity).all(axis=1)
    for pattern, mine in alike(np.stack([has_position, *has], axis=1)):
        _, turned, moving = pattern
        if not pattern[0]:
            continue

        def columns(rows: IntArray, turned: int = turned, moving: int = moving) -> dict[str, NDArray]:
            velocity, spread = r.velocity[rows], r.velocity_covariance[rows]
            if turned:
                back = Rotation.from_quat(r.quaternion[rows], scalar_first=True).inv().as_matrix()
                velocity = np.einsum("nij,nj->ni", back, velocity)
                spread = back @ spread @ back.transpose(0, 2, 1)
            whole = np.zeros((len(rows), 6, 6))
            whole[:, :3, :3] = spread
            each = {"timestamp": stamp[rows], "pose.position": r.position[rows]}
            each |= {"pose.orientation": r.quaternion[rows][:, [1, 2, 3, 0]]} if turned else {}
            each |= {"linear_velocity": velocity} if moving else {}
            covariance = np.nan_to_num(r.pose_covariance[rows], nan=0.0)
            return each | {
                "pose_covariance": covariance.reshape(-1, 36),
                "velocity_covariance": np.nan_to_num(whole, nan=0.0).reshape(-1, 36),
            }

        constants: dict[str, Any] = {"frame_id": frame_id, "body_frame_id": body if turned else frame_id}
        yield mine, constants | {"pose": {"orientation": {"w": 1.0}}}, columns
