"""Clocks as values: receptions (broadcasts, beeps), links, a solved network, and a prior for a recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from smoother.array_types import BoolArray, FloatArray, IntArray
from smoother.errors import CalibrationError
from smoother.measurements.clock import Clock
from smoother.recording import Recording

from ..file import CalibrationFile

if TYPE_CHECKING:
    from .beeps import Beep

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

    def links(self) -> list[ClockLink]:
        """Every pair of clocks that hang together, in the order of the nodes."""
        n = len(self.nodes)
        return [
            self.between(self.nodes[u], self.nodes[v])
            for u in range(n)
            for v in range(u + 1, n)
            if self.group[u] == self.group[v]
        ]


#: Speed of sound in a room, m/s.
SOUND_M_S = 343.0


class SoundTrack(Protocol):
    """Sound without a pause in it: samples (N,), samples per second, time of the first sample in s."""

    @property
    def samples(self) -> FloatArray:
        """(N,) sound pressure in any unit."""
        ...

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        ...

    @property
    def start_s(self) -> float:
        """Time of the first sample."""
        ...


def beeps_of_tracks(
    tracks: Iterable[SoundTrack], tone_hz: float | None = None, start_s: float = 0.0
) -> list[Beep]:
    """All beeps of a sound, on the clock of its stamps."""
    from .beeps import find_beeps

    beeps: list[Beep] = []
    reason: CalibrationError | None = None
    for track in tracks:
        try:
            found = find_beeps(track.samples, track.rate_hz, tone_hz)
        except CalibrationError as error:
            reason = error
            continue
        shift = track.start_s + start_s
        beeps += [
            replace(beep, start_s=beep.start_s + shift, end_s=beep.end_s + shift, t_s=beep.t_s + shift)
            for beep in found
        ]
    if not beeps and reason is not None:
        raise reason
    return beeps


def beep_receptions(
    beeps: Sequence[Beep],
    event_times_s: Sequence[float],
    clocks: tuple[str, str] = ("camera", "base"),
    *,
    distance_m: float = 0.0,
    resolution_s: float = 0.3125e-3,
    source: str = "sound",
) -> Receptions:
    """The ends of beeps on both clocks (Jatesiktat & Ang, II-G.1)."""
    if len(beeps) != len(event_times_s):
        ends = ", ".join(f"{beep.end_s:.2f} s" for beep in beeps[:12]) + (", .." if len(beeps) > 12 else "")
        raise CalibrationError(
            f"beeps that end in it: {len(beeps)} ({ends}), event times given: {len(event_times_s)}; give one"
            " --event-time for each beep, cut the sound, or name the buzzer's tone with --tone-hz"
        )
    ends_s = np.array([beep.end_s for beep in beeps]) - distance_m / SOUND_M_S
    sigma = np.array([beep.sigma_s for beep in beeps])
    return Receptions(
        event=np.repeat(np.arange(len(beeps)), 2),
        node=list(clocks) * len(beeps),
        t_s=np.column_stack([ends_s, np.sort(event_times_s)]).ravel(),
        sigma_s=np.column_stack([sigma, np.full(len(beeps), resolution_s / np.sqrt(12))]).ravel(),
        source=source,
        estimate_noise=len(beeps) > 2,
    )


def buzzer_node(nodes: Iterable[str], usual: str = "base") -> str:
    """The one node of a broadcast that is called base something, whose buzzer the camera heard."""
    named = [name for name in dict.fromkeys(nodes) if usual in name.lower()]
    return named[0] if len(named) == 1 else usual


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
    links = [link for link in table["links"] if isinstance(link, dict) and _camera_ends(link) == 1]
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


def _camera_ends(link: Mapping[str, Any]) -> int:
    return sum(_is_camera(str(link.get(end, ""))) for end in ("from", "to"))


def _is_camera(name: str) -> bool:
    return any(word in name.lower() for word in CAMERA_WORDS)


def _imu_end(link: Mapping[str, Any]) -> str:
    return str(link["to"] if _is_camera(str(link["from"])) else link["from"])


def _clock(link: Mapping[str, Any], source: str, recording: Recording) -> Clock:
    numbers = {}
    for key, default in (
        ("offset_s", None),
        ("sigma_s", None),
        ("skew_ppm", 0.0),
        ("skew_sigma_ppm", 0.0),
        ("at_s", 0.0),
    ):
        value = link.get(key, default)
        if not isinstance(value, int | float) or not np.isfinite(value):
            raise CalibrationError(f"{source}: {key} of a link of [clock] must be a number")
        numbers[key] = float(value)
    if numbers["sigma_s"] < 0.0:
        raise CalibrationError(f"{source}: sigma_s of a link of [clock] cannot be negative")
    offset_s, skew, at_s = numbers["offset_s"], 1e-6 * numbers["skew_ppm"], numbers["at_s"]
    if not _is_camera(str(link["from"])):  # t_camera = t_imu + offset, turned round
        offset_s, skew, at_s = -offset_s, -skew, at_s + offset_s
    if abs(at_s) > UNIX_S:
        at_s -= 1e-9 * recording.origin_ns
    t = recording.arm.t_s
    farthest_s = max(abs(float(t[0]) - at_s), abs(float(t[-1]) - at_s)) if len(t) else 0.0
    skew_sigma_ppm = numbers["skew_sigma_ppm"]
    if skew_sigma_ppm >= UNKNOWN_PPM:
        skew, skew_sigma_ppm = 0.0, TYPICAL_PPM
    drift_s = 1e-6 * skew_sigma_ppm * farthest_s
    sigma_s = float(np.hypot(max(numbers["sigma_s"], LEAST_SIGMA_S), drift_s))
    return Clock(np.array([at_s]), np.array([offset_s]), sigma_s, skew=skew)
