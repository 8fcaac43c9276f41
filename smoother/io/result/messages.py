"""Gaps, residuals and the IMU's pose as messages of a result."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray
from ...measurements.visibility import Gap
from ...recording import JOINTS
from ...result import FrameResiduals, GapVerdict, Recovery
from ...result.segment_motion import SegmentMotion
from ...rotation import Rotation
from ..wire import protobuf_encode as wire
from ..wire.schemas import message_class


def gap_messages(
    gaps: Sequence[Gap],
    start_ns: IntArray,
    end_ns: IntArray,
    side: str,
    verdicts: Sequence[GapVerdict] | None = None,
) -> tuple[list[bytes], list[bytes]]:
    """Events (`foxglove.Event`) and lines (`foxglove.Log`), encoded.

    Parameters
    ----------
    gaps : sequence of Gap
        Of the forearm.
    start_ns, end_ns : ndarray of int, shape (n,), ns
        Stamps of their ends.
    side : str
        Of the arm; "" where it is not known.
    verdicts : sequence of GapVerdict, optional
        Whether each is to be trusted; None where not judged. An event then has no `trusted`.

    Returns
    -------
    events, lines : list of bytes
        One of each a gap.
    """
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


class ResidualMessages:
    """What the messages of a recovery's residuals are made of; the same joints in all of them.

    Parameters
    ----------
    residuals : FrameResiduals
        All of them.
    frame_id : str
        Of the camera.
    """

    def __init__(self, residuals: FrameResiduals, frame_id: str):
        self._frame_id = frame_id
        self._joints = _present(residuals)
        self._templates: dict[tuple[int, ...], wire.Template] = {}  # by reasons

    def of_batch(self, residuals: FrameResiduals) -> Iterator[wire.AlikeRows]:
        """Frames that are written alike, the message that contains them, and its columns.

        Parameters
        ----------
        residuals : FrameResiduals
            Some of them.

        Yields
        ------
        rows : ndarray of int
            Frames of the batch.
        template : wire.Template
            What is the same in all of them.
        columns : callable
            From some of the rows to what is not.
        """

        def columns(rows: IntArray) -> dict[str, NDArray]:
            flat = residuals.residual[rows].reshape(len(rows), -1)
            return {"residual": flat, "used": residuals.used[rows].astype(np.int64)}

        for pattern, rows in wire.alike(residuals.reason):
            if pattern not in self._templates:
                reasons = [residuals.reasons[code].sentence for code in pattern]
                self._templates[pattern] = self._template(reasons)
            yield rows, self._templates[pattern], columns

    def _template(self, reasons: list[str]) -> wire.Template:
        """One message, with the reason of each joint."""
        parts = [wire.timestamp(1, "stamp"), wire.text(2, self._frame_id)]
        for i in self._joints:
            value = wire.vector(2, "residual", (3 * i, 3 * i + 1, 3 * i + 2))
            used, why = wire.flag(3, "used", i), wire.text(4, reasons[i])
            parts.append(wire.message(3, wire.text(1, JOINTS[i]), value, used, why))
        return wire.join(*parts)


def _present(residuals: FrameResiduals) -> list[int]:
    """Joints of which there is anything to say."""
    present = np.zeros(len(JOINTS), bool)
    for part in residuals.batches():
        present |= np.isfinite(part.residual).any(axis=(0, 2)) | part.used.any(axis=0)
        present |= (part.reason != 0).any(axis=0)
    return np.flatnonzero(present).tolist()


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


def odometry(r: Recovery, frame_id: str, body: str) -> Iterator[wire.AlikeRows]:
    """What the messages of the samples with a position are made of, one layout after the other.

    Parameters
    ----------
    r : Recovery
        Its poses are written, those of the forearm's IMU or what was put in their place.
    frame_id, body : str
        Names of the camera's frame and of the IMU's; an answer without orientation has the former for both.

    Yields
    ------
    rows : ndarray of int
        Samples of the layout.
    template : wire.Template
        What is the same in all of them.
    columns : callable
        From some of the rows to what is not.
    """
    has_position = np.isfinite(r.position).all(axis=1)
    has_turn = np.isfinite(r.quaternion).all(axis=1)
    has_velocity = np.isfinite(r.velocity).all(axis=1)
    head = [wire.timestamp(1, "stamp"), wire.text(2, frame_id)]
    for turned in (True, False):
        for moving in (True, False):
            mine = has_position & (has_turn == turned) & (has_velocity == moving)
            if not mine.any():
                continue
            turn = wire.vector(2, "quaternion", (1, 2, 3, 0))
            if not turned:
                turn = wire.message(2, wire.constants(0, 0, 0, 1))
            parts = [
                *head,
                wire.text(3, body if turned else frame_id),
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

            yield np.flatnonzero(mine), wire.join(*parts), columns
