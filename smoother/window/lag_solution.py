"""What a fixed-lag window says of its newest node and of one a lag before, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

from ..array_types import FloatArray


@dataclass(frozen=True)
class NodeState:
    """Pose and velocity of the IMU at one moment.

    Attributes
    ----------
    t : float, s
        On the IMU's clock.
    R : ndarray, shape (3, 3)
        `R_K_A`.
    p : ndarray, shape (3,), m
        In {K}.
    v : ndarray, shape (3,), m/s
        In {K}.
    """

    t: float
    R: FloatArray
    p: FloatArray
    v: FloatArray


@dataclass(frozen=True)
class LagSolution:
    """A solved window.

    Attributes
    ----------
    newest, settled : NodeState
        Of the newest node, and of the one that `settled` was asked for.
    bias : ndarray, shape (6,), m/s^2 and rad/s
        The newest.
    gravity : ndarray, shape (3,), m/s^2
        In {K}.
    levers : dict of str to ndarray, shape (3,), m
        In {A}.
    shoulder : ndarray, shape (3,), m, or None
        The newest knot's, in {K}; None before the camera saw one.
    covariance : ndarray, shape (c, c)
        Joint, of the rows below; rotations as vectors in {K}.
    rows : dict of str to slice
        `turn`, `position`, `velocity`, `bias`, `gravity` of the newest node; `settled_turn`,
        `settled_position`, `settled_velocity`; `shoulder`; and the lever arms by joint.
    change_m : float, m
        How far the last iteration moved the newest node.
    iterations : int
    """

    newest: NodeState
    settled: NodeState
    bias: FloatArray
    gravity: FloatArray
    levers: dict[str, FloatArray]
    shoulder: FloatArray | None
    covariance: FloatArray
    rows: dict[str, slice]
    change_m: float
    iterations: int

    def block(self, *names: str) -> FloatArray:
        """Joint covariance of some of the rows, in the order asked for."""
        index = [i for name in names for i in range(self.rows[name].start, self.rows[name].stop)]
        return self.covariance[index][:, index]
