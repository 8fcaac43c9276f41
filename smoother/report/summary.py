"""The result in plain words: how much was hidden, how well it is known, what to trust."""

from __future__ import annotations

import numpy as np

from ..evaluation.advice import listed
from ..evaluation.metrics import Figures
from ..evaluation.summary import GapSummary, camera_consistency, error_figures, gap_summaries
from ..evaluation.validate import Validation
from ..linalg import median_rate_hz
from ..measurements.timestamps import pauses
from ..measurements.visibility import occluded_at
from ..result import Recovery
from ..result.untrusted import MOST_NAMED, partly_untrusted, untrusted_sentences
from .sheet import ALARM, CARE, GOOD

#: A gap in which 95 of 100 errors need not lie below this needs care, m.
WIDE_M = 0.10
#: Time outside the gaps without any result that is reported, s.
UNANSWERED_S = 1.0
#: Below this share of camera samples inside their 95 % region the stated uncertainty is doubted.
DOUBTFUL_SHARE = 0.80
#: Above this NEES the stated uncertainty is called over-confident.
OVER_CONFIDENT = 2.0


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
        return [(True, "The result has no sample.")]
    gaps, estimates = gap_summaries(recovery), recovery.estimates
    check = "" if estimates.self_check is None else estimates.self_check.sentence
    hidden = _what_was_hidden(recovery, gaps)
    reference = "" if validation is None else _against_reference(validation)
    if estimates.trusted is False:
        remedies = [remedy for remedy in estimates.remedies if remedy not in estimates.verdict]
        signs = [reason for reason in estimates.reasons if estimates.cause not in ("", reason)]
        parts = [
            (True, estimates.verdict),
            (True, f"Run `unocclude smooth` again with {' or '.join(remedies)}." if remedies else ""),
            (False, f"Evidence: {'; '.join(signs)}." if signs else ""),
            (True, _WITHDRAWN),
            *((False, text) for text in (check, hidden, reference)),
        ]
    else:
        trusted = [gap for gap in gaps if gap.trusted is not False]
        doubt = _camera_doubts(recovery)
        consistent = _consistent(validation) and not doubt
        which = "gap" if len(trusted) == len(gaps) else "other gap"
        parts = [
            *((True, text) for text in (estimates.verdict, check, _untrusted(recovery))),
            (False, hidden),
            (not check, _how_well(recovery, which, trusted, consistent)),
            (False, reference),
            (True, doubt),
            (False, _what_to_trust(trusted, consistent, which)),
        ]
    return [(is_first, text) for is_first, text in parts if text]


_WITHDRAWN = (
    "Do not use the figures of this result. Its stated uncertainty is valid only for a correct set-up"
    " and is not shown on this page; curves and pictures remain, in red, to help find the cause."
)


def _untrusted(recovery: Recovery) -> str:
    """Which gaps and times are not to be trusted, and why; "" where all are."""
    sentences = untrusted_sentences(recovery)
    if not sentences:
        return ""
    more = f"; and {len(sentences) - MOST_NAMED} more" if len(sentences) > MOST_NAMED else ""
    named = "; ".join(sentences[:MOST_NAMED])
    return f"Not to be trusted, and red on this page: {named}{more}. Leave them out; the rest is valid."


def _what_was_hidden(recovery: Recovery, gaps: list[GapSummary]) -> str:
    text = f"The recording lasts {recovery.t_s[-1] - recovery.t_s[0]:.1f} s. The camera"
    if not gaps:
        return f"{text} saw the forearm all the time: there is no gap."
    lengths = [gap.gap.length_s for gap in gaps]
    times = "once" if len(gaps) == 1 else f"{len(gaps)} times"
    text += f" lost the forearm {times}, for {sum(lengths):.1f} s in all"
    if len(gaps) > 1:
        text += f"; the longest gap lasts {max(lengths):.1f} s"
    without = ~recovery.answered & ~occluded_at(recovery.t_s, recovery.gaps)
    nothing_s = np.count_nonzero(without) / median_rate_hz(recovery.t_s)
    if nothing_s > UNANSWERED_S:
        text += f". For {nothing_s:.1f} s more there is no result"
    if len(pauses(recovery.t_s)):
        text += ". What was hidden while the IMU paused is not counted"
    return f"{text}."


def _how_well(recovery: Recovery, which: str, trusted: list[GapSummary], consistent: bool) -> str:
    """What is stated of the gaps that are to be trusted."""
    if not trusted:
        return ""
    error = error_figures(recovery, recovery.trusted)
    inside, outside = error["occluded"], error["visible"]
    if inside["all"] is None or inside["max"] is None:
        return "This method does not state its uncertainty."
    share = "in 95 of 100 cases" if consistent else "in 95 %, as stated"
    text = (
        f"In the {which}s the sensor's position is within {100 * inside['all']:.1f} cm {share}"
        f" ({100 * inside['max']:.1f} cm at the least certain moment)"
    )
    if outside["all"] is not None:
        text += f"; while the camera sees the arm, within {100 * outside['all']:.1f} cm"
    unanswered = [gap for gap in trusted if gap.answered < 1]
    tail = f" {len(unanswered)} of the gaps are not answered completely." if unanswered else ""
    return f"{text}.{tail}"


