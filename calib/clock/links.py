"""Clocks as values: what was heard, links, and a solved network of clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.array_types import BoolArray, FloatArray, IntArray
from smoother.errors import CalibrationError

#: Crystals differ by some hundred parts in a million.
SKEW_SIGMA = 5e-4


@dataclass(frozen=True)
class Receptions:
    """Who heard what, and when on its own clock.

    Attributes
    ----------
    event : ndarray of int, shape (M,)
        Number of the event; rows of one event were heard at the same instant.
    node : sequence of str
        (M,) names, one a row.
    t_s : ndarray, shape (M,), s
        On the node's clock.
    sigma_s : ndarray, shape (M,), s
        Noise of a stamp, one standard deviation.
    source : str
        What it is called in messages and reports.
    estimate_noise : bool
        Whether the noise may turn out larger than stated (several events of one kind).
    """

    event: IntArray
    node: Sequence[str]
    t_s: FloatArray
    sigma_s: FloatArray
    source: str
    estimate_noise: bool = True


@dataclass(frozen=True)
class ClockLink:
    """t_to = t_from + offset_s + 1e-6 skew_ppm (t_from - at_s); belongs to one recording.

    Attributes
    ----------
    from_clock, to_clock : str
        Names of the nodes.
    offset_s, sigma_s : float, s
        Offset at `at_s` with its standard deviation.
    skew_ppm, skew_sigma_ppm : float, parts in a million
        How fast it grows; sigma is 500 where nothing was measured.
    at_s : float, s
        Time on `from_clock` for which the offset is stated.
    source : str
        What it comes from.
    """

    from_clock: str
    to_clock: str
    offset_s: float
    sigma_s: float
    skew_ppm: float = 0.0
    skew_sigma_ppm: float = 1e6 * SKEW_SIGMA
    at_s: float = 0.0
    source: str = ""

    def at(self, t_from_s: FloatArray) -> FloatArray:
        """Times on `to_clock` for times on `from_clock`, s."""
        t = np.asarray(t_from_s, dtype=float)
        return t + self.offset_s + 1e-6 * self.skew_ppm * (t - self.at_s)


@dataclass(frozen=True)
class Leftover:
    """What a source's data leave unexplained.

    Attributes
    ----------
    source : str
        Its name.
    node : tuple of str
        (n,) who heard it, or the link's pair.
    t_s : ndarray, shape (n,), s
        On the clock of the group's first node.
    residual_s : ndarray, shape (n,), s
        Measured minus explained.
    used : ndarray of bool, shape (n,)
        False where it was rejected.
    sigma_s : float, s
        Noise found, one standard deviation of a stamp (of the offset for a link).
    """

    source: str
    node: tuple[str, ...]
    t_s: FloatArray
    residual_s: FloatArray
    used: BoolArray
    sigma_s: float


@dataclass(frozen=True)
class ClockNetwork:
    """Every clock against every other that it hangs together with.

    Attributes
    ----------
    nodes : tuple of str
        Names; the first of each group is that group's reference.
    group : ndarray of int, shape (n,)
        Number of the group that a node belongs to.
    value : ndarray, shape (2 n,)
        Offsets at tau0 (s), then skews (s/s), against the group's reference.
    covariance : ndarray, shape (2 n, 2 n)
        Of the same.
    tau0_s : ndarray, shape (n,), s
        Time on the group's reference that the offsets are stated for.
    span_s : ndarray, shape (n, 2), s
        First and last time on the reference at which the group was measured.
    leftovers : tuple of Leftover
        Residuals, a source each.
    """

    nodes: tuple[str, ...]
    group: IntArray
    value: FloatArray
    covariance: FloatArray
    tau0_s: FloatArray
    span_s: FloatArray
    leftovers: tuple[Leftover, ...]

    def between(self, from_clock: str, to_clock: str) -> ClockLink:
        """The link between two clocks, stated for the time at which its offset is known best.

        Raises
        ------
        CalibrationError
            One of them is not known, or nothing links them.
        """
        for name in (from_clock, to_clock):
            if name not in self.nodes:
                raise CalibrationError(f"there is no clock {name!r}; there are {', '.join(self.nodes)}")
        u, v, n = self.nodes.index(from_clock), self.nodes.index(to_clock), len(self.nodes)
        if self.group[u] != self.group[v]:
            raise CalibrationError(
                f"nothing links the clocks {from_clock} and {to_clock}; let both hear the same event"
            )
        pick = np.zeros((2, 2 * n))
        for row, first in enumerate((0, n)):
            pick[row, first + v] += 1.0
            pick[row, first + u] -= 1.0
        offset, skew = pick @ self.value
        spread = pick @ self.covariance @ pick.T
        # the offset is known best where the skew's error does not turn it
        dt = -spread[0, 1] / spread[1, 1] if spread[1, 1] > 0 else 0.0
        dt = float(np.clip(dt, *(self.span_s[u] - self.tau0_s[u])))
        variance = spread[0, 0] + 2 * dt * spread[0, 1] + dt**2 * spread[1, 1]
        a, b = self.value[u], self.value[n + u]
        return ClockLink(
            from_clock,
            to_clock,
            offset_s=float(offset + dt * skew),
            sigma_s=float(np.sqrt(max(variance, 0.0))),
            skew_ppm=float(1e6 * skew / (1 + b)),
            skew_sigma_ppm=float(1e6 * np.sqrt(max(spread[1, 1], 0.0))),
            at_s=float(self.tau0_s[u] + dt + a + b * dt),
        )

    def links(self) -> list[ClockLink]:
        """Every pair of clocks that hang together, in the order of the nodes."""
        n = len(self.nodes)
        return [
            self.between(self.nodes[u], self.nodes[v])
            for u in range(n)
            for v in range(u + 1, n)
            if self.group[u] == self.group[v]
        ]
