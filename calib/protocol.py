"""The form in which every calibration answers, and its figures as tables for terminals and pages."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from smoother.table import Table

from .file import CalibrationFile


@dataclass(frozen=True)
class Verdict:
    """The answer in words."""

    grade: str  # "good", "usable" or "not good enough"
    sentence: str  # The value's sigma and what it is good for
    findings: tuple[str, ...] = ()  # What else is to be known
    next: tuple[str, ...] = ()  # What to record next

    @property
    def words(self) -> dict[str, Any]:
        """Plain values for `--json`."""
        return {
            "grade": self.grade,
            "verdict": self.sentence,
            "findings": self.findings,
            "next": self.next,
        }


@dataclass(frozen=True)
class Answer:
    """What a calibration found."""

    verdict: Verdict  # What the answer is good for, and what to record next
    open_questions: tuple[str, ...]  # What was not determined, one sentence each
    table: CalibrationFile  # What belongs into the calibration file, for `write_calibration`
    figures: dict[str, Any]  # What `--json` writes; keys end in their unit, sigma stands beside its value


#: Figures that are not shown: words, which stand elsewhere, and curves.
_WORDS = {"words", "verdict", "findings", "next", "remarks", "not_determined", "grade", "allan"}
#: Units at the end of a key, and what people read instead.
_UNITS = {"_m": (1e3, "mm"), "_rad": (180.0 / np.pi, "deg"), "_deg_s": (1.0, "deg/s"), "_s": (1.0, "s"),
          "_deg": (1.0, "deg"), "_ppm": (1.0, "ppm"), "_hz": (1.0, "Hz"), "_db": (1.0, "dB")}  # fmt: skip
#: Longer lists of numbers are covariances and residuals, which are for programs.
_MOST = 9


def findings(figures: Mapping[str, Any], title: str = "") -> list[Table]:
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
    return findings({part + unit: each for part, each in values.items()}, name)


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
