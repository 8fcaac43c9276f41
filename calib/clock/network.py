"""Clocks against each other: a network of nodes, solved from what they heard together and from links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.array_types import BoolArray, FloatArray, IntArray
from smoother.errors import CalibrationError

from .links import SKEW_SIGMA, ClockLink, ClockNetwork, Leftover, Receptions

#: A pair's skew is looked for where its events lie this far apart, s.
SKEW_SPAN_S = 2.0
#: Up to this many events every line through two of them is tried; what is wrong is far wrong, s.
FEW = 12
NEAR_S = 0.0005
USUAL_SKEW = 3e-4
#: Events that a pair's slope is taken from; more tell no more.
MOST = 300
PLAUSIBLE_SKEW = 2e-3


def start_values(
    event: IntArray,  # int (M,)
    node: IntArray,  # int (M,)
    t: FloatArray,  # int (M,)
    ends: IntArray,  # int (L, 2)
    links: Sequence[ClockLink],
    count: int,
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Offsets and skews of all nodes against the first of their group."""
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
        skew = skew if abs(skew) < PLAUSIBLE_SKEW else 0.0
    return at, float(np.median(difference - skew * (t_from - at))), skew


def _consensus(dt: FloatArray, difference: FloatArray) -> tuple[float, float]:
    """Skew and offset of the line that most events lie near to, and that no crystal would be ashamed of."""
    skews = [0.0]
    if np.ptp(dt) > SKEW_SPAN_S:
        i, j = np.triu_indices(len(dt), 1)
        far = dt[j] != dt[i]
        slopes = (difference[j] - difference[i])[far] / (dt[j] - dt[i])[far]
        skews += slopes[np.abs(slopes) < PLAUSIBLE_SKEW].tolist()
    slope = np.array(skews)
    level = difference - slope[:, None] * dt  # (slopes, n): an offset through each event
    apart = level[:, None, :] - level[:, :, None]
    loss = np.log1p((apart / NEAR_S) ** 2).sum(axis=2) + ((slope / USUAL_SKEW) ** 2)[:, None]
    k, event = np.unravel_index(int(np.argmin(loss)), loss.shape)
    near = np.abs(apart[k, event]) < 3 * NEAR_S
    return float(slope[k]), float(level[k][near].mean())


#: The stated noise of a source is treated as this many samples when its noise is measured.
PRIOR_SAMPLES = 4.0
#: What is farther off than this many sigmas is rejected.
OUTLIER = 5.0
ROUNDS = 40
#: No crystal is off by more, s/s.
LARGEST_SKEW = 3.0 * SKEW_SIGMA
#: Agreement better than this part of the stamps' own noise means that all rounds share one rounding.
TOO_GOOD = 0.5


def solve_clocks(receptions: Sequence[Receptions], links: Sequence[ClockLink] = ()) -> ClockNetwork:
    """Offsets and skews of all clocks from what was heard together and from measured links."""
    rows = _Rows.of(receptions)
    if not len(rows.t) and not links:
        raise CalibrationError("no event was received by two clocks, so nothing links them; broadcast again")
    nodes = list(
        dict.fromkeys([*(n for each in links for n in (each.from_clock, each.to_clock)), *rows.nodes])
    )
    number = {name: k for k, name in enumerate(nodes)}
    node = np.array([number[name] for name in rows.nodes], dtype=np.int64)
    ends = np.array([[number[k.from_clock], number[k.to_clock]] for k in links], dtype=np.int64).reshape(
        -1, 2
    )
    a, b, group, tau0 = start_values(rows.event, node, rows.t, ends, links, len(nodes))
    system = _System(rows, node, ends, links, group, tau0)
    # the start is robust: its residuals say first what to trust
    left, weight = system.apart(a, b, np.ones(len(rows.t))), np.zeros(len(rows.t))
    scale = system.noise(left, np.ones(len(left)), robust=True)
    again = 1.0 / (1.0 + (left / (rows.sigma * scale)) ** 2)
    for _ in range(ROUNDS):  # weights of Cauchy's loss, until they settle
        weight = again
        a, b, left, _ = system.solve(a, b, weight)
        scale = np.minimum(system.noise(left, weight, robust=True), scale)
        again = 1.0 / (1.0 + (left / (rows.sigma * scale)) ** 2)
        if np.abs(again - weight).max(initial=0.0) < 1e-6:
            break
    used = system.heard_together(np.abs(left) < OUTLIER * scale * rows.sigma)
    used |= system.cut_off(used)
    for _ in range(3):  # the noise sets the weight between sources
        weight = used.astype(float) / scale**2
        a, b, left, covariance = system.solve(a, b, weight)
        scale = system.noise(left, used.astype(float), robust=False)
    left = system.apart(a, b, np.maximum(weight, 1e-6))  # of the rejected rows too
    covariance = covariance + system.outvoted(left, used)
    spans = system.spans(a, b)
    covariance = covariance + system.shared_rounding(left, used) + _no_crystal(b, np.ptp(spans, axis=1))
    return ClockNetwork(
        nodes=tuple(nodes),
        group=group,
        value=np.concatenate([a, b]),
        covariance=covariance,
        tau0_s=tau0[group],
        span_s=spans,
        leftovers=system.leftovers(nodes, a, b, left, used, scale),
    )


