"""Which IMU is on whom: without names, calibration or a common clock, and left open where it must be."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from smoother.array_types import FloatArray
from smoother.errors import RecordingError, UnoccludeError
from smoother.matching import METHODS, Limb, limbs_of, match_imus
from smoother.matching.excerpt_motion import read_excerpts
from smoother.matching.match import assign, probabilities
from smoother.recording import CameraFrame, ImuStream
from smoother.simulation import ArmSimulation, PeopleSimulation, SimulatedPeople, simulate_people

DOWN = CameraFrame.KINECT.down


@cache
def scene(
    seed: int = 3, in_time: float = 0.0, hanging: float = 0.0, seconds: float = 12.0
) -> SimulatedPeople:
    arm = ArmSimulation.preset("realistic", protocol="random", duration_s=seconds, imu_rate_hz=50)
    return simulate_people(PeopleSimulation(in_time=in_time, hanging=hanging), arm, seed)


def limbs(people: SimulatedPeople) -> list[Limb]:
    return [limb for body, side, arm in people.arms for limb in limbs_of(arm, body, side)]


def imus(people: SimulatedPeople) -> list[ImuStream]:
    return [one.stream for one in people.worn]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_every_imu_is_where_it_is(seed: int) -> None:
    people = scene(seed)
    for worn, match in zip(people.worn, match_imus(imus(people), limbs(people), DOWN), strict=True):
        body = None if match.limb is None else match.limb.body
        assert (match.imu, body, match.joint) == (worn.stream.name, worn.body, worn.joint)
        assert match.is_sure == (worn.body is not None)
        if match.limb is not None:  # the grid is 0.04 s, the camera's latency 0.02 s
            assert match.clock_offset_s == pytest.approx(worn.clock_offset_s, abs=0.1)


@pytest.mark.slow
def test_mounting_and_order_do_not_matter() -> None:
    """Another mounting is a rotation of all samples; another order changes no answer."""
    people = scene()
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    turned = [replace(one, acc=one.acc @ turn.T, gyro=one.gyro @ turn.T) for one in imus(people)]
    usual = {m.imu: (m.joint, m.probability) for m in match_imus(imus(people), limbs(people), DOWN)}
    for match in match_imus(turned[::-1], limbs(people)[::-1], DOWN):
        joint, probability = usual[match.imu]
        assert match.joint == joint and match.probability == pytest.approx(probability, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("change", ["no direction of gravity", "frames missing", "two joints in one place"])
def test_what_is_not_needed(change: str) -> None:
    """Also with a third of the frames gone in gaps, which are not made up, each is found."""
    people, down = scene(), None if change.startswith("no") else DOWN
    places = limbs(people)
    if down is not None:
        every = ("shoulder", "elbow", "wrist", "hand")
        places = [
            replace(limb, tracks=limb.tracks.hide((limb.tracks.t_s % 3.0) < 1.0, every)) for limb in places
        ]
    if change.startswith("two"):
        for limb in places:
            limb.tracks.position[50] = limb.tracks.position[50, 1]
    for worn, match in zip(people.worn, match_imus(imus(people), places, down), strict=True):
        assert match.joint == worn.joint


def test_clocks_that_are_seconds_apart() -> None:
    people = scene()
    late = [replace(one, t_s=one.t_s + 3.0) for one in imus(people)]
    for worn, match in zip(people.worn, match_imus(late, limbs(people), DOWN), strict=True):
        assert match.joint == worn.joint
        if match.limb is not None:
            assert match.clock_offset_s == pytest.approx(worn.clock_offset_s + 3.0, abs=0.1)
    too_late = [replace(one, t_s=one.t_s + 100.0) for one in imus(people)]
    assert not any(match.is_known and match.limb for match in match_imus(too_late, limbs(people), DOWN))


def test_the_true_limb_out_of_view_is_not_replaced_by_another() -> None:
    """The wearer's limbs are cut from the list: nobody else's is named for sure."""
    people = scene()
    for worn in people.worn:
        others = [limb for limb in limbs(people) if limb.body != worn.body or worn.body is None]
        (match,) = match_imus([worn.stream], others, DOWN)
        assert not match.is_sure


def test_arms_that_hang_are_unknown() -> None:
    people = scene(7, hanging=1.0)
    for worn, match in zip(people.worn, match_imus(imus(people), limbs(people), DOWN), strict=True):
        assert not match.is_sure
        if worn.body is None:
            assert match.joint == "none" and match.probability > 0.95


def test_two_people_who_share_one_motion_cannot_be_told_apart() -> None:
    """The same arm under two numbers: half and half, so unknown, whatever one IMU's noise says."""
    people = scene()
    worn = next(one for one in people.worn if one.body is not None)
    twice = [limb for limb in limbs(people) if limb.body == worn.body]
    twice += [replace(limb, body=9) for limb in twice]
    (match,) = match_imus([worn.stream], twice, DOWN)
    assert match.joint == "unknown" and match.probability == pytest.approx(0.5, abs=0.01)
    assert {where for where, _ in match.others[:2]} == {f"{worn.joint} of body {b}" for b in (worn.body, 9)}


