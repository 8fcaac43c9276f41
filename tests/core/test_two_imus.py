"""Two IMUs on an arm: on wrist and upper arm, and on the hand, from start to end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import Scene, answer, blind, moving, recovered
from scipy.spatial.transform import Rotation

from smoother.angles import shoulder_angles
from smoother.angles.definitions import arm_angles, wrapped_deg
from smoother.io.recording.names import role, role_among
from smoother.io.recording.streams import ImuSamples
from smoother.recording import JOINTS, ImuStream
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm

GAP_S = 8.0


def simulated(preset: str = "white", **changes: object) -> SimulatedArm:
    settings = {
        "imus": "wrist,upper-arm",
        "protocol": "random",
        "duration_s": 30.0,
        "occlusion_lengths_s": (GAP_S,),
        "occlusion_every_s": 18.0,
    }
    return simulate_arm(ArmSimulation.preset(preset, **(settings | changes)), seed=2)


def error_m(scene: Scene) -> float:
    """Rms error of the forearm's IMU in gaps."""
    return scene.validation.occluded.position_rms_m


def one_imu(made: SimulatedArm) -> Scene:
    return blind(made, made.recording.with_imu("upper_arm", None))


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    return simulated(upper_clock_s=0.08, upper_clock_ppm=50.0)


@pytest.fixture(scope="module")
def scene(made: SimulatedArm) -> Scene:
    return blind(made)


@pytest.fixture
def two(scene: Scene) -> Recovery:
    return scene.recovery


@pytest.mark.slow
def test_better_than_one_and_as_good_as_it_says(made: SimulatedArm, scene: Scene) -> None:
    one = one_imu(made)
    assert one.recovery.upper is None and not one.recovery.calibration.upper_imu
    assert error_m(scene) < min(0.006, 1.02 * error_m(one))  # 0.3 cm as measured
    assert scene.validation.occluded.nees < 1.5


@pytest.mark.slow
def test_mounting_and_clock_are_found(made: SimulatedArm, two: Recovery) -> None:
    for joint, lever in two.calibration.upper_imu.items():
        off = lever.position_m - made.calibration.upper_imu[joint].position_m
        assert np.abs(off / lever.sigma_m).max() < 4.0 and np.linalg.norm(off) < 0.01
    # 80 ms, and 50 ppm over a quarter of a minute on the mean; the camera finds both clocks to 1 to 3 ms
    ahead = two.upper.clock_offset_s - two.clock_offset_s
    assert ahead == pytest.approx(0.08, abs=0.004)


def test_the_upper_arms_pose_and_the_shoulders_angles(made: SimulatedArm, two: Recovery) -> None:
    known = np.flatnonzero(np.isfinite(two.upper.position[:, 0]))
    assert len(known) > 0.99 * len(two)
    part = two.rows(known)
    R, position = made.further_motions["upper_arm"].imu_pose(part.t_s)
    turn = Rotation.from_quat(part.upper.quaternion, scalar_first=True) * Rotation.from_matrix(R).inv()
    assert np.sqrt(np.mean(np.sum((part.upper.position - position) ** 2, axis=1))) < 0.006
    assert np.degrees(turn.magnitude()).max() < 1.5
    angles, sigmas = shoulder_angles(part)
    lateral, _ = made.motion.bone_axes(part.t_s)  # type: ignore[attr-defined]
    joints = made.motion.joints(part.t_s)
    truth = arm_angles(joints, len(part), None, "right", part.gravity_direction, flexion_axis=lateral)
    raised = truth["shoulder_elevation"] > 15.0
    for name, angle in angles.items():
        off = wrapped_deg(angle - truth[name])[raised]
        assert np.sqrt(np.mean(off**2)) < 1.0, name  # 0.1 to 0.3 as measured
        assert np.mean((off / sigmas[name][raised]) ** 2) < 1.5


@pytest.mark.slow
def test_one_imu_where_the_other_pauses(made: SimulatedArm, two: Recovery) -> None:
    """Ten seconds without upper-arm samples, a gap's end among them."""
    upper = made.recording.upper_imu
    end_s = next(gap.end_s for gap in two.gaps if gap.length_s > 1.0)
    t = upper.t_s - 0.08
    paused = upper.select((t < end_s - 1.0) | (t > end_s + 9.0))
    found = blind(made, made.recording.with_imu("upper_arm", paused))
    recovery, t = found.recovery, found.recovery.t_s
    assert recovery.upper is not None and np.isfinite(recovery.position).all()
    known = np.isfinite(recovery.upper.position[:-5, 0])
    assert not known[((t > end_s + 0.5) & (t < end_s + 8.5))[:-5]].any()
    assert known[((t < end_s - 1.5) | (t > end_s + 9.5))[:-5]].all()
    assert error_m(found) < 0.01


