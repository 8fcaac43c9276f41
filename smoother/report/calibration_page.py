"""`calibration_page`: the page of any calibration, from the form in which all of them answer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from calib.protocol import Answer

from ..linalg import robust_sigma
from .sheet import Page, PageSection, notes, rendered

if TYPE_CHECKING:
    from ..io.rig.strap import StrapFound


def calibration_page(title: str, answer: Answer, remarks: Iterable[str] = ()) -> Page:
    """The page of an answer; `remarks` are of its input."""
    subtitle = f"Grade: {answer.grade}. Sigma is one standard deviation; quaternions are qw, qx, qy, qz."
    return Page(title, subtitle, [answer.sentence], _sections(answer, remarks))


def _sections(answer: Answer, remarks: Iterable[str]) -> Iterator[PageSection]:
    yield PageSection("What to record next", sentences=answer.next)
    yield from map(rendered, answer.tables())
    yield PageSection("What else was found", sentences=answer.findings)
    yield PageSection("What stayed open", sentences=answer.open_questions or ["Nothing stayed open."])
    yield notes(remarks)


#: A strap that wanders along the forearm by more than this part of it was at times something else.
WANDER = 0.06


def strap_verdict(search: StrapFound) -> list[str]:
    """How often and how well the strap was seen."""
    total = len(search.reasons)
    good = np.array([not reason for reason in search.reasons], dtype=bool)
    if not good.any():
        worst = max(search.counts, key=lambda name: search.counts[name]) if total else "there are no images"
        return [f"the strap was found in none of {total} images: {worst}"]
    sigma = 1e3 * float(np.sqrt(np.mean(np.median(search.sigma_m[good], axis=0) ** 2)))
    middle = float(np.median(search.along[good]))
    wander = float(robust_sigma(search.along[good] - middle))
    sentences = [
        f"the strap was found in {int(good.sum())} of {total} images ({100 * good.mean():.0f} %), the"
        f" sensor's place to {sigma:.0f} mm per axis",
        f"it sits at {100 * middle:.0f} % of the way from elbow to wrist, +- {100 * wander:.1f} % from"
        " image to image",
    ]
    if wander > WANDER:
        sentences.append("that is too much for a tight strap: something else was sometimes detected instead")
    return sentences
