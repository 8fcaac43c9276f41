"""An IMU on the hand: the same graph, with a row in the table of segments."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from smoother import read_recording, smooth, write_recording
from smoother.io.recording.selection import role, role_among
from smoother.io.recording.streams import ImuSamples
from smoother.io.result.read import read_recovery
from smoother.io.result.write import write_recovery
from smoother.result import Recovery
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm


@pytest.fixture(scope="module")
def made() -> SimulatedArm:
    config = ArmSimulation.preset(
        "realistic",
        protocol="random",
        duration_s=24.0,
        imus="wrist,hand",
        wrist_deg=18.0,
        hand_clock_s=0.15,
        occlusion_lengths_s=(1.0, 2.0),
    )
    return simulate_arm(config, 4)


@pytest.fixture(scope="module")
def recovery(made: SimulatedArm) -> Recovery:
    return smooth(replace(made.recording, truth=None), processes=1, draws=32)


def off(recovery: Recovery, made: SimulatedArm, joint: str) -> tuple[float, float]:
    """Rms error of a joint in gaps, m, and the mean of its squared error in sigmas, an axis."""
    rows = np.flatnonzero(recovery.occluded)
    error = recovery.joints[joint][rows] - made.motion.joints(recovery.t_s[rows])[joint]
    covariance = recovery.joint_covariance[joint][rows]
    squared = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    return float(np.sqrt((error**2).sum(axis=1).mean())), float(squared.mean() / 3.0)


def test_wrist_and_hand_in_gaps(recovery: Recovery, made: SimulatedArm) -> None:
    """Eight arms: wrist 0.8 to 1.4 cm, hand 1.0 to 1.9 cm, mean squared error in sigmas 0.3 to 1.05."""
    assert recovery.estimates.trusted and all(verdict.trusted for verdict in recovery.gap_verdicts)
    wrist_m, wrist_nees = off(recovery, made, "wrist")
    hand_m, hand_nees = off(recovery, made, "hand")
    assert wrist_m < 0.025 and 0.2 < wrist_nees < 2.0
    assert hand_m < 0.022 and 0.2 < hand_nees < 2.0


def test_without_its_imu_the_hand_is_worse(recovery: Recovery, made: SimulatedArm) -> None:
    bare = replace(made.recording, truth=None).with_imu("hand", None)
    alone = smooth(bare, processes=1)
    hand_m, nees = off(alone, made, "hand")
    assert hand_m > 1.6 * off(recovery, made, "hand")[0]  # 2 to 3 times on eight arms
    assert 0.2 < nees < 2.0  # and it says so: 2 to 4 where the hand treated as rigid with the forearm


def test_the_hand_s_orientation_and_clock(recovery: Recovery, made: SimulatedArm) -> None:
    motion = recovery.segments["hand"]
    R, _ = made.further_motions["hand"].imu_pose(recovery.t_s)
    known = np.isfinite(motion.quaternion).all(axis=1)
    assert known.mean() > 0.99
    turn = (
        Rotation.from_quat(motion.quaternion[known], scalar_first=True) * Rotation.from_matrix(R[known]).inv()
    )
    assert np.degrees(np.sqrt((turn.magnitude() ** 2).mean())) < 2.5  # 0.4 to 1.1 on eight arms
    ahead_s = motion.clock_offset_s - recovery.clock_offset_s
    assert ahead_s == pytest.approx(0.15, abs=0.006)  # of 8 arms the worst is 3 ms off
    assert recovery.calibration is not None
    for joint, lever in recovery.calibration.mountings["hand"].lever_arms.items():
        true = made.calibration.mountings["hand"].lever_arms[joint].position_m
        assert np.linalg.norm(lever.position_m - true) < 0.025
    assert "hand" not in recovery.calibration.lever_arms


def test_drawn_hands_have_the_stated_covariance(recovery: Recovery) -> None:
    assert recovery.draws is not None
    drawn = recovery.draws.joints["hand"]
    rows = np.searchsorted(recovery.t_s, recovery.draws.t_s)
    stated = np.sqrt(np.trace(recovery.joint_covariance["hand"][rows], axis1=1, axis2=2))
    found = np.sqrt((drawn**2).sum(axis=2).mean(axis=0))
    # 32 draws: a standard deviation to 13 % an axis; the tie of the two hands' ends adds a little
    assert np.nanmedian(found / stated) == pytest.approx(1.0, abs=0.3)


def test_written_and_read_again(recovery: Recovery, made: SimulatedArm, tmp_path: Path) -> None:
    write_recording(made.recording, tmp_path / "a.mcap")
    back = read_recording(tmp_path / "a.mcap")
    assert back.further_imus["hand"].name == "/imu/hand_right"
    np.testing.assert_allclose(back.further_imus["hand"].acc, made.recording.further_imus["hand"].acc)
    write_recovery(recovery, tmp_path / "out.mcap")
    (found,) = read_recovery(tmp_path / "out.mcap")
    np.testing.assert_allclose(
        found.segments["hand"].quaternion, recovery.segments["hand"].quaternion, atol=1e-6
    )
    assert found.draws is not None and list(found.draws.turns) == ["hand"]
    assert found.calibration is not None and set(found.calibration.mountings) == {"hand"}
    columns = found.to_table().column_names
    assert {"hand_x", "hand_imu_x", "hand_imu_sigma_x", "hand_imu_sigma_deg"} <= set(columns)


def test_one_that_stops_early_is_left_out(made: SimulatedArm) -> None:
    imu = made.recording.further_imus["hand"]
    short = replace(made.recording, truth=None).with_imu("hand", imu.select(imu.t_s < 4.0))
    alone = smooth(short, processes=1)
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
