"""Parts of a Jacobian; sizes and values of variables."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, D, E, F, G, L, M, N, Q, S, U, V, W, X, Y, Z
from small_window import small_window

from smoother.graph.build import build
from smoother.graph.linear_system import Jacobian
from smoother.graph.variables import DIMENSION, sizes_of, values_of


def test_a_block_is_part_of_the_whole() -> None:
    built = build(small_window()[0])
    jacobian = Jacobian.of(built.graph, built.values)
    whole = jacobian.toarray()
    assert whole.shape == (len(jacobian.rhs), jacobian.width)
    np.testing.assert_array_equal(jacobian.block(slice(9, 30), slice(4, 40)), whole[9:30, 4:40])
    row, column, value = jacobian.entries(slice(9, 30))
    np.testing.assert_array_equal(whole[9 + row, column], value)
    assert len(value) == np.count_nonzero(whole[9:30])


POSE = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 0.3), np.array([1.0, 2.0, 3.0]))
BIAS = gtsam.imuBias.ConstantBias(np.array([0.1, 0.2, 0.3]), np.array([0.01, 0.02, 0.03]))
POINT = np.array([0.4, 0.5, 0.6])
OF_KEY = {
    **{key(7): POSE for key in (X, Y, Z)},
    **{key(7): POINT for key in (V, W, Q, L, S, E, F, M, N)},
    **{key(7): BIAS for key in (B, C, D)},
    G(0): gtsam.Unit3(np.array([0.1, -0.9, 0.2])),
    U(0): 0.25,
}


def values() -> gtsam.Values:
    all_of_them = gtsam.Values()
    for key, value in OF_KEY.items():
        all_of_them.insert(key, value)
    return all_of_them


def test_sizes() -> None:
    assert {chr(gtsam.Symbol(key).chr()) for key in OF_KEY} == set(DIMENSION)
    for key, value in OF_KEY.items():
        alone = gtsam.Values()
        alone.insert(key, value)
        (size,) = sizes_of(np.array([key], np.uint64)).tolist()
        assert alone.dim() == size == DIMENSION[chr(gtsam.Symbol(key).chr())]
    assert sizes_of(np.array(list(OF_KEY), np.uint64)).sum() == values().dim()


def test_some_values() -> None:
    """Of all that a lag window has, or that windows share."""
    for keys in ([X(7), V(7), S(7)], [B(7), G(0), U(0), L(7)], [C(7), M(7)], [D(7), N(7)], []):
        expected = gtsam.Values()
        for key in keys:
            expected.insert(key, OF_KEY[key])
        assert values_of(values(), keys).equals(expected, 1e-12)