def _no_crystal(skew: FloatArray, span_s: FloatArray) -> FloatArray:
    """Covariance to add where a skew is larger than any crystal's: times contradict each other and few
    rounds hide it.
    """
    wrong = np.where(np.abs(skew) > LARGEST_SKEW, skew, 0.0)
    return np.diag(np.concatenate([(wrong * span_s) ** 2, wrong**2]))


@dataclass(frozen=True)
class _Rows:
    """All receptions of events that at least two nodes heard."""

    event: IntArray
    nodes: list[str]
    t: FloatArray
    sigma: FloatArray
    source: IntArray
    names: tuple[str, ...]
    estimated: BoolArray

    @classmethod
    def of(cls, receptions: Sequence[Receptions]) -> _Rows:
        event, nodes, t, sigma, source, first = [], [], [], [], [], 0
        for k, each in enumerate(receptions):
            names, number = np.unique(np.asarray(each.event), return_inverse=True)
            keep = np.bincount(number, minlength=len(names))[number] > 1
            event.append(number[keep] + first)
            nodes += [name for name, kept in zip(each.node, keep, strict=True) if kept]
            t.append(np.asarray(each.t_s, dtype=float)[keep])
            sigma.append(np.broadcast_to(each.sigma_s, keep.shape)[keep])
            source.append(np.full(int(keep.sum()), k))
            first += len(names)
        join = lambda parts, kind: np.concatenate([*parts, np.empty(0)]).astype(kind)  # noqa: E731
        return cls(
            join(event, np.int64),
            nodes,
            join(t, float),
            join(sigma, float),
            join(source, np.int64),
            tuple(each.source for each in receptions),
            np.array([each.estimate_noise for each in receptions], dtype=bool),
        )


