"""Nodes and pauses: properties over random stamps."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from smoother.measurements.timestamps import PAUSE_S, split_at_pauses
from smoother.recording import ImuStream
from smoother.window.nodes import CLOSEST_S, GAP_NODE_S, decimate, insert_nodes

#: Rounding of sums of steps: times are some tens of seconds.
EPS = 1e-9
steps = st.lists(st.floats(0.0, 3.0) | st.floats(0.0, 0.02), min_size=0, max_size=60)
starts = st.floats(-5.0, 60.0)


def stream(t: np.ndarray) -> ImuStream:
    return ImuStream("", t, np.zeros((len(t), 3)), np.zeros((len(t), 3)))


@given(starts, steps)
def test_thin_keeps_times_apart_and_no_fewer_than_needed(start: float, gaps: list[float]) -> None:
    t = start + np.concatenate(([0.0], np.cumsum(gaps)))
    keep = decimate(t)
    kept = t[keep]
    assert keep[0]
    assert (np.diff(kept) >= CLOSEST_S - EPS).all()
    for dropped in t[~keep]:  # only because a kept one is just before it
        before = kept[kept <= dropped].max()
        assert dropped - before < CLOSEST_S + EPS


def test_thin_of_nothing_and_one() -> None:
    assert decimate(np.zeros(0)).tolist() == []
    assert decimate(np.array([3.0])).tolist() == [True]


@given(starts, steps, st.floats(0.1, 50.0), st.floats(0.0, 1.0))
def test_nodes_increase_are_close_enough_and_keep_the_given_times(
    start: float, gaps: list[float], length: float, shift: float
) -> None:
    t = start + np.concatenate(([0.0], np.cumsum(gaps)))
    t = t[decimate(t)]
    start_s = start + shift
    end_s = start_s + length
    nodes = insert_nodes(t, start_s, end_s)
    spacing = np.diff(nodes)
    assert nodes[0] == start_s
    assert nodes[-1] == end_s
    assert (spacing > 0).all()
    assert spacing.max() <= GAP_NODE_S + EPS
    # an interval is cut into pieces longer than half of the limit; given times are CLOSEST_S apart
    assert spacing.min() >= CLOSEST_S - EPS
    inner = t[(t > start_s + CLOSEST_S) & (t < end_s - CLOSEST_S)]
    assert np.isin(inner, nodes).all()


@given(starts, steps)
def test_nodes_are_no_more_than_needed(start: float, gaps: list[float]) -> None:
    """Between two given times the fewest evenly spaced nodes."""
    t = start + np.concatenate(([0.0], np.cumsum(gaps)))
    t = t[decimate(t)]
    end = t[-1] + 1.0
    nodes = insert_nodes(t, t[0], end)
    inner = t[(t > t[0] + CLOSEST_S) & (t < end - CLOSEST_S)]
    given_times = np.concatenate(([t[0]], inner, [end]))
    for a, b in itertools.pairwise(given_times):
        inside = nodes[(nodes >= a) & (nodes <= b)]
        assert len(inside) - 1 == max(1, int(np.ceil((b - a) / GAP_NODE_S - 1e-9)))
        np.testing.assert_allclose(np.diff(inside), (b - a) / (len(inside) - 1), atol=EPS)


@given(st.lists(st.integers(2, 30), min_size=1, max_size=5), st.sampled_from([20.0, 40.0, 100.0, 285.0]))
@settings(max_examples=50)
def test_pauses_split_the_stream(lengths: list[int], rate: float) -> None:
    """Runs of samples a second apart come back as they were made."""
    t, at = [], 0.0
    for n in lengths:
        t.append(at + np.arange(n) / rate)
        at = t[-1][-1] + 1.0
    joined = np.concatenate(t)
    if (np.diff(joined) > 0.5).sum() * 2 >= len(joined) - 1:
        return  # then the pause is the median spacing, and there is no rate to speak of
    segments = split_at_pauses(stream(joined))
    assert [joined[rows].tolist() for rows in segments] == [times.tolist() for times in t]


def test_a_lost_sample_or_four_are_no_pause() -> None:
    """Five sample periods are bridged where they are longer than a tenth of a second."""
    for rate in (20.0, 100.0, 285.0):
        t = np.arange(200) / rate
        lost = max(1, int(min(4.0, PAUSE_S * rate - 1.5)))
        keep = np.ones(200, dtype=bool)
        keep[100 : 100 + lost] = False
        assert len(split_at_pauses(stream(t[keep]))) == 1


def test_short_streams() -> None:
    assert split_at_pauses(stream(np.zeros(0))) == [slice(0, 0)]
    assert split_at_pauses(stream(np.array([1.0]))) == [slice(0, 1)]
