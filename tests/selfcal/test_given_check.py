"""A calibration of another mounting or person is told from the recording's own."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenes import ALONE
from scipy.spatial.transform import Rotation

from smoother import smooth
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.measurements.outliers import reject_by_camera
from smoother.measurements.segment import Segment, split_into_segments
from smoother.selfcal.mounting import contradictions
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm


@cache
def made(seed: int, preset: str) -> SimulatedArm:
    return simulate_arm(ArmSimulation.preset(preset, protocol="random", duration_s=30.0), seed)


def segments_of(arm: SimulatedArm) -> list[Segment]:
    return [reject_by_camera(segment) for segment in split_into_segments(arm.recording, 0.4)]


def turned(arm: ArmCalibration, degrees: float) -> ArmCalibration:
    """The sensor strapped on otherwise: its axes turned about an axis across the forearm."""
    along = arm.forearm_direction
    assert along is not None
    across = np.cross(along, [0.3, 0.5, 0.8])
    turn = Rotation.from_rotvec(degrees * across / np.linalg.norm(across), degrees=True)
    levers = {
        joint: LeverArm(turn.apply(lever.position_m), lever.sigma_m)
        for joint, lever in arm.lever_arms.items()
    }
    return replace(arm, lever_arms=levers, R_F_A=None)


@pytest.mark.parametrize(("seed", "preset"), [(1, "realistic"), (2, "azure"), (3, "white")])
def test_the_recordings_own_calibration_fits(seed: int, preset: str):
    arm = made(seed, preset)
    assert not list(contradictions(segments_of(arm), arm.calibration))


@pytest.mark.parametrize("degrees", [40.0, 90.0, 173.0])
def test_another_mounting_is_named_with_its_angle(degrees: float):
    arm = made(1, "realistic")
    (sentence,) = contradictions(segments_of(arm), turned(arm.calibration, degrees))
    assert sentence.startswith("the calibration does not fit this recording: the IMU sits")
    assert abs(float(sentence.split("sits ")[1].split(" degrees")[0]) - degrees) < 6.0


def test_another_person_is_named_with_the_length():
    arm = made(1, "realistic")
    other = replace(arm.calibration, upper_arm=Length(arm.calibration.upper_arm.value_m - 0.12, 0.005))
    (sentence,) = contradictions(segments_of(arm), other)
    assert "its upper arm is" in sentence
    unsure = replace(other, upper_arm=Length(other.upper_arm.value_m, 0.08))
    assert not list(contradictions(segments_of(arm), unsure))


def test_nothing_given_nothing_said():
    assert not list(contradictions(segments_of(made(1, "realistic")), ArmCalibration()))


def test_the_verdict_begins_with_it():
    arm = made(1, "realistic")
    recovery = smooth(replace(arm.recording, truth=None), turned(arm.calibration, 90.0), ALONE)
    assert recovery.estimates.verdict.startswith("Not to be trusted: the calibration seems to be of another")
    assert any("the calibration does not fit this recording" in each for each in recovery.estimates.reasons)


def test_a_mounting_with_a_rival_is_used_with_care():
    """An arm that hardly moves in view leaves open how the sensor sits; one that moves does not."""
    still = simulate_arm(ArmSimulation(repetitions=1, still_all=True), 1).recording
    cautions = smooth(replace(still, truth=None), config=ALONE).estimates.cautions
    assert any("fits the visible motion nearly as well" in caution for caution in cautions)
    moving = smooth(replace(made(1, "realistic").recording, truth=None), config=ALONE).estimates.cautions
    assert not any("fits the visible motion" in caution for caution in moving)
