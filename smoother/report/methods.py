"""The methods section of a paper about a result: sentences, a table, what its authors add, references."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from calib.motion import found_in
from calib.protocol import tables_of

from ..baselines.registry import BASELINES
from ..config import Config
from ..error_radius import within_words
from ..evaluation.summary import gap_summaries
from ..linalg import median_rate_hz
from ..result import Recovery
from ..table import Table, cell_text
from .sheet import web_file, words

#: What sentences cite as "[@key]", and how they name the orientation filters.
REFERENCES: dict[str, str] = words()["sources"]
ORIENTATION_WORDS: dict[str, str] = words()["filters"]
#: Figures of the tables.
_ESTIMATED = ("camera_sigma_m", "lever_arms", "lengths")
CITATION = re.compile(r"\[@([a-z]+\d*)\]")


def methods_section(
    recoveries: Sequence[Recovery], version: str, simulation: str
) -> tuple[str, dict[str, object]]:
    """The Markdown of a result's arms, and its references; `simulation`: a simulated one's title."""
    from jinja2 import Environment

    environment = Environment()  # Markdown, not HTML
    environment.filters |= {"cell": _cell, "flat": lambda text: " ".join(text.split())}
    template = environment.from_string(web_file("methods.md"))
    arms = [_figures(one) for one in recoveries]
    untrusted = sum(arm["untrusted"] for arm in arms)
    text = template.render(arms=arms, version=version, simulation=simulation, untrusted=untrusted)
    cited = dict.fromkeys(CITATION.findall(text))
    references = {
        key: REFERENCES[key].format(version=version or "not stated") for key in cited if key in REFERENCES
    }
    numbers = {key: str(n) for n, key in enumerate(references, start=1)}
    text = CITATION.sub(
        lambda found: f"[{numbers[found[1]]}]" if found[1] in numbers else found[0], text
    ).rstrip()
    listed = "\n".join(f"{numbers[key]}. {source}" for key, source in references.items())
    text = f"{text}\n\n### References\n\n{listed}\n"
    return text, {"references": references, "text": text}


def _figures(one: Recovery) -> dict[str, Any]:
    """What the template is given of an arm."""
    found, gaps, entry = one.estimates, gap_summaries(one), BASELINES.get(one.method)
    lengths_s = [gap.length_s for gap in one.gaps]
    worst_m = max((gap.error_95_m for gap in gaps if gap.error_95_m is not None), default=None)
    filter_ = str(found.further.get("orientation", ""))
    return {
        "one": one,
        "gaps": gaps,
        "is_graph": one.method == "graph",
        "method": entry.words if entry else one.method,
        "filter": ORIENTATION_WORDS.get(filter_, filter_),
        "length_s": float(one.t_s[-1] - one.t_s[0]) if len(one) else 0.0,
        "camera_hz": median_rate_hz(np.asarray(one.arm.t_s)),
        "imu_hz": median_rate_hz(one.t_s),
        "imus": ["forearm", *one.segments, *(["trunk"] if one.trunk else [])],
        "clock_known": math.isfinite(one.clock_offset_s),
        "occluded_s": sum(lengths_s),
        "longest_s": max(lengths_s, default=0.0),
        "worst_m": worst_m,
        "within": "" if worst_m is None else within_words(worst_m),
        "factors": [factor for factor in found.sigma_factors if factor != 1.0],
        "untrusted": sum(gap.trusted is False for gap in gaps),
        "tables": list(_tables(one)),
    }


def _tables(one: Recovery) -> Iterator[Table]:
    """What was estimated with sigma, and the settings that are not the defaults."""
    found, stated = found_in(one), one.estimates
    known = {} if found is None else found.figures
    figures = {key: known[key] for key in _ESTIMATED if key in known}
    if stated.gyroscope_bias is not None:
        figures["gyroscope_bias_deg_s"] = np.degrees(stated.gyroscope_bias)
    if stated.accelerometer_bias is not None:
        figures["accelerometer_bias, m/s^2"] = stated.accelerometer_bias
    yield from tables_of(figures)
    usual = Config().model_dump(mode="json", exclude_none=True)
    changed = [
        (f"{section}.{key}", value, default)
        for section, settings in one.config.items()
        for key, value in (settings.items() if isinstance(settings, dict) else ())
        if value != (default := usual.get(section, {}).get(key, value))
    ]
    if changed:
        yield Table("Settings set, or adapted to the recording", ("setting", "value", "default"), changed)


def _cell(value: object) -> str:
    """A value as text in which Markdown finds no markup."""
    return re.sub(r"([\\|*_`<\[])", r"\\\1", cell_text(value))
