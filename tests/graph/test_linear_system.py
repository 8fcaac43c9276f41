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


def test_sizes_and_values_of_all_that_windows_have() -> None:
    pose = gtsam.Pose3(gtsam.Rot3.RzRyRx(0.1, -0.2, 0.3), np.array([1.0, 2.0, 3.0]))
    bias = gtsam.imuBias.ConstantBias(np.array([0.1, 0.2, 0.3]), np.array([0.01, 0.02, 0.03]))
    point = np.array([0.4, 0.5, 0.6])
    of_key = dict.fromkeys([key(7) for key in (X, Y, Z)], pose)
    of_key |= dict.fromkeys([key(7) for key in (V, W, Q, L, S, E, F, M, N)], point)
    of_key |= dict.fromkeys([key(7) for key in (B, C, D)], bias)
    of_key |= {G(0): gtsam.Unit3(np.array([0.1, -0.9, 0.2])), U(0): 0.25}

    def values(keys: list[int]) -> gtsam.Values:
        some = gtsam.Values()
        for key in keys:
            some.insert(key, of_key[key])
        return some

    assert {chr(gtsam.Symbol(key).chr()) for key in of_key} == set(DIMENSION)
    np.testing.assert_array_equal(
        sizes_of(np.array(list(of_key), np.uint64)), [values([key]).dim() for key in of_key]
    )
    everything = values(list(of_key))
    # of all that a lag window has, or that windows share
    for keys in ([X(7), V(7), S(7)], [B(7), G(0), U(0), L(7)], [C(7), M(7)], [D(7), N(7)], []):
        assert values_of(everything, keys).equals(values(keys), 1e-12)
