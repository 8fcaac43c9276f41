"""What commands print of arms: a heading for each, what was found of it, and how far it is to be trusted."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from ..errors import UnoccludeError
from ..runtime.printable import printable
from .output import say
from .run import NOT_TRUSTED

if TYPE_CHECKING:
    from ..recording import Recording
    from ..result import Recovery


Answer = TypeVar("Answer")


def arms_figures(arms: Sequence[Any], figures: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The figures of one arm as they are; of several those of the first, and `arms` with all of them.

    With several, `trusted`, `verdict` and `reasons` at the top are those of all arms together, and `pairing`
    is that of the arm whose is proved least.
    """
    if len(figures) == 1:
        return figures[0]
    each = [{"side": arm.side, "body": arm.body, **mine} for arm, mine in zip(arms, figures, strict=True)]
    together = {**each[0], "arms": each}
    if "trusted" not in together:
        return together
    trusted = [mine["trusted"] for mine in each]
    together["trusted"] = False if False in trusted else None if None in trusted else True
    labelled = [(arm.arm_label, mine) for arm, mine in zip(arms, each, strict=True)]
    reasons = ((label, reason) for label, mine in labelled for reason in mine.get("reasons", ()))
    together["reasons"] = [f"{label}: {reason}" for label, reason in reasons]
    if "verdict" in together:
        verdicts = (f"{label.capitalize()}: {mine['verdict']}" for label, mine in labelled)
        together["verdict"] = " ".join(verdicts)
    if pairings := [mine["pairing"] for mine in each if mine.get("pairing")]:
        together["pairing"] = max(pairings, key=lambda one: (not one["proved"], one["chance"] or 0.0))
    return together


def each_arm(
    recordings: Sequence[Recording], work: Callable[[int], Answer]
) -> tuple[list[tuple[Recording, Answer]], list[str]]:
    """Some work on every arm; one of several that cannot be worked on is left out, and said."""
    answers, left_out, errors = [], [], []
    for number, recording in enumerate(recordings):
        try:
            answers.append((recording, work(number)))
        except UnoccludeError as error:
            errors.append(error)
            left_out.append(f"The {recording.arm_label} was left out: {str(error).rstrip('.')}.")
    if not answers:
        raise errors[0]
    return answers, left_out


def say_arm(arm: Any, count: int) -> None:
    """Say whose tables follow, where there are several arms."""
    if count > 1:
        say(f"--- {arm.arm_label} ---")


def warn(recoveries: Sequence[Recovery]) -> None:
    """A line on stderr for each result that is not to be trusted, or not everywhere; of several it names the
    arm.
    """
    from ..result.untrusted import standing

    for recovery in recoveries:
        if recovery.has_verdict and not recovery.trusted.all():
            of = f"{recovery.arm_label}: " if len(recoveries) > 1 else ""
            line = printable(" ".join(f"{of}{standing(recovery)}".split()))
            print(f"unocclude: warning: {line}", file=sys.stderr)


def end_strictly(verdicts: Iterable[bool | None]) -> None:
    """End with the exit code of results that are not to be trusted, where one is not, or was not judged."""
    if not all(trusted is True for trusted in verdicts):
        raise typer.Exit(NOT_TRUSTED)
