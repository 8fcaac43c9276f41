"""Pairs are proved by their motion, wrong ones never; the evidence of every offset against a plain search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.filters import gaussian_smoothed
from smoother.measurements.clock import Clock, constant_clock
from smoother.measurements.remedy import Remedy
from smoother.measurements.rigid import best_fits, correlation, fits_along, known_at
from smoother.recording import CameraFrame, ImuStream, JointTracks, Recording
from smoother.selfcal.agreement import (
    CameraTurning,
    ImuTurning,
    MotionAgreement,
    OffsetLine,
    TurningSums,
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


def spliced(right: Recording, other: Recording) -> Recording:
    """Two seconds of the right motion at the end of another's: they alone would fit."""
    count, acc, gyro = round(2.0 * right.imu.rate_hz), other.imu.acc.copy(), other.imu.gyro.copy()
    acc[-count:], gyro[-count:] = right.imu.acc[:count], right.imu.gyro[:count]
    return replace(right, imu=replace(other.imu, acc=acc, gyro=gyro), clocks_unrelated=True)


def hand_as_wrist(right: Recording, other: Recording) -> Recording:
    seen, places = right.arm, [0, 1, 4, 2, 4]
    return replace(right, arm=replace(seen, position=seen.position[:, places], state=seen.state[:, places]))


@pytest.mark.parametrize(
    ("change", "proved"),
    [
        (lambda right, other: right, True),
        (lambda right, other: replace(right, clocks_unrelated=True), True),
        # what is wrong with the axes belongs to its IMU all the same: others name the mistake
        (lambda right, other: Remedy(mirror="x").applied(right), True),
        (lambda right, other: replace(right, camera_frame=CameraFrame.ZUP), True),
        (hand_as_wrist, True),
        (lambda right, other: replace(right, imu=other.imu), False),
        (spliced, False),
    ],
)
def test_pairs_are_proved_by_their_motion(
    change: Callable[[Recording, Recording], Recording], proved: bool, right: Recording, other: Recording
) -> None:
    recording = change(right, other)
    pairing, clock = find_pairing(recording)
    assert pairing is not None and pairing.proved is proved is (pairing.chance < 1e-3)
    assert bool(pairing.reason) is not proved and not pairing.caution
    assert proved or recording.clocks_unrelated or TELLS in pairing.reason
    if recording is right:
        assert clock is None  # the fine search reaches it
        late = replace(right, arm=replace(right.arm, t_s=right.arm.t_s - 11.3))
        again, clock = find_pairing(late)
        assert again.proved and clock.mean_s == pytest.approx(pairing.offset_s + 11.3, abs=0.02)


def found(
    best: OffsetLine,
    near: OffsetLine | None = None,
    freedom: float = 5.0,
    mounted: bool = False,
    **more: float,
) -> MotionAgreement:
    """An agreement of these lines; the best one's rival has an evidence of 2."""
    usual = {"rival": 2.0, "noise_share": 0.0} | more
    return MotionAgreement(
        4.0, best, near or best, freedom=freedom, heading_only=True, is_mounted=mounted, **usual
    )


def line(evidence: float = 4.0, chance: float = 0.2, offset_s: float = 0.0, skew: float = 0.0) -> OffsetLine:
    return OffsetLine(offset_s, skew, evidence, chance, 0.4)


#: A sound pair shows 0.8 times the freedom: 14 or more of that tell, or 6 where there is hardly any of it.
SHORT, LONG, GIVEN = 8.0, 30.0, constant_clock(5.0, 0.1)
ONE, APART = False, True
TELLS, NOT_YET, UNLIKE = (
    "does not turn with this forearm",
    "too short or too slow",
    "does not show that these",
)
UNDECIDED, SEVERAL, ELSEWHERE = "too short to decide", "fits several offsets", "from the one given"
FAR = {"offset_s": 2.0, "chance": 1e-5}


