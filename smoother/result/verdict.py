"""What is to be trusted of a result and what it was found by; values as files state them, and back."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal, TypeVar, get_type_hints

import numpy as np
from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError

from ..array_types import BoolArray, FloatArray
from ..error_radius import in_cm, within_words
from ..measurements.visibility import Gap

T = TypeVar("T")

#: A number that a file states as null where it is not known.
Known = Annotated[float, BeforeValidator(lambda value: float("nan") if value is None else value)]
Vector = Annotated[tuple[float, ...], Field(min_length=3, max_length=3)]
Matrix = Annotated[tuple[Vector, ...], Field(min_length=3, max_length=3)]


def plain(value: object) -> Any:
    """A dataclass as plain values: lists for tuples, null for a number that is not known."""
    return json.loads(TypeAdapter(type(value)).dump_json(value))


def from_plain(kind: type[T], value: object) -> T | None:
    """A dataclass from plain values; None where one is of another kind."""
    return _checked(TypeAdapter(kind), value)


def field_from_plain(kind: type, name: str, value: object) -> Any:
    """A dataclass's field from a plain value; None where it is of another kind, or there is no such field."""
    adapter = _fields(kind).get(name)
    return None if adapter is None else _checked(adapter, value)


def _checked(adapter: TypeAdapter[Any], value: object) -> Any:
    try:  # strict as JSON: a list may be a tuple, and a whole number a number, and nothing else
        return adapter.validate_json(json.dumps(value), strict=True)
    except (ValidationError, TypeError, ValueError):
        return None


@cache
def _fields(kind: type) -> dict[str, TypeAdapter[Any]]:
    hints = get_type_hints(kind, include_extras=True)
    return {name: TypeAdapter(hint) for name, hint in hints.items()}


@dataclass(frozen=True)
class UntrustedInterval:
    """Times whose answer is not to be trusted."""

    start_s: float  # s: On the IMU's clock
    end_s: float
    reasons: tuple[str, ...]  # Why, one sentence each without a full stop

    def overlaps(self, start_s: float, end_s: float) -> bool:
        """Whether it reaches into the times between two."""
        return self.start_s < end_s and self.end_s > start_s


#: All times of a recording.
EVER = (-float("inf"), float("inf"))


@dataclass(frozen=True)
class Finding:
    """What was found of a recording or its result."""

    code: str  # Its kind, as "camera-moved"
    # A remark, or times whose answer it contradicts, or all of the answer
    severity: Literal["caution", "times", "recording"]
    start_s: float | None  # s: These times, on the IMU's clock; None for a remark and where it is all of it
    end_s: float | None
    sentence: str  # In words, without a full stop
    remedy: str = ""  # Options that undo it; "" where the sentence says what to do


def finding(
    code: str, sentence: str, contradicts_s: tuple[float, float] | None = None, remedy: str = ""
) -> Finding:
    """What was found, and the times, s on the IMU's clock, whose answer it contradicts; None for a remark."""
    if contradicts_s is None:
        return Finding(code, "caution", None, None, sentence, remedy)
    if contradicts_s == EVER:
        return Finding(code, "recording", None, None, sentence, remedy)
    return Finding(code, "times", *contradicts_s, sentence, remedy)


@dataclass(frozen=True)
class GapVerdict:
    """Whether the answer in a gap is to be trusted."""

    start_s: float  # s: The gap, on the IMU's clock
    end_s: float
    reasons: tuple[str, ...] = ()  # Why it is not; empty where it is

    @property
    def trusted(self) -> bool:
        """Nothing speaks against it."""
        return not self.reasons


def gap_verdicts(
    gaps: Sequence[Gap], trusted: bool | None, reasons: Sequence[str], untrusted: Sequence[UntrustedInterval]
) -> tuple[GapVerdict, ...]:
    """A verdict for every gap, by that of the recording (None where not judged) and of parts of it."""
    verdicts = []
    for gap in gaps:
        own = [why for each in untrusted if each.overlaps(gap.start_s, gap.end_s) for why in each.reasons]
        if trusted is False:
            own += reasons or ["the recording is not to be trusted"]
        verdicts.append(GapVerdict(gap.start_s, gap.end_s, tuple(dict.fromkeys(own))))
    return tuple(verdicts)


def trusted_at(
    t_s: FloatArray, trusted: bool | None, untrusted: Sequence[UntrustedInterval | GapVerdict]
) -> BoolArray:
    """Which times (N,), increasing, are trusted; all of them where not judged (None)."""
    good = np.full(len(t_s), trusted is not False)
    for each in untrusted:
        good[slice(*np.searchsorted(t_s, [each.start_s, each.end_s], side="left").tolist())] = False
    return good


@dataclass(frozen=True)
class SelfCheck:
    """Visible stretches that were hidden, recovered and compared with what the camera saw."""

    stretches: int  # How many were hidden
    unanswered: int = 0  # Of them, those that could not be recovered at all
    length_s: float = 0.0  # s: Their median length; 0 without any
    # m: 3D error against the camera's hidden wrist (or only joint); nan without any
    rms_m: Known = float("nan")
    # m: What was stated of the same quantity, the camera's own noise included
    stated_sigma_m: Known = float("nan")
    inside_95: Known = float("nan")  # Share of the hidden samples inside the stated 95 % region
    worst_nees: Known = float("nan")  # Largest mean squared error in sigmas / 3 of a stretch; 1 is expected
    # What sigma in gaps was multiplied by; 1 where the stretches do not require more
    sigma_factor: float = 1.0
    note: str = ""  # Why there are none, or fewer than wanted
    failed: int = 0  # Those, and the ones that were recovered elsewhere with a sigma that contradicts them
    # m: 95 % of the hidden samples were recovered to within the first; the second is what was stated of it
    # (`error_radius`), the camera's own noise included. Nan where a file does not state them
    error_95_m: Known = float("nan")
    stated_95_m: Known = float("nan")

    @property
    def sentence(self) -> str:
        """What was tried and found, in one sentence."""
        if not self.stretches:
            return f"Self-check: {self.note}."
        times = "once" if self.stretches == 1 else f"{self.stretches} times"
        hidden = f"Hidden {times} for {self.length_s:.1f} s where the camera saw the arm"
        if self.unanswered == self.stretches:
            return f"{hidden}: it could not be recovered."
        lost = f"; {self.unanswered} could not be recovered" if self.unanswered else ""
        if np.isfinite(self.error_95_m):
            found = f"{within_words(self.error_95_m)} (stated: {in_cm(self.stated_95_m)})"
        else:  # of a file that states the rms only
            found = f"{in_cm(self.rms_m)} rms (stated {in_cm(self.stated_sigma_m)})"
        return f"{hidden}: recovered to {found}{lost}."


@dataclass(frozen=True)
class Pairing:
    """Whether the skeleton and the IMU are of one motion."""

    proved: bool  # The motion itself proves it, or the user stated the clock
    chance: Known = float("nan")  # How often streams that do not belong together agree as well, at most
    evidence: Known = float("nan")  # Evidence from the motion; grows with the length of the recording
    offset_s: Known = float("nan")  # s: t_imu - t_camera to some tens of milliseconds, as the motion has it
    reason: str = ""  # Why the result is not to be trusted; "" where nothing speaks against the pairing
    caution: str = ""  # What is open where nothing speaks against it
