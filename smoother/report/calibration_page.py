"""`calibration_page`: the page of any calibration, from the form in which all of them answer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from calib.protocol import Answer, findings

from .sheet import Page, listing, rendered


def calibration_page(title: str, answer: Answer, notes: Iterable[str] = ()) -> Page:
    """The page of an answer; `notes` are of its input."""
    subtitle = (
        f"Grade: {answer.verdict.grade}. Sigma is one standard deviation; quaternions are qw, qx, qy, qz."
    )
    return Page(title, subtitle, [answer.verdict.sentence], _sections(answer, notes))


def _sections(answer: Answer, notes: Iterable[str]) -> Iterator[str]:
    again = "Nothing is missing: record the next session in the same way."
    yield listing("What to record next", answer.verdict.next, again)
    yield from map(rendered, findings(answer.figures))
    if answer.verdict.findings:
        yield listing("What else was found", answer.verdict.findings)
    yield listing("What stayed open", answer.open_questions, "Nothing stayed open.")
    yield listing("Notes", dict.fromkeys(notes), "There is nothing to note.")
