"""The result in plain words: how much was hidden, how well it is known, what to trust."""

from __future__ import annotations

import numpy as np

from ..evaluation.coverage import camera_residuals
from ..evaluation.summary import GapSummary, gap_summaries, recovery_figures
from ..evaluation.validate import Validation
from ..result import Recovery

#: A gap that is less certain than this needs care, m (one standard deviation).
WEAK_M = 0.05
#: Below this share of camera samples inside their 95 % region the stated uncertainty is doubted.
DOUBTFUL_SHARE = 0.80
#: Above this NEES the stated uncertainty is called too small.
DISHONEST = 2.0


def summary(recovery: Recovery, validation: Validation | None) -> list[str]:
    """Sentences, a paragraph each."""
    if not len(recovery):
        return ["The result holds no sample."]
    found = gap_summaries(recovery)
    paragraphs = [_what_was_hidden(recovery, found)]
    if found:
        paragraphs.append(_how_well(recovery, found))
    if validation is not None:
        paragraphs.append(_against_reference(validation))
    doubt = _camera_doubts(recovery)
    paragraphs.append(doubt)
    paragraphs.append(_what_to_trust(found, _honest(validation) and not doubt))
    return [paragraph for paragraph in paragraphs if paragraph]


def _what_was_hidden(recovery: Recovery, found: list[GapSummary]) -> str:
    duration = float(recovery.t_s[-1] - recovery.t_s[0])
    if not found:
        return (
            f"The recording lasts {duration:.1f} s. The camera saw the forearm all the time: there is no gap."
        )
    lengths = [each.gap.length_s for each in found]
    times = "once" if len(found) == 1 else f"{len(found)} times"
    text = f"The recording lasts {duration:.1f} s. The camera lost the forearm {times}"
    text = f"{text}, for {sum(lengths):.1f} s in all"
    return f"{text}; the longest gap lasts {max(lengths):.1f} s." if len(found) > 1 else f"{text}."


def _how_well(recovery: Recovery, found: list[GapSummary]) -> str:
    sigma = recovery_figures(recovery)["sigma_m"]
    assert isinstance(sigma, dict)
    inside, outside = sigma["occluded"], sigma["visible"]
    if inside["median"] is None:
        return "This method does not say how certain its answer is."
    text = (
        f"In the gaps the sensor's position is known to about {100 * inside['median']:.1f} cm"
        f" (one standard deviation an axis; {100 * inside['max']:.1f} cm at the worst moment)"
    )
    if outside["median"] is not None:
        text += f", against {100 * outside['median']:.1f} cm while the camera sees the arm"
    unanswered = [each for each in found if each.answered < 1]
    tail = f" {len(unanswered)} of the gaps are not answered completely." if unanswered else ""
    return f"{text}.{tail}"


def _against_reference(validation: Validation) -> str:
    hidden = validation.occluded if validation.occluded.samples else validation.all
    where = "in the gaps" if validation.occluded.samples else "over the recording"
    if hidden.position_rms_m is None:
        return "The reference has no position to compare with there."
    text = (
        f"Against the reference the position is off by {100 * hidden.position_rms_m:.1f} cm {where}"
        f" (root mean square; {100 * (hidden.position_max_m or 0):.1f} cm at most)"
    )
    if hidden.orientation_rms_deg is not None:
        text += f", the orientation by {hidden.orientation_rms_deg:.1f} degrees"
    if hidden.nees is None:
        return f"{text}."
    if hidden.nees > DISHONEST:
        factor = np.sqrt(hidden.nees)
        return (
            f"{text}. These errors are about {factor:.1f} times as large as the stated uncertainty allows:"
            " read every standard deviation on this page as that much larger."
        )
    return f"{text}. The stated uncertainty covers these errors."


def _camera_doubts(recovery: Recovery) -> str:
    """That the camera's samples lie farther from the answer than stated, where they do."""
    kept = camera_residuals(recovery)
    inside = {joint: each.inside(0.95) for joint, each in kept.items()}
    if not inside or min(inside.values()) >= DOUBTFUL_SHARE:
        return ""
    worst = min(inside, key=lambda joint: inside[joint])
    return (
        f"The answer and the camera disagree more than stated: of the {worst}'s samples that took part"
        f" {100 * inside[worst]:.0f} % lie where 95 % should. Take every standard deviation on this page for"
        " too small."
    )


def _honest(validation: Validation | None) -> bool:
    """Whether nothing is known against the stated uncertainty."""
    figures = None if validation is None else (validation.occluded.nees or validation.all.nees)
    return figures is None or figures <= DISHONEST


def _what_to_trust(found: list[GapSummary], honest: bool) -> str:
    weak = [each for each in found if each.sigma_max_m is not None and each.sigma_max_m > WEAK_M]
    one_sided = [each for each in found if each.gap.open_start or each.gap.open_end]
    parts = []
    if weak:
        parts.append(
            f"Take {_listed(weak)} with care: the position there is less certain than {100 * WEAK_M:.0f} cm."
        )
    if one_sided:
        parts.append(
            f"{_listed(one_sided).capitalize()} could be recovered from one side only, because the camera"
            " did not see the forearm before or after; the error grows with time there."
        )
    if found and honest and not parts and any(each.sigma_max_m is not None for each in found):
        parts.append(
            f"No gap is less certain than {100 * WEAK_M:.0f} cm. In 95 of 100 cases a coordinate lies within"
            " two standard deviations, the shaded band of the curves."
        )
    return " ".join(parts)


def _listed(found: list[GapSummary]) -> str:
    starts = [f"{each.gap.start_s:.1f} s" for each in found]
    if len(starts) > 6:
        return f"{len(starts)} gaps (marked in the table below)"
    return f"the gap{'s' if len(starts) > 1 else ''} at {', '.join(starts)}"
