"""`calibrate clock`: a network of clocks, solved from what they heard together and from links; a recording's.

Receptions (broadcasts, beeps) and links, the solved network and what it says in words, a recording's clock
from its motion alone, and the prior that a calibration file has for a recording's clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import numpy as np
from pydantic import ConfigDict, Field

from smoother.array_types import BoolArray, FloatArray, IntArray
from smoother.calibration import ArmCalibration
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.linalg import scaled_inverse
from smoother.measurements.clock import LARGEST_OFFSET_S, Clock
from smoother.measurements.outliers import reject_by_camera
from smoother.measurements.segment import Segment, split_into_segments
from smoother.recording import Recording
from smoother.runtime.pool import Pool

from .file import CalibrationFile, FileSection, checked
from .protocol import Answer, Check

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
class Beep:
    """One beep."""

    start_s: float  # After the track's first sample
    end_s: float
    sigma_s: float  # Of the end
    frequency_hz: float  # Its tone
    above_quiet_db: float  # Level above the background
    loud_room: bool  # The room's answer is about as loud as the beep, so that its end is hard to tell


@dataclass(frozen=True)
class ClockLink:
    """t_to = t_from + offset_s + 1e-6 skew_ppm (t_from - at_s); belongs to one recording."""

    from_clock: str  # Names of the nodes
    to_clock: str  # Names of the nodes
    offset_s: float  # Offset at `at_s`
    sigma_s: float  # Its standard deviation
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
        pairs = combinations(zip(self.nodes, self.group.tolist(), strict=True), 2)
        return [self.between(u, v) for (u, own), (v, other) in pairs if own == other]


#: A pair's line is sought through this many of its events, spread over time; no skew is larger, s/s.
MOST, PLAUSIBLE_SKEW = 200, 2e-3


def consensus(t_from: FloatArray, t_to: FloatArray) -> tuple[float, float, float]:
    """Time, offset there and skew of the line through most events: repeated medians (Siegel 1982)."""
    from scipy.stats import siegelslopes

    chosen = np.unique(np.linspace(0, len(t_from) - 1, MOST).astype(int))
    at, difference = float(np.median(t_from)), (t_to - t_from)[chosen]
    skew = siegelslopes(difference, t_from[chosen] - at).slope if len(chosen) > 2 else np.inf
    skew = float(skew) if abs(skew) < PLAUSIBLE_SKEW else 0.0
    return at, float(np.median(difference - skew * (t_from[chosen] - at))), skew


#: The stated noise of a source is treated as this many samples when its noise is measured.
PRIOR_SAMPLES = 4.0
#: What is farther off than this many sigmas is rejected.
OUTLIER = 5.0
ROUNDS = 40
#: No crystal is off by more, s/s.
LARGEST_SKEW = 3.0 * SKEW_SIGMA
#: Agreement better than this part of the stamps' own noise means that all rounds share one rounding.
TOO_GOOD = 0.5
#: So few times of a node say little of its noise: a skew makes up for a late one.
FEW_TIMES = 5
#: Weight of a row that was rejected, where none of its event was not.
NO_WEIGHT = 1e-12


def solve_clocks(
    receptions: Sequence[Receptions], links: Sequence[ClockLink] = (), skew_sigma: float = SKEW_SIGMA
) -> ClockNetwork:
    """Offsets and skews of all clocks from what was heard together and from measured links."""
    system = _System(receptions, links, skew_sigma) if receptions or links else None
    if system is None or not len(system.t):
        raise CalibrationError("no event was received by two clocks, so nothing links them; broadcast again")
    # the start is robust: its residuals say first what to trust
    left, weight = system.apart(system.start, np.ones(len(system.t))), np.zeros(len(system.t))
    scale = system.noise(left, np.ones(len(left)), robust=True)
    for _ in range(ROUNDS):  # weights of Cauchy's loss, until they settle
        before = weight
        weight = np.where(system.is_link, 1.0, 1.0 / (1.0 + (left / (system.sigma * scale)) ** 2))
        if np.abs(weight - before).max() < 1e-6:
            break
        x, left, _ = system.solve(weight)
        scale = np.minimum(system.noise(left, weight, robust=True), scale)
    used = system.is_link | (np.abs(left) < OUTLIER * scale * system.sigma)
    used &= np.bincount(system.event, used)[system.event] > 1  # not alone in their event
    used |= system.cut_off(used)
    for _ in range(3):  # the noise sets the weight between sources
        x, left, covariance = system.solve(used / scale**2)
        scale = system.noise(left, used.astype(float), robust=False)
    return system.network(x, left, used, scale, covariance)


class _System:
    """The least-squares system of a network: times on the reference's clock are linear in the unknowns.

    Of row i with node k the time since tau0 is y_i - alpha_k - beta_k y_i, with y_i by the start's offset;
    alpha and beta of the reference nodes are zero. A link is an event of two rows that is never rejected.
    """

    def __init__(
        self, receptions: Sequence[Receptions], links: Sequence[ClockLink], skew_sigma: float
    ) -> None:
        root = np.sqrt(0.5)
        self.sources = [*receptions]
        for link in links:
            ends, t = [link.from_clock, link.to_clock], np.array([link.at_s, link.at_s + link.offset_s])
            noise = np.full(2, root * link.sigma_s)
            self.sources.append(Receptions(np.zeros(2, np.int64), ends, t, noise, link.source, False))
        names: list[str] = []
        parts, first = [], 0
        for k, each in enumerate(self.sources):  # rows of events that at least two nodes heard
            _, number = np.unique(np.asarray(each.event), return_inverse=True)
            keep = np.bincount(number)[number] > 1
            names += [name for name, kept in zip(each.node, keep, strict=True) if kept]
            t, sigma = np.asarray(each.t_s, dtype=float), np.broadcast_to(each.sigma_s, keep.shape)
            parts.append((number[keep] + first, t[keep], sigma[keep], np.full(int(keep.sum()), k)))
            first += len(each.node)
        self.event, self.t, self.sigma, self.source = map(np.concatenate, zip(*parts, strict=True))
        self.is_link = self.source >= len(receptions)
        ends = [name for link in links for name in (link.from_clock, link.to_clock)]
        self.nodes = tuple(dict.fromkeys([*ends, *names]))
        self.node = np.array([self.nodes.index(name) for name in names], dtype=np.int64)
        self.count = n = len(self.nodes)
        if not n:
            return
        a, b = self._start()
        self.y = self.t - self.tau0[self.group[self.node]] - a[self.node]
        self.offset, self.start = a, np.concatenate([np.zeros(n), b])
        self.references = np.unique(self.group, return_index=True)[1]
        free = np.setdiff1d(np.arange(n), self.references)
        self.columns = np.concatenate([free, n + free])
        self.prior, self.pull = np.diag(np.repeat([0.0, skew_sigma**-2], n)), np.zeros(2 * n)
        for link in links:  # its skew
            pick = np.zeros(2 * n)
            pick[[n + self.nodes.index(name) for name in (link.to_clock, link.from_clock)]] = 1.0, -1.0
            weight = (1e-6 * link.skew_sigma_ppm) ** -2
            self.prior += weight * np.outer(pick, pick)
            self.pull += weight * 1e-6 * link.skew_ppm * pick

    def _start(self) -> tuple[FloatArray, FloatArray]:
        """Offsets and skews (n,) to the first of each group, along the pairs with the most events."""
        from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

        heard = np.full((int(self.event.max()) + 1, self.count), np.nan)
        heard[self.event, self.node] = self.t
        weight = np.zeros((self.count, self.count))
        for u, v in combinations(range(self.count), 2):
            both = np.isfinite(heard[:, u] + heard[:, v]).sum()
            weight[u, v] = 1 / both if both else 0.0
        self.group = connected_components(weight, directed=False)[1].astype(np.int64)
        tree, a, b, tau0 = minimum_spanning_tree(weight), np.zeros(self.count), np.zeros(self.count), []
        for first in np.unique(self.group, return_index=True)[1].tolist():
            tau0.append(float(np.mean(self.t[self.node == first])))
            order, before = breadth_first_order(tree, first, directed=False)
            for v, u in zip(order[1:].tolist(), before[order[1:]].tolist(), strict=True):
                both = heard[np.isfinite(heard[:, u] + heard[:, v])]
                at, offset, skew = consensus(both[:, u], both[:, v])
                a[v], b[v] = a[u] + offset + skew * (tau0[-1] + a[u] - at), b[u] + skew
        self.tau0 = np.array(tau0)
        return a, b

    def _centred(self, values: FloatArray, weight: FloatArray) -> FloatArray:
        """Values (M, ...) less the weighted mean of their event."""
        information = np.maximum(weight, NO_WEIGHT) / self.sigma**2
        total = np.bincount(self.event, information)
        if values.ndim > 1:
            return np.stack([self._centred(column, weight) for column in values.T], axis=1)
        mean = np.bincount(self.event, information * values) / np.maximum(total, 1e-300)
        return np.asarray(values - mean[self.event])

    def apart(self, x: FloatArray, weight: FloatArray) -> FloatArray:
        """(M,) how far each time is from its event's, s."""
        return self._centred(self._on_reference(x), weight)

    def _on_reference(self, x: FloatArray) -> FloatArray:
        return np.asarray(self.y - x[self.node] - x[self.count + self.node] * self.y)

    def solve(self, weight: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The unknowns (2 n,), residuals (M,) and covariance (2 n, 2 n) of linear least squares."""
        n, rows = self.count, np.arange(len(self.t))
        design = np.zeros((len(self.t), 2 * n))
        design[rows, self.node], design[rows, n + self.node] = 1.0, self.y
        design = self._centred(design, weight)[:, self.columns]
        information = weight / self.sigma**2
        kept = np.ix_(self.columns, self.columns)
        x, covariance = np.zeros(2 * n), np.zeros((2 * n, 2 * n))
        covariance[kept] = scaled_inverse(design.T @ (information[:, None] * design) + self.prior[kept])
        pull = design.T @ (information * self._centred(self.y, weight)) + self.pull[self.columns]
        x[self.columns] = covariance[kept] @ pull
        return x, self.apart(x, weight), covariance

    def cut_off(self, used: BoolArray) -> BoolArray:
        """(M,) all rows of nodes that the rows in use no longer link to their group: their scatter is
        their noise.
        """
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        n, size = self.count, self.count + int(self.event.max()) + 1
        heard = np.stack([self.node[used], n + self.event[used]])
        graph = coo_matrix((np.ones(heard.shape[1]), heard), shape=(size, size))
        part = connected_components(graph, directed=False)[1][:n]
        lost = part != part[self.references[self.group]]
        return np.isin(self.event, self.event[lost[self.node]])

    def noise(self, left: FloatArray, weight: FloatArray, robust: bool) -> FloatArray:
        """(M,) how much larger than stated the noise of each row's source is (at least as stated)."""
        scale = np.ones(len(left))
        for k, each in enumerate(self.sources):
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

    def network(
        self, x: FloatArray, left: FloatArray, used: BoolArray, scale: FloatArray, covariance: FloatArray
    ) -> ClockNetwork:
        """The answer: offsets and skews of t = tau0 + a + (1 + b) dt, spans and residuals."""
        n, dt = self.count, self._on_reference(x)
        b = x[n:] / (1 - x[n:])
        own = self.group[self.node]
        spans = np.array([[np.min(dt[own == g]), np.max(dt[own == g])] for g in self.group.tolist()])
        leftovers = []
        for k, each in enumerate(self.sources):
            mine = self.source == k
            if not mine.any():
                continue
            who, t, rest = [self.nodes[i] for i in self.node[mine]], (dt + self.tau0[own])[mine], left[mine]
            sigma = float(np.mean(self.sigma[mine] * scale[mine]))
            if self.is_link[mine].all():  # its two ends as one
                who, t, rest, mine = [" to ".join(who)], t[:1], np.diff(rest), np.flatnonzero(mine)[:1]
                sigma *= np.sqrt(2.0)
            leftovers.append(Leftover(each.source, tuple(who), t, rest, used[mine], sigma))
        return ClockNetwork(
            nodes=self.nodes,
            group=self.group,
            value=np.concatenate([self.offset + x[:n] * (1 + b), b]),
            covariance=covariance + np.diag(self._doubts(left, used, scale, b, np.ptp(spans, axis=1))),
            tau0_s=self.tau0[self.group],
            span_s=self.tau0[self.group][:, None] + spans,
            leftovers=tuple(leftovers),
        )

    def _doubts(
        self, left: FloatArray, used: BoolArray, scale: FloatArray, skew: FloatArray, spans_s: FloatArray
    ) -> FloatArray:
        """Variance (2 n,) to add where the times contradict each other, or agree too well."""
        n = self.count
        offset, turn = np.zeros(n), np.zeros(n)
        for node in range(n):
            mine = self.node == node
            span_s = float(np.ptp(self.y[mine]))
            # of a few times none agrees whose noise seems many times what is stated
            agree = used & ((scale < OUTLIER) | (np.sum(mine) > FEW_TIMES) | self.is_link)
            rejected = np.abs(left[mine & ~agree])
            # no more times agree than were rejected; where a skew may hide a late one, one more is needed
            hides = 2.0 * rejected.max(initial=0.0) < LARGEST_SKEW * span_s
            if len(rejected) and np.sum(mine & agree) - hides <= len(rejected):
                size = (2.0 * rejected.max() if hides else float(np.median(rejected))) ** 2
                # what is wrong with the reference's times is wrong with all that hang on it
                others = (self.group == self.group[node]) & (np.arange(n) != node)
                doubted = np.flatnonzero(others) if node in self.references else [node]
                offset[doubted] = np.maximum(offset[doubted], size)
                turn[doubted] = np.maximum(turn[doubted], size / span_s**2 if hides else 0.0)
        shared = np.zeros(n)
        for k in range(len(self.sources)):  # all rounds agree too well: they share one rounding error
            mine = (self.source == k) & used
            events = len(np.unique(self.event[mine]))
            freedom = int(mine.sum()) - events
            if events >= 3 and np.sum((left[mine] / self.sigma[mine]) ** 2) <= TOO_GOOD**2 * freedom:
                nodes = np.unique(self.node[mine])
                shared[nodes] = np.maximum(shared[nodes], float(np.max(self.sigma[mine]) ** 2))
        # a skew larger than any crystal's: times contradict each other and few rounds hide it
        wrong = np.where(np.abs(skew) > LARGEST_SKEW, skew, 0.0)
        return np.concatenate([offset + shared + (wrong * spans_s) ** 2, turn + wrong**2])


#: Beyond this the offset is looked for coarsely first, s: the self-calibration's reach, with room.
COARSE_S = 0.75 * LARGEST_OFFSET_S
#: Length of an excerpt, s, and at most this many of them; each needs this many frames with a visible forearm.
EXCERPT_S, MOST_EXCERPTS, FEWEST_FRAMES = 20.0, 24, 60
#: What no excerpt is better than, s: frames are stamped that well at most.
FLOOR_S = 0.0005
#: With a longer recording the skew is looked for, s; in a shorter one it is held at zero, to this.
MOTION_SPAN_S, NO_SKEW = 60.0, 1e-9


class MotionClock(NamedTuple):
    """The clock of a recording from motion, without equipment."""

    link: ClockLink  # Camera to IMU; t_imu = t_camera + offset
    used: BoolArray  # bool (k,): excerpts that agree


def clock_from_motion(
    recording: Recording,
    known: ArmCalibration | None = None,
    config: Config | None = None,
    names: tuple[str, str] = ("camera", "imu"),
) -> MotionClock:
    """Offset and skew of the IMU's clock against the camera's from what both saw of the motion.

    The smoother's own self-calibration finds each excerpt's offset (the residuals of the camera's joints
    along their velocity); how the IMU sits is found once, from four excerpts. The excerpts are then events
    that both clocks met.
    """
    from smoother.selfcal.pairing import coarse_offset
    from smoother.selfcal.rounds import self_calibrate

    config = config or Config()
    coarse = coarse_offset(recording, COARSE_S)
    if coarse:
        recording = replace(recording, imu=replace(recording.imu, t_s=recording.imu.t_s - coarse))
    segments = [reject_by_camera(segment) for segment in split_into_segments(recording)]
    excerpts = _excerpts(segments)
    if not excerpts:
        raise CalibrationError(
            f"{recording.name}: the forearm was visible for too short a time to find the clock; record"
            " 20 s of motion in view"
        )
    met: list[tuple[float, float, float]] = []  # time on the camera's clock, offset, sigma
    with Pool(config.windows.processes, sum(len(segment.frame_t_camera) for segment in segments)) as pool:
        chosen = [excerpts[k] for k in np.unique(np.linspace(0, len(excerpts) - 1, 4).astype(int))]
        numbered = [replace(segment, recording=k) for k, segment in enumerate(chosen)]
        arm = self_calibrate(numbered, known or ArmCalibration(side=recording.side), config, pool).estimate
        for excerpt in excerpts:
            try:
                clock = self_calibrate([excerpt], arm, config, pool).clocks[0]
            except CalibrationError:
                continue
            middle = 0.5 * (excerpt.start_s + excerpt.end_s)
            at = float(clock.at(np.array([middle - clock.mean_s]))[0])
            met.append((middle - at, coarse + at, float(np.hypot(clock.sigma_s, FLOOR_S))))
    if not met:
        raise CalibrationError(
            f"{recording.name}: the clock could not be found in any excerpt; move more and faster"
        )
    t, offset, sigma = np.array(met).T
    return _line(t, offset, sigma, names, f"motion {recording.name}")


def _line(
    t: FloatArray, offset: FloatArray, sigma: FloatArray, names: tuple[str, str], source: str
) -> MotionClock:
    """The link through the excerpts' offsets (k,) s, events that both clocks met, and which of them agree."""
    has_skew = len(t) >= 3 and np.ptp(t) >= MOTION_SPAN_S
    event, node = np.tile(np.arange(len(t)), 2), [name for name in names for _ in t]
    times, noise = np.concatenate([t, t + offset]), np.tile(np.sqrt(0.5) * sigma, 2)
    heard = Receptions(event, node, times, noise, source)
    network = solve_clocks([heard], skew_sigma=SKEW_SIGMA if has_skew else NO_SKEW)
    link = replace(network.between(*names), source=source)
    link = link if has_skew else replace(link, skew_ppm=0.0, skew_sigma_ppm=1e6 * SKEW_SIGMA)
    return MotionClock(link, np.asarray(network.leftovers[0].used.reshape(2, -1).all(axis=0)))


def _excerpts(segments: list[Segment]) -> list[Segment]:
    """Parts of equal length with a visible forearm, spread over the recording."""

    def visible(part: Segment) -> int:
        inside = (part.frame_t_camera >= part.start_s) & (part.frame_t_camera <= part.end_s)
        return int((part.accepted[inside][:, 1:].sum(axis=1) >= part.needed).sum())

    parts = []
    for segment in segments:
        count = max(round((segment.end_s - segment.start_s) / EXCERPT_S), 1)
        edges = np.linspace(segment.start_s, segment.end_s, count + 1)
        parts += [segment.between(a, b) for a, b in pairwise(edges)]
    enough = [part for part in parts if visible(part) >= FEWEST_FRAMES]
    if len(enough) <= MOST_EXCERPTS:
        return enough
    groups = np.array_split(np.arange(len(enough)), MOST_EXCERPTS)
    return [max((enough[k] for k in group.tolist()), key=visible) for group in groups]


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


def clock_answer(
    session: str,
    receptions: Sequence[Receptions] = (),
    beeps: Sequence[Beep] = (),  # of the camera's sound
    motion: MotionClock | None = None,
    origin_ns: int = 0,  # zero of the motion's times
) -> Answer:
    """All clocks of a session together: how good they are now, and what the data left open."""
    moved = [] if motion is None else [replace(motion.link, at_s=motion.link.at_s + 1e-9 * origin_ns)]
    network = solve_clocks(receptions, moved)
    links = network.links()
    worst = max(links, key=lambda link: link.sigma_s)
    sentence = (
        f"{len(network.nodes)} clocks are linked by {len(links)} pairs; the worst pair"
        f" ({worst.from_clock}, {worst.to_clock}) is known to {1e3 * worst.sigma_s:.2f} ms; an offset is"
        " valid for its recording only: measure it again in every session"
    )
    apart = disagreements(network)
    grade = "good" if all(link.sigma_s <= WEAK_S for link in links) else "usable"
    if apart or len(network.groups) > 1:
        grade = "not good enough"
    numbers = ("offset_s", "sigma_s", "skew_ppm", "skew_sigma_ppm", "at_s")
    rows = [
        {"from": link.from_clock, "to": link.to_clock}
        | {name: float(getattr(link, name)) for name in numbers}
        for link in links
    ]
    shown = ("end_s", "sigma_s", "frequency_hz", "above_quiet_db")
    figures: dict[str, Any] = {
        "session": session,
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
        "beeps": [{key: getattr(beep, key) for key in shown} for beep in beeps],
    }
    checks = [Check(text, is_open=True) for text in apart]
    checks += _checks(receptions, beeps, motion, network, links)
    table = {"session": session, "valid_for": "this session alone", "links": rows}
    return Answer(grade, sentence, checks, CalibrationFile().with_table("clock", table), figures)


def disagreements(network: ClockNetwork) -> list[str]:
    """Links that were measured in two ways which contradict each other."""
    return [
        f"{each.source} ({each.node[0]}) is {1e3 * each.residual_s[0]:+.1f} ms off the other"
        f" measurements, {abs(each.residual_s[0]) / each.sigma_s:.0f} of its sigmas: one of them is wrong"
        for each in network.leftovers
        if len(each.residual_s) == 1 and abs(each.residual_s[0]) > DISAGREE * each.sigma_s
    ]


def _checks(
    receptions: Sequence[Receptions],
    beeps: Sequence[Beep],
    motion: MotionClock | None,
    network: ClockNetwork,
    links: list[ClockLink],
) -> Iterator[Check]:
    """What is looked at, against its bounds."""
    if len(network.groups) > 1:
        apart = "; ".join(map(", ".join, network.groups))
        yield Check(f"nothing links these groups of clocks: {apart}", remedy=ONE_NAME, is_open=True)
    for name in sorted({name for each in receptions for name in each.node} - set(network.nodes)):
        yield Check(f"{name} received nothing that another clock received: it is not linked", is_open=True)
    for left in network.leftovers:
        name = f"{left.source}: rejected times, of {len(left.used)}"
        yield Check(name, int((~left.used).sum()), 0, is_open=True)
    has_clear_beep = any(beep.sigma_s < WEAK_S for beep in beeps)
    for link in links:
        pair = f"{link.from_clock} and {link.to_clock}"
        yield Check(f"{pair}: sigma", 1e3 * link.sigma_s, 1e3 * WEAK_S, "ms", is_open=True)
        common = 0  # rounds that both heard
        for each in receptions:
            mine = [each.event[np.asarray(each.node) == name] for name in (link.from_clock, link.to_clock)]
            common += len(np.intersect1d(*mine)) * each.estimate_noise
        if common and not has_clear_beep:
            yield Check(f"{pair}: rounds together", common, FEW_ROUNDS, "", ROUNDS_AGAIN, True, True)
    skew = max(link.skew_sigma_ppm for link in links)
    yield Check("sigma of a skew", skew, SKEW_KNOWN_PPM, "ppm", TWICE, is_open=True)
    for beep in beeps:
        name = f"sigma of the beep that ends at {beep.end_s:.2f} s, by its echo"
        yield Check(name, 1e3 * beep.sigma_s * beep.loud_room, 0.0, "ms", NEARER, is_open=True)
    if motion is not None:
        yield Check("excerpts of the motion off the line", int((~motion.used).sum()), 0, is_open=True)
        yield Check("sigma by motion", 1e3 * motion.link.sigma_s, 3.0, "ms", BRISKLY)


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


class _MeasuredLink(FileSection):
    """What is read of a link in the file."""

    model_config = ConfigDict(strict=True)

    from_clock: Any = Field(default=None, alias="from")
    to_clock: Any = Field(default=None, alias="to")
    offset_s: float
    sigma_s: float = Field(ge=0)
    skew_ppm: float = 0.0
    skew_sigma_ppm: float = 0.0
    at_s: float = 0.0


def measured_clock(file: CalibrationFile, recording: Recording) -> Clock | None:
    """The link of a file's `[clock]` between the recording's camera and its IMU."""
    table = file.tables.get("clock")
    if not isinstance(table, dict) or not isinstance(table.get("links"), list):
        return None

    def is_camera(name: object) -> bool:
        return any(word in str(name).lower() for word in CAMERA_WORDS)

    def imu_end(link: Mapping[str, Any]) -> str:
        return str(link["to"] if is_camera(link["from"]) else link["from"])

    links = [
        link
        for link in table["links"]
        if isinstance(link, dict) and is_camera(link.get("from")) != is_camera(link.get("to"))
    ]
    links = [link for link in links if imu_end(link).lower() in recording.imu.name.lower()] or links
    if not links:
        return None
    if len(links) > 1:
        names = ", ".join(map(imu_end, links))
        raise CalibrationError(
            f"{file.source}: its [clock] links the camera with {names}, and none has the name of the IMU,"
            f" {recording.imu.name}; give --clock-offset"
        )
    read = checked(_MeasuredLink, links[0], f"{file.source}: a link of [clock]")
    offset_s, skew, at_s = read.offset_s, 1e-6 * read.skew_ppm, read.at_s
    if not is_camera(read.from_clock):  # t_camera = t_imu + offset, turned round
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
