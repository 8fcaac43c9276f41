"""The result in plain words: how much was hidden, how well it is known, what to trust."""

from __future__ import annotations

from functools import partial

import numpy as np

from ..evaluation.metrics import Figures
from ..evaluation.summary import GapSummary, camera_inside_95, certainty_figures, gap_summaries
from ..evaluation.validate import Validation
from ..evaluation.words import listed, said
from ..linalg import median_rate_hz
from ..measurements.visibility import occluded_at
from ..result import Recovery
from ..result.untrusted import MOST_NAMED, partly_untrusted, untrusted_sentences
from .sheet import ALARM, CARE, GOOD

#: Below this share of camera samples inside their 95 % region the stated uncertainty is doubted.
DOUBTFUL_SHARE = 0.80
#: Above this NEES the stated uncertainty is called over-confident.
OVER_CONFIDENT = 2.0


_said = partial(said, "summary")


def summary(recovery: Recovery, validation: Validation | None) -> list[str]:
    """Sentences, a paragraph each: the verdict first, of what is not to be trusted its cause and remedy."""
    return [text for _, text in _parts(recovery, validation)]


def below(recovery: Recovery, validation: Validation | None) -> list[str]:
    """The sentences of `summary` that the first screen does not have."""
    return [text for is_first, text in _parts(recovery, validation) if not is_first]


def box(recovery: Recovery, validation: Validation | None, arm: str = "") -> tuple[str, str, list[str]]:
    """Tone, large word and sentences of the first screen: the verdict, and one figure of the error."""
    estimates = recovery.estimates
    shown = [text for is_first, text in _parts(recovery, validation) if is_first]
    if not len(recovery):
        return CARE, f"{arm}: no result" if arm else "No result", shown
    word, _, why = estimates.verdict.rstrip(".").partition(": ")
    shown = [why, *(text for text in shown if text != estimates.verdict)]
    partly = partly_untrusted(recovery)
    if estimates.trusted is False:
        tone = ALARM
    elif partly or why or not _consistent(validation) or _camera_doubts(recovery):
        tone = CARE
    else:
        tone = GOOD if estimates.trusted else ""
    word = (word or "Not judged") + (" in part" if partly and not why else "")
    head = f"{arm}: {word[:1].lower()}{word[1:]}" if arm else word
    return tone, head, [text for text in shown if text]


def _parts(recovery: Recovery, validation: Validation | None) -> list[tuple[bool, str]]:
    """Sentences in order, and whether the first screen has them."""
    if not len(recovery):
        return [(True, _said("nothing"))]
    gaps, estimates = gap_summaries(recovery), recovery.estimates
    check = "" if estimates.self_check is None else estimates.self_check.sentence
    hidden = _what_was_hidden(recovery, gaps)
    reference = "" if validation is None else _against_reference(validation)
    if estimates.trusted is False:
        remedies = [remedy for remedy in estimates.remedies if remedy not in estimates.verdict]
        signs = [reason for reason in estimates.reasons if estimates.cause not in ("", reason)]
        parts = [
            (True, estimates.verdict),
            (True, _said("again", remedies=" or ".join(remedies)) if remedies else ""),
            (False, _said("evidence", signs="; ".join(signs)) if signs else ""),
            (True, _said("withdrawn")),
            *((False, text) for text in (check, hidden, reference)),
        ]
    else:
        trusted = [gap for gap in gaps if gap.trusted is not False]
        doubt = _camera_doubts(recovery)
        consistent = _consistent(validation) and not doubt
        which = "gap" if len(trusted) == len(gaps) else "other gap"
        wrong = list(untrusted_sentences(recovery))
        if (more := len(wrong) - MOST_NAMED) > 0:
            wrong = [*wrong[:MOST_NAMED], f"and {more} more"]
        parts = [
            (True, estimates.verdict),
            (True, check),
            (True, _said("untrusted", named="; ".join(wrong)) if wrong else ""),
            (False, hidden),
            (not check, _how_well(recovery, which, trusted, consistent)),
            (False, reference),
            (True, doubt),
        ]
    return [(is_first, text) for is_first, text in parts if text]


def _what_was_hidden(recovery: Recovery, gaps: list[GapSummary]) -> str:
    lengths_s = [gap.length_s for gap in gaps]
    without = ~recovery.answered & ~occluded_at(recovery.t_s, recovery.gaps)
    return _said(
        "hidden",
        length_s=recovery.t_s[-1] - recovery.t_s[0],
        count=len(gaps),
        hidden_s=sum(lengths_s),
        longest_s=max(lengths_s, default=0.0),
        nothing_s=np.count_nonzero(without) / median_rate_hz(recovery.t_s),
    )


def _how_well(recovery: Recovery, which: str, trusted: list[GapSummary], consistent: bool) -> str:
    """What is stated of the gaps that are to be trusted."""
    if not trusted:
        return ""
    error = certainty_figures(recovery, recovery.trusted)["error_95_m"]
    inside, outside = error["occluded"], error["visible"]
    if inside["all"] is None or inside["max"] is None:
        return _said("silent")
    share = "in 95 of 100 cases" if consistent else "in 95 %, as stated"
    seen = outside["all"] and f"; while the camera sees the arm, within {100 * outside['all']:.1f} cm"
    unanswered = [gap for gap in trusted if gap.answered < 1]
    tail = f" {len(unanswered)} of the gaps are not answered completely." if unanswered else ""
    centimetres = {"all_cm": 100 * inside["all"], "max_cm": 100 * inside["max"]}
    return _said("within", which=which, share=share, seen=seen or "", open=tail, **centimetres)


def _against_reference(validation: Validation) -> str:
    part, found = _compared(validation)
    if not found:
        return _said("reference_nothing")
    words = [
        f"{100 * (each.position_rms_m or 0):.1f} cm at the {name} (95 % below"
        f" {100 * (each.position_p95_m or 0):.1f} cm)"
        for name, each in found.items()
    ]
    where = "in the gaps" if part == "occluded" else "over the recording"
    covered, nees = ".", max(_nees(found), default=None)
    if nees is not None:
        covered = _said("covered") if nees <= OVER_CONFIDENT else _said("not_covered", factor=np.sqrt(nees))
    return _said("reference", where=where, errors=listed(words), covered=covered)


def _compared(validation: Validation) -> tuple[str, dict[str, Figures]]:
    """Figures of sensor and joints in gaps; over the recording where none has a reference there."""
    for part in ("occluded", "all"):
        figures = {"sensor": getattr(validation, part)}
        figures |= {joint: parts[part] for joint, parts in validation.points.items() if part in parts}
        if known := {name: each for name, each in figures.items() if each.position_rms_m is not None}:
            return part, known
    return "", {}


def _nees(found: dict[str, Figures]) -> list[float]:
    """Of the sensor, else of the joints, where it is known."""
    own = [found["sensor"]] if "sensor" in found else found.values()
    return [each.nees for each in own if each.nees is not None]


def _camera_doubts(recovery: Recovery) -> str:
    """That the camera's samples lie farther from the answer than stated, where they do."""
    inside = camera_inside_95(recovery)
    if not inside or min(inside.values()) >= DOUBTFUL_SHARE:
        return ""
    worst = min(inside, key=lambda joint: inside[joint])
    return _said("doubt", joint=worst, percent=100 * inside[worst])


def _consistent(validation: Validation | None) -> bool:
    """Whether no reference contradicts the stated uncertainty."""
    return validation is None or max(_nees(_compared(validation)[1]), default=0.0) <= OVER_CONFIDENT
