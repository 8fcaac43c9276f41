"""A movement of the hand, or a repetition of an exercise: from when to when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Movement:
    """From when to when something is done.

    Attributes
    ----------
    start_s, end_s : float, s
        On the recovery's times.
    kind : {"movement", "repetition"}
        A movement lies between two rests of the hand; a repetition is one round of an exercise.
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
