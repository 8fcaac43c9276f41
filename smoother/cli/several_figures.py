"""Figures of several arms as one JSON, and headings between their tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from ..errors import UnoccludeError
from .output import say

if TYPE_CHECKING:
    from ..recording import Recording

Answer = TypeVar("Answer")


def arms_figures(arms: Sequence[Any], figures: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The figures of one arm as they are; of several those of the first, and `arms` with all of them.

    With several, `trusted`, `verdict` and `reasons` at the top are those of all arms together, and `pairing`
    is that of the arm whose is proved least.

    Parameters
    ----------
    arms : sequence of Recording or Recovery
        Whose side and body are stated.
    figures : sequence of dict
        Of the arms, in the same order.
    """
    if len(figures) == 1:
        return figures[0]
    each = [{"side": arm.side, "body": arm.body, **mine} for arm, mine in zip(arms, figures, strict=True)]
    together = {**each[0], "arms": each}
    if "trusted" in together:
        trusted = [mine["trusted"] for mine in each]
        labels = [arm.arm_label for arm in arms]
        together["trusted"] = False if False in trusted else None if None in trusted else True
        together["reasons"] = [
            f"{label}: {reason}"
            for label, mine in zip(labels, each, strict=True)
            for reason in mine.get("reasons", ())
        ]
        if "verdict" in together:
            together["verdict"] = " ".join(
                f"{label.capitalize()}: {mine['verdict']}" for label, mine in zip(labels, each, strict=True)
            )
        together |= _least_proved([mine["pairing"] for mine in each if mine.get("pairing")])
    return together


def _least_proved(pairings: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """`pairing` of several arms: one that is not proved before one that is; nothing without any."""
    if not pairings:
        return {}
    return {"pairing": max(pairings, key=lambda each: (not each["proved"], each["chance"] or 0.0))}


def each_arm(
    recordings: Sequence[Recording], work: Callable[[int], Answer]
) -> tuple[list[tuple[Recording, Answer]], list[str]]:
    """Some work on every arm; one of several that cannot be worked on is left out, and said.

    Raises
    ------
    UnoccludeError
        No arm can be worked on: the first one's sentence.
    """
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
