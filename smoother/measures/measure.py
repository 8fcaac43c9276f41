"""One measure of a motion: a value, the interval that holds it, and what it rests on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

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
        The interval that holds the true value with 95 %, by the draws; nan without draws.
    sigma : float
        Standard deviation by the draws; nan without them.
    recovered_share : float, 0 to 1
        How much of it rests on samples that the camera did not see.
    scope : {"session", "movement", "repetition"}
        What it is of.
    movement : int, optional
        Index of the movement or repetition; None for the session.
    start_s, end_s : float, s
        From when to when it was measured.
    n_draws : int
        How many draws the interval is of; 0 = there is no interval.
    note : str
        What to know of it; where the value is nan, why.
    untrusted_share : float, 0 to 1
        How much of it rests on samples that are not to be trusted (`Recovery.trusted`).
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
        return {
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "unit": self.unit,
            "recovered_share": self.recovered_share,
            "untrusted_share": self.untrusted_share,
            "sigma": self.sigma,
            "name": self.name,
            "start_s": self.start_s,
            "end_s": self.end_s,
            "draws": self.n_draws,
            "note": self.note,
        }
