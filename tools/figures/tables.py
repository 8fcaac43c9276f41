"""The curves' figures as tables in Markdown."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any


def tables(found: dict[str, Any]) -> Iterator[str]:
    """A table a data set: rms over all samples in the gaps, and median and quartiles over gaps, cm."""
    for panel in found.values():
        lengths = panel["lengths"]
        names = list(dict.fromkeys(name for entry in lengths for name in entry["methods"]))
        gaps = ", ".join(str(max(each["gaps"] for each in entry["methods"].values())) for entry in lengths)
        yield f"\n**{panel['title']}** (gaps a length: {gaps}); cm, rms / median (25 % .. 75 %)\n"
        yield "| gap | " + " | ".join(f"{entry['length_s']:g} s" for entry in lengths) + " |"
        yield "|---" * (len(lengths) + 1) + "|"
        for name in sorted(names, key=lambda name: _order(lengths, name)):
            yield f"| {name} | " + " | ".join(_cell(entry["methods"].get(name)) for entry in lengths) + " |"


def _order(lengths: list[dict[str, Any]], name: str) -> float:
    """By the sum of the medians, each against the best at its length."""
    total = 0.0
    for entry in lengths:
        known = [each["median_m"] for each in entry["methods"].values() if each["median_m"]]
        mine = entry["methods"].get(name, {}).get("median_m")
        total += mine / min(known) if mine and known else 1e3
    return total


def _cell(each: dict[str, Any] | None) -> str:
    if each is None or each["median_m"] is None:
        return "-"
    digits = 1 if each["median_m"] >= 0.1 else 2 if each["median_m"] >= 0.001 else 3
    rms, median, low, high = (
        f"{100 * each[key]:.{digits}f}" for key in ("samples_rms_m", "median_m", "low_m", "high_m")
    )
    failed = f", {each['failed']} failed" if each["failed"] else ""
    return f"{rms} / {median} ({low} .. {high}){failed}"
