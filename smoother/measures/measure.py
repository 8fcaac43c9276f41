"""Measures of a motion: values with the intervals that contain them, of one recording, and their settings."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from ..array_types import BoolArray, FloatArray
from ..recording import arm_words
from ..runtime.packages import pandas_module

if TYPE_CHECKING:
    import pandas
    import pyarrow


@dataclass(frozen=True)
class Movement:
    """From when to when something is done.

    Attributes
    ----------
    start_s, end_s : float, s
        On the recovery's times.
    kind : {"movement", "repetition"}
        A movement is between two rests of the hand; a repetition is one round of an exercise.
    """

    start_s: float
    end_s: float
    kind: Literal["movement", "repetition"]

    @property
    def length_s(self) -> float:
        """How long it takes, s."""
        return self.end_s - self.start_s

    def as_dict(self) -> dict[str, object]:
        """Plain values by name."""
        return {"start_s": self.start_s, "end_s": self.end_s, "kind": self.kind}


class Figure(NamedTuple):
    """A number, before it has an interval."""

    value: float  # nan where it cannot be measured
    share: float  # Of it that comes from recovered samples


UNKNOWN = Figure(float("nan"), float("nan"))


def share_of(occluded: BoolArray, weight: FloatArray | BoolArray | None = None) -> float:
    """How much of some samples (n,) the camera did not see, each with a weight; nan without any."""
    weights = np.ones(len(occluded)) if weight is None else np.asarray(weight, dtype=float)
    total = float(weights.sum())
    return float((weights * occluded).sum()) / total if total > 0.0 else float("nan")


#: What a measure is of.
Scope = Literal["session", "movement", "repetition"]


@dataclass(frozen=True)
class Measure:
    """One number that describes a motion, with its uncertainty.

    Attributes
    ----------
    key : str
        Name in files, with its unit at the end: "elbow_flexion_range_deg".
    name : str
        In plain words.
    unit : str
        "deg", "m", "s", "%"; "" for a pure number.
    value : float
        Of the recovered motion; nan where it cannot be measured.
    low, high : float
        The 95 % interval of the true value, by the draws; nan without draws.
    sigma : float
        Standard deviation by the draws; nan without them.
    recovered_share : float, 0 to 1
        How much of it comes from samples that the camera did not see.
    scope : {"session", "movement", "repetition"}
        What it is of.
    movement : int, optional
        Index of the movement or repetition; None for the session.
    start_s, end_s : float, s
        From when to when it was measured.
    n_draws : int
        How many draws the interval is of; 0 = there is no interval.
    note : str
        A note on it; where the value is nan, the reason.
    untrusted_share : float, 0 to 1
        How much of it comes from samples that are not to be trusted (`Recovery.trusted`).
    """

    key: str
    name: str
    unit: str
    value: float
    low: float
    high: float
    sigma: float
    recovered_share: float
    scope: Scope
    movement: int | None
    start_s: float
    end_s: float
    n_draws: int
    note: str = ""
    untrusted_share: float = 0.0

    @property
    def is_known(self) -> bool:
        """There is a value."""
        return math.isfinite(self.value)

    @property
    def has_interval(self) -> bool:
        """There is a value with an interval."""
        return self.is_known and math.isfinite(self.low) and math.isfinite(self.high)

    def as_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` states them; numbers that are not finite stay what they are."""
        return {name: getattr(self, name) for name in _IN_FILES} | {"draws": self.n_draws}


_IN_FILES = (
    *("value", "low", "high", "unit", "recovered_share", "untrusted_share", "sigma", "name"),
    *("start_s", "end_s", "note"),
)