class _System:
    """The least-squares system of a network; offsets and skews of the reference nodes are zero."""

    def __init__(
        self,
        rows: _Rows,
        node: IntArray,
        ends: IntArray,
        links: Sequence[ClockLink],
        group: IntArray,
        tau0: FloatArray,
    ) -> None:
        self.rows, self.node, self.ends, self.links = rows, node, ends, links
        self.group, self.tau0, self.count = group, tau0, len(group)
        first = [int(np.flatnonzero(group == g)[0]) for g in np.unique(group)]
        self.free = np.setdiff1d(np.arange(self.count), first)

    def on_reference(self, k: IntArray, t: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
        """Times of nodes (M,) on their own clocks as time since tau0 on the reference."""
        return np.asarray((t - self.tau0[self.group[k]] - a[k]) / (1 + b[k]))

    def solve(
        self, a: FloatArray, b: FloatArray, weight: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """One Gauss-Newton step: offsets, skews, residuals (M,) and covariance (2 n, 2 n)."""
        rows, n = self.rows, self.count
        dt = self.on_reference(self.node, rows.t, a, b)
        information = weight / rows.sigma**2
        middle = self._mean(dt, information)
        off = self.apart(a, b, weight)
        design = np.zeros((len(rows.t), 2 * n))
        at = np.arange(len(rows.t))
        design[at, self.node], design[at, n + self.node] = 1.0, middle
        design -= np.stack([self._mean(column, information) for column in design.T], axis=1).reshape(
            design.shape
        )
        design_l, off_l, information_l = self._link_rows(a, b)
        design = np.concatenate([design, design_l, np.eye(2 * n)[n:]])
        off = np.concatenate([off, off_l, -b])
        information = np.concatenate([information, information_l, np.full(n, SKEW_SIGMA**-2)])
        columns = np.concatenate([self.free, n + self.free])
        part = design[:, columns]
        normal = part.T @ (information[:, None] * part)
        size = np.sqrt(np.diag(normal))  # seconds and ppm: scaled for the inverse
        inverse = np.linalg.inv(normal / np.outer(size, size)) / np.outer(size, size)
        step = np.zeros(2 * n)
        step[columns] = inverse @ (part.T @ (information * off))
        covariance = np.zeros((2 * n, 2 * n))
        covariance[np.ix_(columns, columns)] = inverse
        left = (off - design @ step)[: len(rows.t)]
        return a + step[:n], b + step[n:], left, covariance

    def apart(self, a: FloatArray, b: FloatArray, weight: FloatArray) -> FloatArray:
        """(M,) how far each time is from its event's, on the node's own clock, s."""
        dt = self.on_reference(self.node, self.rows.t, a, b)
        information = weight / self.rows.sigma**2
        off = (dt - self._mean(dt, information)) * (1 + b[self.node])
        return off - self._mean(off, information)

    def _mean(self, values: FloatArray, weight: FloatArray) -> FloatArray:
        """Weighted mean of each event, at its rows (M,)."""
        total = np.bincount(self.rows.event, weight) if len(values) else np.empty(0)
        mean = np.bincount(self.rows.event, weight * values) if len(values) else np.empty(0)
        return np.asarray((mean / np.maximum(total, 1e-300))[self.rows.event])

    def _link_rows(self, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        n = self.count
        design, off = np.zeros((2 * len(self.links), 2 * n)), np.zeros(2 * len(self.links))
        information = np.zeros(2 * len(self.links))
        for k, (link, (u, v)) in enumerate(zip(self.links, self.ends.tolist(), strict=True)):
            at = np.array([link.at_s])
            dt = float(self.on_reference(np.array([u]), at, a, b)[0])
            for row, first in enumerate((0, n)):
                design[2 * k + row, first + v], design[2 * k + row, first + u] = 1.0, -1.0
            design[2 * k, n + v], design[2 * k, n + u] = dt, -dt
            off[2 * k] = link.offset_s - ((a[v] - a[u]) + dt * (b[v] - b[u]))
            off[2 * k + 1] = 1e-6 * link.skew_ppm - (b[v] - b[u])
            information[2 * k] = link.sigma_s**-2
            information[2 * k + 1] = (1e-6 * link.skew_sigma_ppm) ** -2
        return design, off, information

    def heard_together(self, used: BoolArray) -> BoolArray:
        """Without the rows that are now alone in their event."""
        if not len(used):
            return used
        alone = np.bincount(self.rows.event, used) < 2
        return used & ~alone[self.rows.event]

    def cut_off(self, used: BoolArray) -> BoolArray:
        """(M,) all rows of nodes that the rows in use no longer link to their group: their scatter is
        their noise.
        """
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        n, events = self.count, int(self.rows.event.max(initial=-1)) + 1
        heard = np.stack([self.node[used], n + self.rows.event[used]])
        edges = np.concatenate([heard, self.ends.T], axis=1)
        graph = coo_matrix((np.ones(edges.shape[1]), edges), shape=(n + events, n + events))
        part = connected_components(graph, directed=False)[1][:n]
        first = {int(g): part[np.flatnonzero(self.group == g)[0]] for g in np.unique(self.group)}
        lost = np.array([part[k] != first[int(self.group[k])] for k in range(n)])
        return np.isin(self.rows.event, self.rows.event[lost[self.node]])

    def noise(self, left: FloatArray, weight: FloatArray, robust: bool) -> FloatArray:
        """(M,) how much larger than stated the noise of each row's source is (at least as stated)."""
        rows, scale = self.rows, np.ones(len(left))
        for k in np.flatnonzero(rows.estimated).tolist():
            mine = (rows.source == k) & (weight > 0)
            if not mine.any():
                continue
            events, parameters = len(np.unique(rows.event[mine])), 2 * (len(np.unique(self.node[mine])) - 1)
            freedom = max(int(mine.sum()) - events - parameters, 0)
            size = (left[mine] / rows.sigma[mine]) ** 2
            if robust:  # the median of a squared normal is 0.455
                total = freedom * float(np.median(size)) / 0.455 * mine.sum() / max(freedom, 1)
            else:
                total = float(size.sum())
            scale[rows.source == k] = np.sqrt(max((PRIOR_SAMPLES + total) / (PRIOR_SAMPLES + freedom), 1.0))
        return scale

    def outvoted(self, left: FloatArray, used: BoolArray) -> FloatArray:
        """Covariance to add to nodes of which no more times agree than were rejected."""
        extra = np.zeros(2 * self.count)
        for node in self.free.tolist():
            mine = self.node == node
            rejected = np.abs(left[mine & ~used])
            if len(rejected) and int((mine & used).sum()) <= len(rejected):
                extra[node] = float(np.median(rejected)) ** 2
        return np.diag(extra)

    def shared_rounding(self, left: FloatArray, used: BoolArray) -> FloatArray:
        """Covariance to add where all rounds of a source agree too well: they share one rounding error."""
        rows, extra = self.rows, np.zeros(2 * self.count)
        for k in range(len(rows.names)):
            mine = (rows.source == k) & used
            events = len(np.unique(rows.event[mine]))
            freedom = int(mine.sum()) - events
            if events < 3 or np.sum((left[mine] / rows.sigma[mine]) ** 2) > TOO_GOOD**2 * freedom:
                continue
            for node in np.unique(self.node[mine]).tolist():
                extra[node] = max(extra[node], float(np.max(rows.sigma[mine]) ** 2))
        return np.diag(extra)

    def spans(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """(n, 2) first and last measured time of each node's group, on its reference."""
        dt = self.on_reference(self.node, self.rows.t, a, b)
        where = self.group[self.node]
        spans = np.zeros((self.count, 2))
        for g in np.unique(self.group).tolist():
            times = dt[where == g]
            linked = [
                float(self.on_reference(ends[:1], np.array([link.at_s]), a, b)[0])
                for link, ends in zip(self.links, self.ends, strict=True)
                if self.group[ends[0]] == g
            ]
            every = np.concatenate([times, linked, np.zeros(0)])
            spans[self.group == g] = self.tau0[g] + ([every.min(), every.max()] if len(every) else [0.0, 0.0])
        return spans

    def leftovers(
        self,
        nodes: list[str],
        a: FloatArray,
        b: FloatArray,
        left: FloatArray,
        used: BoolArray,
        scale: FloatArray,
    ) -> tuple[Leftover, ...]:
        """Residuals of every source and link."""
        rows, found = self.rows, []
        dt = self.on_reference(self.node, rows.t, a, b) + self.tau0[self.group[self.node]]
        for k, name in enumerate(rows.names):
            mine = rows.source == k
            if mine.any():
                sigma = float(np.mean(rows.sigma[mine] * scale[mine]))
                who = tuple(nodes[i] for i in self.node[mine].tolist())
                found.append(Leftover(name, who, dt[mine], left[mine], used[mine], sigma))
        _, off, _ = self._link_rows(a, b)
        for k, link in enumerate(self.links):
            pair = (f"{link.from_clock} to {link.to_clock}",)
            one = np.array([link.at_s])
            found.append(
                Leftover(link.source, pair, one, off[2 * k : 2 * k + 1], np.ones(1, dtype=bool), link.sigma_s)
            )
        return tuple(found)
