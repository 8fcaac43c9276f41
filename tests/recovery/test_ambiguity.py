"""Other explanations: their cost, a mirrored skeleton, gaps that they leave ambiguous."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
from arms import make_recording, make_recovery
from scenes import answer

from smoother.array_types import FloatArray
from smoother.linalg import nearest_rotation, unit
from smoother.measurements.remedy import Remedy
from smoother.recording import CameraFrame, Recording
from smoother.recovery import ambiguity
from smoother.recovery.ambiguity import (
    LEAST_ACCELERATION,
    LEAST_RAD,
    LEVER_SIGMA_M,
    Explanation,
    Likelihood,
    Seen,
    effective_count,
    with_ambiguities,
)
from smoother.recovery.trust import with_gap_verdicts
from smoother.result import Recovery
from smoother.rotation import Rotation
from smoother.selfcal.mounting import sphere
from tools.reliability.scenes import draw_scene

#: When the wrist is hidden, s.
GAP_S = (8.0, 10.0)
MIRROR = np.diag([-1.0, 1.0, 1.0])


@pytest.mark.slow
def test_a_mirrored_skeleton_is_named_though_it_fits() -> None:
    """An arm that the camera sees in one upright plane, and that moves freely where it does not."""
    scene = draw_scene("in one plane", 24.0, 5)
    recording = scene.with_arm(position=scene.recording.arm.position @ MIRROR).recording
    mirrored = answer(recording).estimates
    assert mirrored.trusted is False and "--mirror x" in mirrored.remedies
    assert mirrored.reasons[0].startswith("the skeleton seems mirrored (x)")
    corrected = answer(Remedy(mirror="x").applied(recording)).estimates
    assert corrected.trusted
    assert not any("mirrored" in reason for each in corrected.untrusted for reason in each.reasons)


@pytest.fixture(scope="module")
def path() -> tuple[Recording, Recovery]:
    """A path made by hand, which bends to all sides; hidden for two seconds."""
    recording = make_recording(20.0, noise_m=0.0)
    arm = recording.arm
    arm = arm.hide((arm.t_s > GAP_S[0]) & (arm.t_s < GAP_S[1]), ("elbow", "wrist", "hand"))
    recording = replace(recording, arm=arm, camera_frame=CameraFrame.KINECT)
    recovery = make_recovery(recording)
    return recording, replace(recovery, estimates=replace(recovery.estimates, trusted=True))


def judged(recording: Recording, recovery: Recovery, *others: Explanation) -> Recovery:
    """With the verdict, if these were the other explanations."""
    own = Explanation(np.eye(3), np.array([0.0, 1.0, 0.0]), 0.0)
    with patch.object(ambiguity, "explanations", lambda *args: (own, others)):
        return with_ambiguities(recovery, recording, [])


def mirror(cost: float, **more: float) -> Explanation:
    """The mirror image, x the other way."""
    return Explanation(MIRROR, np.array([0.0, 1.0, 0.0]), cost, **more)


def test_a_gap_that_another_explanation_contradicts(path: tuple[Recording, Recovery]) -> None:
    ambiguous = judged(*path, mirror(3.0))
    (gap,) = ambiguous.estimates.untrusted
    assert (gap.start_s, gap.end_s) == pytest.approx(GAP_S, abs=0.1)
    assert "a mirrored skeleton fits the visible motion about as well" in gap.reasons[0]
    assert gap.reasons[0].endswith("run again with --mirror x")
    # the only gap: nothing is left to trust
    found = with_gap_verdicts(ambiguous).estimates
    assert found.trusted is False and found.reasons == gap.reasons and found.remedies == ()


def test_what_fits_clearly_better_is_the_cause(path: tuple[Recording, Recovery]) -> None:
    """Also where the answer is not trusted already; one that fits badly, or as well as the answer, is not."""
    recording, recovery = path
    better = judged(*path, mirror(-20.0)).estimates
    assert better.trusted is False and not better.untrusted
    assert better.remedies == ("--mirror x", "--negate accelerometer")
    undone = judged(replace(recording, applied_fixes=("--mirror x",)), recovery, mirror(-20.0)).estimates
    assert undone.remedies == () and undone.cause is not None
    assert undone.cause.endswith("run again without --mirror x")
    alone = judged(*path).estimates  # what does not fit at all is left out by `explanations`
    assert alone.trusted and not alone.untrusted and alone.remedies == ()
    distrusted = replace(recovery, estimates=replace(recovery.estimates, trusted=False, reasons=("why",)))
    named = judged(recording, distrusted, mirror(-20.0)).estimates
    assert named.cause == named.reasons[0] != "why" and named.reasons[1:] == ("why",)
    for unfit in (mirror(-20.0, direction_rad=0.5), mirror(0.0)):
        assert judged(recording, distrusted, unfit) is distrusted


def test_another_mounting(path: tuple[Recording, Recovery]) -> None:
    recording, recovery = path
    turned = Explanation(np.eye(3), np.array([np.sin(0.6), np.cos(0.6), 0.0]), 2.0)
    (gap,) = judged(*path, turned).estimates.untrusted
    assert gap.reasons[0].startswith("a mounting of the sensor that is 34 degrees off fits")
    # less likely than a mounting may be, and one that differs by less than sigma states
    assert judged(*path, replace(turned, cost=6.0)).estimates.trusted
    unsure = replace(recovery, pose_covariance=recovery.pose_covariance * 2000.0)
    assert judged(recording, unsure, turned).estimates.trusted


#: The forearm in the sensor, and a joint's lever arm, m.
ALONG_A, LEVER_A = unit(np.array([0.9, 0.3, -0.2])), np.array([0.05, -0.03, 0.02])


def scene(rng: np.random.Generator, *, plane: bool = False, mirror: bool = False, count: int = 200) -> Seen:
    """What a camera sees of a forearm that turns, with a degree of noise; in one plane where asked for."""
    turns = rng.normal(size=(count, 3)) * ([0.0, 0.0, 1.2] if plane else 1.0)
    start = Rotation.from_matrix(nearest_rotation(rng.normal(size=(3, 3)))).as_matrix()
    if plane:  # the forearm lies in the plane that it turns in
        here = start @ ALONG_A
        into = unit(np.array([1.0, 0.2, 0.0]))
        axis = unit(np.cross(here, into))
        start = Rotation.from_rotvec(axis * np.arccos(here @ into)).as_matrix() @ start
    R_K_A = Rotation.from_rotvec(turns).as_matrix() @ start
    imu_K = rng.normal(size=(count, 3)) * ([1.0, 1.0, 0.0] if plane else 1.0)
    turn_K = rng.normal(size=(count, 3, 3)) * 3.0
    if plane:
        turn_K[:, 2] = 0.0
    image = MIRROR if mirror else np.eye(3)
    along_K = unit((R_K_A @ ALONG_A) @ image + 0.02 * rng.normal(size=(count, 3)))
    acc_K = (imu_K + turn_K @ LEVER_A) @ image + 0.1 * rng.normal(size=(count, 3))
    return Seen(along_K, R_K_A, acc_K, imu_K, turn_K, LEVER_A)


def slow_cost(
    what: Seen, weights: tuple[float, float], gravity: FloatArray, one: tuple[FloatArray, ...]
) -> float:
    """The cost as its definition has it, sample by sample."""
    Q, f, lever = one
    pairs = zip(what.acc_K, what.imu_K, what.turn_K, strict=True)
    directions = [np.sum((d - Q @ R @ f) ** 2) for d, R in zip(what.along_K, what.R_K_A, strict=True)]
    accelerations = [np.sum((a - Q @ (b + T @ lever)) ** 2) for a, b, T in pairs]
    prior = 0.5 * np.sum((lever - what.lever_A) ** 2) / LEVER_SIGMA_M**2
    down = np.linalg.norm(gravity) - np.sum(Q * gravity)
    return float(weights[0] * np.mean(directions) + weights[1] * np.mean(accelerations) + down + prior)


def weights_of(what: Seen, one: tuple[FloatArray, ...]) -> tuple[float, float]:
    """n_d / s_d^2 and 3 n_a / (2 s_a^2), from what an explanation leaves."""
    Q, f, lever = one
    left_d = what.along_K - np.einsum("ij,njk,k->ni", Q, what.R_K_A, f)
    left_a = what.acc_K - np.einsum("ij,nj->ni", Q, what.imu_K + what.turn_K @ lever)
    square_d = max(np.mean(np.sum(left_d**2, axis=1)), 2.0 * LEAST_RAD**2)
    square_a = max(np.mean(np.sum(left_a**2, axis=1)), 3.0 * LEAST_ACCELERATION**2)
    return effective_count(left_d) / square_d, 1.5 * effective_count(left_a) / square_a


def test_second_moments_give_the_cost_of_the_plain_sum() -> None:
    rng = np.random.default_rng(1)
    what = scene(rng)
    truth = (np.eye(3), ALONG_A, LEVER_A)
    gravity = np.outer(unit(np.array([0.1, -1.0, 0.2])), unit(np.array([0.0, -1.0, 0.1]))) / 0.07
    likelihood = Likelihood(what, truth, gravity)
    weights = weights_of(what, truth)
    for sign in (1.0, -1.0):
        found = likelihood.lowest(sphere(5), LEVER_A, (sign,), steps=3)
        for Q, f, lever, cost in zip(*found, strict=True):
            assert np.linalg.det(Q) == pytest.approx(sign)
            assert cost == pytest.approx(slow_cost(what, weights, gravity, (Q, f, lever)), rel=1e-9)


@pytest.mark.parametrize(
    ("mirror", "plane", "is_accelerated"),
    [(False, False, True), (True, False, True), (False, False, False), (False, True, True)],
)
def test_the_lowest_of_both_kinds(mirror: bool, plane: bool, is_accelerated: bool) -> None:
    """Free motion tells a mirrored skeleton. In one plane a half turn makes the one the other."""
    what = scene(np.random.default_rng(3), mirror=mirror, plane=plane)
    if not is_accelerated:
        none = np.zeros((0, 3))
        what = replace(what, acc_K=none, imu_K=none, turn_K=np.zeros((0, 3, 3)))
    image = MIRROR if mirror else np.eye(3)
    likelihood = Likelihood(what, (image, ALONG_A, LEVER_A), np.zeros((3, 3)))
    lowest = {}
    for sign in (1.0, -1.0):
        every = likelihood.lowest(sphere(30), LEVER_A, (sign,))
        lowest[sign] = [each[int(np.argmin(every[3]))] for each in every]
    right, wrong = lowest.pop(np.linalg.det(image)), *lowest.values()
    if plane:  # two explanations of the same noise: some units of log-likelihood
        assert abs(wrong[3] - right[3]) < 5.0
        return
    for found, true in zip(right, (image, ALONG_A, LEVER_A), strict=False):
        np.testing.assert_allclose(found, true, atol=0.01)
    assert wrong[3] - right[3] > 100.0 or not is_accelerated


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_effective_count_of_noise_with_a_memory(memory: float) -> None:
    """Of a first-order autoregression n (1 - r) / (1 + r) are independent (Bayley and Hammersley 1946)."""
    rng = np.random.default_rng(6)
    count = 4000
    noise = np.zeros((count, 3))
    for k in range(1, count):
        noise[k] = memory * noise[k - 1] + rng.normal(size=3)
    expected = count * (1.0 - memory) / (1.0 + memory)
    # the tail below a correlation of 0.05 is left out, and the rest is an estimate
    assert effective_count(noise) == pytest.approx(expected, rel=0.2)
    assert effective_count(np.ones((10, 3))) == 10.0


def test_how_far_explanations_are_apart() -> None:
    turn = Rotation.from_rotvec([0.0, 0.3, 0.0]).as_matrix()
    one = Explanation(np.eye(3), np.array([1.0, 0.0, 0.0]), 0.0)
    assert one.apart_rad(replace(one, Q_K=turn)) == pytest.approx(0.3)
    assert one.apart_rad(replace(one, along_A=np.array([0.0, 1.0, 0.0]))) == pytest.approx(np.pi / 2)
    mirrored = replace(one, Q_K=MIRROR)
    assert mirrored.is_mirrored and not one.is_mirrored
    assert mirrored.apart_rad(replace(one, Q_K=MIRROR @ turn)) == pytest.approx(0.3)
