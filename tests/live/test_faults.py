"""The bench of faults: no kind may make the answer wrong for longer than half a second."""

from __future__ import annotations

import pytest

from tools import live_faults as bench


@pytest.fixture(scope="module")
def sound() -> bench.Sound:
    bench.sound = bench.Sound()
    return bench.sound


@pytest.mark.slow
@pytest.mark.parametrize("kind", bench.KINDS)
def test_no_fault_makes_it_wrong_for_long(sound: bench.Sound, kind: str):
    (wrong_s, *_), _ = bench.verdict(kind)
    assert wrong_s <= bench.MOST_S
