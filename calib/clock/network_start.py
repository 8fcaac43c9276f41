"""Where the fit of a clock network starts: robust offsets of pairs, followed from node to node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from smoother.array_types import FloatArray, IntArray

if TYPE_CHECKING:
    from .links import ClockLink

#: A pair's skew is looked for where its events lie so far apart, s.
SKEW_SPAN_S = 2.0
#: Up to so many events every line through two of them is tried; what is wrong is far wrong, s.
FEW = 12
NEAR_S = 0.0005
USUAL_SKEW = 3e-4
#: Events that a pair's slope is taken from; more tell no more.
MOST = 300
LARGEST_SKEW = 2e-3


def start_values(
    event: IntArray,
    node: IntArray,
    t: FloatArray,
    ends: IntArray,
    links: Sequence[ClockLink],
    count: int,
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Offsets and skews of all nodes against the first of their group.

    Parameters
    ----------
    event, node, t : ndarray of int and ndarray, shape (M,)
        Receptions: event, node, time on the node's clock.
    ends : ndarray of int, shape (L, 2)
        Nodes of each link.
    links : sequence of ClockLink
        Measured in another way.
    count : int
        Number of nodes.

    Returns
    -------
    a (n,) s, b (n,) s/s, group (n,), tau0 (groups,) time on a group's first node.
    """
    edges = _pairs(event, node, t)
    for (u, v), link in zip(ends.tolist(), links, strict=True):
        edges.append((u, v, link.at_s, link.offset_s, 1e-6 * link.skew_ppm, 1))
    edges.sort(key=lambda edge: -edge[-1])  # most events first
    a, b, group = np.zeros(count), np.zeros(count), np.full(count, -1, dtype=np.int64)
    tau0: list[float] = []
    for first in range(count):
        if group[first] >= 0:
            continue
        mine = t[node == first]
        near = [at for u, v, at, *_ in edges if u == first]
        tau0.append(float(mine.mean()) if len(mine) else (near[0] if near else 0.0))
        group[first] = len(tau0) - 1
        grown = True
        while grown:
            grown = _grow(edges, a, b, group, len(tau0) - 1, tau0[-1])
    return a, b, group, np.array(tau0)


def _grow(
    edges: list[tuple[int, int, float, float, float, int]],
    a: FloatArray,
    b: FloatArray,
    group: IntArray,
    number: int,
    tau0: float,
) -> bool:
    """Add to a group the node of the strongest edge that leads out of it."""
    for u, v, at, offset, skew, _ in edges:
        if group[u] == number and group[v] < 0:
            a[v], b[v] = a[u] + offset + skew * (tau0 + a[u] - at), b[u] + skew
            group[v] = number
            return True
        if group[v] == number and group[u] < 0:
            # t_v = t_u + offset + skew (t_u - at), the other way round
            a[u] = (tau0 + a[v] - offset + skew * at) / (1 + skew) - tau0
            b[u] = b[v] - skew
            group[u] = number
            return True
    return False


def _pairs(event: IntArray, node: IntArray, t: FloatArray) -> list[tuple[int, int, float, float, float, int]]:
    """For each pair of nodes with common events: nodes, time, offset there, skew, number of events."""
    events = np.unique(event)
    if not len(events):
        return []
    present = np.unique(node)
    table = np.full((len(events), int(present.max()) + 1), np.nan)
    table[np.searchsorted(events, event), node] = t
    pairs = []
    for k, u in enumerate(present.tolist()):
        for v in present[k + 1 :].tolist():
            both = np.isfinite(table[:, u]) & np.isfinite(table[:, v])
            if both.any():
                pairs.append((u, v, *_line(table[both, u], table[both, v]), int(both.sum())))
    return pairs


def _line(t_from: FloatArray, t_to: FloatArray) -> tuple[float, float, float]:
    """Time, offset there and skew by medians (Theil and Sen): half of the events may be wrong."""
    if len(t_from) > MOST:
        chosen = np.linspace(0, len(t_from) - 1, MOST).astype(int)
        t_from, t_to = t_from[chosen], t_to[chosen]
    at, skew = float(np.median(t_from)), 0.0
    difference = t_to - t_from
    if len(t_from) <= FEW:
        skew, offset = _consensus(t_from - at, difference)
        return at, offset, skew
    if np.ptp(t_from) > SKEW_SPAN_S:
        i, j = np.triu_indices(len(t_from), 1)
        apart = t_from[j] - t_from[i]
        far = np.abs(apart) > 0.2 * np.ptp(t_from)
        skew = float(np.median((difference[j] - difference[i])[far] / apart[far]))
        skew = skew if abs(skew) < LARGEST_SKEW else 0.0
    return at, float(np.median(difference - skew * (t_from - at))), skew


def _consensus(dt: FloatArray, difference: FloatArray) -> tuple[float, float]:
    """Skew and offset of the line that most events lie near to, and that no crystal would be ashamed of."""
    skews = [0.0]
    if np.ptp(dt) > SKEW_SPAN_S:
        i, j = np.triu_indices(len(dt), 1)
        far = dt[j] != dt[i]
        slopes = (difference[j] - difference[i])[far] / (dt[j] - dt[i])[far]
        skews += slopes[np.abs(slopes) < LARGEST_SKEW].tolist()
    slope = np.array(skews)
    level = difference - slope[:, None] * dt  # (slopes, n): an offset through each event
    apart = level[:, None, :] - level[:, :, None]
    loss = np.log1p((apart / NEAR_S) ** 2).sum(axis=2) + ((slope / USUAL_SKEW) ** 2)[:, None]
    k, event = np.unravel_index(int(np.argmin(loss)), loss.shape)
    near = np.abs(apart[k, event]) < 3 * NEAR_S
    return float(slope[k]), float(level[k][near].mean())