@pytest.mark.slow
def test_every_sample_of_a_gap_at_the_end_is_answered() -> None:
    made = simulated(occlusion_lengths_s=(), end_gap_s=15.0)
    both, one = blind(made), one_imu(made)
    sigma = both.recovery.worst_sigma_m
    assert both.recovery.answered.all() and one.recovery.answered.all()
    assert error_m(both) < 0.01 and error_m(one) < 0.05  # 1 cm as measured
    assert sigma[-200:-20].max() < 0.02 < 0.2  # it does not grow with the time
    # one IMU answers to the end as well, and says that it is less certain
    assert one.recovery.worst_sigma_m[-20:].min() > 1.5 * sigma[-20:].max()
    assert one.validation.occluded.nees < 1.5


@pytest.mark.slow
def test_a_wrist_that_is_hidden_for_half_a_minute() -> None:
    found = blind(simulated(duration_s=52.0, occlusion_lengths_s=(30.0,), occlusion_every_s=38.0))
    recovery = found.recovery
    assert max(gap.length_s for gap in recovery.gaps) > 29.0
    assert recovery.answered.all() and error_m(found) < 0.008  # 0.3 cm as measured
    assert recovery.worst_sigma_m[recovery.occluded].max() < 0.02


@pytest.mark.slow
def test_a_hidden_shoulder_loses_the_room_but_not_the_arm() -> None:
    found = blind(simulated(shoulder_lost=1.0))
    recovery, inside = found.recovery, found.recovery.occluded
    wrist, true = (
        (each.joints["wrist"] - each.joints["shoulder"])[inside] for each in (recovery, found.recording.truth)
    )
    assert np.sqrt(np.mean(np.sum((wrist - true) ** 2, axis=1))) < 0.01
    assert np.nanmax(recovery.worst_sigma_m[inside]) > 0.03  # and says so


@pytest.mark.slow
def test_a_shoulder_that_is_never_seen(made: SimulatedArm) -> None:
    """Nothing says how the upper-arm IMU sits: it is left out, in a sentence, and one IMU answers."""
    hidden = made.recording.arm.hide(np.ones(len(made.recording.arm), bool), ("shoulder",))
    recording = replace(made.recording, arm=hidden)
    recovery = answer(recording)
    assert recovery.upper is None
    assert any("left out" in note and "upper_arm_right" in note for note in recovery.notes)
    one = answer(recording.with_imu("upper_arm", None))
    np.testing.assert_array_equal(recovery.position, one.position)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("whose", "words"),
    [("nobody", "left out"), ("somebody else", "check that it was on this upper arm")],
)
def test_an_imu_that_is_not_on_this_upper_arm(made: SimulatedArm, whose: str, words: str) -> None:
    """It lies on the table, or wrist and upper arm are mixed up: it must not spoil the answer."""
    rng, t = np.random.default_rng(0), made.recording.imu.t_s
    force = np.array([0.0, 0.0, 9.81]) + rng.normal(0, 0.03, (len(t), 3))
    other = ImuStream("/imu/upper_arm_right", t, force, rng.normal(0, 0.003, (len(t), 3)))
    if whose == "somebody else":
        settings = ArmSimulation(imus="wrist,upper-arm", protocol="random", duration_s=30.0)
        other = simulate_arm(settings, seed=77).recording.upper_imu
    recovery = answer(made.recording.with_imu("upper_arm", other))
    assert recovery.upper is None and any(words in note for note in recovery.notes)


@pytest.mark.slow
def test_calibrated_beforehand(made: SimulatedArm) -> None:
    found = recovered(made)
    assert error_m(found) < 0.005
    elbow, true = (
        each.upper_imu["elbow"].position_m for each in (found.recovery.calibration, made.calibration)
    )
    assert np.linalg.norm(elbow - true) < 0.004
    assert JOINTS[0] in found.recovery.joints


@pytest.fixture(scope="module")
def hand_arm() -> SimulatedArm:
    worn = {"imus": "wrist,hand", "wrist_deg": 18.0, "hand_clock_s": 0.15}
    return moving(4, duration_s=24.0, occlusion_lengths_s=(1.0, 2.0), **worn)


@pytest.fixture(scope="module")
def recovery(hand_arm: SimulatedArm) -> Recovery:
    return answer(hand_arm.recording, draws=32)


