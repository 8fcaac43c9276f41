"""The probability of a scale: its slope against determinants of dense matrices; limb lengths as a prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from gtsam.symbol_shorthand import G, U, X
from small_window import small_window

from smoother.config import ArmPrior
from smoother.graph import scale
from smoother.graph.build import build
from smoother.graph.linear_system import Jacobian
from smoother.graph.scale import coordinates_by_pixels, with_scale_term
from smoother.graph.shared_prior import lever_keys
from smoother.graph.solved import SolvedWindow
from smoother.window.priors import limb_lengths, with_limb_lengths
from smoother.window.problem import Window, joints_at_start

ORIGIN = np.array([0.4, -0.2, -1.7])


@pytest.fixture
def window() -> Window:
    small = small_window()[0]
    flat = tuple(replace(each, origin_m=ORIGIN) for each in small.joint_measurements)
    small = replace(small, joint_measurements=flat, bodies=small.bodies[:1], alone=True)
    return small.linearised(joints_at_start(small))


def test_coordinates_are_the_slope_of_the_log_determinant(
    window: Window, monkeypatch: pytest.MonkeyPatch
) -> None:
    """-1/2 log det of what is integrated over, by the logarithm of the scale, in finite differences."""
    monkeypatch.setattr(scale, "FREE", 0.0)  # a window of half a second has hardly more
    built = build(window)
    jacobian = Jacobian.of(built.graph, built.values)
    layout = window.priors.layout
    held = [G(0), *([U(0)] if layout.has_upper_arm else []), *lever_keys(layout)]
    fixed = np.concatenate([np.arange(jacobian.width)[jacobian.columns[key]] for key in held])
    free = np.setdiff1d(np.arange(jacobian.width), fixed)
    dense = jacobian.toarray()
    rows = np.concatenate(
        [
            np.arange(group.rows.start, group.rows.stop)
            for group in built.groups
            if group.kind == "camera" and group.of != "shoulder"
        ]
    )
    positions = np.concatenate(
        [np.arange(jacobian.width)[jacobian.columns[X(k)]][3:] for k in range(len(window.t))]
    )

    def volume(log_scale: float) -> float:
        scaled = dense.copy()
        scaled[np.ix_(rows, positions)] *= np.exp(-log_scale)
        return float(np.linalg.slogdet(scaled[:, free].T @ scaled[:, free])[1])

    slope = -0.5 * (volume(1e-4) - volume(-1e-4)) / 2e-4
    assert slope > 3.0
    found = coordinates_by_pixels(SolvedWindow(window, *built))
    assert found == pytest.approx(slope, rel=1e-4)


def test_the_scale_term_moves_the_forearm_by_its_slope(window: Window) -> None:
    priors, layout = window.priors, window.priors.layout
    moved = with_scale_term(priors, 7.0)
    pull = np.linalg.solve(priors.shared.covariance, moved.shared.mean - priors.shared.mean)
    apart = priors.shared.mean[layout.lever("wrist")] - priors.shared.mean[layout.lever("elbow")]
    length, step = np.linalg.norm(apart), 1e-6
    for axis in range(3):
        longer = apart + step * np.eye(3)[axis]
        slope = 7.0 * (np.log(np.linalg.norm(longer)) - np.log(length)) / step
        assert pull[layout.lever("wrist")][axis] == pytest.approx(slope, rel=1e-4, abs=1e-4)
        assert pull[layout.lever("elbow")][axis] == pytest.approx(-slope, rel=1e-4, abs=1e-4)


def test_limb_lengths_are_one_measurement_more(window: Window) -> None:
    """Against the sum of information; the upper arm's own prior is replaced by a length of 1 m +- .."""
    shared, layout = window.priors.shared, window.priors.layout
    lengths = limb_lengths(ArmPrior(height_m=1.8))
    assert lengths.mean == pytest.approx([0.146 * 1.8, 0.186 * 1.8])
    known = with_limb_lengths(shared, layout, lengths)
    apart = shared.mean[layout.lever("wrist")] - shared.mean[layout.lever("elbow")]
    along = apart / np.linalg.norm(apart)
    row = np.zeros(layout.size)
    row[layout.lever("wrist")], row[layout.lever("elbow")] = along, -along
    before = row @ shared.covariance @ row
    after = row @ known.covariance @ row
    own = lengths.covariance[0, 0]
    assert after == pytest.approx(1.0 / (1.0 / before + 1.0 / own), rel=0.05)
    assert row @ known.mean == pytest.approx(
        after * (row @ shared.mean / before + lengths.mean[0] / own), rel=0.05
    )
    assert np.linalg.eigvalsh(known.covariance).min() > 0.0


def test_a_stated_height_says_more_than_none() -> None:
    stated, unknown = limb_lengths(ArmPrior(height_m=1.7)), limb_lengths(ArmPrior())
    share = np.sqrt(stated.covariance[0, 0]) / stated.mean[0]
    assert 0.06 < share < 0.08
    assert 0.08 < np.sqrt(unknown.covariance[0, 0]) / unknown.mean[0] < 0.10
    correlation = unknown.covariance[0, 1] / np.sqrt(np.prod(np.diag(unknown.covariance)))
    assert correlation > 0.4
