"""Networks of clocks: broadcasts, chains, loops, what is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from calib.clock.clock_calibration import ClockCalibration, disagreements, open_questions, verdict
from calib.clock.links import ClockLink, Receptions
from calib.clock.network import solve_clocks
from smoother.errors import CalibrationError
from smoother.simulation.clocks import STEP_S, broadcast


def test_twenty_rounds_give_a_fifth_of_a_millisecond():
    errors, sigmas, skews = [], [], []
    for seed in range(25):
        clocks, heard = broadcast(seed, nodes=4)
        for link in solve_clocks([heard]).links():
            errors.append(clocks.error_s(link))
            sigmas.append(link.sigma_s)
            skews.append(clocks.skew_error_ppm(link))
    assert np.abs(errors).max() < 0.2e-3
    assert np.abs(skews).max() < 10  # over 15 minutes; 390 ppm among them
    assert 0.5 < np.mean(np.square(np.array(errors) / sigmas)) < 1.6  # 1 where sigma is honest


def test_stamps_that_count_from_1970():
    clocks, heard = broadcast(3, start_s=1.7e9)
    for link in solve_clocks([heard]).links():
        assert abs(clocks.error_s(link)) < 0.2e-3


def test_agrees_with_a_plain_least_squares_fit():
    """Every event's time as an unknown of its own, solved by scipy; no rows are wrong."""
    clocks, heard = broadcast(5, nodes=3, rounds=15, span_s=60, late=0.0, missed=0.1)
    keep = np.bincount(heard.event)[heard.event] > 1
    event, t = heard.event[keep], heard.t_s[keep]
    node = np.array([int(name[1:]) for name in heard.node])[keep]
    network = solve_clocks([heard])
    tau0 = float(network.tau0_s[0])

    def left(x: np.ndarray) -> np.ndarray:
        a, b, tau = np.append(0, x[:2]), np.append(0, x[2:4]), x[4:]
        rows = t - (tau[event] + a[node] + b[node] * (tau[event] - tau0))
        return np.concatenate([rows / heard.sigma_s[keep], b[1:] / 5e-4])

    start = np.concatenate([clocks.offset_s[1:], np.zeros(2), [t[event == e].mean() for e in range(15)]])
    slow = least_squares(left, start, x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    spread = np.linalg.inv(slow.jac.T @ slow.jac)[:4, :4]
    index = [network.nodes.index(name) for name in ("n1", "n2")]
    columns = [*index, *(3 + k for k in index)]
    assert network.value[columns] == pytest.approx(slow.x[:4], abs=1e-9)
    noise = network.leftovers[0].sigma_s / (STEP_S / np.sqrt(12))
    assert network.covariance[np.ix_(columns, columns)] == pytest.approx(
        noise**2 * spread, rel=1e-3, abs=1e-13
    )


def test_links_chain_and_their_sigmas_add():
    links = [ClockLink("n0", "n1", 0.5, 0.003), ClockLink("n1", "n2", -0.2, 0.004, at_s=0.5)]
    chained = solve_clocks([], links).between("n0", "n2")
    assert chained.offset_s == pytest.approx(0.3)
    assert chained.sigma_s == pytest.approx(0.005, rel=0.01)
    back = solve_clocks([], links).between("n2", "n0")
    assert back.offset_s == pytest.approx(-0.3)


def test_sound_and_broadcast_chain_from_camera_to_arm():
    clocks, heard = broadcast(8, nodes=2)
    names = {"n0": "n1", "n1": "n2"}  # n0 is now the camera, 40 s behind
    heard = replace(heard, node=[names[name] for name in heard.node])
    beep = Receptions(
        np.zeros(2, int), ["n0", "n1"], np.array([260.0, 300.0]), np.array([3e-4, 1e-4]), "sound", False
    )
    network = solve_clocks([beep, heard])
    chained = network.between("n0", "n2")
    tau = chained.at_s + 40.0
    assert chained.offset_s == pytest.approx(40 + clocks.read(1, tau) - tau, abs=2e-3)
    assert chained.sigma_s >= network.between("n0", "n1").sigma_s > 3e-4


def test_a_loop_that_does_not_close_is_said():
    clocks, heard = broadcast(9, nodes=2)
    at = 100.0
    right = clocks.read(1, at) - at
    for wrong, said in ((0.0, False), (0.012, True)):
        motion = ClockLink("n0", "n1", right + wrong, 0.001, at_s=at, source="motion")
        assert bool(disagreements(solve_clocks([heard], [motion]))) is said


def test_groups_that_nothing_links():
    heard = Receptions(
        np.array([0, 0, 1, 1, 2]), ["a", "b", "c", "d", "e"], np.arange(5.0), np.full(5, 1e-4), "broadcast"
    )
    network = solve_clocks([heard])
    assert [(link.from_clock, link.to_clock) for link in network.links()] == [("a", "b"), ("c", "d")]
    assert any("nothing links these groups" in text for text in verdict(network))
    assert any("e never heard" in text for text in open_questions(ClockCalibration("", network, (heard,))))
    with pytest.raises(CalibrationError, match="nothing links the clocks a and c"):
        network.between("a", "c")
    alone = replace(heard, event=np.arange(5))
    with pytest.raises(CalibrationError, match="no event was heard by two clocks"):
        solve_clocks([alone])


def test_rounds_that_share_one_rounding_are_not_averaged():
    """Both clocks tick in step: every round shows the same rounding error, which is then in sigma."""
    tau = np.arange(20) * 320 * STEP_S
    t = np.concatenate([tau, np.floor((tau + 0.4 * STEP_S + 1.0) / STEP_S) * STEP_S])
    heard = Receptions(
        np.tile(np.arange(20), 2), ["a"] * 20 + ["b"] * 20, t, np.full(40, STEP_S / np.sqrt(12)), "broadcast"
    )
    link = solve_clocks([heard]).between("a", "b")
    assert abs(link.offset_s - 1.0 - 0.4 * STEP_S) < 2.5 * link.sigma_s


def test_rounds_that_contradict_each_other_cost_sigma():
    """Two rounds, one of them 60 ms late: no telling which, and sigma says so."""
    t = np.array([0.0, 20.0, 1.0, 21.06])
    heard = Receptions(np.array([0, 1, 0, 1]), ["a", "a", "b", "b"], t, np.full(4, 1e-4), "broadcast")
    link = solve_clocks([heard]).between("a", "b")
    assert link.sigma_s > 5e-3 and abs(link.offset_s - 1.0) < 3 * link.sigma_s


@given(st.integers(0, 10_000), st.integers(2, 6), st.floats(0.0, 0.5))
@settings(max_examples=25, deadline=None)
def test_any_network_has_offsets_that_add_up(seed: int, nodes: int, missed: float):
    _, heard = broadcast(seed, nodes=nodes, rounds=8, span_s=30, missed=missed)
    try:
        network = solve_clocks([heard])
    except CalibrationError:
        return
    for u, v, w in zip(network.nodes, network.nodes[1:], network.nodes[2:], strict=False):
        if len({int(network.group[network.nodes.index(name)]) for name in (u, v, w)}) == 1:
            t = np.array([10.0])
            there = network.between(v, w).at(network.between(u, v).at(t))
            # links are linear about their own time: second-order terms of two skews are left out
            assert there == pytest.approx(network.between(u, w).at(t), abs=2e-5)
    assert np.all(np.linalg.eigvalsh(network.covariance) > -1e-12)
