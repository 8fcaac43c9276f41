"""Errors in hidden gaps: gap by gap, by method and length, their spread, and beside the real gaps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from calib.sigma_factor import LengthFactor, length_factors

from ..array_types import FloatArray
from ..measurements.visibility import accepted_samples, find_gaps, visible_frames
from ..recording import Recording
from ..units import GRAVITY
from .hidden_gaps import GapErrors, HiddenGap
from .metrics import Figures


@dataclass(frozen=True)
class GapRow:
    """One hidden gap and what a method made of it."""

    length_s: float  # Length asked for
    method: str  # Name of the method
    run: int  # Which copy of the recording the gap was hidden in
    gap: HiddenGap  # Where it was hidden, on the camera's clock
    errors: GapErrors  # Sample by sample inside the gap
    failure: str = ""  # Why there is no answer, "" where there is one
    recording: str = ""  # Name of the recording

    @property
    def reference(self) -> str:
        """What the answer was compared with: "truth", "wrist", "strap" .."""
        return self.errors.reference

    @cached_property
    def figures(self) -> Figures:
        """Errors inside the gap."""
        return self.errors.figures()

    def to_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {
            **{name: getattr(self, name) for name in ("length_s", "method", "run", "reference")},
            "start_s": self.gap.start_s,
            "end_s": self.gap.end_s,
            "rms_m": self.figures.position_rms_m,
            "max_m": self.figures.position_max_m,
            **{name: getattr(self.figures, name) for name in ("orientation_rms_deg", "nees", "samples")},
            "sigma_max_m": self.errors.sigma_max_m,
            "path_m": self.errors.path_m,
            "failure": self.failure,
            "recording": self.recording,
        }


@dataclass(frozen=True)
class GapFigures:
    """A method's errors in all gaps of one length."""

    figures: Figures
    gaps: int
    failed: int

    def to_dict(self) -> dict[str, float | int | None]:
        """Plain values by name, distances in m and in cm."""
        figures = asdict(self.figures)
        result: dict[str, float | int | None] = {}
        for name in ("rms", "median", "p95", "max"):
            value = figures[f"position_{name}_m"]
            result |= {f"{name}_m": value, f"{name}_cm": None if value is None else 100.0 * value}
        names = ("orientation_rms_deg", "orientation_max_deg", "nees", "coverage_95", "samples", "unanswered")
        return result | {name: figures[name] for name in names} | {"gaps": self.gaps, "failed": self.failed}


@dataclass(frozen=True)
class GapTable:
    """Error against gap length."""

    rows: tuple[GapRow, ...]  # Each gap by itself
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each

    @cached_property
    def lengths(self) -> dict[float, dict[str, GapFigures]]:
        """By gap length (s), by method, its figures over all gaps of that length."""
        return {
            length: {name: _figures(rows) for name, rows in by_method.items()}
            for length, by_method in _grouped(self.rows).items()
        }

    def sigma_factors(self, method: str = "graph") -> tuple[LengthFactor, ...]:
        """By what a method's sigma has to be multiplied to hold; empty without its answers."""
        own = [row for row in self.rows if row.method == method]
        return length_factors([(row.length_s, row.errors.needed_factors) for row in own])

    def to_dict(self) -> dict[str, object]:
        """Plain values, as `--json` writes them."""
        return {
            "lengths": [
                {"length_s": length, "methods": {name: f.to_dict() for name, f in methods.items()}}
                for length, methods in self.lengths.items()
            ],
            "rows": [row.to_dict() for row in self.rows],
            "notes": list(self.notes),
            "sigma_factors": [row.to_dict() for row in self.sigma_factors()],
        }


def _grouped(rows: Iterable[GapRow]) -> dict[float, dict[str, list[GapRow]]]:
    """Rows by length (s) and method, in order of appearance."""
    by_length: dict[float, dict[str, list[GapRow]]] = {}
    for row in rows:
        by_length.setdefault(float(row.length_s), {}).setdefault(row.method, []).append(row)
    return by_length


def _figures(rows: Sequence[GapRow]) -> GapFigures:
    together = GapErrors.pooled([row.errors for row in rows])
    return GapFigures(together.figures(), len(rows), sum(bool(row.failure) for row in rows))


