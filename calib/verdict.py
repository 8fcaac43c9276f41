"""What a calibration says of its own answer."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Verdict:
    """The answer in words.

    Attributes
    ----------
    grade : "good", "usable" or "not good enough".
    sentence : the value's sigma and what it is good for.
    findings : what else is to be known.
    next : what to record next.
    """

    grade: str
    sentence: str
    findings: tuple[str, ...]
    next: tuple[str, ...]
