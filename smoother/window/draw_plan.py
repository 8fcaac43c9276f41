"""Random numbers of the motions that are drawn: whose they are decides them, not where or when.

A number belongs to a draw, to a node's time, or to a quantity that the whole recording shares. So windows
that overlap draw the same motion where they do, and the draws do not depend on the number of processes.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..array_types import FloatArray
from .shared import Considered

#: Times are told apart to this, s.
_TICK_S = 1e-6
#: Longest interval between positions of a drawn motion, s.
DRAWN_S = 0.04
#: Samples of which the usual step is taken: neighbours, as their distance is asked for.
_ENOUGH = 100_000


@dataclass(frozen=True)
class DrawPlan:
    """What all windows need for drawing motions."""

    count: int  # Motions
    seed: int  # As it was asked for
    arm: str  # Side and person: each arm has its own random numbers
    every: int  # Each so-many-th sample of the recording's IMU has a drawn position
    shared: FloatArray  # (s, s): covariance of the shared vector before any section has spoken
    considered: Considered | None = None  # Errors that are constant over the recording

    def once(self, name: str, width: int) -> FloatArray:
        """Standard normals (count, width) of something that the whole recording has once."""
        return self._normals(self._stream(name), [0], width)[0]

    def at_times(self, name: str, t: FloatArray, width: int) -> FloatArray:
        """Standard normals (count, k, width) of times (k,), the same wherever the time is met again."""
        ticks = np.rint(t / _TICK_S).astype(np.int64) + (1 << 60)
        return np.swapaxes(self._normals(self._stream(name), ticks.tolist(), width), 0, 1)

    def shared_errors(self, covariance: FloatArray) -> FloatArray:  # covariance (s, s) -> (count, s)
        """Errors (count, s) of the shared vector, drawn once, as a window with this covariance has them.

        One draw is taken from the prior. A window's own posterior differs a little from
        that, so its errors are the nearest ones with its covariance: the optimal transport between two
        Gaussians (Olkin and Pukelsheim, Linear Algebra Appl. 1982).
        """
        scale, root, inverse_root = self._reference
        middle = root_of(root @ (covariance / scale / scale[:, None]) @ root)
        return np.asarray(self.once("shared", len(scale)) @ middle @ inverse_root * scale)

    @cached_property
    def _reference(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Standard deviations of the pooled covariance, root of its correlation, and that root's inverse."""
        scale = np.asarray(np.sqrt(np.diag(self.shared)))
        root = root_of(self.shared / scale / scale[:, None])
        return scale, root, np.asarray(np.linalg.inv(root))

    def considered_errors(self, t: FloatArray) -> FloatArray | None:
        """Considered errors (count, SIZE + m) of a window with nodes (n,): constant ones, then at m knots."""
        if self.considered is None or self.constant_errors is None:
            return None
        knots = self.considered.stamp_knots(float(t[0]), float(t[-1]))
        if not len(knots):
            return self.constant_errors
        stamps = self.at_times("stamps", knots, 1)[:, :, 0] @ root_of(self.considered.stamp_covariance(knots))
        return np.concatenate([self.constant_errors, stamps], axis=1)

    @cached_property
    def constant_errors(self) -> FloatArray | None:
        """Considered errors (count, SIZE), drawn once; None without any."""
        if self.considered is None:
            return None
        root = root_of(self.considered.covariance)
        return np.asarray(self.once("considered", len(root)) @ root)

    def _stream(self, name: str) -> int:
        """Number of a stream of random numbers, by seed, arm and name."""
        words = [self.seed, zlib.crc32(self.arm.encode()), zlib.crc32(name.encode())]
        return int(np.random.SeedSequence(words).generate_state(1, np.uint64)[0])

    def _normals(self, stream: int, numbers: Sequence[int], width: int) -> FloatArray:
        """Standard normals (k, count, width), those of a number by its own `Philox(key=[stream, number])`."""
        philox = np.random.Philox(key=np.array([stream, 0], np.uint64))
        fresh, generator = philox.state, np.random.Generator(philox)
        normals = np.empty((len(numbers), self.count, width))
        for number, own in zip(numbers, normals, strict=True):
            # in a tenth of the time that a new generator takes
            fresh["state"]["key"][1] = number
            philox.state = fresh
            # row after row: the first draws are the same however many there are
            generator.standard_normal(out=own)
        return normals


def samples_apart(t: FloatArray) -> int:
    """Each so-many-th of the samples at times (n,) has a drawn position: `DRAWN_S` apart or closer."""
    step_s = float(np.median(np.diff(t[:_ENOUGH]))) if len(t) > 1 else DRAWN_S
    return max(int(DRAWN_S / step_s + 1e-6), 1)


def root_of(covariance: FloatArray) -> FloatArray:
    """Symmetric square roots (..., k, k) of covariances, which may be singular."""
    variance, axes = np.linalg.eigh(covariance)
    return np.asarray((axes * np.sqrt(np.maximum(variance, 0.0))[..., None, :]) @ np.swapaxes(axes, -1, -2))
