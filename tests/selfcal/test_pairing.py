"""Pairs are proved by their motion, wrong ones never; the evidence of every offset against a plain search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.filters import gaussian_smoothed
from smoother.measurements.clock import constant_clock
from smoother.measurements.rigid import best_fits, correlation, fits_along, known_at
from smoother.recording import CameraFrame, Recording
from smoother.selfcal.agreement import (
    CameraTurning,
    ImuTurning,
    MotionAgreement,
    OffsetLine,
    TurningSums,
    agreement,
    chance,
)
from smoother.selfcal.pairing import decided, find_pairing
from smoother.simulation import ArmSimulation, simulate_arm


def made(seed: int, seconds: float = 30.0, preset: str = "realistic") -> Recording:
    config = ArmSimulation.preset(preset, protocol="random", duration_s=seconds)
    return replace(simulate_arm(config, seed).recording, truth=None)


@pytest.fixture(scope="module")
def right() -> Recording:
    return made(1)


@pytest.fixture(scope="module")
def other() -> Recording:
    return made(2)


def late(recording: Recording, seconds: float) -> Recording:
    return replace(recording, arm=replace(recording.arm, t_s=recording.arm.t_s - seconds))


@pytest.mark.parametrize("unrelated", [False, True])
def test_a_right_pair_proves_itself(right: Recording, unrelated: bool) -> None:
    pairing, clock = find_pairing(replace(right, clocks_unrelated=unrelated))
    assert pairing is not None and pairing.proved and pairing.chance < 1e-3
    assert clock is None  # the fine search reaches it
    assert not pairing.reason and not pairing.caution


def test_the_imu_of_another_session_is_not_trusted(right: Recording, other: Recording) -> None:
    wrong = replace(right, imu=other.imu)
    found = agreement(wrong)
    for unrelated, says in ((False, "check that skeleton and IMU"), (True, "unrelated")):
        pairing, _ = decided(found, replace(wrong, clocks_unrelated=unrelated))
        assert pairing is not None and not pairing.proved
        assert says in pairing.reason


def test_data_cannot_be_left_out_to_win(right: Recording, other: Recording) -> None:
    """Two seconds of the right motion at the end of another's: they alone would fit."""
    wrong = replace(right, imu=other.imu)
    n = round(2.0 * right.imu.rate_hz)
    imu = wrong.imu
    acc, gyro = imu.acc.copy(), imu.gyro.copy()
    acc[-n:], gyro[-n:] = right.imu.acc[:n], right.imu.gyro[:n]
    pairing, _ = find_pairing(replace(wrong, imu=replace(imu, acc=acc, gyro=gyro), clocks_unrelated=True))
    assert pairing is not None and not pairing.proved


def test_an_offset_of_seconds_is_found(right: Recording) -> None:
    near, _ = find_pairing(right)
    pairing, clock = find_pairing(late(right, 11.3))
    assert pairing.proved
    assert clock.mean_s == pytest.approx(near.offset_s + 11.3, abs=0.02)


@pytest.mark.parametrize("change", ["mirrored", "down", "hand"])
def test_what_is_wrong_with_the_axes_is_no_wrong_pair(right: Recording, change: str) -> None:
    """A mirrored skeleton, or a wrong down, belongs to its IMU all the same: others name the mistake."""
    recording = right
    if change == "mirrored":
        recording = replace(right, arm=replace(right.arm, position=right.arm.position * [-1.0, 1.0, 1.0]))
    elif change == "down":
        recording = replace(right, camera_frame=CameraFrame.ZUP)
    else:  # a hand in place of the wrist
        joints = right.arm.position[:, [0, 1, 4, 2, 4]], right.arm.state[:, [0, 1, 4, 2, 4]]
        recording = replace(right, arm=replace(right.arm, position=joints[0], state=joints[1]))
    pairing, _ = find_pairing(recording)
    assert pairing is not None and pairing.proved


