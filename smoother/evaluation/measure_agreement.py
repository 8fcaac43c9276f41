"""How well the measures of results agree with those of their references, pair by pair; files of pairs."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from pydantic import TypeAdapter

from calib.file import toml_document

from ..errors import UnoccludeError
from ..measures.definitions import definitions, is_measure
from ..recording import Truth
from ..result import Recovery
from ..runtime.pool import Progress
from ..table import Table, tabulated
from .statistics import pair_agreement
from .words import interval, is_main, limits_words, quantity, with_interval


@dataclass(frozen=True)
class MeasurePair:
    """A measure of a session, of the answer and of the reference."""

    recording: str  # What it was measured on
    side: str  # The arm
    key: str  # As a `Measure` has them
    name: str
    unit: str
    value: float  # Of the answer
    low: float  # nan without an interval
    high: float
    reference: float  # Value of the reference
    recovered_share: float  # How much of the answer's value comes from recovered samples

    @property
    def difference(self) -> float:
        """Answer minus reference."""
        return self.value - self.reference

    @property
    def inside(self) -> bool | None:
        """Whether the interval contains the reference; None without one."""
        if not math.isfinite(self.low) or not math.isfinite(self.high):
            return None
        return self.low <= self.reference <= self.high

    @property
    def identity(self) -> tuple[object, ...]:
        """The same for a pair that was written and read again."""
        numbers = (f"{self.value:.9g}", f"{self.reference:.9g}")
        return (self.recording, self.side, self.key, *numbers)

    def to_dict(self) -> dict[str, object]:
        """Plain values by name, as `--json` writes them."""
        return asdict(self) | {"difference": self.difference, "inside": self.inside}


def unique_pairs(pairs: Iterable[MeasurePair]) -> list[MeasurePair]:
    """The pairs without those that come again: files that were pooled hold what was pooled before."""
    return list({pair.identity: pair for pair in pairs}.values())


def same_samples(recovery: Recovery, reference: Truth) -> tuple[Recovery, Recovery]:
    """Answer and reference as recoveries, each without what the other does not have."""
    score = reference.score[:, None]
    position = np.where(score, reference.position, np.nan)
    place = position if np.isfinite(position).any() else recovery.position
    joints = {
        name: np.where(score, joint, np.nan)
        for name, joint in reference.joints.items()
        if name in recovery.joints and np.isfinite(joint).any()
    }
    motion = replace(
        recovery,
        method="reference",
        position=place,
        quaternion=np.where(score, reference.quaternion, np.nan),
        velocity=np.gradient(place, recovery.t_s, axis=0) if len(recovery) > 1 else np.zeros_like(place),
        joints=joints,
        joint_covariance={name: np.zeros((len(recovery), 3, 3)) for name in joints},
        segments={},
        draws=None,
    )
    known = {name: np.isfinite(place).all(axis=1, keepdims=True) for name, place in joints.items()}
    answer = replace(
        recovery,
        joints={name: np.where(known[name], recovery.joints[name], np.nan) for name in joints},
        joint_covariance={name: each for name, each in recovery.joint_covariance.items() if name in joints},
    )
    return answer, motion


@dataclass(frozen=True)
class MeasureComparison:
    """The measures of a recording beside those of its reference."""

    pairs: tuple[MeasurePair, ...]  # Those that both have
    pooled: tuple[MeasurePair, ...] = ()  # Of earlier validations
    notes: tuple[str, ...] = ()  # What a reader must know, one sentence each

    @property
    def together(self) -> list[MeasurePair]:
        """All pairs, the pooled ones first."""
        return unique_pairs((*self.pooled, *self.pairs))

    @cached_property
    def agreements(self) -> dict[str, dict[str, Any]]:
        """Figures by measure, over these pairs and the pooled ones."""
        groups: dict[str, list[MeasurePair]] = {}
        for pair in self.together:
            groups.setdefault(pair.key, []).append(pair)
        return {key: _agreement(pairs) for key, pairs in groups.items()}

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name, as `--json` writes them; another `validate` may pool them."""
        pairs = [pair.to_dict() for pair in self.together]
        return {"agreement": {"session": self.agreements}, "pairs": pairs, "notes": list(self.notes)}


def _agreement(pairs: Sequence[MeasurePair]) -> dict[str, Any]:
    """How well a measure agrees over many pairs, and of how many recordings they are."""
    inside = [pair.inside for pair in pairs if pair.inside is not None]
    values = np.array([(pair.value, pair.reference) for pair in pairs])
    return {
        "name": pairs[0].name,
        "unit": pairs[0].unit,
        "recordings": len({(pair.recording, pair.side) for pair in pairs}),
        "inside": sum(inside),  # intervals that contain the reference
        "intervals": len(inside),
        **pair_agreement(*values.T),
    }


def compare_measures(
    recovery: Recovery,
    reference: Truth,
    pooled: Sequence[MeasurePair] = (),
    processes: int = 1,
    progress: Progress | None = None,
) -> MeasureComparison | None:
    """Measure the answer and the reference by the same functions over the same samples."""
    from ..measures import measure

    answer, motion = same_samples(recovery, reference)
    if not any(np.isfinite(place).all(axis=1).sum() > 1 for place in motion.joints.values()):
        return None
    mine, theirs = measure(answer, processes=processes, progress=progress), measure(motion)
    others = theirs.by_key
    pairs = tuple(
        MeasurePair(
            *(recovery.name, mine.side, key, row.name, row.unit),
            *(row.value, row.low, row.high, others[key].value, row.recovered_share),
        )
        for key, row in mine.by_key.items()
        if key in others and row.is_known and others[key].is_known
    )
    without = "The result has no draws: the measures have no intervals (smooth with --draws 64)."
    return MeasureComparison(pairs, tuple(pooled), () if mine.n_draws else (without,))