@pytest.mark.parametrize(
    ("agreed", "seconds", "unrelated", "given", "says", "offset_s"),
    [
        (found(line()), SHORT, ONE, None, NOT_YET, None),
        (found(line()), SHORT, APART, None, UNDECIDED, None),
        (found(line(chance=0.9e-3)), SHORT, ONE, None, "", None),
        (found(line(chance=1.1e-3)), SHORT, ONE, None, NOT_YET, None),
        (found(line(), freedom=17.6), SHORT, ONE, None, TELLS, None),
        (found(line(), freedom=17.6), SHORT, APART, None, UNDECIDED, None),
        (found(line(), freedom=17.6), LONG, APART, None, UNLIKE, None),
        (found(line(), freedom=17.4), SHORT, ONE, None, NOT_YET, None),
        (found(line(3.4), freedom=17.4), SHORT, ONE, None, TELLS, None),
        (found(line(1.5), freedom=7.6), SHORT, ONE, None, TELLS, None),
        (found(line(0.0), freedom=7.4), SHORT, ONE, None, NOT_YET, None),
        (found(line(), freedom=17.6, noise_share=0.5), SHORT, ONE, None, NOT_YET, None),
        # another offset counts where it is clearly better than one near zero, and nothing rivals it
        (found(line(30.0, **FAR), line()), SHORT, ONE, None, "", 2.0),
        (found(line(11.1, 0.9e-2, 2.0), line()), SHORT, ONE, None, NOT_YET, 2.0),
        (found(line(10.9, 0.9e-2, 2.0), line()), SHORT, ONE, None, NOT_YET, None),
        (found(line(11.1, 1.1e-2, 2.0), line()), SHORT, ONE, None, NOT_YET, None),
        (found(line(30.0, **FAR), line(), rival=18.8), SHORT, ONE, None, "", 2.0),
        (found(line(30.0, **FAR), line(), rival=19.1), SHORT, ONE, None, NOT_YET, 2.0),
        (found(line(30.0, **FAR), line(), mounted=True, rival=24.2), SHORT, ONE, None, "", 2.0),
        (found(line(30.0, **FAR), line(), mounted=True, rival=24.4), SHORT, ONE, None, NOT_YET, 2.0),
        (found(line(30.0, **FAR), line(), rival=25.1), SHORT, APART, None, SEVERAL, 2.0),
        (found(line(30.0, **FAR), line(), rival=24.9), SHORT, APART, None, UNDECIDED, 2.0),
        # the fine search reaches 0.4 s, and a drift that stays within it
        (found(line(30.0, 1e-5, 0.41)), SHORT, ONE, None, "", 0.41),
        (found(line(30.0, 1e-5, -0.39)), SHORT, ONE, None, "", None),
        (found(line(30.0, 1e-5, 0.0, 0.01)), SHORT, ONE, None, "", None),
        (found(line(30.0, 1e-5, -0.38, 0.01)), SHORT, ONE, None, "", -0.38),
        (found(line(30.0, 1e-5, 0.0, 0.02)), SHORT, ONE, None, "", 0.0),
        # a clock that is given is contradicted far beyond its own sigma by much more evidence alone
        (found(line(24.1, 0.9e-3, 0.71), line()), SHORT, APART, GIVEN, ELSEWHERE, None),
        (found(line(24.1, 0.9e-3, -0.71), line()), SHORT, APART, GIVEN, ELSEWHERE, None),
        (found(line(24.1, 0.9e-3, 0.69), line()), SHORT, APART, GIVEN, "", None),
        (found(line(24.1, 0.9e-3, 0.75), line(offset_s=0.1)), SHORT, APART, GIVEN, "", None),
        (found(line(23.9, 0.9e-3, 0.71), line()), SHORT, APART, GIVEN, "", None),
        (found(line(24.1, 1.1e-3, 0.71), line()), SHORT, APART, GIVEN, "", None),
    ],
)
def test_what_is_decided_from_an_agreement(
    agreed: MotionAgreement,
    seconds: float,
    unrelated: bool,
    given: Clock | None,
    says: str,
    offset_s: float | None,
) -> None:
    """Both sides of every border; a caution where one recorder stamped both and nothing contradicts them."""
    t = np.linspace(0.0, seconds, 9)
    arm = JointTracks("camera", t, np.full((9, 5, 3), np.nan), np.zeros((9, 5), np.int8))
    imu = ImuStream("imu", t, np.zeros((9, 3)), np.zeros((9, 3)))
    pairing, clock = decided(agreed, Recording(imu, arm, clocks_unrelated=unrelated), given)
    assert pairing.proved == (not says)
    assert says in (pairing.caution if says == NOT_YET else pairing.reason)
    assert bool(pairing.caution) == (says == NOT_YET) and bool(pairing.reason) == (says not in ("", NOT_YET))
    if given is not None:
        assert pairing.offset_s == pytest.approx(5.0 + agreed.near.offset_s)
    assert clock is None if offset_s is None else clock.mean_s == pytest.approx(offset_s)


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
    # an offset counts where 0.35 of the camera's 19 s are in common
    curve, least = TurningSums(whole, [ImuTurning(0, Y)], None).curve(), 166
    assert curve.searched == 475 + 500 - 1 - 2 * (least - 1)
    assert not curve.evidence[: least - 1].any()
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