def test_what_the_user_states_is_used_and_contradicted_only_loudly(right: Recording) -> None:
    demanded = replace(right, clocks_unrelated=True)
    pairing, clock = find_pairing(demanded, None, constant_clock(0.0, 0.02))
    assert pairing is not None and pairing.proved and clock is None
    pairing, _ = find_pairing(late(demanded, 9.0), None, constant_clock(0.0, 0.02))
    assert pairing is not None and not pairing.proved
    assert "one given" in pairing.reason


def test_a_short_recording_of_one_recorder_is_a_caution() -> None:
    """Eight seconds of one pair prove little; nothing contradicts it."""
    line = OffsetLine(0.0, 0.0, 4.0, 0.2, 0.4)
    found = MotionAgreement(4.0, line, line, 2.0, 5.0, 0.1, True, False)
    recording = made(3, 8.0)
    together, _ = decided(found, recording)
    assert not together.reason and "too short" in together.caution
    apart, _ = decided(found, replace(recording, clocks_unrelated=True))
    assert "--clock-offset" in apart.reason


def test_without_a_forearm_there_is_nothing_to_prove(right: Recording) -> None:
    strap = right.arm.position[:, [4] * 5], np.zeros_like(right.arm.state)
    alone = replace(right, arm=replace(right.arm, position=strap[0], state=strap[1]))
    assert find_pairing(alone) == (None, None)
    pairing, _ = find_pairing(replace(alone, clocks_unrelated=True))
    assert pairing is not None and not pairing.proved and pairing.reason


def test_chance_is_a_tail() -> None:
    """Less with evidence, more with every offset tried, never less than what the same exercise explains."""
    evidence = np.linspace(0.0, 60.0, 61)
    tail = [chance(each, 0.9, 60.0, 1, True) for each in evidence]
    assert tail[0] == 1.0 and (np.diff(tail) <= 0).all()
    assert chance(15.0, 0.9, 600.0, 1, True) > chance(15.0, 0.9, 6.0, 1, True)
    assert chance(15.0, 0.9, 6.0, 1, False) > chance(15.0, 0.9, 6.0, 1, True)
    assert chance(1e3, 0.4, 6.0, 1, True) > 1e-3


def turning(seed: int, n: int) -> tuple[FloatArray, FloatArray]:
    """Derivatives of a smooth attitude (n, 3, 3), and a rotation that is constant."""
    rng = np.random.default_rng(seed)
    angles = 4.0 * gaussian_smoothed(rng.normal(size=(n, 3)), 8.0)
    matrix = Rotation.from_rotvec(angles).as_matrix().reshape(n, 9)
    rate = gaussian_smoothed(matrix, 3.0, derivative=True) * 25.0
    return rate.reshape(n, 3, 3), Rotation.random(random_state=seed).as_matrix()


def camera_of(rate: FloatArray, known: FloatArray | None = None) -> CameraTurning:
    seen = np.ones(len(rate), bool) if known is None else known
    return CameraTurning(0, np.where(seen[:, None], rate, 0.0), seen, np.zeros(len(rate)))


def slow_power(camera: CameraTurning, Y: FloatArray, lag: int) -> float:
    """The largest explained power at one offset by a general optimiser from many starts."""
    rows = np.flatnonzero(camera.known)
    rows = rows[(rows + lag >= 0) & (rows + lag < len(Y))]
    x, weight, Ys = camera.rate[rows], camera.weight[rows], Y[rows + lag]

    def left(p: FloatArray) -> float:
        a = p[3:] / np.linalg.norm(p[3:])
        residual = x - Ys @ a @ Rotation.from_rotvec(p[:3]).as_matrix().T
        return float(weight @ (residual**2).sum(axis=1))

    rng, best = np.random.default_rng(0), np.inf
    for _ in range(12):
        start = np.append(Rotation.random(random_state=rng.integers(2**31)).as_rotvec(), rng.normal(size=3))
        best = min(best, minimize(left, start).fun)
    return float(weight @ (x**2).sum(axis=1)) - best


