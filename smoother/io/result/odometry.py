"""Poses and velocities of an IMU as `foxglove.Odometry`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...array_types import IntArray
from ...result import Recovery
from ...rotation import Rotation
from ..wire import protobuf_encode as wire


def upper_arm_poses(r: Recovery) -> Recovery | None:
    """An upper-arm IMU's poses, without velocities, in the forearm's place; None without one."""
    if r.upper is None:
        return None
    return replace(
        r,
        position=r.upper.position,
        quaternion=r.upper.quaternion,
        pose_covariance=r.upper.pose_covariance,
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
