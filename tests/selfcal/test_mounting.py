"""The closed-form mounting from visible motion alone; a calibration of another mounting or person is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from curve import Curve
from scenes import answer, arm, moving
from scipy.spatial.transform import Rotation

from smoother.array_types import FloatArray
from smoother.calibration import ArmCalibration, Length, LeverArm
from smoother.measurements.outliers import reject_by_camera
from smoother.measurements.segment import Segment, split_into_segments
from smoother.recording import JOINTS, Recording
from smoother.selfcal.mounting import (
    ACCELERATION_SHARE,
    CHUNK_S,
    DIRECTION_DEG,
    DIRECTION_SIGMA_RAD,
    HINT_SIGMA_RAD,
    SURE_RAD,
    ClosedForm,
    Mounting,
    _both,
    _losses,
    contradictions,
    find_mounting,
    sphere,
)
from smoother.simulation import ArmSimulation, SimulatedArm, simulate_arm

#: Offset (s), direction (degrees) and lever arms (m): what the closed form must be good to. The graph
#: refines from here; it finds its way from 18 ms, 10 degrees and 4 cm.
LIMITS = {
    "clean": (0.004, 1.0, 0.015),
    "white": (0.006, 2.0, 0.030),
    "realistic": (0.018, 4.0, 0.045),
}


def found_in(*recordings: Recording) -> Mounting:
    segments = [
        reject_by_camera(segment)
        for number, recording in enumerate(recordings)
        for segment in split_into_segments(recording, number)
    ]
    return find_mounting(segments, ArmCalibration())


def degrees_between(a: FloatArray, b: FloatArray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1.0, 1.0))))


def errors(found: Mounting, made: SimulatedArm, number: int = 0) -> tuple[float, float, float]:
    """Offset (s), direction (degrees), and the worst lever arm (m)."""
    along, true = found.calibration.forearm_direction, made.calibration.forearm_direction
    levers = [
        float(np.linalg.norm(lever.position_m - made.calibration.lever_arms[joint].position_m))
        for joint, lever in found.calibration.lever_arms.items()
    ]
    assert set(found.calibration.lever_arms) == {"elbow", "wrist", "hand"}
    offset = abs(float(found.offset_s[number]) - made.parameters["clock_offset_s"])
    return offset, degrees_between(along, true), max(levers)


@pytest.mark.parametrize(
    ("preset", "seed", "latency_s"),
    [
        *((preset, seed, 0.03 * (seed - 1)) for preset in LIMITS for seed in range(4)),
        ("white", 5, -0.2),
        ("white", 5, 0.2),
    ],
)
def test_simulated_arms(preset: str, seed: int, latency_s: float) -> None:
    made = arm(seed, preset, repetitions=1, latency_s=latency_s)
    found = found_in(made.recording)
    assert np.less(errors(found, made), LIMITS[preset]).all()
    assert found.direction_spread_rad < SURE_RAD
    for lever in found.calibration.lever_arms.values():
        assert (lever.sigma_m >= 0.01).all()


def test_two_recordings_have_an_offset_each() -> None:
    one, two = (arm(2, repetitions=1, latency_s=latency) for latency in (0.05, -0.08))
    found = found_in(one.recording, two.recording)
    for number, made in enumerate((one, two)):
        assert np.less(errors(found, made, number), LIMITS["white"]).all()


def test_what_is_known_is_kept() -> None:
    made = arm(1, repetitions=1)
    (segment,) = split_into_segments(made.recording)
    wrist = made.calibration.lever_arms["wrist"]
    found = find_mounting([segment], ArmCalibration("right", {"wrist": wrist}))
    assert found.calibration.lever_arms["wrist"] is wrist
    assert errors(found, made)[2] < 0.01  # the others hang on the wrist by differences that were seen


def slow_loss(segment: Segment, offset_s: float, direction: FloatArray) -> float:
    """Wahba's loss by scipy, stretch by stretch: half the weighted squared distance, in sigmas squared."""
    rows = np.flatnonzero(_both(segment))
    elbow, wrist = (segment.position[rows, JOINTS.index(joint)] for joint in ("elbow", "wrist"))
    seen = (wrist - elbow) / np.linalg.norm(wrist - elbow, axis=1)[:, None]
    t = segment.frame_t_camera[rows]
    inertial = segment.attitude.at(t + offset_s).apply(direction)
    hint = (DIRECTION_SIGMA_RAD / HINT_SIGMA_RAD) ** 2
    total = 0.0
    for part in range(int((t[-1] - t[0]) / CHUNK_S) + 1):
        own = np.floor((t - t[0]) / CHUNK_S) == part
        in_K, in_E = np.vstack([seen[own], segment.down]), np.vstack([inertial[own], [0.0, 0.0, -1.0]])
        weights = np.append(np.ones(own.sum()), hint)
        _, distance = Rotation.align_vectors(in_K, in_E, weights=weights)[:2]
        total += 0.5 * distance**2 - hint  # the fast one leaves the hint's own length out
    return float(total / DIRECTION_SIGMA_RAD**2)


