"""Fewer points, same shape."""

from __future__ import annotations

import numpy as np

from smoother.report.style import band, decimate, split_line


def test_short_lines_are_kept_whole():
    np.testing.assert_array_equal(decimate(np.zeros(100, bool), 200), np.arange(100))


def test_long_lines_keep_ends_and_gaps():
    important = np.zeros(300_000, bool)
    important[1000:1200] = True
    important[200_000:200_400] = True
    index = decimate(important, 6000)
    assert len(index) <= 6000
    assert index[0] == 0
    assert index[-1] == 299_999
    assert set(np.flatnonzero(important)) <= set(index)
    assert (np.diff(index) > 0).all()


def test_everything_important_is_still_bounded():
    assert len(decimate(np.ones(100_000, bool), 5000)) <= 5000


def test_split_line_meets_at_the_edges():
    values = np.arange(6.0)
    occluded = np.array([0, 0, 1, 1, 0, 0], bool)
    seen, hidden = split_line(values, occluded)
    assert np.isnan(seen).tolist() == [False, False, True, True, False, False]
    assert np.isnan(hidden).tolist() == [True, False, False, False, False, True]


def test_band_is_one_loop_a_stretch():
    t = np.arange(6.0)
    low = np.array([0, 0, np.nan, 0, 0, 0])
    x, y = band(t, low, low + 1)
    assert np.isnan(x).sum() == 2
    assert len(x) == 2 * 5 + 2
    assert x[0] == x[3] == 0.0
    assert np.nanmax(y) == 1
    assert len(band(t, np.full(6, np.nan), t)[0]) == 0
