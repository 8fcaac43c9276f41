"""The report's tables."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from ..evaluation.advice import rejected
from ..evaluation.summary import (
    camera_consistency,
    certainty_figures,
    consistency,
    recovery_figures,
)
from ..evaluation.validate import sample_errors
from ..recording import Truth
from ..result import Estimates, Recovery
from ..result.untrusted import certain
from ..table import Table, centimetres, percent, tabulated

#: Figures of a recovery that another section of the page shows.
_ELSEWHERE = (
    *("camera_sigma_m", "joint_bias_sigma_m", "given", "max_sigma_m"),
    *("untrusted", "cameras"),
)
WITHDRAWN = "withdrawn: the result is not to be trusted"


def overview(recovery: Recovery) -> Table:
    """What was recovered, in numbers."""
    return Table("Figures", ("what", "value"), list(_overview(recovery, recovery.estimates)))


def _overview(recovery: Recovery, estimates: Estimates) -> Iterator[tuple[str, object]]:
    answered, error = recovery.answered, certainty_figures(recovery, recovery.trusted)["error_95_m"]
    yield "method", recovery.method
    yield "arm", recovery.side or "not stated"
    yield "samples of the forearm sensor", len(recovery)
    yield "sample rate, Hz", recovery_figures(recovery)["rate_hz"]
    yield "samples without the camera", recovery.occluded.sum()
    yield "samples without an answer", int((~answered).sum())
    for words, within_m in (
        ("while seen", error["visible"]["all"]),
        ("in gaps", error["occluded"]["all"]),
        ("at the least certain moment of a gap", error["occluded"]["max"]),
    ):
        stated = WITHDRAWN if estimates.trusted is False else centimetres(within_m)
        yield f"position, 95 of 100 errors below, {words}, cm", stated
    yield "samples that are not to be trusted", int(np.count_nonzero(~recovery.trusted))
    offset = None
    if np.isfinite(recovery.clock_offset_s):
        offset = f"{1000 * recovery.clock_offset_s:.1f} ms"
        if np.isfinite(recovery.clock_offset_sigma_s):
            offset += f" ± {1960 * recovery.clock_offset_sigma_s:.1f} ms (95 of 100 cases)"
    yield "sensor's clock minus camera's clock", offset
    if (limit_m := estimates.max_sigma_m) is not None:
        unsure = int(answered.sum() - certain(recovery).sum())
        yield "samples marked as too uncertain to use", f"{unsure} (above {100 * limit_m:g} cm)"
    further = {name: value for name, value in estimates.plain().items() if name not in _ELSEWHERE}
    for name, value in _leaves(further, ", "):
        if value not in ("", "null"):
            yield name.replace("_", " "), value


def settings(config: dict[str, object]) -> Table:
    """The effective configuration, a setting a row."""
    return Table("Settings", ("setting", "value"), list(_leaves(config, ".")))


def _leaves(values: Mapping[Any, Any], between: str) -> Iterator[tuple[str, str]]:
    """Values under their whole names as cells show them; numbers short, what is no text as JSON writes it."""
    for name, value in values.items():
        if isinstance(value, np.ndarray | np.generic):
            value = value.tolist()
        if isinstance(value, Mapping) and value:
            yield from ((f"{name}{between}{rest}", each) for rest, each in _leaves(value, between))
        elif isinstance(value, list | tuple):
            yield name, ", ".join(each for _, each in _leaves(dict(enumerate(value)), between))
        elif isinstance(value, float):
            yield name, f"{value:.6g}"
        else:
            yield name, value if isinstance(value, str) else json.dumps(value, default=str)


def rejections(recovery: Recovery) -> Table:
    """Rejected camera samples, one row per reason and joint."""
    columns: dict[str, str | Callable[[Any], object]] = {
        "reason": "reason",
        "in words": "why",
        "joint": "joint",
        "samples": "count",
        "of its tracked ones": lambda row: percent(row["share"]),
        "first, s": lambda row: f"{row['first_s']:.2f}",
        "last, s": lambda row: f"{row['last_s']:.2f}",
    }
    return tabulated("Rejected camera samples", rejected(recovery), columns)


def consistent(recovery: Recovery, truth: Truth | None) -> Table:
    """Whether what is stated holds: for the camera's joints, and for the sensor against a reference."""
    parts = {f"camera's {joint}": each for joint, each in camera_consistency(recovery).items()}
    if truth is not None and len(truth):
        errors = sample_errors(recovery, truth).difference_m
        for name, rows in (("in gaps", recovery.occluded), ("while seen", ~recovery.occluded)):
            parts[f"errors {name}"] = consistency(errors[rows], recovery.pose_covariance[rows, :3, :3])
    columns = {"of": "of", "samples": "samples", "inside 50 %": "inside_50", "inside 95 %": "inside_95"}
    columns |= {"stated sigma, cm per axis": "stated_m", "actual rms, cm per axis": "actual_m"}
    known = [{"of": name, **found} for name, found in parts.items() if found["samples"]]
    return tabulated("Whether sigma is consistent with the errors", known, columns)
