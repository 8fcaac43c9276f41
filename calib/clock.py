"""`calibrate clock`: a network of clocks, solved from what they heard together and from links; a recording's.

Receptions (broadcasts, beeps), links, the solved network and what it says in words, and the prior that a
calibration file has for a recording's clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from smoother.array_types import BoolArray, FloatArray, IntArray
from smoother.errors import CalibrationError
from smoother.measurements.clock import Clock
from smoother.recording import Recording

from .file import CalibrationFile, checked
from .protocol import Answer, Check

if TYPE_CHECKING:
    from .motion_clock import MotionClock
    from .sound import Beep

#: Crystals differ by some hundred ppm.
SKEW_SIGMA = 5e-4


@dataclass(frozen=True)
class Receptions:
    """Which node heard what, and when on its own clock."""

    event: IntArray  # int (M,): number of the event; rows of one event were heard at the same instant
    node: Sequence[str]  # (M,) names, one per row
    t_s: FloatArray  # (M,) s: on the node's clock
    sigma_s: FloatArray  # (M,) s: noise of a stamp, one standard deviation
    source: str  # What it is called in messages and reports
    # Whether the noise may turn out larger than stated (several events of one kind)
    estimate_noise: bool = True


@dataclass(frozen=True)
class ClockLink:
    """t_to = t_from + offset_s + 1e-6 skew_ppm (t_from - at_s); belongs to one recording."""

    from_clock: str  # Names of the nodes
    to_clock: str  # Names of the nodes
    offset_s: float  # Offset at `at_s` with its standard deviation
    sigma_s: float  # Offset at `at_s` with its standard deviation
    skew_ppm: float = 0.0  # ppm: how fast it grows; sigma is 500 where nothing was measured
    skew_sigma_ppm: float = 1e6 * SKEW_SIGMA  # ppm: how fast it grows
    at_s: float = 0.0  # Time on `from_clock` for which the offset is stated
    source: str = ""  # What it comes from

    def at(self, t_from_s: FloatArray) -> FloatArray:
        """Times on `to_clock` for times on `from_clock`, s."""
        t = np.asarray(t_from_s, dtype=float)
        return t + self.offset_s + 1e-6 * self.skew_ppm * (t - self.at_s)


@dataclass(frozen=True)
class Leftover:
    """What a source's data leave unexplained."""

    source: str
    node: tuple[str, ...]  # (n,) who heard it, or the link's pair
    t_s: FloatArray  # (n,) s: on the clock of the group's first node
    residual_s: FloatArray  # (n,) s: measured minus explained
    used: BoolArray  # bool (n,): False where it was rejected
    sigma_s: float  # Noise found, one standard deviation of a stamp (of the offset for a link)


