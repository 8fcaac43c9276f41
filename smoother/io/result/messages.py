"""What a result has beside its trajectory as messages, and its topics as tables of numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...array_types import FloatArray, IntArray
from ...measurements.visibility import Gap
from ...result import GapVerdict
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


def odometry(
    poses: tuple[FloatArray, FloatArray, FloatArray],  # (n, 3) m; (n, 4); (n, 6, 6)
    velocity: FloatArray,  # (n, 3) m/s
    spread: FloatArray,  # (n, 3, 3): its covariance
    frame_id: str,
    body: str,
    stamp: IntArray,
) -> Iterator[AlikeRows]:
    """The samples with a position, those with orientation and velocity apart, as foxglove.Odometry."""
    position, quaternion, covariance = poses
    has = [np.isfinite(each).all(axis=1) for each in (position, quaternion, velocity)]
    for pattern, mine in alike(np.stack(has, axis=1)):
        placed, turned, moving = pattern
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

        constants: dict[str, Any] = {"frame_id": frame_id, "body_frame_id": body if turned else frame_id}
        yield mine, constants | {"pose": {"orientation": {"w": 1.0}}}, columns
