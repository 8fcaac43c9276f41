"""Skeleton messages of an arm whose strap carries a covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...recording import JOINTS, FloatArray, JointState
from ..mcap.merge import Encoded, Outgoing, Output
from ..recording.streams import ArmFrames
from ..wire import protobuf_encode as wire


def arm_with_strap(output: Output, arm: ArmFrames, covariance: FloatArray | None) -> Outgoing:
    """Messages of an arm; its strap carries `covariance` (F, 9), m^2 row by row, zero where there is none."""
    suffix = f"_{arm.side}" if arm.side else ""
    present = [i for i in range(len(JOINTS)) if (arm.state[:, i] != JointState.NOT_TRACKED).any()]
    parts = [wire.timestamp(1, "stamp"), wire.text(2, arm.frame_id), wire.number(3, arm.body)]
    for i in present:
        own = [
            wire.text(1, JOINTS[i] + suffix),
            wire.vector(2, "position", (3 * i, 3 * i + 1, 3 * i + 2)),
            wire.flag(3, "state", i),
        ]
        if covariance is not None and JOINTS[i] == "strap":
            own.append(wire.packed(5, "covariance", 9))
        parts.append(wire.message(4, *own))
    template = wire.join(*parts)

    def encode(part: slice) -> Encoded:
        stamp = arm.stamp_ns[part]
        columns: dict[str, NDArray] = {
            "position": arm.position[part].reshape(-1, 3 * len(JOINTS)),
            "state": arm.state[part],
        }
        if covariance is not None:
            columns["covariance"] = np.nan_to_num(covariance[part])
        return template.encode(len(stamp), columns | wire.stamps("stamp", stamp))

    return Outgoing(output.channel(arm.topic, "unocclude.Skeleton"), arm.stamp_ns, encode)