def test_the_grid_against_another_solution_of_wahba_s_problem() -> None:
    made = arm(3, protocol="random", duration_s=45.0)
    (segment,) = split_into_segments(made.recording)
    offsets, directions = np.array([-0.1, 0.0, 0.06]), sphere(12)
    fast = _losses(segment, _both(segment), offsets, directions)
    for i, offset in enumerate(offsets):
        for k in (0, 5, 11):
            assert fast[i, k] == pytest.approx(slow_loss(segment, offset, directions[k]), rel=1e-6, abs=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_the_sign_in_a_vertical_plane(seed: int) -> None:
    """Directions in a plane fit their opposites as well; only where down is shows which is which."""
    rng, curve = np.random.default_rng(seed), Curve(seed, 0.8, turns_rad=(0.0, 0.0, 1.2))
    imu, t = curve.imu(100.0, 20.0), np.arange(0.1, 19.9, 1 / 30)
    noise = np.array([0.03, 0.003])[:, None, None] * rng.normal(size=(2, len(imu), 3))
    along, joints = np.array([0.0, np.cos(seed), np.sin(seed)]), {}
    for joint, reach_m in (("elbow", -0.2), ("wrist", 0.05)):
        place = curve.position(t) + curve.rotation(t).apply(reach_m * along + np.array([0.03, 0.0, 0.0]))
        joints[joint] = place + 0.008 * rng.normal(size=place.shape)
    samples = imu.t_s, imu.acc + noise[0], imu.gyro + noise[1]
    seen = Recording.from_arrays(*samples, t, joints, camera_frame="kinect")
    found, blindly = found_in(seen), found_in(replace(seen, camera_frame=None))
    assert degrees_between(found.calibration.forearm_direction, along) < 4.0
    assert found.direction_spread_rad < np.pi / 2 < blindly.direction_spread_rad


def segments_of(arm: SimulatedArm) -> list[Segment]:
    return [reject_by_camera(segment) for segment in split_into_segments(arm.recording)]


def turned(arm: ArmCalibration, degrees: float) -> ArmCalibration:
    """The sensor strapped on otherwise: its axes turned about an axis across the forearm."""
    along = arm.forearm_direction
    across = np.cross(along, [0.3, 0.5, 0.8])
    turn = Rotation.from_rotvec(degrees * across / np.linalg.norm(across), degrees=True)
    levers = {
        joint: LeverArm(turn.apply(lever.position_m), lever.sigma_m)
        for joint, lever in arm.lever_arms.items()
    }
    return replace(arm, lever_arms=levers, R_F_A=None)


@pytest.mark.parametrize(("seed", "preset"), [(1, "realistic"), (2, "azure"), (3, "white")])
def test_the_recordings_own_calibration_fits(seed: int, preset: str) -> None:
    made = moving(seed, preset)
    for fits in (made.calibration, ArmCalibration()):
        assert not list(contradictions(segments_of(made), fits))


def test_another_mounting_or_person_is_named_with_its_angle_or_length() -> None:
    made = moving(1)
    segments, arm = segments_of(made), made.calibration
    for degrees in (40.0, 90.0, 173.0):
        (sentence,) = contradictions(segments, turned(arm, degrees))
        assert sentence.startswith("the calibration does not fit this recording: the IMU sits")
        assert abs(float(sentence.split("sits ")[1].split(" degrees")[0]) - degrees) < 6.0
    other = Length(arm.upper_arm.value_m - 0.12, 0.005)
    (sentence,) = contradictions(segments, replace(arm, upper_arm=other))
    assert "its upper arm is" in sentence
    assert not list(contradictions(segments, replace(arm, upper_arm=replace(other, sigma_m=0.08))))


@pytest.mark.parametrize(
    ("direction", "share", "fits"),
    [(0.9, 0.9, True), (1.1, 0.9, False), (0.9, 1.1, False), (np.nan, 0.1, False)],
)
def test_a_closed_form_fits_where_directions_and_accelerations_do(
    direction: float, share: float, fits: bool
) -> None:
    found = ClosedForm(direction * DIRECTION_DEG, share * ACCELERATION_SHARE, np.zeros(3), ArmCalibration())
    assert found.fits is fits
    assert found.misfit == pytest.approx(np.hypot(direction, share) if direction > 0 else np.inf)


@pytest.mark.slow
def test_a_mounting_with_a_rival_is_used_with_care() -> None:
    """An arm that hardly moves in view leaves open how the sensor sits; one that moves does not."""
    still = simulate_arm(ArmSimulation(repetitions=1, still_all=True), 1).recording
    for recording, is_open in ((still, True), (moving(1).recording, False)):
        cautions = answer(recording).estimates.cautions
        assert any("fits the visible motion nearly as well" in caution for caution in cautions) is is_open