def pooled(tables: Sequence[GapTable]) -> GapTable:
    """The gaps of several recordings as one table."""
    notes = dict.fromkeys(note for table in tables for note in table.notes)
    return GapTable(tuple(row for table in tables for row in table.rows), tuple(notes))


@dataclass(frozen=True)
class GapSpread:
    """Errors gap by gap: quartiles (25, 50, 75 %) over gaps of the rms inside each; None without any."""

    low_m: float | None
    median_m: float | None
    high_m: float | None
    rms_m: float | None  # Root mean square over gaps, each weighing the same
    worst_m: float | None  # The worst gap's rms
    gaps: int  # Gaps that were tried
    failed: int  # Those of them without an answer; they are in no other figure

    def to_dict(self) -> dict[str, float | int | None]:
        """Plain values by name."""
        return asdict(self)


def spread_of(rms_m: Sequence[float | None]) -> GapSpread:
    """The spread of the rms of some gaps, m; None is a gap without an answer."""
    known = np.array([value for value in rms_m if value is not None and np.isfinite(value)])
    failed = len(rms_m) - len(known)
    if not len(known):
        return GapSpread(None, None, None, None, None, len(rms_m), failed)
    low, median, high = (float(value) for value in np.percentile(known, (25, 50, 75)))
    return GapSpread(
        low, median, high, float(np.sqrt(np.mean(known**2))), float(known.max()), len(rms_m), failed
    )


def spread_by_length(rows: Iterable[GapRow]) -> dict[float, dict[str, GapSpread]]:
    """By gap length (s) and method the spread over its gaps; lengths rise, methods in order of appearance."""
    by_length = _grouped(rows)
    return {
        length: {
            name: spread_of([None if row.failure else row.figures.position_rms_m for row in own])
            for name, own in by_length[length].items()
        }
        for length in sorted(by_length)
    }


#: Real gaps shorter than this are flicker, s.
SHORTEST_S = 0.2
#: Errors against movement are only fitted to this many hidden gaps, and believed from this many sigmas on.
FEWEST_GAPS, FIRM_SIGMAS = 20, 2.0
#: How errors may grow with movement: as its power.
STEEPEST = 1.5
#: A difference below this deserves no warning.
ALIKE = 1.15


# The camera loses an arm when it moves fast, turns away or passes behind something; gaps can only be hidden
# where it saw the arm. The IMU feels both kinds: how fast the forearm turned and was accelerated in real
# gaps against hidden ones shows how optimistic the test is, and how the errors of the hidden gaps grow with
# movement shows what that costs.
@dataclass(frozen=True)
class RealGaps:
    """Movement in the real gaps of some recordings against their hidden ones."""

    count: int  # Real gaps
    # Rms turn rate, and rms of specific force less gravity's size, in real gaps over those in hidden ones
    turning_ratio: float | None = None
    acceleration_ratio: float | None = None
    error_ratio: float | None = None  # How much larger errors are to be expected in real gaps

    def to_dict(self) -> dict[str, float | int | None]:
        """Plain values by name."""
        return asdict(self)

    @property
    def sentence(self) -> str:
        """Notes for the reader."""
        start = "gaps were hidden where the camera saw the arm, which is easier than where it lost it"
        if self.turning_ratio is None or self.acceleration_ratio is None:
            return f"{start}: real gaps may be worse, and this recording has no real gap to show by how much"
        where = "the real gap" if self.count == 1 else f"its {self.count} real gaps"
        movement = (
            f"in {where} the forearm turned {self.turning_ratio:.1f} times as fast and was"
            f" accelerated {self.acceleration_ratio:.1f} times as strongly"
        )
        if self.error_ratio is not None:
            return f"{start}: {movement}, so expect errors {self.error_ratio:.1f} times those of the table"
        if max(self.turning_ratio, self.acceleration_ratio) < ALIKE:
            return f"{start}; here the IMU feels no difference: {movement}"
        return f"{start}: {movement}, so expect larger errors there"


