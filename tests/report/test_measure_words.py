"""One measure in words: nothing is said that its interval does not hold."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from made_measures import made_measure, made_measures

from smoother.measures import Measure, Measures
from smoother.report.measures import (
    both_arms,
    capitalised,
    compared,
    listed,
    mark_of,
    of_arm,
    reached,
    share,
    with_interval,
)

RANGE = made_measure("elbow_flexion_range_deg", 62.0, 2.0)


def arm(side: str, *rows: Measure) -> Measures:
    return replace(made_measures(side), rows=rows)


def test_the_unit_stands_once_and_the_interval_only_where_there_is_one() -> None:
    text = with_interval(RANGE)
    assert text == "62.0° (58.1 to 65.9°)"
    alone = with_interval(replace(RANGE, low=math.nan, high=math.nan))
    assert alone == "62.0°"
    speed = replace(RANGE, unit="m/s", value=0.812, low=0.75, high=0.87)
    assert with_interval(speed).count("m/s") == 1 and " to " in with_interval(speed)
    assert mark_of(RANGE, "3").name == "3"


def test_a_share_that_is_not_known_is_a_dash() -> None:
    assert share(None) == share(replace(RANGE, recovered_share=math.nan)) == "–"
    assert share(replace(RANGE, recovered_share=0.256)) == "26\u00a0%"


@pytest.mark.parametrize(
    "value, low, high, word",
    [
        (1.0, 1.0, 1.0, "reached"),
        (0.0, 0.0, 0.0, "not reached"),
        (1.0, 0.0, 1.0, "cannot be assessed"),
        (1.0, math.nan, math.nan, "cannot be assessed"),
    ],
)
def test_reached_is_said_where_the_draws_agree(value: float, low: float, high: float, word: str) -> None:
    row = replace(made_measure("hand_to_mouth_reached", value, 0.0), value=value, low=low, high=high)
    distance = made_measure("hand_to_mouth_distance_m", 0.04, 0.01)
    text = reached(arm("left", row, distance), "hand_to_mouth_reached")
    assert word in text
    assert ("not reached" in text) == (word == "not reached")
    assert text.endswith("away")
    assert "cannot be assessed" in reached(arm("left"), "hand_to_mouth_reached")


def test_left_and_right_are_compared_only_of_one_person_to_be_trusted() -> None:
    left, right = arm("left", RANGE), arm("right", replace(RANGE, value=40.0, low=38.0, high=42.0))
    assert both_arms([right, left]) == (left, right)
    for others in (
        [left],
        [left, left],
        [left, replace(right, body=7)],
        [left, replace(right, trusted=False)],
    ):
        assert both_arms(others) is None
    assert compared(left, arm("right"), RANGE.key) == "cannot be assessed"
    assert compared(left, left, RANGE.key) == "no clear difference"
    assert compared(left, right, RANGE.key) not in ("no clear difference", "cannot be assessed")


def test_names() -> None:
    assert listed(["a", "b"]) == "a, b" and listed(["a", "b", "c"]) == "a and 2 measures more"
    one = arm("left", RANGE)
    assert of_arm(one, [one]) == "" and "left" in of_arm(one, [one, arm("right", RANGE)])
    assert capitalised("elbow flexion") == "Elbow flexion" and capitalised("") == ""