def test_the_power_explained_is_that_of_a_slow_search() -> None:
    Y, Q = turning(3, 220)
    rng = np.random.default_rng(3)
    x = Y[40:160] @ np.array([0.9, 0.3, -0.3]) @ Q.T + rng.normal(0, 0.3, (120, 3))
    camera = camera_of(x, np.arange(120) % 50 < 40)
    step, share = explained(camera, [ImuTurning(0, Y)])
    assert step == 40
    # the alternation stops after a few rounds: a per mille below the optimum
    assert share == pytest.approx(slow_power(camera, Y, 40) / camera.power, rel=2e-3)


def explained(
    camera: CameraTurning, runs: list[ImuTurning], up: FloatArray | None = None
) -> tuple[int, float]:
    """The best offset, in steps, and the part of the camera's turning that it explains."""
    curve = TurningSums(camera, runs, up).curve()
    row = int(curve.evidence.argmax())
    return curve.first + row, float(-np.expm1(-curve.evidence[row] / curve.freedom))


def test_a_perfect_pair_is_explained_as_far_as_the_imu_was_there() -> None:
    Y, _ = turning(5, 500)
    up, along = np.array([0.0, 1.0, 0.0]), np.array([0.6, 0.0, 0.8])
    Q = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # turns z up into y up
    whole = camera_of(Y[25:] @ along @ Q.T)
    # an IMU that paused: each part has a heading of its own
    turned = Rotation.from_rotvec([0, 0, 0.9]).as_matrix() @ Y[260:]
    one, two = [ImuTurning(0, Y)], [ImuTurning(0, Y[:240]), ImuTurning(260, turned)]
    for runs, direction, least in ((one, None, 0.99), (one, up, 0.99), (two, up, 0.9)):
        step, share = explained(whole, runs, direction)
        assert step == 25 and share > least
    assert explained(whole, one, -up)[1] < 0.8
    # what lies outside the overlap is unexplained
    half = float(whole.weight[225:] @ (whole.rate[225:] ** 2).sum(axis=1)) / whole.power
    assert explained(whole, [ImuTurning(250, Y[250:])])[1] == pytest.approx(half, abs=0.02)


def test_correlation_is_the_sum() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(7, 2)), rng.normal(size=(11, 3))
    found = correlation(x, y)
    for k, lag in enumerate(range(-6, 11)):
        rows = [t for t in range(7) if 0 <= t + lag < 11]
        expected = sum((np.outer(x[t], y[t + lag]) for t in rows), np.zeros((2, 3)))
        np.testing.assert_allclose(found[k], expected, atol=1e-12)


def test_the_fit_finds_the_axis_and_every_part_s_rotation() -> None:
    """Two parts of one sensor, each in axes of its own: directions and forces are explained whole."""
    rng = np.random.default_rng(2)
    along, forces = np.array([0.48, 0.6, 0.64]), rng.normal(size=(2, 50, 3))
    turns, Q = (
        Rotation.random(100, random_state=2).as_matrix(),
        Rotation.random(2, random_state=3).as_matrix(),
    )
    seen = turns.reshape(2, 50, 3, 3) @ along @ np.swapaxes(Q, 1, 2)
    T = np.einsum("eni,enjk->eijk", seen, turns.reshape(2, 50, 3, 3))
    F = np.einsum("eni,enj->eij", forces @ np.swapaxes(Q, 1, 2), forces)
    fit = best_fits(T[None], 100.0 * np.eye(3)[None], False, F[None], rounds=20)[:, 0]
    np.testing.assert_allclose(fit, [100.0, 2.0 * (forces**2).sum()], rtol=1e-6)
    of_one = fits_along(T[:1], 50.0 * np.eye(3)[None], np.array([along, -along]), False)[:, 0]
    assert of_one[0] == pytest.approx(50.0) and of_one[1] < 25.0
    t = np.array([0.0, 0.2, 0.4, 1.0, 1.2])
    assert known_at(np.array([0.05, 0.2, 0.35, 0.7, 1.1, 1.15]), t, 0.1).tolist() == [0, 1, 0, 0, 0, 0]
