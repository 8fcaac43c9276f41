"""Terms of the pages for therapists, in plain words."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from .sheet import headed

#: What both pages say of themselves.
NO_DIAGNOSIS = (
    "This page measures motion. It is no diagnosis, and says nothing of why a motion is as it is; what"
    " follows from it is for the person who treats to decide."
)
TERMS = {
    "interval": (
        "95 % interval",
        "if the recovery's own errors are as it states them, the true value lies between these two numbers in"
        " 95 of 100 recordings. A wide interval is a poorly known value. The thin dark lines show it.",
    ),
    "recovered": (
        "recovered",
        "how much of a value rests on moments that the camera did not see and that were calculated from the"
        " sensor on the wrist.",
    ),
    "clear": (
        "clearly more, clearly less",
        "the difference is larger than the errors of both recordings explain (95 %), and larger than the"
        " minimal detectable change where one is known. More is not always better.",
    ),
    "unclear": (
        "no clear change, no clear difference",
        "the recordings do not show a difference. There may be one that is smaller than the interval.",
    ),
    "unknown": (
        "cannot be said",
        "there is no value, no interval, or the interval is too wide for an answer.",
    ),
    "symmetry": (
        "right against left, in percent",
        "how much more the right arm has than the left one, as a part of their mean: 0 is alike, below 0 the"
        " left one has more.",
    ),
    "mdc": (
        "minimal detectable change",
        "measured against motion capture or given by you: two sessions without any change differ by less in"
        " 95 of 100 cases.",
    ),
    "flexion": ("elbow flexion", "bend of the elbow: 0° is a straight arm."),
    "elevation": (
        "shoulder elevation",
        "how far the upper arm is raised: 0° hangs down, 90° is level.",
    ),
    "pronation": ("forearm pronation", "turn of the forearm: 0° is the palm forward with the arm hanging."),
    "reach": ("reach volume", "the room that the hand passed through, in litres."),
    "sparc": (
        "SPARC",
        "smoothness of the hand's speed: nearer to zero is smoother; one simple reach has about −1.4.",
    ),
    "ratio": ("path ratio", "length of the hand's way over the straight line: 1 is straight."),
}


def explained(heading: str, names: Iterable[str]) -> str:
    """A section that explains terms.

    Parameters
    ----------
    heading : str
        Over them.
    names : iterable of str
        Keys of `TERMS`.
    """
    lines = "".join(
        f"<p><b>{escape(term)}</b>: {escape(words)}</p>" for term, words in (TERMS[name] for name in names)
    )
    return f'{headed(heading)}<div class="terms">{lines}</div>'


def terms_of(keys: Iterable[str]) -> list[str]:
    """The terms that the names of some measures need."""
    needs = {
        "flexion": "elbow_flexion",
        "elevation": "shoulder_elevation",
        "pronation": "pronation",
        "reach": "hand_reach",
        "sparc": "sparc",
        "ratio": "hand_path_ratio",
    }
    shown = list(keys)
    return [term for term, start in needs.items() if any(key.startswith(start) for key in shown)]
