"""`write_arms_report`: several arms of one recording on one page."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from html import escape

from ..evaluation.compare import Comparison
from ..evaluation.summary import trust_word
from ..evaluation.validate import Validation
from ..recording import CameraFrame, Recording, Truth
from ..result import Recovery, arm_tags
from ..result.untrusted import untrusted_gaps
from .chart import NOT_TRUSTED, badge
from .method_comparison import sections as of_comparison
from .method_comparison import verdict
from .page import in_motion, origin, sections
from .sheet import Html, qualified, table, write_sheet
from .summary import summary, tone

#: An arm's recording, answer, and what it was held against, where it was.
Arm = tuple[Recording | None, Recovery] | tuple[Recording | None, Recovery, Validation | None, Truth | None]


def write_arms_report(
    arms: Sequence[Arm],
    path: str | os.PathLike[str],
    *,
    camera_frame: CameraFrame | None = None,
    force: bool = False,
) -> None:
    """Write the results of several arms as one HTML page: a summary of each, then arm by arm.

    Parameters
    ----------
    arms : sequence of (Recording or None, Recovery[, Validation or None, Truth or None])
        Each as `write_report` takes it.
    path : path-like
        The page to write.
    camera_frame : CameraFrame, optional
        The directions of the camera's axes, where no recording is at hand.
    force : bool
        Overwrite a page that exists.

    Raises
    ------
    UnoccludeError
        The page exists and `force` is not given, or it cannot be written.
    """
    recoveries = [arm[1] for arm in arms]
    marks = [_mark(tag) for tag in arm_tags(recoveries)]
    paragraphs = []
    for arm in sorted(arms, key=lambda arm: arm[1].estimates.trusted is not False):  # the worst first
        paragraphs += [f"{_name(arm[1])}: {text}" for text in summary(arm[1], _of(arm)[0])]
    write_sheet(
        path,
        f"Recovered arm motion: {recoveries[0].name}",
        origin(recoveries[0]),
        paragraphs,
        _sections(arms, marks, camera_frame),
        tone=tone(recoveries),
        force=force,
    )


def _sections(arms: Sequence[Arm], marks: Sequence[str], frame: CameraFrame | None) -> Iterator[str]:
    links = [
        Html(f'<a href="#arm-{mark}">{escape(_name(arm[1]))}</a>')
        for arm, mark in zip(arms, marks, strict=True)
    ]
    rows = [
        (
            link,
            len(arm[1].gaps),
            f"{sum(gap.length_s for gap in arm[1].gaps):.1f}",
            Html(_trusted(arm[1])),
            arm[1].estimates.verdict,
        )
        for link, arm in zip(links, arms, strict=True)
    ]
    yield table(("arm", "gaps", "hidden, s", "trusted", "verdict"), rows)
    frame = next((arm[0].camera_frame for arm in arms if arm[0] is not None), None) or frame
    yield in_motion([(arm[1], _of(arm)[1]) for arm in arms], frame)
    for arm, mark in zip(arms, marks, strict=True):
        yield f'<section id="arm-{mark}"><h1>{escape(_name(arm[1]))}</h1>'
        for section in sections(arm[1], arm[0], *_of(arm), frame, alone=False):
            yield qualified(section, mark)
        yield "</section>"


def _trusted(recovery: Recovery) -> str:
    """Whether an arm's answer is to be trusted, as a word in its colour."""
    trusted, untrusted = recovery.estimates.trusted, len(untrusted_gaps(recovery))
    word = trust_word(trusted, len(recovery.gaps), untrusted)
    if trusted is False:
        return badge(NOT_TRUSTED)
    return badge(word, "care") if untrusted else escape(word) or "–"


def _of(arm: Arm) -> tuple[Validation | None, Truth | None]:
    """What an arm was held against."""
    return (arm[2], arm[3]) if len(arm) == 4 else (None, None)


def _name(recovery: Recovery) -> str:
    return _capital(recovery.arm_label)


def write_arms_comparison(
    compared: Sequence[tuple[Recording, Comparison]], path: str | os.PathLike[str], *, force: bool = False
) -> None:
    """Write the comparisons of several arms as one HTML page, arm by arm.

    Raises
    ------
    UnoccludeError
        The page exists and `force` is not given, or it cannot be written.
    """
    arms = [
        (_capital(recording.arm_label), verdict(comparison), of_comparison(comparison, recording))
        for recording, comparison in compared
    ]
    recording, comparison = compared[0]
    write_sheet(
        path,
        comparison.title(f"Methods compared: {recording.name}"),
        f"{len(comparison.rows)} methods, {len(compared)} arms, each held against its own truth.",
        [f"{name}: {text}" for name, texts, _ in arms for text in texts],
        (
            part
            for name, _, parts in arms
            for part in (f"<h1>{escape(name)}</h1>", *(qualified(one, _mark(name)) for one in parts))
        ),
        force=force,
    )


def _mark(name: str) -> str:
    """A name as a part of an id."""
    return re.sub("[^a-z0-9]+", "-", name.lower())


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
