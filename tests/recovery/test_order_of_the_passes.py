"""What each section of the second pass gets is its own: state, priors and field, also when sections drop out.

Sections are made up: window `code` answers with so much information of its own, so that a leave-one-out
prior shows by what it lacks whose it is.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from smoother.errors import SolveError
from smoother.recovery.first_pass import FirstAnswer, FirstPass, SecondJob
from smoother.recovery.second_pass import SecondAnswer, SectionCheck, second_pass
from smoother.recovery.task import SectionState
from smoother.runtime.disk_store import DiskStore
from smoother.runtime.pool import Pool
from smoother.runtime.store import Store
from smoother.selfcal.clock_fit import ClockScore
from smoother.window.problem import FieldMeasurements, Priors
from smoother.window.shared import Gaussian, SharedLayout
from smoother.window.solution import Message

#: Windows of each section; sections of one window and neighbours of equal count are among them.
WINDOWS = (2, 1, 3, 3, 2)
DROPPED = [(), (0,), (2,), (4,), (0, 1), (1, 2, 3), (3, 4), (0, 1, 3, 4)]
LAYOUT = SharedLayout(("wrist",), has_upper_arm=True, gravity_axes=np.eye(3)[:2])
PRIOR = Priors(LAYOUT, Gaussian(np.zeros(LAYOUT.size), np.eye(LAYOUT.size)), np.zeros(6))
#: A constant: it does not wander, so information adds up exactly.
CONSTANT = LAYOUT.upper_arm.start
Handed = list[tuple[int, list[float], dict[int, float]]]


def code(section: int, window: int) -> float:
    """Time and information of a window: different for all of them."""
    return 10.0 * (section + 1) + window


def score(section: int) -> ClockScore:
    return ClockScore(np.array([float(section)]), np.ones(1), np.ones(1), np.zeros(1, int))


def answer(section: int) -> FirstAnswer:
    """All windows have the same mean, so pooling finds no spread between them that would widen them."""
    nothing = cast("Any", None)
    state = SectionState(np.full(3, section), section, nothing, nothing, nothing, nothing, [], nothing, ())
    codes = [code(section, window) for window in range(WINDOWS[section])]
    messages = [Message(t, Gaussian(np.zeros(LAYOUT.size), np.eye(LAYOUT.size) / (1.0 + t))) for t in codes]
    strengths = tuple(np.array([t]) for t in codes)
    return FirstAnswer(state, np.array(codes), np.arange(len(codes)), messages, strengths, score(section))


class FakeSections:
    """Numbers instead of sections."""

    name = "made by hand"

    def __len__(self) -> int:
        return len(WINDOWS)

    def __iter__(self) -> Iterator[int]:
        return iter(range(len(WINDOWS)))


@pytest.fixture(params=[Store, DiskStore], ids=["memory", "disk"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    with ExitStack() as stack:
        yield Store() if request.param is Store else stack.enter_context(DiskStore(tmp_path))


def first_pass(dropped: tuple[int, ...], store: Store, monkeypatch: pytest.MonkeyPatch) -> FirstPass:
    """The first pass over all sections, of which some are without an answer."""

    def solve_alone(section: int, task: None) -> FirstAnswer | None:
        return None if section in dropped else answer(section)

    monkeypatch.setattr("smoother.recovery.first_pass.solve_alone", solve_alone)
    shares: list[float] = []
    with Pool(1, 0) as workers:
        first = FirstPass.over(cast("Any", FakeSections()), cast("Any", None), workers, store, shares.append)
    assert shares == [0.2, 0.4, 0.6, 0.8, 1.0]  # a section without an answer is done as well
    return first


def field_of(first: FirstPass) -> dict[int, FieldMeasurements]:
    """A field for every other window, its sigma the window's code."""
    nothing = cast("Any", None)
    return {
        number: FieldMeasurements(nothing, nothing, nothing, message.t_s)
        for number, message in enumerate(first.messages)
        if number % 2
    }


def own_information(priors: Priors, first: FirstPass) -> float:
    """What the leave-one-out prior lacks of all that is known: the information of its own window."""
    total = 1.0 + sum(message.t_s for message in first.messages)
    return total - 1.0 / float(priors.shared.covariance[CONSTANT, CONSTANT])


def second_jobs(first: FirstPass) -> Iterator[SecondJob]:
    return first.jobs(first.priors(PRIOR), field_of(first))


def handed(jobs: Iterator[SecondJob], first: FirstPass) -> Handed:
    """Of each job its section, its priors' windows (by code) and its field's (by number in the section)."""
    return [
        (
            job.state.first_sample,
            [own_information(priors, first) for priors in job.priors],
            {number: field.sigma_rad for number, field in job.field.items()},
        )
        for job in jobs
    ]


def assert_own(actual: Handed, dropped: tuple[int, ...]) -> None:
    answered = [section for section in range(len(WINDOWS)) if section not in dropped]
    assert [section for section, _, _ in actual] == answered
    number = 0
    for section, priors, field in actual:
        codes = [code(section, window) for window in range(WINDOWS[section])]
        # information is a sum of up to 11 numbers below 100, inverted: rounding is near 1e-12
        np.testing.assert_allclose(priors, codes, rtol=1e-9)
        assert field == {k: own for k, own in enumerate(codes) if (number + k) % 2}
        number += len(codes)


@pytest.mark.parametrize("put_back", [False, True])
@pytest.mark.parametrize("dropped", DROPPED)
def test_each_section_gets_its_own(
    dropped: tuple[int, ...], put_back: bool, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where states are taken out and put back while others wait, as the magnetometer's pass does."""
    first = first_pass(dropped, store, monkeypatch)
    answered = [section for section in range(len(WINDOWS)) if section not in dropped]
    own = [(section, [code(section, window) for window in range(WINDOWS[section])]) for section in answered]
    codes = [each for _, codes in own for each in codes]
    assert len(first) == len(answered)
    assert [message.t_s for message in first.messages] == codes
    assert [float(strength[0]) for strength in first.strengths] == codes
    assert [float(score.t[0]) for score in first.clock_scores] == answered
    if put_back:
        seen = []
        for state, windows in first.states():
            seen.append((state.first_sample, [first.messages[k].t_s for k in windows]))
            first.put_back(replace(state, outliers_rejected=True), windows)
        assert seen == own
    jobs = list(second_jobs(first))
    assert not put_back or all(job.state.outliers_rejected for job in jobs)
    assert_own(handed(iter(jobs), first), dropped)
    assert len(first) == 0  # the states were taken out, one by one


def test_the_second_pass_answers_in_order(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each job with its own answer, taken from the store no earlier than it is asked for."""

    def solve_again(job: SecondJob, task: None) -> SecondAnswer:
        return SecondAnswer(cast("Any", job.state.first_sample), [], (), SectionCheck((), ()))

    monkeypatch.setattr("smoother.recovery.second_pass.solve_again", solve_again)
    first = first_pass((2,), store, monkeypatch)
    taken: list[int] = []

    def listen() -> Iterator[SecondJob]:
        for job in second_jobs(first):
            taken.append(job.state.first_sample)
            yield job

    with Pool(1, 0) as workers:
        answers = second_pass(cast("Any", listen()), cast("Any", None), workers)
        assert not taken
        for section in (0, 1, 3, 4):
            assert cast("Any", next(answers).answer) == section
            assert taken[-1] == section
        assert next(answers, None) is None


def test_no_section_at_all_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SolveError, match="made by hand: too few"):
        first_pass((0, 1, 2, 3, 4), Store(), monkeypatch)
