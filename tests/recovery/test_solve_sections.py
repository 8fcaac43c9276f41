"""Sections solved side by side: each as if it were alone, whatever the number of processes."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import asdict
from unittest.mock import patch

import numpy as np
import pytest
from scenes import Found, answer, moving

from smoother.recovery.sections import Sections
from smoother.recovery.solve_section import solve_section, solve_sections
from smoother.recovery.task import Task
from smoother.runtime.pool import Pool


@pytest.fixture
def cut(monkeypatch: pytest.MonkeyPatch) -> tuple[Sections, Task]:
    """The sections of 25 s, three of them, and what holds for all, with motions to draw."""
    monkeypatch.setattr("smoother.recovery.sections.SECTION_S", 8.0)
    made = moving(3, "white", 25.0, occlusion_lengths_s=(2.0,), occlusion_every_s=8.0)
    given: list[tuple[Sections, Task]] = []

    def listen(sections: Sections, task: Task, workers: Pool) -> None:
        given.append((sections, task))
        raise Found

    with suppress(Found), patch("smoother.smoothing.solve_sections", listen):
        answer(made.recording, made.calibration, draws=3)
    return given[0]


@pytest.mark.slow
def test_the_answer_is_the_same_on_any_number_of_processes(cut: tuple[Sections, Task]) -> None:
    sections, task = cut
    alone = [asdict(solved) for data in sections if (solved := solve_section(data, task)) is not None]
    assert len(alone) == len(sections) == 3 and alone[0]["draws"] is not None
    for processes in (1, 2):
        with Pool(processes, 1_000_000) as workers:
            together = [asdict(solved) for solved in solve_sections(sections, task, workers)]
        np.testing.assert_equal(together, alone)
