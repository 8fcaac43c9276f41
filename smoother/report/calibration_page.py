"""`calibration_page`: the page of any calibration, from the form in which all of them answer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calib.protocol import Answer

from .sheet import Page, listing, tabulated

#: Longer lists of numbers are covariances and residuals: `--json` has them.
MOST_NUMBERS = 9


def calibration_page(title: str, answer: Answer, notes: Iterable[str] = ()) -> Page:
    """The page of an answer; `notes` are of its input."""
    subtitle = f"Grade: {answer.verdict.grade}. Values are in SI units; sigma is one standard deviation."
    return Page(title, subtitle, [answer.verdict.sentence], _sections(answer, notes))


def _sections(answer: Answer, notes: Iterable[str]) -> Iterator[str]:
    again = "Nothing is missing: record the next session in the same way."
    yield listing("What to record next", answer.verdict.next, again)
    rows = [(_words(name), *_value(name, value, answer.sigma)) for name, value in answer.estimate.items()]
    yield tabulated(
        "The answer",
        "Rotations (R_K_E: axes of E as seen in K) are qw, qx, qy, qz; their sigmas are in degrees about each"
        " axis.",
        ("", "value", "sigma"),
        rows,
    )
    if answer.verdict.findings:
        yield listing("What else was found", answer.verdict.findings)
    yield listing("What stayed open", answer.open_questions, "Nothing stayed open.")
    yield from _tables(answer.figures)
    yield listing("Notes", dict.fromkeys(notes), "There is nothing to note.")


def _value(name: str, value: Any, sigma: Mapping[str, Any]) -> tuple[str, str]:
    """A value and its sigma as text."""
    is_rotation = name.startswith("R_") or "_R_" in name
    if is_rotation:
        value = np.roll(Rotation.from_matrix(value).as_quat(canonical=True), 1)
    own = sigma.get(name)
    return _numbers(value), "–" if own is None else _numbers(np.degrees(own) if is_rotation else own)


def _tables(figures: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """The figures as tables: one of single values, then one of every list of rows."""
    single, below = [], []
    for name, value in figures.items():
        if name in ("words", "findings"):
            continue  # they are on the page already
        if isinstance(value, Mapping):
            below += list(_tables(value, f"{path}{name}: "))
        elif isinstance(value, list | tuple) and value and all(isinstance(each, Mapping) for each in value):
            columns = tuple(value[0])
            rows = [tuple(_numbers(each.get(column)) for column in columns) for each in value]
            below.append(tabulated(_words(path + name).capitalize(), "", [_words(c) for c in columns], rows))
        elif np.size(value) <= MOST_NUMBERS:
            single.append((_words(name), _numbers(value)))
    if single:
        yield tabulated(_words(path.removesuffix(": ")).capitalize() or "Figures", "", ("", "value"), single)
    yield from below


def _words(name: str) -> str:
    """A key as words; the symbols of rotations and their like stay."""
    return name if "_K_" in name or name.startswith(("R_", "t_", "p_")) else name.replace("_", " ")


def _numbers(value: Any) -> str:
    """Numbers with six digits, several of them with commas between; other values as they are."""
    if value is None or np.size(value) == 0:
        return "–"
    parts = np.ravel(np.asarray(value, dtype=object)).tolist()
    return ", ".join(f"{each:.6g}" if isinstance(each, float | np.floating) else str(each) for each in parts)