def off(recovery: Recovery, hand_arm: SimulatedArm, joint: str) -> tuple[float, float]:
    """Rms error of a joint in gaps, m, and the mean of its squared error in sigmas, an axis."""
    rows = np.flatnonzero(recovery.occluded)
    error = recovery.joints[joint][rows] - hand_arm.motion.joints(recovery.t_s[rows])[joint]
    covariance = recovery.joint_covariance[joint][rows]
    squared = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    return float(np.sqrt((error**2).sum(axis=1).mean())), float(squared.mean() / 3.0)


@pytest.mark.slow
def test_wrist_and_hand_in_gaps(recovery: Recovery, hand_arm: SimulatedArm) -> None:
    """Eight arms: wrist 0.8 to 1.4 cm, hand 1.0 to 1.9 cm, mean squared error in sigmas 0.3 to 1.05."""
    assert recovery.estimates.trusted and all(verdict.trusted for verdict in recovery.gap_verdicts)
    wrist_m, wrist_nees = off(recovery, hand_arm, "wrist")
    hand_m, hand_nees = off(recovery, hand_arm, "hand")
    assert wrist_m < 0.025 and 0.2 < wrist_nees < 2.0
    assert hand_m < 0.022 and 0.2 < hand_nees < 2.0


@pytest.mark.slow
def test_without_its_imu_the_hand_is_worse(recovery: Recovery, hand_arm: SimulatedArm) -> None:
    alone = answer(hand_arm.recording.with_imu("hand", None))
    hand_m, nees = off(alone, hand_arm, "hand")
    assert hand_m > 1.6 * off(recovery, hand_arm, "hand")[0]  # 2 to 3 times on eight arms
    assert 0.2 < nees < 2.0  # and it says so: 2 to 4 where the hand treated as rigid with the forearm


def test_the_hand_s_orientation_and_clock(recovery: Recovery, hand_arm: SimulatedArm) -> None:
    motion = recovery.segments["hand"]
    R, _ = hand_arm.further_motions["hand"].imu_pose(recovery.t_s)
    known = np.isfinite(motion.quaternion).all(axis=1)
    assert known.mean() > 0.99
    turn = (
        Rotation.from_quat(motion.quaternion[known], scalar_first=True) * Rotation.from_matrix(R[known]).inv()
    )
    assert np.degrees(np.sqrt((turn.magnitude() ** 2).mean())) < 2.5  # 0.4 to 1.1 on eight arms
    ahead_s = motion.clock_offset_s - recovery.clock_offset_s
    assert ahead_s == pytest.approx(0.15, abs=0.006)  # of 8 arms the worst is 3 ms off
    for joint, lever in recovery.calibration.mountings["hand"].lever_arms.items():
        true = hand_arm.calibration.mountings["hand"].lever_arms[joint].position_m
        assert np.linalg.norm(lever.position_m - true) < 0.025
    assert "hand" not in recovery.calibration.lever_arms


def test_drawn_hands_have_the_stated_covariance(recovery: Recovery) -> None:
    drawn = recovery.draws.joints["hand"]
    rows = np.searchsorted(recovery.t_s, recovery.draws.t_s)
    stated = np.sqrt(np.trace(recovery.joint_covariance["hand"][rows], axis1=1, axis2=2))
    found = np.sqrt((drawn**2).sum(axis=2).mean(axis=0))
    # 32 draws: a standard deviation to 13 % an axis; the tie of the two hands' ends adds a little
    assert np.nanmedian(found / stated) == pytest.approx(1.0, abs=0.3)


def test_one_that_stops_early_is_left_out(hand_arm: SimulatedArm) -> None:
    imu = hand_arm.recording.further_imus["hand"]
    alone = answer(hand_arm.recording.with_imu("hand", imu.select(imu.t_s < 4.0)))
    assert not alone.segments and np.isfinite(alone.joints["hand"]).all(axis=1).mean() > 0.99
    assert any("has samples in 16 % of the recording only" in note for note in alone.notes)


def stream(topic: str) -> ImuSamples:
    return ImuSamples(topic, "", np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), None)


@pytest.mark.parametrize(
    ("topics", "roles"),
    [
        (("/imu/forearm_right", "/imu/hand_right"), ("forearm", "hand")),
        (("/imu/wrist", "/imu/RightHand"), ("forearm", "hand")),
        # the only one of its arm: worn where a hand begins, as it was before there were two
        (("/imu/hand_right",), ("forearm",)),
        (("/imu/forearm_right", "/imu/hand_left"), ("forearm", "forearm")),
        (("/imu/handheld_wrist",), ("forearm",)),
        (("/imu/arm", "/imu/palm"), ("forearm", "hand")),
    ],
)
def test_names(topics: tuple[str, ...], roles: tuple[str, ...]) -> None:
    imus = [stream(topic) for topic in topics]
    assert tuple(role_among(imu, imus) for imu in imus) == roles
    assert role(stream("/imu/hand")) == "hand"