def compare_real_gaps(recordings: Sequence[Recording], table: GapTable, method: str = "graph") -> RealGaps:
    """Movement in real gaps against hidden ones, over some recordings."""
    by_name = {recording.name: recording for recording in recordings}
    real = []
    for recording in recordings:
        arm, imu = recording.arm, recording.imu
        if not len(arm) or not len(imu):
            continue
        ends = float(max(arm.t_s[0], imu.t_s[0])), float(min(arm.t_s[-1], imu.t_s[-1]))
        for gap in find_gaps(arm.t_s, visible_frames(arm, accepted_samples(arm)), *ends):
            movement = _movement(recording, gap.start_s, gap.end_s)
            if not (gap.open_start or gap.open_end or gap.length_s < SHORTEST_S or movement is None):
                real.append(movement)
    rows = [row for row in table.rows if not row.failure]
    hidden = [
        (row, movement)
        for row in [row for row in rows if row.method == method] or rows
        if (movement := _movement(by_name[row.recording], row.gap.start_s, row.gap.end_s)) is not None
    ]
    if not real or not hidden:
        return RealGaps(len(real))
    moved = np.array([movement for _, movement in hidden])
    of_real, of_hidden = (np.sqrt(np.mean(each**2, axis=0)) for each in (np.array(real), moved))
    turning, acceleration = (float(ratio) for ratio in of_real / np.maximum(of_hidden, 1e-6))
    power = _growth([row for row, _ in hidden], moved[:, 0])
    error = None if power is None else max(turning, 1e-6) ** power
    return RealGaps(len(real), turning, acceleration, error)


def _movement(recording: Recording, start_s: float, end_s: float) -> tuple[float, float] | None:
    """Rms turn rate, rad/s, and rms of specific force less gravity's size, m/s^2; None without samples."""
    first, last = np.searchsorted(recording.imu.t_s, [start_s, end_s])
    if last - first < 3:
        return None
    gyro, acc = recording.imu.gyro[first:last], recording.imu.acc[first:last]
    turning = np.sqrt(np.mean(np.sum(np.square(gyro), axis=1)))
    return float(turning), float(np.sqrt(np.mean((np.linalg.norm(acc, axis=1) - GRAVITY) ** 2)))


def _growth(rows: Sequence[GapRow], turning: FloatArray) -> float | None:
    """With which power errors grow with the turn rate, at equal lengths; None where that is not firm."""
    error = np.array([row.figures.position_rms_m or np.nan for row in rows], dtype=float)
    good = np.isfinite(error) & (error > 0) & (turning > 0)
    if good.sum() < FEWEST_GAPS:
        return None
    length = np.array([row.length_s for row in rows])[good]
    own = np.unique(length, return_inverse=True)[1]
    x, y = (
        each - (np.bincount(own, each) / np.bincount(own))[own]
        for each in (np.log(turning[good]), np.log(error[good]))
    )
    power = float(x @ y / (x @ x)) if x @ x > 0 else 0.0
    left = y - power * x
    variance = left @ left / max(len(left) - own.max() - 2, 1)
    return min(power, STEEPEST) if power > FIRM_SIGMAS * np.sqrt(variance / max(x @ x, 1e-300)) else None


#: Borders of the times, s; a gap's last part may be shorter.
BORDERS_S = (0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 30.0)


class SinceFigures(NamedTuple):
    """A method's errors at some time since the last frame."""

    from_s: float
    to_s: float
    method: str
    figures: Figures

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        distances = {f"{name}_m": getattr(self.figures, f"position_{name}_m") for name in _SINCE}
        about = {"from_s": self.from_s, "to_s": self.to_s, "method": self.method}
        return about | distances | {"nees": self.figures.nees, "samples": self.figures.samples}


_SINCE = ("rms", "median", "p95")


def since_last_frame(table: GapTable, methods: Sequence[str]) -> list[SinceFigures]:
    """Errors in hidden gaps by the time since each began."""
    rows = []
    for from_s, to_s in pairwise(BORDERS_S):
        for method in methods:
            own = [row.errors for row in table.rows if row.method == method and len(row.errors.since_s)]
            together = GapErrors.pooled(own or [GapErrors.empty()])
            inside = (together.since_s >= from_s) & (together.since_s < to_s)
            inside &= np.isfinite(together.distance_m)
            if inside.any():
                rows.append(SinceFigures(from_s, to_s, method, together.figures(inside)))
    return rows
