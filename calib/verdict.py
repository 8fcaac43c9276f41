"""What a calibration says of its own answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Verdict:
    """The answer in words.

    Attributes
    ----------
    grade : str
        "good", "usable" or "not good enough".
    sentence : str
        The value's sigma and what it is good for.
    findings : tuple of str
        What else is to be known.
    next : tuple of str
        What to record next.
    """

    grade: str
    sentence: str
    findings: tuple[str, ...] = ()
    next: tuple[str, ...] = ()

    @property
    def words(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {
            "grade": self.grade,
            "verdict": self.sentence,
            "findings": self.findings,
            "next": self.next,
        }