def test_what_names_exclude_is_never_taken() -> None:
    people = scene()
    places = limbs(people)
    allowed = np.array([[limb.joint != worn.joint for limb in places] for worn in people.worn])
    for worn, match in zip(people.worn, match_imus(imus(people), places, DOWN, allowed=allowed), strict=True):
        assert match.limb is None or match.limb.joint != worn.joint


@pytest.mark.parametrize("method", [name for name in METHODS if name != "motion"])
def test_the_other_methods_answer_too(method: str) -> None:
    """They are there to compare with: of the moving limbs each finds most in an easy scene."""
    people = scene(3)
    places = [limb for limb in limbs(people) if limb.segment == "wrist"]
    chosen = [one for one in people.worn if one.joint.startswith("wrist")]
    assert chosen
    near = [replace(one.stream, t_s=one.stream.t_s - one.clock_offset_s) for one in chosen]
    matches = match_imus(near, places, DOWN, method)
    assert all(0 < match.probability <= 1 for match in matches)
    right = [
        match.limb is not None and (match.limb.body, match.joint) == (one.body, one.joint)
        for one, match in zip(chosen, matches, strict=True)
    ]
    assert sum(right) >= len(chosen) - 1


@pytest.mark.slow
def test_a_long_recording_is_read_in_excerpts() -> None:
    """Three minutes, of which the arm moves in some: the liveliest ten seconds of every twelfth."""
    arm = ArmSimulation.preset(
        "realistic", protocol="random", duration_s=150.0, imu_rate_hz=25, frame_rate_hz=15, still_start_s=60.0
    )
    people = simulate_people(PeopleSimulation(people=1, sensors=2, hanging=0), arm, 1)
    places = limbs(people)
    excerpts = read_excerpts(imus(people), places, 0.4)
    starts = [float(one.t[0]) for one in excerpts]
    assert len(excerpts) == 12 and starts == sorted(starts) and starts[-1] > 120
    assert all(len(one.t) == 250 and len(one.imus[0].rate) == 270 for one in excerpts)
    for worn, match in zip(people.worn, match_imus(imus(people), places, DOWN), strict=True):
        assert match.joint == worn.joint


def test_what_cannot_be_used() -> None:
    people = scene()
    places, streams = limbs(people), imus(people)
    with pytest.raises(UnoccludeError, match="state the camera's frame"):
        match_imus(streams, places, None, "joint-likelihood")
    short = [replace(limb, tracks=limb.tracks.select(slice(0, 10))) for limb in places]
    with pytest.raises(RecordingError, match="too short"):
        match_imus(streams, short, DOWN)
    empty = ImuStream("/imu/empty", np.empty(0), np.empty((0, 3)), np.empty((0, 3)))
    *rest, last = match_imus([*streams, empty], places, DOWN)
    assert last.limb is None and [m.joint for m in rest] == [one.joint for one in people.worn]
    assert [match.joint for match in match_imus(streams, [], DOWN)] == ["unknown"] * 4


def by_force(weight: FloatArray, none: FloatArray) -> FloatArray:
    """The best total weight with each IMU on each limb, and on none: (k, m + 1), all assignments tried."""
    k, m = weight.shape
    best = np.full((k, m + 1), -np.inf)
    columns = np.column_stack([weight, none])
    for chosen in product(range(m + 1), repeat=k):
        used = [j for j in chosen if j < m]
        if len(used) == len(set(used)):
            rows = np.arange(k), np.array(chosen)
            best[rows] = np.maximum(best[rows], columns[rows].sum())
    return best


@pytest.mark.parametrize(
    ("weight", "none"),
    [
        *((rng.normal(0, 3, (3, 4)), rng.normal(0, 1, 3)) for rng in map(np.random.default_rng, range(10))),
        (np.array([[5.0], [4.0], [-np.inf]]), np.zeros(3)),  # more IMUs than limbs, and an excluded pair
        (np.full((2, 2), 10.0), np.zeros(2)),  # equal IMUs share
    ],
)
def test_the_assignment_is_the_best_of_all_and_ratios_are_those_of_the_best(
    weight: FloatArray, none: FloatArray
) -> None:
    best, limb, each = by_force(weight, none), assign(weight, none), np.arange(len(none))
    assert np.column_stack([weight, none])[each, limb].sum() == pytest.approx(best.max())
    share = np.exp(best - best.max(axis=1, keepdims=True))
    np.testing.assert_allclose(
        probabilities(weight, none), share / share.sum(axis=1, keepdims=True), atol=1e-9
    )
