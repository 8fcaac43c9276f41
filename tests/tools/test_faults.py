"""One case in thirty of the matrix of faults: none is silent, none unexpected."""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

import pytest

from tools.fault_cases import Workshop, all_cases
from tools.faults import ENDS, run_all, table


@pytest.mark.skipif(not hasattr(os, "fork"), reason="cases run in forked processes")
def test_a_sample_of_the_matrix(tmp_path: Path):
    shop = Workshop(tmp_path, seed=1)
    cases = all_cases(shop)
    containers = [case for case in cases if case.family.startswith("MCAP")]
    assert len(cases) >= 1200 and len(containers) >= 288
    outcomes = run_all(cases[7::30], shop, shown=False)
    ends = Counter(outcome.end for outcome in outcomes)
    worst = [(o.case.family, o.case.name, o.text) for o in outcomes if o.end in ENDS[3:]]
    assert not worst
    assert min(ends["right"], ends["note"], ends["sentence"]) > 3  # the sample has all three
    assert f"**{len(outcomes)}**" in table(outcomes)
