"""The form in which every calibration answers, and its figures as tables for terminals and pages."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from smoother.table import Table

from .file import CalibrationFile


class Check(NamedTuple):
    """A statistic of what was found against its bound, and what to record where it is beyond it."""

    name: str  # What was looked at; a whole sentence if it has no number
    value: float | None = None
    bound: float = np.inf
    unit: str = ""
    remedy: str = ""
    at_least: bool = False  # The bound is the smallest value that is good
    is_open: bool = False  # Beyond the bound something is not determined

    @property
    def is_good(self) -> bool:
        """Within its bound; sentences are not."""
        if self.value is None:
            return False
        return self.value >= self.bound if self.at_least else self.value <= self.bound

    @property
    def sentence(self) -> str:
        """In words."""
        if self.value is None:
            return self.name
        wanted = f"{'at least' if self.at_least else 'at most'} {self.bound:.3g} {self.unit}".strip()
        return f"{self.name}: {self.value:.4g} {self.unit}".strip() + f" ({wanted} is good)"


#: Grades of an answer, the best first.
GRADES = ("good", "usable", "not good enough")


def graded(*values: tuple[float, float, float]) -> str:
    """The grade of values, each with the largest that is good and the largest that is usable."""
    return GRADES[max(sum(not value <= bound for bound in bounds) for value, *bounds in values)]


@dataclass(frozen=True)
class Answer:
    """What a calibration found."""

    grade: str  # Of `GRADES`
    sentence: str  # The value's sigma and what it is good for
    checks: Sequence[Check]  # All that was looked at, the most important first
    table: CalibrationFile  # What belongs into the calibration file, for `write_calibration`
    figures: dict[str, Any]  # What `--json` writes; keys end in their unit, sigma stands beside its value

    @property
    def findings(self) -> list[str]:
        """What else is to be known."""
        return [row.sentence for row in self.checks if not row.is_good and not row.is_open]

    @property
    def open_questions(self) -> list[str]:
        """What was not determined."""
        return [row.sentence for row in self.checks if not row.is_good and row.is_open]

    @property
    def next(self) -> list[str]:
        """What to record next."""
        remedies = dict.fromkeys(row.remedy for row in self.checks if not row.is_good and row.remedy)
        return [*remedies] or ["record in the same way: nothing is missing"]

    def to_dict(self) -> dict[str, Any]:
        """All of it as plain values."""
        return self.figures | {
            "grade": self.grade,
            "verdict": self.sentence,
            "findings": [
                row._asdict() | {"good": row.is_good, "sentence": row.sentence} for row in self.checks
            ],
            "not_determined": self.open_questions,
            "next": self.next,
        }

    def tables(self) -> Iterator[Table]:
        """The figures, and the statistics that were checked against their bounds."""
        yield from tables_of(self.figures)
        rows = [
            (row.name, f"{row.value:.4g}", f"{'>=' if row.at_least else '<='} {row.bound:.3g}", row.unit)
            for row in self.checks
            if row.value is not None and np.isfinite(row.bound)
        ]
        yield Table("Checks", ("what", "value", "good", "unit"), rows)


#: Figures that are not shown: words, which stand elsewhere, and curves.
_WORDS = {"grade", "verdict", "not_determined"}
#: Units at the end of a key, and what people read instead.
_UNITS = {"_m": (1e3, "mm"), "_rad": (180.0 / np.pi, "deg"), "_deg_s": (1.0, "deg/s"), "_s": (1.0, "s"),
          "_deg": (1.0, "deg"), "_ppm": (1.0, "ppm"), "_hz": (1.0, "Hz"), "_db": (1.0, "dB")}  # fmt: skip
#: Longer lists of numbers are covariances and residuals, which are for programs.
_MOST = 9


def tables_of(figures: Mapping[str, Any], title: str = "") -> list[Table]:
    """Figures as tables: one of single values, then one of every list of rows.

    A value is written to two digits of its sigma, which stands under the same key with `sigma` in it.
    """
    single: list[tuple[str, str, str]] = []
    tables: list[Table] = []
    for key, unit in _shown(figures):
        value = figures[key]
        name = f"{title}: {_name(key)}" if title else f"{_name(key)[:1].upper()}{_name(key)[1:]}"
        if isinstance(value, Mapping):
            tables += _below(value, key, name)
        elif isinstance(value, list | tuple) and value and all(isinstance(each, Mapping) for each in value):
            tables.append(_rows(name, value))
        elif 0 < np.size(value) <= _MOST:
            single.append((_name(key), _cell(figures, key), unit))
    values = [Table(title or "Values", ("", "value +- one sigma", "unit"), single)] if single else []
    return values + tables


def _below(values: Mapping[str, Any], key: str, name: str) -> list[Table]:
    """A table of its own for what stands under a key: rows where all parts have the same keys."""
    parts = [tuple(each) if isinstance(each, Mapping) else None for each in values.values()]
    if parts and parts[0] is not None and set(parts) == {parts[0]}:
        return [_rows(name, [{"of": _name(part), **each} for part, each in values.items()])]
    numbers = all(isinstance(each, int | float) for each in values.values())
    unit = _unit(key) if numbers else ""  # of joints under `camera_sigma_m`, say
    return tables_of({part + unit: each for part, each in values.items()}, name)


def _rows(name: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    keys = _shown(rows[0])
    columns = [", ".join(filter(None, (_name(key), unit))) for key, unit in keys]
    cells = [[_cell(row, key) if key in row else None for key, _ in keys] for row in rows]
    return Table(name, columns, cells)


def _unit(key: str) -> str:
    return next((unit for unit in _UNITS if key.endswith(unit)), "")


def _name(key: str) -> str:
    """A key in words, without its unit; the symbols of rotations stay."""
    stem = key.removesuffix(_unit(key))
    return stem if re.match(r"[Rtp]_[A-Z]_[A-Z]", stem) else stem.replace("_", " ")


def _sigma_key(values: Mapping[str, Any], key: str) -> str:
    """Under which key the sigma of a value stands, if it is of the same shape; "" without one."""
    if isinstance(values[key], str):
        return ""
    stem, unit = key.removesuffix(_unit(key)), _unit(key)
    names = [f"{stem}_sigma{end}" for end in ([unit] if unit else ["", *_UNITS])]
    names += [f"sigma{unit}"] if stem in ("value", "position", "offset", "end") else []
    return next(
        (name for name in names if name in values and np.shape(values[name]) == np.shape(values[key])), ""
    )


def _shown(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Keys whose values are shown, without the sigmas beside them, and their units in words."""
    beside = {key: _sigma_key(values, key) for key in values if key not in _WORDS}
    units = {key: _unit(key) or _unit(own) for key, own in beside.items() if key not in beside.values()}
    return [(key, _UNITS.get(unit, (1.0, ""))[1]) for key, unit in units.items()]


def _cell(values: Mapping[str, Any], key: str) -> str:
    """A value as people read it, with its sigma."""
    from scipy.spatial.transform import Rotation  # `smooth` does not need it

    value, own = values[key], _sigma_key(values, key)
    if key.startswith("R_") and np.shape(value) == (3, 3):  # qw, qx, qy, qz
        value = Rotation.from_matrix(value).as_quat(canonical=True, scalar_first=True)
    scale = _UNITS.get(_unit(key) or _unit(own), (1.0, ""))[0]
    sigmas = scale * np.ravel(values[own]) if own else ()
    parts = []
    for at, each in enumerate(np.ravel(np.asarray(value, dtype=object)).tolist()):
        if isinstance(each, bool):
            parts.append("yes" if each else "no")
        elif not isinstance(each, int | float):
            parts.append("-" if each is None else str(each))
        elif not np.isfinite(each):
            parts.append("-")
        elif own and np.isfinite(sigmas[at]) and sigmas[at] > 0:
            digits = max(1 - int(np.floor(np.log10(sigmas[at]))), 0)
            parts.append(f"{scale * each:.{digits}f} +- {sigmas[at]:.{digits}f}")
        else:
            parts.append(f"{scale * each:.5g}")
    return ", ".join(parts) or "-"