@dataclass(frozen=True)
class ClockNetwork:
    """Every clock against every other that it hangs together with."""

    nodes: tuple[str, ...]  # Names; the first of each group is that group's reference
    group: IntArray  # int (n,): number of the group that a node belongs to
    value: FloatArray  # (2 n,): offsets at tau0 (s), then skews (s/s), against the group's reference
    covariance: FloatArray  # (2 n, 2 n): of the same
    tau0_s: FloatArray  # (n,) s: time on the group's reference that the offsets are stated for
    span_s: FloatArray  # (n, 2) s: first and last time on the reference at which the group was measured
    leftovers: tuple[Leftover, ...]  # Residuals, a source each

    def between(self, from_clock: str, to_clock: str) -> ClockLink:
        """The link between two clocks, stated for the time at which its offset is known best."""
        for name in (from_clock, to_clock):
            if name not in self.nodes:
                raise CalibrationError(f"there is no clock {name!r}; there are {', '.join(self.nodes)}")
        u, v, n = self.nodes.index(from_clock), self.nodes.index(to_clock), len(self.nodes)
        if self.group[u] != self.group[v]:
            raise CalibrationError(
                f"nothing links the clocks {from_clock} and {to_clock}; let both receive the same event"
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

    @property
    def groups(self) -> list[list[str]]:
        """The clocks that hang together, in the order of the nodes."""
        named = list(zip(self.nodes, self.group.tolist(), strict=True))
        return [[name for name, own in named if own == g] for g in sorted(set(self.group.tolist()))]

    def links(self) -> list[ClockLink]:
        """Every pair of clocks that hang together, in the order of the nodes."""
        n = len(self.nodes)
        return [
            self.between(self.nodes[u], self.nodes[v])
            for u in range(n)
            for v in range(u + 1, n)
            if self.group[u] == self.group[v]
        ]


#: A pair's line is sought through this many of its events, spread over time.
MOST = 40
#: A skew is sought where they lie this far apart, s; events near a line, s; what skews usually are, at most.
SKEW_SPAN_S, NEAR_S, USUAL_SKEW, PLAUSIBLE_SKEW = 2.0, 0.0005, 3e-4, 2e-3


def consensus(t_from: FloatArray, t_to: FloatArray) -> tuple[float, float, float]:
    """Time, offset there and skew of the line between two events that most others lie near to."""
    chosen = np.unique(np.linspace(0, len(t_from) - 1, MOST).astype(int))
    at, difference = float(np.median(t_from)), (t_to - t_from)[chosen]
    dt, slope = t_from[chosen] - at, np.zeros(1)
    if np.ptp(dt) > SKEW_SPAN_S:
        i, j = np.triu_indices(len(dt), 1)
        far = np.abs(dt[j] - dt[i]) > 0.2 * np.ptp(dt)
        slopes = (difference[j] - difference[i])[far] / (dt[j] - dt[i])[far]
        slope = np.append(slope, slopes[np.abs(slopes) < PLAUSIBLE_SKEW])
    level = difference - slope[:, None] * dt  # (slopes, n): an offset through each event
    apart = level[:, None, :] - level[:, :, None]
    loss = np.log1p((apart / NEAR_S) ** 2).sum(axis=2) + ((slope / USUAL_SKEW) ** 2)[:, None]
    k, event = np.unravel_index(int(np.argmin(loss)), loss.shape)
    near = np.abs(apart[k, event]) < 3 * NEAR_S
    return at, float(level[k][near].mean()), float(slope[k])


def _reversed(at: float, offset: float, skew: float) -> tuple[float, float, float]:
    return at + offset, -offset, -skew / (1 + skew)


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
    system = _System(receptions, links)
    if not len(system.t) and not links:
        raise CalibrationError("no event was received by two clocks, so nothing links them; broadcast again")
    a, b = system.start
    # the start is robust: its residuals say first what to trust
    left, weight = system.apart(a, b, np.ones(len(system.t))), np.zeros(len(system.t))
    scale = system.noise(left, np.ones(len(left)), robust=True)
    again = 1.0 / (1.0 + (left / (system.sigma * scale)) ** 2)
    for _ in range(ROUNDS):  # weights of Cauchy's loss, until they settle
        weight = again
        a, b, left, _ = system.solve(a, b, weight)
        scale = np.minimum(system.noise(left, weight, robust=True), scale)
        again = 1.0 / (1.0 + (left / (system.sigma * scale)) ** 2)
        if np.abs(again - weight).max(initial=0.0) < 1e-6:
            break
    used = system.heard_together(np.abs(left) < OUTLIER * scale * system.sigma)
    used |= system.cut_off(used)
    for _ in range(3):  # the noise sets the weight between sources
        weight = used.astype(float) / scale**2
        a, b, left, covariance = system.solve(a, b, weight)
        scale = system.noise(left, used.astype(float), robust=False)
    left = system.apart(a, b, np.maximum(weight, 1e-6))  # of the rejected rows too
    spans = system.spans(a, b)
    covariance = covariance + system.doubts(left, used, b, np.ptp(spans, axis=1))
    return ClockNetwork(
        nodes=system.nodes,
        group=system.group,
        value=np.concatenate([a, b]),
        covariance=covariance,
        tau0_s=system.tau0[system.group],
        span_s=spans,
        leftovers=system.leftovers(a, b, left, used, scale),
    )


class _System:
    """The least-squares system of a network; offsets and skews of the reference nodes are zero."""

    def __init__(self, receptions: Sequence[Receptions], links: Sequence[ClockLink]) -> None:
        nothing = np.zeros(0, np.int64), np.zeros(0), np.zeros(0), np.zeros(0, np.int64)
        parts: list[tuple[IntArray, FloatArray, FloatArray, IntArray]] = [nothing]
        names: list[str] = []
        first = 0
        for k, each in enumerate(receptions):  # rows of events that at least two nodes heard
            heard, number = np.unique(np.asarray(each.event), return_inverse=True)
            keep = np.bincount(number, minlength=len(heard))[number] > 1
            names += [name for name, kept in zip(each.node, keep, strict=True) if kept]
            t, sigma = np.asarray(each.t_s, dtype=float), np.broadcast_to(each.sigma_s, keep.shape)
            parts.append((number[keep] + first, t[keep], sigma[keep], np.full(int(keep.sum()), k)))
            first += len(heard)
        columns = zip(*parts, strict=True)
        self.event, self.t, self.sigma, self.source = (np.concatenate(column) for column in columns)
        self.receptions, self.links = receptions, links
        ends = [(link.from_clock, link.to_clock) for link in links]
        self.nodes = tuple(dict.fromkeys([*(name for pair in ends for name in pair), *names]))
        number_of = {name: k for k, name in enumerate(self.nodes)}
        self.node = np.array([number_of[name] for name in names], dtype=np.int64)
        self.ends = np.array([[number_of[u], number_of[v]] for u, v in ends], dtype=np.int64).reshape(-1, 2)
        self.count = len(self.nodes)
        self.start = self._start()
        self.free = np.setdiff1d(np.arange(self.count), np.unique(self.group, return_index=True)[1])

    def _start(self) -> tuple[FloatArray, FloatArray]:
        """Offsets and skews (n,) to the first of each group, along the pairs with the most events."""
        from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

        heard = np.full((int(self.event.max(initial=-1)) + 1, self.count), np.nan)
        heard[self.event, self.node] = self.t
        weight = np.zeros((self.count, self.count))
        edges: dict[tuple[int, int], tuple[float, float, float]] = {}  # time on u, offset there, skew
        for (u, v), link in zip(self.ends.tolist(), self.links, strict=True):
            weight[u, v], edges[u, v] = 1, (link.at_s, link.offset_s, 1e-6 * link.skew_ppm)
        for u, v in combinations(range(self.count), 2):
            both = heard[np.isfinite(heard[:, u] + heard[:, v])]
            if len(both):
                weight[u, v], edges[u, v] = 1 / len(both), consensus(both[:, u], both[:, v])
        self.group = connected_components(weight, directed=False)[1].astype(np.int64)
        tree, a, b, tau0 = minimum_spanning_tree(weight), np.zeros(self.count), np.zeros(self.count), []
        for first in np.unique(self.group, return_index=True)[1].tolist():
            own = self.t[self.node == first]
            linked = (at for (u, _), (at, *_) in edges.items() if u == first)
            tau0.append(float(own.mean()) if len(own) else next(linked, 0.0))
            order, before = breadth_first_order(tree, first, directed=False)
            for v, u in zip(order[1:].tolist(), before[order[1:]].tolist(), strict=True):
                at, offset, skew = edges.get((u, v)) or _reversed(*edges[v, u])
                a[v], b[v] = a[u] + offset + skew * (tau0[-1] + a[u] - at), b[u] + skew
        self.tau0 = np.array(tau0)
        return a, b

    def on_reference(self, k: IntArray, t: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
        """Times of nodes (M,) on their own clocks as time since tau0 on the reference."""
        return np.asarray((t - self.tau0[self.group[k]] - a[k]) / (1 + b[k]))

    def solve(
        self, a: FloatArray, b: FloatArray, weight: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """One Gauss-Newton step: offsets, skews, residuals (M,) and covariance (2 n, 2 n)."""
        n = self.count
        dt = self.on_reference(self.node, self.t, a, b)
        information = weight / self.sigma**2
        middle = self._mean(dt, information)
        off = self.apart(a, b, weight)
        design = np.zeros((len(self.t), 2 * n))
        at = np.arange(len(self.t))
        design[at, self.node], design[at, n + self.node] = 1.0, middle
        design -= np.array([self._mean(column, information) for column in design.T]).T.reshape(design.shape)
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
        left = (off - design @ step)[: len(self.t)]
        return a + step[:n], b + step[n:], left, covariance

    def apart(self, a: FloatArray, b: FloatArray, weight: FloatArray) -> FloatArray:
        """(M,) how far each time is from its event's, on the node's own clock, s."""
        dt = self.on_reference(self.node, self.t, a, b)
        information = weight / self.sigma**2
        off = (dt - self._mean(dt, information)) * (1 + b[self.node])
        return off - self._mean(off, information)

    def _mean(self, values: FloatArray, weight: FloatArray) -> FloatArray:
        """Weighted mean of each event, at its rows (M,)."""
        total = np.bincount(self.event, weight) if len(values) else np.empty(0)
        mean = np.bincount(self.event, weight * values) if len(values) else np.empty(0)
        return np.asarray((mean / np.maximum(total, 1e-300))[self.event])

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
        alone = np.bincount(self.event, used) < 2
        return used & ~alone[self.event]

    def cut_off(self, used: BoolArray) -> BoolArray:
        """(M,) all rows of nodes that the rows in use no longer link to their group: their scatter is
        their noise.
        """
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        n, events = self.count, int(self.event.max(initial=-1)) + 1
        heard = np.stack([self.node[used], n + self.event[used]])
        edges = np.concatenate([heard, self.ends.T], axis=1)
        graph = coo_matrix((np.ones(edges.shape[1]), edges), shape=(n + events, n + events))
        part = connected_components(graph, directed=False)[1][:n]
        first = {int(g): part[np.flatnonzero(self.group == g)[0]] for g in np.unique(self.group)}
        lost = np.array([part[k] != first[int(self.group[k])] for k in range(n)])
        return np.isin(self.event, self.event[lost[self.node]])

    def noise(self, left: FloatArray, weight: FloatArray, robust: bool) -> FloatArray:
        """(M,) how much larger than stated the noise of each row's source is (at least as stated)."""
        scale = np.ones(len(left))
        for k, each in enumerate(self.receptions):
            mine = (self.source == k) & (weight > 0)
            if not (each.estimate_noise and mine.any()):
                continue
            events, parameters = len(np.unique(self.event[mine])), 2 * (len(np.unique(self.node[mine])) - 1)
            freedom = max(int(mine.sum()) - events - parameters, 0)
            size = (left[mine] / self.sigma[mine]) ** 2
            if robust:  # the median of a squared normal is 0.455
                total = freedom * float(np.median(size)) / 0.455 * mine.sum() / max(freedom, 1)
            else:
                total = float(size.sum())
            scale[self.source == k] = np.sqrt(max((PRIOR_SAMPLES + total) / (PRIOR_SAMPLES + freedom), 1.0))
        return scale

    def doubts(self, left: FloatArray, used: BoolArray, skew: FloatArray, span_s: FloatArray) -> FloatArray:
        """Covariance to add where the times contradict each other, or agree too well."""
        extra, n = np.zeros(2 * self.count), self.count
        for node in self.free.tolist():  # no more times of it agree than were rejected
            mine = self.node == node
            rejected = np.abs(left[mine & ~used])
            if len(rejected) and int((mine & used).sum()) <= len(rejected):
                extra[node] = float(np.median(rejected)) ** 2
        shared = np.zeros(n)
        for k in range(len(self.receptions)):  # all rounds agree too well: they share one rounding error
            mine = (self.source == k) & used
            events = len(np.unique(self.event[mine]))
            freedom = int(mine.sum()) - events
            if events < 3 or np.sum((left[mine] / self.sigma[mine]) ** 2) > TOO_GOOD**2 * freedom:
                continue
            for node in np.unique(self.node[mine]).tolist():
                shared[node] = max(shared[node], float(np.max(self.sigma[mine]) ** 2))
        # a skew larger than any crystal's: times contradict each other and few rounds hide it
        wrong = np.where(np.abs(skew) > LARGEST_SKEW, skew, 0.0)
        extra[:n] += shared + (wrong * span_s) ** 2
        extra[n:] += wrong**2
        return np.diag(extra)

    def spans(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """(n, 2) first and last measured time of each node's group, on its reference."""
        dt = self.on_reference(self.node, self.t, a, b)
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
        self, a: FloatArray, b: FloatArray, left: FloatArray, used: BoolArray, scale: FloatArray
    ) -> tuple[Leftover, ...]:
        """Residuals of every source and link."""
        found = []
        dt = self.on_reference(self.node, self.t, a, b) + self.tau0[self.group[self.node]]
        for k, each in enumerate(self.receptions):
            mine = self.source == k
            if mine.any():
                sigma = float(np.mean(self.sigma[mine] * scale[mine]))
                who = tuple(self.nodes[i] for i in self.node[mine].tolist())
                found.append(Leftover(each.source, who, dt[mine], left[mine], used[mine], sigma))
        _, off, _ = self._link_rows(a, b)
        for k, link in enumerate(self.links):
            pair = (f"{link.from_clock} to {link.to_clock}",)
            one, residual = np.array([link.at_s]), off[2 * k : 2 * k + 1]
            found.append(Leftover(link.source, pair, one, residual, np.ones(1, dtype=bool), link.sigma_s))
        return tuple(found)


#: A link no better than this is said to be weak, s: at 1 m/s it is 5 mm.
WEAK_S = 0.005
#: A link whose sources disagree by this many sigmas.
DISAGREE = 4.0
#: One late reception among fewer rounds than this cannot be detected.
FEW_ROUNDS = 4
SKEW_KNOWN_PPM = 20.0
#: What to do next time.
ONE_NAME = "name a clock that two sources share alike in both, see --sound-clocks and --motion-clocks"
ROUNDS_AGAIN = "broadcast twenty rounds; every pair of nodes needs several that both received"
TWICE = "measure once at the start and once at the end of the session: the two give the skew"
NEARER = "hold the buzzer right in front of the microphone, so that it is louder than its echo"
BRISKLY = "move the forearm briskly in view for 20 s; only fast motion determines the clock"


@dataclass(frozen=True)
class ClockCalibration:
    """The clocks of one session, and what they were solved from."""

    session: str
    network: ClockNetwork  # Every clock against every other
    receptions: tuple[Receptions, ...] = ()  # What several clocks heard
    beeps: tuple[Beep, ...] = ()  # Of the camera's sound
    motion: MotionClock | None = None  # The clock in a recording's motion


def calibrate_clocks(
    session: str,
    receptions: Sequence[Receptions] = (),
    beeps: Sequence[Beep] = (),
    motion: MotionClock | None = None,
    origin_ns: int = 0,
) -> ClockCalibration:
    """Offsets and skews of all clocks of a session, from sound, broadcasts and motion together."""
    links = [] if motion is None else [replace(motion.link, at_s=motion.link.at_s + 1e-9 * origin_ns)]
    network = solve_clocks(receptions, links)
    return ClockCalibration(session, network, tuple(receptions), tuple(beeps), motion)


def clock_answer(calibration: ClockCalibration) -> Answer:
    """How good the clocks are now, what the data left open, and what to record next."""
    network, links = calibration.network, calibration.network.links()
    worst = max(links, key=lambda link: link.sigma_s)
    sentence = (
        f"{len(network.nodes)} clocks are linked by {len(links)} pairs; the worst pair"
        f" ({worst.from_clock}, {worst.to_clock}) is known to {1e3 * worst.sigma_s:.2f} ms; an offset is"
        " valid for its recording only: measure it again in every session"
    )
    apart = disagreements(network)
    grade = "good" if all(link.sigma_s <= WEAK_S for link in links) else "usable"
    numbers = ("offset_s", "sigma_s", "skew_ppm", "skew_sigma_ppm", "at_s")
    rows = [
        {"from": link.from_clock, "to": link.to_clock}
        | {name: float(getattr(link, name)) for name in numbers}
        for link in links
    ]
    shown = ("end_s", "sigma_s", "frequency_hz", "above_quiet_db")
    figures: dict[str, Any] = {
        "session": calibration.session,
        "links": rows,
        "sources": [
            {
                "source": left.source,
                "sigma_s": left.sigma_s,
                "used": int(left.used.sum()),
                "set_aside": int((~left.used).sum()),
                "largest_residual_s": float(abs(left.residual_s[left.used]).max(initial=0.0)),
            }
            for left in network.leftovers
        ],
        "beeps": [{key: getattr(beep, key) for key in shown} for beep in calibration.beeps],
    }
    grade = "not good enough" if apart or len(network.groups) > 1 else grade
    checks = [*(Check(text, is_open=True) for text in apart), *_checks(calibration, links)]
    table = {"session": calibration.session, "valid_for": "this session alone", "links": rows}
    return Answer(grade, sentence, checks, CalibrationFile().with_table("clock", table), figures)


def disagreements(network: ClockNetwork) -> list[str]:
    """Links that were measured in two ways which contradict each other."""
    return [
        f"{each.source} ({each.node[0]}) is {1e3 * each.residual_s[0]:+.1f} ms off the other"
        f" measurements, {abs(each.residual_s[0]) / each.sigma_s:.0f} of its sigmas: one of them is wrong"
        for each in network.leftovers
        if len(each.residual_s) == 1 and abs(each.residual_s[0]) > DISAGREE * each.sigma_s
    ]


def _checks(calibration: ClockCalibration, links: list[ClockLink]) -> Iterator[Check]:
    """What is looked at, against its bounds."""
    network, receptions, motion = calibration.network, calibration.receptions, calibration.motion
    if len(network.groups) > 1:
        apart = "; ".join(map(", ".join, network.groups))
        yield Check(f"nothing links these groups of clocks: {apart}", remedy=ONE_NAME, is_open=True)
    for name in sorted({name for each in receptions for name in each.node} - set(network.nodes)):
        yield Check(f"{name} received nothing that another clock received: it is not linked", is_open=True)
    for left in network.leftovers:
        name = f"{left.source}: rejected times, of {len(left.used)}"
        yield Check(name, int((~left.used).sum()), 0, is_open=True)
    has_clear_beep = any(beep.sigma_s < WEAK_S for beep in calibration.beeps)
    for link in links:
        pair, common = f"{link.from_clock} and {link.to_clock}", _common(receptions, link)
        yield Check(f"{pair}: sigma", 1e3 * link.sigma_s, 1e3 * WEAK_S, "ms", is_open=True)
        if common and not has_clear_beep:
            yield Check(f"{pair}: rounds together", common, FEW_ROUNDS, "", ROUNDS_AGAIN, True, True)
    skew = max(link.skew_sigma_ppm for link in links)
    yield Check("sigma of a skew", skew, SKEW_KNOWN_PPM, "ppm", TWICE, is_open=True)
    for beep in calibration.beeps:
        name = f"sigma of the beep that ends at {beep.end_s:.2f} s, by its echo"
        yield Check(name, 1e3 * beep.sigma_s * beep.loud_room, 0.0, "ms", NEARER, is_open=True)
    if motion is not None:
        yield Check("excerpts of the motion off the line", int((~motion.used).sum()), 0, is_open=True)
        yield Check("sigma by motion", 1e3 * motion.link.sigma_s, 3.0, "ms", BRISKLY)


def _common(receptions: Sequence[Receptions], link: ClockLink) -> int:
    """Rounds that both clocks of a link heard; 0 where a broadcast is not what links them."""
    count = 0
    for each in receptions:
        if not each.estimate_noise:
            continue
        node = np.asarray(each.node)
        first, second = each.event[node == link.from_clock], each.event[node == link.to_clock]
        count += len(np.intersect1d(first, second))
    return count


#: Words by which a clock is the camera's.
CAMERA_WORDS = ("camera", "kinect", "k4a", "azure", "depth", "realsense")
#: Nothing is measured better than a frame is stamped, s.
LEAST_SIGMA_S = 0.0005
#: A time beyond this counts from 1970, not from the recording's start, s.
UNIX_S = 1e8
#: A skew with this sigma was not measured, ppm.
UNKNOWN_PPM = 499.0
#: What crystals differ by in most devices, ppm: widens sigma where it was not measured.
TYPICAL_PPM = 50.0


def measured_clock(file: CalibrationFile, recording: Recording) -> Clock | None:
    """The link of a file's `[clock]` between the recording's camera and its IMU."""
    table = file.tables.get("clock")
    if not isinstance(table, dict) or not isinstance(table.get("links"), list):
        return None
    links = [
        link
        for link in table["links"]
        if isinstance(link, dict) and _is_camera(link.get("from")) != _is_camera(link.get("to"))
    ]
    named = [link for link in links if _imu_end(link).lower() in recording.imu.name.lower()]
    links = named or links
    if not links:
        return None
    if len(links) > 1:
        names = ", ".join(_imu_end(link) for link in links)
        raise CalibrationError(
            f"{file.source}: its [clock] links the camera with {names}, and none has the name of the IMU,"
            f" {recording.imu.name}; give --clock-offset"
        )
    return _clock(links[0], file.source, recording)


def _is_camera(name: object) -> bool:
    return any(word in str(name).lower() for word in CAMERA_WORDS)


def _imu_end(link: Mapping[str, Any]) -> str:
    return str(link["to"] if _is_camera(link["from"]) else link["from"])


class _MeasuredLink(BaseModel):
    """What is read of a link in the file; its names and further keys are for people."""

    model_config = ConfigDict(allow_inf_nan=False, strict=True, defer_build=True)

    offset_s: float
    sigma_s: float = Field(ge=0)
    skew_ppm: float = 0.0
    skew_sigma_ppm: float = 0.0
    at_s: float = 0.0


def _clock(link: Mapping[str, Any], source: str, recording: Recording) -> Clock:
    read = checked(_MeasuredLink, link, f"{source}: a link of [clock]")
    offset_s, skew, at_s = read.offset_s, 1e-6 * read.skew_ppm, read.at_s
    if not _is_camera(link["from"]):  # t_camera = t_imu + offset, turned round
        offset_s, skew, at_s = -offset_s, -skew, at_s + offset_s
    if abs(at_s) > UNIX_S:
        at_s -= 1e-9 * recording.origin_ns
    t = recording.arm.t_s
    farthest_s = max(abs(float(t[0]) - at_s), abs(float(t[-1]) - at_s)) if len(t) else 0.0
    skew_sigma_ppm = read.skew_sigma_ppm
    if skew_sigma_ppm >= UNKNOWN_PPM:
        skew, skew_sigma_ppm = 0.0, TYPICAL_PPM
    drift_s = 1e-6 * skew_sigma_ppm * farthest_s
    sigma_s = float(np.hypot(max(read.sigma_s, LEAST_SIGMA_S), drift_s))
    return Clock(np.array([at_s]), np.array([offset_s]), sigma_s, skew=skew)