@dataclass(frozen=True)
class Measures:
    """What was measured of one arm: over the session, by movement and by repetition.

    Attributes
    ----------
    side : str
        "left", "right" or "".
    body : int, optional
        The camera's number of the person, where several are told apart.
    name : str
        Of the recording.
    start_s, end_s : float, s
        First and last sample.
    rows : tuple of Measure
        The session's first, then those of movements and repetitions in the order of time.
    movements, repetitions : tuple of Movement
        In the order of time; a measure's `movement` counts in them.
    trusted : bool, optional
        Whether the recovery is to be trusted; None where not judged.
    verdict : str
        The recovery's verdict, one sentence.
    n_draws : int
        How many draws the intervals are of; 0 = there are none.
    notes : tuple of str
        What a reader must know, one sentence each.
    """

    side: str
    body: int | None
    name: str
    start_s: float
    end_s: float
    rows: tuple[Measure, ...]
    movements: tuple[Movement, ...] = ()
    repetitions: tuple[Movement, ...] = ()
    trusted: bool | None = None
    verdict: str = ""
    n_draws: int = 0
    notes: tuple[str, ...] = ()

    @property
    def arm_label(self) -> str:
        """Which arm, in words: "right arm of body 2"."""
        return arm_words(self.side, self.body)

    @property
    def session(self) -> tuple[Measure, ...]:
        """Those of the whole session."""
        return tuple(row for row in self.rows if row.scope == "session")

    @property
    def by_key(self) -> dict[str, Measure]:
        """Those of the session by their key."""
        return {row.key: row for row in self.session}

    def of(self, scope: Scope, number: int) -> dict[str, Measure]:
        """Those of one movement or repetition by their key."""
        return {row.key: row for row in self.rows if (row.scope, row.movement) == (scope, number)}

    def to_table(self) -> pyarrow.Table:
        """All measures as an Arrow table, one row per measure; null where the value is missing.

        Returns
        -------
        table : pyarrow.Table
            `side`, `body`, then the columns of `Measure`.
        """
        import pyarrow as pa

        numbers = ("value", "low", "high", "sigma", "recovered_share", "untrusted_share", "start_s", "end_s")
        types = dict.fromkeys(("movement", "n_draws"), pa.int32()) | dict.fromkeys(numbers, pa.float64())
        columns = {
            "side": pa.array([self.side] * len(self.rows), pa.string()),
            "body": pa.array([self.body] * len(self.rows), pa.int32()),
        }
        for name in (each.name for each in fields(Measure)):
            values = [getattr(row, name) for row in self.rows]
            columns[name] = pa.array(values, types.get(name, pa.string()), from_pandas=True)
        return pa.table(columns)

    def to_dataframe(self) -> pandas.DataFrame:
        """The same as a pandas table.

        Raises
        ------
        UnoccludeError
            pandas is not installed.
        """
        pandas_module()
        return self.to_table().to_pandas()

    def as_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` states them.

        Returns
        -------
        figures : dict
            `measures` by key (of the session), `movements` and `repetitions` (each with its own `measures`),
            and notes on them.
        """

        def listed(scope: Scope, places: tuple[Movement, ...]) -> list[dict[str, object]]:
            return [
                place.as_dict()
                | {"measures": {key: row.as_dict() for key, row in self.of(scope, number).items()}}
                for number, place in enumerate(places)
            ]

        about = {
            name: getattr(self, name) for name in ("side", "body", "trusted", "verdict", "start_s", "end_s")
        }
        return about | {
            "recording": self.name,
            "draws": self.n_draws,
            "measures": {key: row.as_dict() for key, row in self.by_key.items()},
            "movements": listed("movement", self.movements),
            "repetitions": listed("repetition", self.repetitions),
            "notes": list(self.notes),
        }


class _Leaves(BaseModel):
    """A group of settings; unknown names are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Smoothing(_Leaves):
    """The low-pass filter that answer, draws and truth all go through before anything is measured."""

    cutoff_hz: float = Field(
        default=6.0, ge=1, le=20, description="second-order Butterworth, run forth and back, Hz"
    )
    most_rate_hz: float = Field(
        default=100.0, ge=40, le=1000, description="faster recordings are measured at this rate, Hz"
    )


class SegmentingMovements(_Leaves):
    """When the hand moves: thresholds of its speed."""

    start_m_s: float = Field(default=0.10, gt=0, description="a movement gets at least this fast, m/s")
    rest_m_s: float = Field(default=0.03, gt=0, description="it starts and ends where it is slower, m/s")
    rest_share: float = Field(default=0.05, gt=0, lt=1, description="or slower than this part of its peak")
    shortest_s: float = Field(default=0.30, gt=0, description="shorter ones do not count, s")
    peak_rise_m_s: float = Field(
        default=0.02, gt=0, description="a velocity peak rises this far above the minimum before it, m/s"
    )
    peak_apart_s: float = Field(default=0.15, gt=0, description="velocity peaks are this far apart, s")


class MatchingRepetitions(_Leaves):
    """Rounds of an exercise: matched to the first one."""

    start_s: float | None = Field(default=None, description="where a round begins, s; looked for if left out")
    end_s: float | None = Field(default=None, description="where it ends, s; looked for if left out")
    shortest_s: float = Field(default=2.0, gt=0.5, description="shorter rounds are not looked for, s")
    longest_s: float = Field(default=60.0, gt=1, description="nor longer ones, s")
    likeness: float = Field(
        default=0.35,
        gt=0,
        le=1,
        description="mean distance from the matched round, in standard deviations of the motion, at most",
    )


class Reach(_Leaves):
    """The reach volume, and the zones about the trunk."""

    voxel_m: float = Field(
        default=0.01, gt=0.002, le=0.2, description="one place of the hand in a cube of this size, m"
    )
    alpha_m: float = Field(
        default=0.30, gt=0.01, description="alpha shape: places this far apart do not belong together, m"
    )
    mouth_m: float = Field(default=0.15, gt=0, description="hand-to-mouth: nearer to the mouth than this, m")
    head_m: float = Field(default=0.10, gt=0, description="hand-to-head: nearer to the head's surface, m")
    behind_m: float = Field(default=0.02, description="hand-behind-back: this far behind the shoulders, m")


class MeasureSettings(_Leaves):
    """Everything that can be set of `unocclude measures`."""

    smoothing: Smoothing = Smoothing()
    movements: SegmentingMovements = SegmentingMovements()
    repetitions: MatchingRepetitions = MatchingRepetitions()
    reach: Reach = Reach()
