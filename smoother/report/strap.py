"""The page of `import strap`: verdict, advice, and how many images it was found in."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from ..linalg import robust_sigma
from .sheet import Page, listing, tabulated

if TYPE_CHECKING:
    from ..io.rig.strap import StrapFound


#: A strap that wanders along the forearm by more than this part of it was at times something else.
WANDER = 0.06
FEW = 0.3

_ADVICE = {
    "nothing on the forearm is dark enough": "wear a black strap on a bare or light forearm, and light"
    " it evenly",
    "no dark stretch with two edges": "wear the strap some centimetres above the wrist, with skin on"
    " both sides of it",
    "the dark stretch is not as wide as a strap": "use a strap of 2 to 5 cm; dark sleeves hide it",
    "no depth at the strap": "see that depth is recorded where the arm is; sunlight and shiny straps"
    " blind it",
    "the forearm points to the camera": "move the camera to the side of the movement",
    "the strap is nearer to the elbow than to the wrist": "wear the strap at the wrist; no dark sleeves",
    "no depth image": "record depth at the rate of the colour images",
}


def verdict(search: StrapFound) -> list[str]:
    """How often and how well the strap was seen."""
    total = len(search.reasons)
    good = np.array([not reason for reason in search.reasons], dtype=bool)
    if not good.any():
        worst = max(search.counts, key=lambda name: search.counts[name]) if total else "there are no images"
        return [f"the strap was found in none of {total} images: {worst}"]
    sigma = 1e3 * float(np.sqrt(np.mean(np.median(search.sigma_m[good], axis=0) ** 2)))
    sentences = [
        f"the strap was found in {int(good.sum())} of {total} images ({100 * good.mean():.0f} %), the"
        f" sensor's place to {sigma:.0f} mm per axis"
    ]
    along = search.along[good]
    middle = float(np.median(along))
    wander = float(robust_sigma(along - middle))
    sentences.append(
        f"it sits at {100 * middle:.0f} % of the way from elbow to wrist, +- {100 * wander:.1f} % from"
        " image to image"
    )
    if wander > WANDER:
        sentences.append("that is too much for a tight strap: something else was sometimes detected instead")
    return sentences


def next_time(search: StrapFound) -> list[str]:
    """What to record next, one sentence each."""
    total = max(len(search.reasons), 1)
    sentences = [text for reason, text in _ADVICE.items() if search.counts.get(reason, 0) > 0.1 * total]
    return sentences or ["record in the same way: nothing is missing"]


def strap_page(name: str, search: StrapFound) -> Page:
    """The page of a search for the strap."""
    subtitle = (
        f"Colour {search.topics[0]}, depth {search.topics[1]}. Times are relative to the first colour image."
    )
    return Page(f"The strap in the images: {name}", subtitle, verdict(search), _sections(search))


def _sections(search: StrapFound) -> Iterator[str]:
    yield listing("For the next recording", next_time(search))
    total = max(len(search.reasons), 1)
    rows = [(what, count, f"{100 * count / total:.1f}") for what, count in sorted(search.counts.items())]
    yield tabulated("Found and rejected", "Result for every colour image.", ("", "images", "%"), rows)
    yield listing("Notes", search.notes, "There is nothing to note.")
