"""What commands print of arms: a heading for each, what was found of it, and how far it is to be trusted."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from ..errors import UnoccludeError
from ..runtime.printable import printable
from ..table import Table
from .output import say, say_more, show
from .run import NOT_TRUSTED

if TYPE_CHECKING:
    from calib.motion import ArmEstimates, ClockOffset

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


def print_arm(estimates: ArmEstimates) -> None:
    """Print lever arms and lengths, each with its sigma."""
    levers = [
        (joint, *map(_with_sigma, lever.position_m, lever.sigma_m))
        for joint, lever in estimates.calibration.lever_arms.items()
    ]
    title = "Lever arms in the IMU's axes, mm (+- one sigma)"
    show(Table(title, ("joint", "x", "y", "z"), levers))
    lengths = [
        (name.replace("_", " ").replace("imu", "IMU"), _with_sigma(value, sigma))
        for name, (value, sigma) in estimates.lengths.items()
    ]
    show(Table("Lengths, mm", ("length", "found"), lengths))


def _with_sigma(value_m: float, sigma_m: float) -> str:
    return f"{1e3 * value_m:.1f} +- {1e3 * sigma_m:.1f}"


def print_clock(offset: ClockOffset) -> None:
    """Print the clock offset of one recording, in a line."""
    known = f" +- {1e3 * offset.sigma_s:.1f} ms" if offset.sigma_s == offset.sigma_s else ""
    wandered = f"; it wandered by {1e3 * offset.drift_s:.0f} ms" if offset.drift_s > WANDERED_S else ""
    say(f"the IMU's clock is {1e3 * offset.offset_s:+.1f} ms{known} against the camera's{wandered}")


def print_camera(estimates: ArmEstimates) -> None:
    """Print the camera's noise and the constant errors of its joints, a line."""
    if not estimates.camera:
        return
    noise = ", ".join(f"{joint} {1e3 * each.sample_m:.1f}" for joint, each in estimates.camera.items())
    say(f"noise of the camera's joints, mm per axis: {noise}")
    off = [f"{joint} {1e3 * each.bias_m:.1f}" for joint, each in estimates.camera.items() if each.bias_m > 0]
    if off:
        say(
            f"constant errors of the joints against each other, mm: {', '.join(off)}; "
            f"shared component: {1e3 * estimates.joint_bias_sigma_m:.1f} mm per axis"
        )


#: A clock that wandered less is not worth a word, s.
WANDERED_S = 0.001


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
    say_more(len(sentences), MOST_SENTENCES, "more; --json and the report have them all")


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
    """End with the exit code of results that are not to be trusted, where one is not, or was not judged."""
    if not all(trusted is True for trusted in verdicts):
        raise typer.Exit(NOT_TRUSTED)