def _against_reference(validation: Validation) -> str:
    hidden = validation.occluded if validation.occluded.samples else validation.all
    where = "in the gaps" if validation.occluded.samples else "over the recording"
    if hidden.position_rms_m is not None:
        text = (
            f"Against the reference 95 % of the position's errors {where} are below"
            f" {100 * (hidden.position_p95_m or 0):.1f} cm (root mean square"
            f" {100 * hidden.position_rms_m:.1f} cm, {100 * (hidden.position_max_m or 0):.1f} cm at most)"
        )
        if hidden.orientation_rms_deg is not None:
            text += f", the orientation is off by {hidden.orientation_rms_deg:.1f} degrees (root mean square)"
        return text + _covered([] if hidden.nees is None else [hidden.nees])
    part, figures = _joint_figures(validation)
    errors = {joint: each.position_rms_m for joint, each in figures.items() if each.position_rms_m}
    if not errors:
        return "The reference has neither the sensor's position nor a joint to compare there."
    where = "in the gaps" if part == "occluded" else "over the recording"
    words = listed([f"{100 * error:.1f} cm at the {joint}" for joint, error in errors.items()])
    text = f"Against the reference the error {where} is {words} (root mean square)"
    return text + _covered([value for joint in errors if (value := figures[joint].nees) is not None])


def _covered(nees: list[float]) -> str:
    """Whether the stated uncertainty covers the errors, if that is known."""
    if not nees:
        return "."
    if max(nees) <= OVER_CONFIDENT:
        return ". The stated uncertainty covers these errors."
    return (
        f". These errors are about {np.sqrt(max(nees)):.1f} times as large as the stated uncertainty allows:"
        " multiply every uncertainty on this page by that factor."
    )


def _joint_figures(validation: Validation) -> tuple[str, dict[str, Figures]]:
    """Figures of each joint in gaps; over the whole recording where no joint has a reference in a gap."""
    for part in ("occluded", "all"):
        figures = {joint: parts[part] for joint, parts in validation.points.items() if part in parts}
        if any(each.position_rms_m is not None for each in figures.values()):
            return part, figures
    return "", {}


def _camera_doubts(recovery: Recovery) -> str:
    """That the camera's samples lie farther from the answer than stated, where they do."""
    inside = {joint: found["inside_95"] for joint, found in camera_consistency(recovery).items()}
    if not inside or min(inside.values()) >= DOUBTFUL_SHARE:
        return ""
    worst = min(inside, key=lambda joint: inside[joint])
    return (
        f"Result and camera disagree more than stated: of the {worst} samples used,"
        f" {100 * inside[worst]:.0f} % lie where 95 % should. Every uncertainty on this page is too small."
    )


def _consistent(validation: Validation | None) -> bool:
    """Whether no reference contradicts the stated uncertainty."""
    if validation is None:
        return True
    own = validation.occluded.nees or validation.all.nees
    joints = [each.nees for each in _joint_figures(validation)[1].values()]
    stated = [value for value in ([own] if own is not None else joints) if value is not None]
    return not stated or max(stated) <= OVER_CONFIDENT


def _what_to_trust(gaps: list[GapSummary], consistent: bool, gap_word: str) -> str:
    weak = [gap for gap in gaps if gap.is_wider_than(WIDE_M)]
    one_sided = [gap for gap in gaps if gap.one_sided]
    parts = []
    if weak:
        parts.append(
            f"Take {_listed(weak)} with care: the position there is less certain than {100 * WIDE_M:.0f} cm"
            " (95 of 100 cases)."
        )
    if one_sided:
        parts.append(
            f"{_listed(one_sided).capitalize()} could be recovered from one side only, because the camera"
            " did not see the forearm before or after; the error grows with time there."
        )
    if consistent and not parts and any(gap.sigma_max_m is not None for gap in gaps):
        parts.append(f"The uncertainty stays below {100 * WIDE_M:.0f} cm in every {gap_word}.")
    return " ".join(parts)


def _listed(gaps: list[GapSummary]) -> str:
    starts = [f"{gap.gap.start_s:.1f} s" for gap in gaps]
    if len(starts) > 6:
        return f"{len(starts)} gaps (marked in the table of gaps)"
    return f"the gap{'s' if len(starts) > 1 else ''} at {', '.join(starts)}"
