"""The methods section of a paper about a result: sentences, a table, what its authors add, references."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from ..baselines.registry import BASELINES
from ..config import Config
from ..error_radius import in_cm, within_words
from ..evaluation.summary import gap_summaries
from ..linalg import median_rate_hz
from ..recording import JOINTS
from ..result import Recovery
from .sheet import web_file, words

#: What sentences cite as "[@key]", and how they name the orientation filters.
REFERENCES: dict[str, str] = words()["sources"]
ORIENTATION_WORDS: dict[str, str] = words()["filters"]
CITATION = re.compile(r"\[@([a-z]+\d*)\]")


def methods_section(
    recoveries: Sequence[Recovery], version: str, simulation: str
) -> tuple[str, dict[str, object]]:
    """The Markdown of a result's arms, and its references; `simulation`: a simulated one's title."""
    from jinja2 import Environment

    environment = Environment()  # Markdown, not HTML
    environment.filters |= {"cell": _cell, "flat": lambda text: " ".join(text.split())}
    template = environment.from_string(web_file("methods.md"))
    arms = [_figures(one, version) for one in recoveries]
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


def _figures(one: Recovery, version: str) -> dict[str, Any]:
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
        "rows": list(_rows(one, version, worst_m)),
    }


def _rows(one: Recovery, version: str, worst_m: float | None) -> Iterator[tuple[str, str]]:
    """The table: noise, places and lengths with sigma, biases, clock, settings that are not the defaults."""
    found, arm = one.estimates, one.calibration

    def lengths(metres: Iterable[float], sigmas: Iterable[float], given: bool) -> str:
        both = (f"{1e3 * value:.1f} ± {1e3 * each:.1f}" for value, each in zip(metres, sigmas, strict=False))
        return f"{', '.join(both)} ({'given beforehand, adjusted' if given else 'estimated'})"

    yield "Program, method", f"unocclude {version or '(version not stated)'}, {one.method}"
    for joint in JOINTS:
        if joint in (found.camera_sigma_m or {}):
            yield f"Camera noise: {joint}, mm per axis", f"{1e3 * (found.camera_sigma_m or {})[joint]:.1f}"
    for joint, lever in () if arm is None else arm.lever_arms.items():
        sigmas = np.broadcast_to(lever.sigma_m, 3)
        yield (
            f"Place of the {joint} in the IMU's axes, mm",
            lengths(lever.position_m, sigmas, joint in found.given),
        )
    if arm is not None and (upper := arm.upper_arm) is not None:
        yield "Upper arm's length, mm", lengths([upper.value_m], [upper.sigma_m], "upper_arm" in found.given)
    if found.gyroscope_bias is not None:
        degrees = ", ".join(f"{math.degrees(v):+.3f}" for v in found.gyroscope_bias)
        yield "Gyroscope's bias, degrees/s", degrees
    if found.accelerometer_bias is not None:
        yield "Accelerometer's bias, m/s^2", ", ".join(f"{v:+.3f}" for v in found.accelerometer_bias)
    if math.isfinite(one.clock_offset_s):
        clock_ms = (1e3 * one.clock_offset_s, 1e3 * one.clock_offset_sigma_s)
        yield "Clock of IMU minus camera", "{:+.1f} ± {:.1f} ms".format(*clock_ms)
    if worst_m is not None:
        yield "95 of 100 position errors in gaps, at worst", in_cm(worst_m)
    usual = Config().model_dump(mode="json", exclude_none=True)
    for section, settings in one.config.items():
        for key, value in settings.items() if isinstance(settings, dict) else ():
            default = usual.get(section, {}).get(key, value)
            if value != default:
                set_or = f"{value} (default {default}; set, or adapted to the recording)"
                yield f"Setting {section}.{key}", set_or


def _cell(text: str) -> str:
    """Text in which Markdown finds no markup."""
    return re.sub(r"([\\|*_`<\[])", r"\\\1", text)
