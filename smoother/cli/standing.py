"""What commands say of results that are not to be trusted, and how they end with --strict."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import typer

from ..runtime.printable import printable
from .output import say
from .run import NOT_TRUSTED

if TYPE_CHECKING:
    from ..result import Recovery

#: More sentences than this are counted on a terminal, not printed.
MOST_SENTENCES = 25


def say_verdict(recovery: Recovery) -> None:
    """Print the verdict, the self-check's sentence, and the other signs where there is a cause."""
    estimates = recovery.estimates
    if estimates.verdict:
        say(estimates.verdict)
    if estimates.self_check is not None:
        say(estimates.self_check.sentence)
    if estimates.cause:
        for sign in estimates.reasons[1:]:
            say(f"sign: {sign}")


def say_untrusted_parts(recovery: Recovery) -> None:
    """Print the gaps and times that are not to be trusted of a result that otherwise is, a line each."""
    from ..result.untrusted import untrusted_sentences

    sentences = untrusted_sentences(recovery)
    for sentence in sentences[:MOST_SENTENCES]:
        say(f"not to be trusted: {sentence}")
    if len(sentences) > MOST_SENTENCES:
        say(f".. and {len(sentences) - MOST_SENTENCES} more; --json and the report have them all")


def has_doubts(recovery: Recovery) -> bool:
    """Whether anything of a result is not to be trusted."""
    return recovery.has_verdict and not bool(recovery.trusted.all())


def doubts(recoveries: Sequence[Recovery]) -> list[str]:
    """A line for each result that is not to be trusted, or not everywhere; of several it names the arm."""
    from ..result.untrusted import standing

    several = len(recoveries) > 1
    return [
        f"{recovery.arm_label}: {standing(recovery)}" if several else standing(recovery)
        for recovery in recoveries
        if has_doubts(recovery)
    ]


def warn(recoveries: Sequence[Recovery]) -> None:
    """Print those lines on stderr."""
    for line in doubts(recoveries):
        print(f"unocclude: warning: {printable(' '.join(line.split()))}", file=sys.stderr)


def end_strictly(verdicts: Iterable[bool | None]) -> None:
    """End with the exit code of results that are not to be trusted, where one is not, or nobody judged it."""
    if not all(trusted is True for trusted in verdicts):
        raise typer.Exit(NOT_TRUSTED)
