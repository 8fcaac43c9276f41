"""The held pose of simulated arms and the strap in rendered images: measures, sigma, what breaks them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import done
from scipy.spatial.transform import Rotation

from calib import read_calibration
from calib.forearm import (
    ForearmCalibration,
    calibrate_forearm,
    compare,
    find_held_pose,
    forearm_answer,
)
from calib.intrinsics import Intrinsics, PlacedCamera
from calib.strap import Depth, find_strap
from smoother.config import Config
from smoother.errors import CalibrationError
from smoother.io import write_recording
from smoother.linalg import unit
from smoother.simulation import ArmSimulation, simulate_arm
from smoother.simulation.arm import SimulatedArm
from smoother.simulation.strap import Arm, Met, Surface, first_met, render

ONE_PROCESS = Config.model_validate({"windows": {"processes": 1}})
SEEDS = (1, 4)


@pytest.fixture(scope="module")
def arms() -> list[tuple[SimulatedArm, ForearmCalibration]]:
    """Realistic arms whose strap is seen, with what their pose tells."""
    found = []
    for seed in SEEDS:
        arm = simulate_arm(ArmSimulation.preset("realistic", repetitions=1, strap=True), seed)
        found.append((arm, calibrate_forearm(arm.recording, config=ONE_PROCESS)))
    return found


@pytest.mark.slow
def test_measures_are_right_within_their_sigmas(arms):
    sigmas = []
    for arm, found in arms:
        m, true = found.measured, arm.parameters
        assert found.strap_from == "seen"
        for measured, value in (
            (m["d_ul"], true["upper_arm_m"]),
            (m["forearm"], true["forearm_m"]),
            (m["d_sw"], true["strap_to_wrist_m"]),
            (m["d_se"], true["forearm_m"] - true["strap_to_wrist_m"]),
        ):
            assert 0.002 < measured.sigma_m < 0.025
            sigmas.append((measured.value_m - value) / measured.sigma_m)
        for joint, lever in found.calibration.lever_arms.items():
            sigmas += (
                (lever.position_m - arm.calibration.lever_arms[joint].position_m) / lever.sigma_m
            ).tolist()
    assert np.mean(np.square(sigmas)) < 2 and np.abs(sigmas).max() < 3.5


def test_pose_and_motion_agree(arms):
    for _, found in arms:
        rows = compare(found)
        names = {row.measure for row in rows}
        assert names >= {"upper arm", "forearm", "radius", "strap to wrist", "direction"}
        assert all(row.agrees for row in rows), [row for row in rows if not row.agrees]
        assert forearm_answer(found).grade == "good"


def test_what_broke_is_named(arms):
    """The palm turned away: R_F_A rolls; a strap that slid by 7 cm: the lengths along the forearm."""
    _, found = arms[0]
    turned = Rotation.from_euler("y", 80, degrees=True).as_matrix()
    away = replace(found, calibration=replace(found.calibration, R_F_A=turned @ found.calibration.R_F_A))
    rows = compare(away)
    if any(row.measure == "roll" for row in rows):  # the motion told the roll
        assert [row.measure for row in rows if not row.agrees] == ["roll"]
        answer = forearm_answer(away)
        assert any("palm square to the camera" in text for text in answer.next)
    m = found.measured
    slid = m | {"d_sw": replace(m["d_sw"], value_m=m["d_sw"].value_m + 0.07)}
    rows = compare(replace(found, measured=slid))
    assert [row.measure for row in rows if not row.agrees] == ["strap to wrist"]
    assert any("the strap slid" in text for text in forearm_answer(replace(found, measured=slid)).next)


@pytest.mark.parametrize("protocol", ["random", "behind"])
def test_an_arm_that_moves_holds_no_pose(protocol):
    recording = simulate_arm(ArmSimulation(protocol=protocol, duration_s=20), 3).recording
    with pytest.raises(
        CalibrationError, match=r"the sensor turns by \d+ degrees/s, so no pose is held there"
    ):
        find_held_pose(recording, 8.0, 14.0)


def test_a_gyroscopes_bias_is_no_turning(arms):
    recording = arms[0][0].recording
    bias = np.radians([0.0, 9.0, -12.0])
    biased = replace(recording, imu=replace(recording.imu, gyro=recording.imu.gyro + bias))
    plain, found = find_held_pose(recording), find_held_pose(biased)
    assert (found.start_s, found.end_s) == pytest.approx((plain.start_s, plain.end_s), abs=0.05)
    assert found.turning_rad_s == pytest.approx(plain.turning_rad_s, rel=1e-6)
    assert find_held_pose(biased, plain.start_s, plain.end_s).chosen == "given"


def test_a_pose_without_motion_leaves_the_mounting_open():
    arm = simulate_arm(ArmSimulation.preset("realistic", repetitions=1), 2)
    pose = find_held_pose(arm.recording)
    imu, tracks = arm.recording.imu, arm.recording.arm
    short = replace(
        arm.recording,
        imu=imu.select(imu.t_s < pose.end_s),
        arm=tracks.select(tracks.t_s < pose.end_s),
        truth=None,
    )
    found = calibrate_forearm(short, config=ONE_PROCESS)
    assert found.calibration.lever_arms == {} and found.calibration.R_F_A is None
    assert found.calibration.upper_arm is not None
    answer = forearm_answer(found)
    assert any("lever arms and R_F_A: the sensor's orientation" in text for text in answer.open_questions)
    assert any("move for 20 s" in text for text in answer.next)


def test_no_pose():
    hang = simulate_arm(ArmSimulation(protocol="hang", duration_s=8), 1).recording
    with pytest.raises(CalibrationError, match="no held pose was found"):
        find_held_pose(hang)
    with pytest.raises(CalibrationError, match="are tracked together in 0 frames"):
        find_held_pose(hang, 100.0, 101.0)
    assert find_held_pose(hang, 2.0, 4.0).chosen == "given"


@pytest.mark.slow
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    arm = simulate_arm(ArmSimulation.preset("realistic", repetitions=1), 4)
    write_recording(arm.recording, tmp_path / "rec.mcap")
    cal, figures = tmp_path / "cal.toml", tmp_path / "f.json"
    ruler = ("--radius-m", 0.035, "--strap-to-wrist-m", arm.parameters["strap_to_wrist_m"])
    arguments = ("calibrate", "forearm", tmp_path / "rec.mcap", *ruler, "--processes", 1, "-o", cal)
    done(*arguments, "--json", figures)
    printed = capsys.readouterr().out
    assert "Against motion" in printed and "Measures" in printed
    held, said = read_calibration(cal), json.loads(figures.read_text())
    assert held.arms["right"].R_F_A is not None and set(held.arms["right"].lever_arms) == {
        "elbow",
        "wrist",
        "hand",
    }
    assert held.tables["forearm"]["right"]["strap_from"] == "ruler"
    assert held.tables["forearm"]["right"]["r_m"] == pytest.approx(0.035)
    assert said["measures"]["d_ul"]["value_m"] == pytest.approx(held.arms["right"].upper_arm.value_m)
    assert said["pose"]["to_s"] - said["pose"]["from_s"] > 1.0
    # what the pose gave serves to recover
    out = tmp_path / "out.mcap"
    done("smooth", tmp_path / "rec.mcap", "-o", out, "--calibration", cal, "--processes", 1, "--draws", 0)


#: The colour camera sits 5 cm beside the depth camera, as in a Kinect.
COLOUR = PlacedCamera(Intrinsics(640, 360, 450.0, 450.0, 320.0, 180.0), t_C_K=np.array([0.05, 0.0, 0.0]))
INFRARED = PlacedCamera(Intrinsics(512, 424, 366.0, 366.0, 256.0, 212.0))


def an_arm(seed: int) -> tuple[Arm, list[Surface], np.random.Generator]:
    """A forearm somewhere in view, its strap near the wrist, often with a marker beside it."""
    rng = np.random.default_rng(seed)
    along = rng.normal(size=3) * [1.0, 1.0, 0.4]
    along /= np.linalg.norm(along)
    elbow = np.array([rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), rng.uniform(1.5, 2.5)])
    length = rng.uniform(0.23, 0.28)
    strap, marker = length - rng.uniform(0.03, 0.07), rng.choice([None, 0.03, -0.03])
    arm = Arm(elbow, elbow + length * along, rng.uniform(0.03, 0.04), strap)
    return arm, [] if marker is None else [ball(arm, marker)], rng


def ball(arm: Arm, towards_elbow_m: float) -> Surface:
    """A reflective marker of 14 mm on the arm's near side, beside the strap's middle."""
    core, radius = arm.strap_core - towards_elbow_m * arm.y, 0.007

    def met(origin: np.ndarray, rays: np.ndarray) -> Met:
        into = core - origin
        off = origin - (core - (arm.radius + radius) * unit(into - (into @ arm.y) * arm.y))
        reach = first_met((rays**2).sum(axis=1), rays @ off, float(off @ off) - radius**2)
        return reach, np.full(len(rays), 255.0), np.isfinite(reach)

    return met


def trunk(centre: np.ndarray, half_axes: np.ndarray) -> Surface:
    """A body with folds of the clothes: bands that a search for dark places may take for a strap."""

    def met(origin: np.ndarray, rays: np.ndarray) -> Met:
        ray, off = rays / half_axes, (origin - centre) / half_axes
        reach = first_met((ray**2).sum(axis=1), ray @ off, float(off @ off) - 1.0)
        height = (origin + np.where(np.isfinite(reach), reach, 0)[:, None] * rays)[:, 1]
        return reach, 80.0 * (1 + 0.3 * np.sin(2 * np.pi * height / 0.06)), np.zeros(len(rays), dtype=bool)

    return met


def look(arm: Arm, others: list[Surface], rng: np.random.Generator, joint_sigma_m: float):
    """Render and search, with joints as a camera places them."""
    grey, _ = render(arm, COLOUR, rng, *others)
    _, z = render(arm, INFRARED, rng, *others)
    elbow, wrist = (end + rng.normal(0, joint_sigma_m, 3) for end in (arm.elbow, arm.wrist))
    return find_strap(
        grey,
        COLOUR,
        Depth(z, INFRARED),
        elbow,
        wrist,
        radius_m=arm.radius,
        joint_sigma_m=max(joint_sigma_m, 0.003),
    )


@pytest.mark.slow
def test_five_millimetres():
    errors, nees = [], []
    for seed in range(24):
        seen = look(*an_arm(seed), 0.008)
        arm = an_arm(seed)[0]
        if seen.found:
            error = seen.core - arm.strap_core
            errors.append(error)
            nees.append(error @ np.linalg.solve(seen.covariance, error) / 3)
    assert len(errors) >= 19
    lengths = np.linalg.norm(errors, axis=1)
    assert np.sqrt(np.mean(lengths**2)) < 0.005  # of the whole vector, with joints 8 mm off an axis
    assert lengths.max() < 0.012
    assert np.mean(nees) < 1.5


@pytest.mark.slow
def test_nothing_is_found_where_the_strap_cannot_be_seen():
    """The body stands before the arm while the camera goes on to call its joints tracked; or no strap."""
    accepted = 0
    for seed in range(12):
        arm, others, rng = an_arm(seed)
        middle = 0.5 * (arm.elbow + arm.wrist)
        before = trunk(middle - [0.0, 0.0, 0.3], np.array([0.22, 0.4, 0.12]))
        accepted += look(arm, [before, *others], rng, 0.008).found
        accepted += look(replace(arm, strap=None), [], rng, 0.008).found
    assert accepted == 0


def test_the_papers_criteria():
    arm, _, rng = an_arm(3)
    near = look(replace(arm, strap=0.06), [], rng, 0.0)
    assert near.reason == "the strap is nearer to the elbow than to the wrist"
    assert np.isnan(near.core).all()
    grey, _ = render(arm, COLOUR)
    _, z = render(arm, INFRARED)
    # joints that are both 7 cm too far away, along the ray: the same pixels, another place
    far = [end * (1 + 0.07 / end[2]) for end in (arm.elbow, arm.wrist)]
    lens = replace(COLOUR, t_C_K=np.zeros(3))
    grey, _ = render(arm, lens)
    seen = find_strap(grey, lens, Depth(z, INFRARED), *far, radius_m=arm.radius)
    assert seen.reason == "the strap is more than 5 cm off the elbow-wrist line"
    ahead = np.array([0.0, 0.0, 0.25])
    seen = find_strap(
        grey, lens, Depth(z, INFRARED), np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 2.0]) - ahead
    )
    assert seen.reason == "the forearm points to the camera"
    blind = find_strap(grey, lens, Depth(np.full_like(z, np.nan), INFRARED), arm.elbow, arm.wrist)
    assert blind.reason == "no depth at the strap"
    away = np.array([5.0, 0.0, 0.0])
    outside = find_strap(grey, lens, Depth(z, INFRARED), arm.elbow + away, arm.wrist + away)
    assert outside.reason == "the forearm is not inside the image"