def pair_table(title: str, comparison: MeasureComparison, keys: Collection[str] | None = None) -> Table:
    """The session's main measures, or those with these keys."""
    return tabulated(
        title,
        [pair for pair in comparison.pairs if _is_shown(pair.key, keys)],
        {
            "measure": "name",
            "answer": lambda pair: quantity(pair.value, pair.unit),
            "95 % interval": lambda pair: interval(pair.low, pair.high, pair.unit) or "-",
            "truth": lambda pair: quantity(pair.reference, pair.unit),
            "difference": lambda pair: quantity(pair.difference, pair.unit, signed=True),
            "inside": lambda pair: {None: "-", True: "yes", False: "no"}[pair.inside],
            "recovered": "recovered_share",
        },
    )


def agreement_table(title: str, comparison: MeasureComparison, keys: Collection[str] | None = None) -> Table:
    """The agreement of the main measures with three pairs or more."""
    return tabulated(
        title,
        [
            one
            for key, one in comparison.agreements.items()
            if _is_shown(key, keys) and one["limits_low"] is not None
        ],
        {
            "measure": "name",
            "recordings": "recordings",
            "bias": lambda one: quantity(one["bias"], one["unit"], signed=True),
            "limits of agreement": limits_words,
            "ICC(2,1), 95 % interval": with_interval,
            "MDC95": lambda one: quantity(one["mdc95"], one["unit"]),
            "inside": lambda one: f"{one['inside']} of {one['intervals']}" if one["intervals"] else "-",
        },
    )


def _is_shown(key: str, keys: Collection[str] | None) -> bool:
    return is_main(key) if keys is None else key in keys


def read_pairs(path: Path) -> list[MeasurePair]:
    """The pairs of an earlier validation's `--json`."""
    pairs = [pair for arm in _arms(path, _json(path)) for pair in arm["measures"].get("pairs", [])]
    try:
        finite = [
            {key: math.nan if value is None else value for key, value in pair.items()}
            for pair in pairs
            if pair.get("scope", "session") == "session"  # earlier versions also wrote those of movements
        ]
        read = TypeAdapter(list[MeasurePair]).validate_python(finite)
    except (AttributeError, ValueError) as error:
        raise UnoccludeError(
            f"{path}: its measures cannot be read; run `unocclude validate` again"
        ) from error
    if not read:
        raise UnoccludeError(f"{path} has no measures; name what `unocclude validate --json` wrote")
    return read


_NO_SDC = "smallest detectable change; `progress --reliability` needs three persons with two sessions each"
_NO_MDC = (
    "minimal detectable change of a session; it takes three recordings with motion capture, each validated"
    " with --pool and the JSON of those before"
)


def read_detectable(path: Path) -> dict[str, float]:
    """Minimal detectable changes by the measures' keys: of a user, of repeated sessions or of pairs."""
    if path.suffix.lower() == ".toml":
        return read_mdc_toml(path)
    figures, found = _json(path), dict[str, float]()
    if (repeated := figures.get("reliability")) is not None:
        for each in repeated if isinstance(repeated, list) else []:
            key, value = (each.get("key"), each.get("sdc")) if isinstance(each, dict) else (None, None)
            if isinstance(key, str) and _is_change(value):
                _check_keys([key], path)
                found[key] = max(float(value), found.get(key, 0.0))  # the largest of several arms
    else:
        pairs: dict[str, int] = {}
        for arm in _arms(path, figures):
            for key, own in arm["measures"].get("agreement", {}).get("session", {}).items():
                value, count = own.get("mdc95"), own.get("pairs", 0)
                if _is_change(value) and count > pairs.get(key, 0):
                    found[key], pairs[key] = float(value), count
    if not found:
        raise UnoccludeError(f"{path} has no {_NO_MDC if repeated is None else _NO_SDC}")
    return found


def read_mdc_toml(path: Path) -> dict[str, float]:
    """Minimal detectable changes that a user states."""
    table = toml_document(path, str(path)).get("mdc95")
    if not isinstance(table, dict) or not table:
        raise UnoccludeError(
            f"{path} has no table [mdc95]; write one with a line per measure: elbow_flexion_range_deg = 5.0"
        )
    _check_keys(table, path)
    for key, value in table.items():
        if not _is_change(value):
            raise UnoccludeError(f"{path}: mdc95 of {key} is {value!r}; it must be a number above 0")
    return {key: float(value) for key, value in table.items()}


def _is_change(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf


def _check_keys(keys: Iterable[str], path: Path) -> None:
    """Refuse a key that no measure has, with the nearest that one has."""
    for key in keys:
        if not is_measure(key):
            near = get_close_matches(key, definitions(), n=1, cutoff=0.0)
            raise UnoccludeError(
                f"{path}: there is no measure {key}, so its mdc95 has no effect; the nearest is {near[0]}"
            )


def _json(path: Path) -> dict[str, Any]:
    try:
        figures = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UnoccludeError(f"{path}: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise UnoccludeError(f"{path} is not JSON; name what `unocclude validate --json` wrote") from error
    return figures if isinstance(figures, dict) else {}


def _arms(path: Path, figures: dict[str, Any]) -> list[dict[str, Any]]:
    """What `validate --json` wrote, one entry per arm."""
    arms = figures.get("arms", [figures]) if figures else []
    if not arms or not all(isinstance(arm, dict) and isinstance(arm.get("measures"), dict) for arm in arms):
        raise UnoccludeError(f"{path} has no measures; name what `unocclude validate --json` wrote")
    return arms
